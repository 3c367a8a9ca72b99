"""Units: how names and rows say them, what they are in SI, and what models read instead.

However it is spelled, `m/s^2`, `m s-2`, `N·mm`, `ft-lb`, a unit is a factor times powers of SI's
base units. `units.txt` says which there are. Not pint: to import it takes 0.3 s, it reads `fin` as
femtoinches, and parses a text of 100 kB for 100 s.
"""

import functools
import itertools
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from riecjax.errors import DataError

_LINES = Path(__file__).with_name("units.txt").read_text(encoding="utf-8").splitlines()


def _definitions(kind: str) -> dict[str, str]:
    """Names, parted by spaces, to what they mean."""
    lines = (line.removeprefix(f"{kind}: ") for line in _LINES if line.startswith(f"{kind}: "))
    parts = (each.partition(" = ") for line in lines for each in line.split("; "))
    return {names: meaning for names, _, meaning in parts}


def _by_name(kind: str) -> dict[str, str]:
    defined = _definitions(kind).items()
    return {name: meaning for names, meaning in defined for name in names.split(" ")}


BASE = tuple(k.split(" ")[0].lstrip("*") for k, of in _definitions("units").items() if of == "1")
PREFIXES = {name: float(factor) for name, factor in _by_name("prefixes").items()}
UNITS = {
    name.lstrip("*"): (names.split(" ")[0], *meaning.partition(" ")[::2])
    for names, meaning in _definitions("units").items()
    for name in names.split(" ")
}
"""By every name of a unit, the first, with a `*` if it takes a prefix, its factor, and of what."""
WHOLE = _by_name("whole")
"""Units that are no products of others, or would be others as such."""
DOUBLE = {name: meanings.split(" ") for name, meanings in _by_name("double").items()}
"""Units whose spelling has two meanings."""
USUAL = tuple(_definitions("usual"))
"""What quantities are said to be in, in SI."""
SECONDS = {name: float(factor) for name, factor in _by_name("seconds").items()}
"""Seconds in each unit of time."""
MINUTE, HOUR, DAY = (SECONDS[name] for name in ("min", "h", "d"))

_SPELLED = {"⁻¹": "^-1", "⁻²": "^-2", "⁻³": "^-3", "²": "^2", "³": "^3", "**": "^", "µ": "u",
            "μ": "u", "º": "°", "\N{MINUS SIGN}": "-"}  # fmt: skip
_TIMES = re.compile(
    r"\s*[·⋅∙•×*]\s*|(?<=[^\W\d])-(?=[^\W\d])|(?<=\w)\.(?=[^\W\d])|(?<=[\w°)])\s+(?=[\w°(])"
)
_TOKEN = re.compile(r"[^\W\d]+|°|[()*/]|\^?-?\d+|\^\(-?\d+\)")
_WORD = re.compile(rf"(?<![\w°])(?:{'|'.join(DOUBLE)})(?![^\W\d])")


class Unit(NamedTuple):
    """A factor times powers of SI's base units, in the order of [`BASE`][]."""

    factor: float
    powers: tuple[int, ...]

    def times(self, other: "Unit", power: int) -> "Unit":
        """This unit times a power of another."""
        powers = tuple(a + power * b for a, b in zip(self.powers, other.powers, strict=True))
        return Unit(self.factor * other.factor**power, powers)


_ONE = Unit(1.0, (0,) * len(BASE))


@functools.cache
def readings(text: str) -> Mapping[str, Unit]:
    """What a text may mean as a unit, by a spelling that says so; of two where it is double.

    A word means the same wherever it stands in the text. Where quantities are usually in one and
    not in the other, that is meant: in `ft-lb`, the pound is a force.
    """
    spelled = functools.reduce(lambda s, old: s.replace(old, _SPELLED[old]), _SPELLED, text.strip())
    spelled = WHOLE.get(spelled, spelled)
    found: dict[str, Unit] = {}
    words = dict.fromkeys(_WORD.findall(spelled))
    for choice in itertools.product(*map(DOUBLE.__getitem__, words)):
        meant = dict(zip(words, choice))
        one = _WORD.sub(lambda match, meant=meant: meant[match[0]], spelled)
        if (unit := _unit(one)) and unit not in found.values():
            found[one] = unit
    return {one: unit for one, unit in found.items() if unit.powers in _usual()} or found


def same(some: str, other: str) -> bool:
    """Whether two texts are one unit, spelled alike or not."""
    if some.strip() == other.strip():
        return True
    powers = {unit.powers: unit.factor for unit in readings(other).values()}
    return any(
        math.isclose(unit.factor, powers.get(unit.powers, 0.0)) for unit in readings(some).values()
    )


def contradict(some: str, other: str) -> bool:
    """Whether two texts are units, and not the same."""
    return not same(some, other) and bool(readings(some) and readings(other))


def usual_name(unit: Unit) -> str:
    """What SI calls the unit with these powers of its base units."""
    powers = zip(BASE, unit.powers, strict=True)
    return _usual().get(unit.powers) or " ".join(
        f"{n}^{p}".removesuffix("^1") for n, p in powers if p
    )


@functools.cache
def _usual() -> dict[tuple[int, ...], str]:
    units = {name: _unit(name) for name in reversed(USUAL)}
    return {unit.powers: name for name, unit in units.items() if unit}


def _unit(text: str) -> Unit | None:
    joined = _TIMES.sub("*", text).replace(" ", "")
    tokens = _TOKEN.findall(joined)
    if "".join(tokens) != joined:
        return None
    try:
        unit = _product(tokens)
    except (ValueError, LookupError, RecursionError, OverflowError):
        return None
    return None if tokens else unit


def _product(tokens: list[str]) -> Unit:
    """The product that begins here, up to its closing bracket.

    **Raises:** `LookupError` for an unknown unit, `ValueError` for what is no product, and for
    `a/b c`, which may be two.
    """
    total, sign, operator = _ONE, 1, "*"
    while True:
        if operator == "/":
            sign = -1
        elif sign < 0:
            raise ValueError
        token = tokens.pop(0)
        if token == "(":
            factor = _product(tokens)
            tokens.remove(")")
        else:
            factor = _ONE if token == "1" else _named(token)
        powered = bool(tokens) and tokens[0].strip("^()")[-1:].isdigit()
        total = total.times(factor, sign * int(tokens.pop(0).strip("^()") if powered else 1))
        if not tokens or tokens[0] == ")":
            return total
        operator = tokens.pop(0)
        if operator not in ("*", "/"):
            raise ValueError


@functools.cache
def _named(name: str) -> Unit:
    """The unit of one name, perhaps with a prefix; a word of three letters or more, which is no
    symbol, perhaps in capitals or plural.

    **Raises:** `LookupError` if there is none.
    """
    for word in (name, name.lower(), name.lower().removesuffix("s")):
        if word != name and len(word) <= 2:
            continue
        if word in UNITS:
            first, factor, of = UNITS[word]
            powers = tuple(int(first.lstrip("*") == base) for base in BASE)
            return Unit(float(factor), powers).times(_unit(of) or _ONE, 1)
        for prefix, factor in PREFIXES.items():
            base = word.removeprefix(prefix)
            first = UNITS.get(base, ("",))[0]
            # No one measures in megametres: Mm is a slip for mm.
            is_symbol = first == f"*{base}" and word == name != "Mm"
            if base != word and (is_symbol or (first.startswith("*") and len(prefix) > 2)):
                return Unit(factor, _ONE.powers).times(_named(base), 1)
    raise LookupError(name)


NO_FACTOR = frozenset(
    ("%", "‰", "°C", "°F", "degC", "degF", "Celsius", "celsius", "dB", "counts", "Counts", "count",
     "Count", "1", "-")
)  # fmt: skip
"""Units that are more, or less, than a factor."""
SHORT = frozenset(("t", "d", "D"))
"""Names of one letter that are not taken for units."""
BRACKETS = re.compile(r"\[([^\[\]]*)\]|\(([^()]*)\)|<([^<>]*)>")
_SUFFIXED = re.compile(r"(?P<name>.*\S)\s*(?:\[(?P<square>[^\[\]]+)\]|\((?P<round>[^()]+)\))\s*")
_SEPARATOR = re.compile(r"\s*/\s*|\s*,\s+|\s+in\s+")
_RATE = re.compile(r"(?:[kcmu]?m|k?N|rad|deg|°|rev|in|ft|l|L|U|1)/.*")
"""What is a unit as a whole: `m/s` is no m in seconds, as `F/kN` is a force in kN."""
_BEHIND = re.compile(
    r".*[^\W_][ _.-]+(?P<unit>(?:[mukµμ]m|[kmMK]N|daN|lbf|kgf|kNm|Nmm|inch|inches|deg|degrees"
    r"|m?rad|rpm|RPM|dps|kmh|kph|mph|[mukµμ][VA]|[hkM]Pa|mbar)(?:(?:_per_|[_/p])(?:s2?|sec|h))?)"
)
DOUBTFUL = ("cm", "g", "in", "ft", "bar", "psi")
"""What may be a unit behind a name, or say something else: the centre of mass, an input, a mean, an
angle."""


def is_known(text: str) -> bool:
    """Whether a text is a unit and, alone, no name."""
    return text not in SHORT and (
        text in NO_FACTOR or text.lower() in SECONDS or bool(readings(text))
    )


def bare_unit(text: str) -> str:
    """A unit without the brackets around it."""
    bracketed = BRACKETS.fullmatch(text)
    return next(filter(None, bracketed.groups()), "") if bracketed else text


def unit_behind(column: str) -> str | None:
    """The unit that stands behind a name without brackets, as in `x_mm`, where it is one for sure.

    Units that need no conversion are none of these.
    """
    found = _BEHIND.fullmatch(column)
    return re.sub(r"_per_|_|(?<=[mg])p(?=[sh])", "/", found["unit"]) if found else None


def split_unit(column: str, grouped: bool = False) -> tuple[str, str | None]:
    """A column's name without its unit, and the unit: `("force", "N")` of `force (N)`.

    In square brackets anything but an index is a unit; in round ones and behind a stroke, a comma
    or `in` only a known unit is, as in `speed (left)`, `force / kN`, `Weg in mm`. `m/s` is a name.

    **Arguments:** `grouped`: strokes part groups, as in `run/F`.
    """
    whole = _RATE.fullmatch(column) or (grouped and "/" in column)
    for separator in _SEPARATOR.finditer("" if whole else column):
        head, tail = column[: separator.start()].strip(), column[separator.end() :].strip()
        tail = tail[1:-1] if tail.startswith("(") and tail.endswith(")") else tail
        if head and head.count("(") == head.count(")") and is_known(tail):
            return head, tail
    found = _SUFFIXED.fullmatch(column)
    if found and found["square"] and not found["square"].strip().isdigit():
        return found["name"], found["square"].strip()
    if found and found["round"] and is_known(found["round"].strip()):
        return found["name"], found["round"].strip()
    return column, None


BY_ATTRIBUTE = ", as counts with an attribute "
"""What stands between the unit of counts and an attribute that may be their factor."""


class Conversion(NamedTuple):
    """The SI unit that a unit is turned into, and the factor to it."""

    unit: str
    factor: float


def conversion(signal: str, unit: str, wanted: str = "") -> Conversion | None:
    """How a signal's unit is turned into SI; `None` where it is SI already, or of no known unit.

    **Arguments:** `wanted`: the unit in which the model reads the signal, if it says one; then no
    other is converted to.

    **Raises:** `DataError` where a unit has two meanings and nothing says which, as `g`, of mass
    or of acceleration; and for `mm or m`, where a file says both.
    """
    if BY_ATTRIBUTE in unit:
        stated, _, attribute = unit.partition(BY_ATTRIBUTE)
        raise DataError(
            f"'{signal}' holds whole numbers, and its dataset has an attribute '{attribute}': say "
            f"whether they are counts, to be multiplied: scale={{'{signal}': ...}} (on the command "
            f"line: --scale {signal}=FACTOR), or {stated} already (--unit {signal}={stated})."
        )
    if " or " in unit:
        raise DataError(
            f"the name of '{signal}' and the row of units say {unit}; say which: units={{'{signal}'"
            f": '{unit.split()[0]}'}} (on the command line: --unit {signal}={unit.split()[0]})."
        )
    if wanted and same(unit, wanted):
        return None
    names = (wanted,) if wanted else USUAL
    targets = {target.powers: target for name in names for target in readings(name).values()}
    found = {
        spelled: Conversion(wanted or usual_name(one), one.factor / targets[one.powers].factor)
        for spelled, one in readings(unit).items()
        if one.powers in targets
    }
    if len(found) > 1:
        kinds = " or ".join(
            f"{spelled} ({usual_name(readings(unit)[spelled])})" for spelled in found
        )
        typed = " or ".join(f"--unit {signal}={spelled}" for spelled in found)
        raise DataError(
            f"'{signal}' is in {unit}, which may be {kinds}; say which: units={{'{signal}': "
            f"'{next(iter(found))}'}} (on the command line: {typed})."
        )
    one = next(iter(found.values()), None)
    return one if one and (one.factor != 1 or wanted) else None


def require_known_unit(signal: str, unit: str) -> None:
    """Refuse a unit that nothing can be converted from with a `DataError`."""
    if not (is_known(unit) or readings(unit) or " since " in unit):
        raise DataError(
            f"the unit '{unit}' of '{signal}' is not known; multiply by a factor instead: scale="
            f"{{'{signal}': ...}} (on the command line: --scale {signal}=FACTOR)."
        )


def require_sure_unit(signal: str, column: str, wanted: str) -> None:
    """Refuse a column such as `x_cm` where that may be a unit of the kind that the model reads.

    **Raises:** `DataError` that asks for the unit.
    """
    tail = re.split(r"[ _.-]", column)[-1]
    if wanted and tail != column and tail in DOUBTFUL and conversion(signal, tail, wanted):
        raise DataError(
            f"column '{column}' may be in {tail}, or be called so for another reason; say its unit:"
            f" units={{'{signal}': '{tail}'}} or '{wanted}' (on the command line: --unit"
            f" {signal}={tail} or --unit '{signal}={wanted}')."
        )
