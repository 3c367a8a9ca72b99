"""Units: how names and rows say them, what they are in SI, and what models read instead.

However it is spelled, `m/s^2`, `m s-2`, `N·mm`, `ft-lb`, `U/min`, a unit is a factor times powers
of SI's base units. Not pint: importing it and building its registry takes 0.23 s, an eighth of a
second run of `identify`; and it takes `g` for grams and knows no `U/min`.
"""

import functools
import itertools
import math
import re
from collections.abc import Mapping
from typing import NamedTuple

from riecjax.errors import DataError

GRAVITY, POUND, TURN = 9.80665, 0.45359237, 6.283185307179586
POUND_FORCE = POUND * GRAVITY

BASE = ("kg", "m", "A", "K", "rad", "s")
PREFIXES = {"da": 10.0, "h": 100.0, "d": 0.1, "c": 0.01, "m": 1e-3, "u": 1e-6, "n": 1e-9,
            "p": 1e-12, "f": 1e-15, "k": 1e3, "K": 1e3, "M": 1e6, "G": 1e9}  # fmt: skip
PREFIXED = {
    **{base: (1.0, base) for base in BASE if base != "kg"},
    "g": (1e-3, "kg"), "gram": (1e-3, "kg"), "gn": (GRAVITY, "m/s^2"), "N": (1.0, "kg m/s^2"),
    "lbf": (POUND_FORCE, "N"), "Nm": (1.0, "N m"), "Ns": (1.0, "N s"), "Nms": (1.0, "N m s"),
    "Pa": (1.0, "N/m^2"), "bar": (1e5, "Pa"), "J": (1.0, "N m"), "eV": (1.602176634e-19, "J"),
    "W": (1.0, "J/s"), "V": (1.0, "W/A"), "C": (1.0, "A s"), "F": (1.0, "C/V"),
    "S": (1.0, "A/V"), "Ohm": (1.0, "V/A"), "Wb": (1.0, "V s"), "H": (1.0, "Wb/A"),
    "T": (1.0, "Wb/m^2"), "Hz": (1.0, "1/s"), "rpm": (TURN / 60, "rad/s"),
    "l": (1e-3, "m^3"), "L": (1e-3, "m^3"), "Gal": (0.01, "m/s^2"),
}  # fmt: skip
"""Units that take a prefix: factor, and unit that is multiplied by it."""
PLAIN = {
    "micron": (1e-6, "m"), "in": (0.0254, "m"), "ft": (0.3048, "m"), "yd": (0.9144, "m"),
    "mil": (2.54e-5, "m"), "mile": (1609.344, "m"), "mph": (0.44704, "m/s"),
    "kph": (1 / 3.6, "m/s"), "kn": (1852 / 3600, "m/s"), "fps": (0.3048, "m/s"),
    "ips": (0.0254, "m/s"), "deg": (TURN / 360, "rad"), "gon": (TURN / 400, "rad"),
    "arcmin": (TURN / 21600, "rad"), "arcsec": (TURN / 1296000, "rad"), "rev": (TURN, "rad"),
    "dps": (TURN / 360, "rad/s"), "rps": (TURN, "rad/s"), "kgf": (GRAVITY, "N"),
    "gf": (1e-3 * GRAVITY, "N"), "tf": (1e3 * GRAVITY, "N"), "dyn": (1e-5, "N"),
    "ozf": (POUND_FORCE / 16, "N"),
    "kip": (1e3 * POUND_FORCE, "N"), "Nmm": (1e-3, "N m"), "Ncm": (0.01, "N m"),
    "psi": (POUND_FORCE / 0.0254**2, "Pa"), "ksi": (1e3 * POUND_FORCE / 0.0254**2, "Pa"),
    "atm": (101325.0, "Pa"), "torr": (101325 / 760, "Pa"), "mmHg": (133.322387415, "Pa"),
    "t": (1e3, "kg"), "lbm": (POUND, "kg"), "ozm": (POUND / 16, "kg"),
    "slug": (POUND_FORCE / 0.3048, "kg"), "hp": (550 * 0.3048 * POUND_FORCE, "W"),
    "min": (60.0, "s"), "h": (3600.0, "s"),
}  # fmt: skip
"""Units that take none."""
ALIASES = {
    "meter": "m", "metre": "m", "second": "s", "sec": "s", "newton": "N", "pascal": "Pa",
    "volt": "V", "ampere": "A", "amp": "A", "radian": "rad", "watt": "W", "joule": "J",
    "hertz": "Hz", "liter": "l", "litre": "l", "tonne": "t", "inch": "in", "inche": "in",
    "foot": "ft", "feet": "ft", "thou": "mil", "kmh": "kph", "kmph": "kph", "kt": "kn",
    "kts": "kn", "knot": "kn", "°": "deg", "Grad": "deg", "degree": "deg", "turn": "rev",
    "revolution": "rev", "gee": "gn", "gravity": "gn", "kp": "kgf", "lb_f": "lbf", "Ω": "Ohm",
    "minute": "min", "hr": "h", "hour": "h", "VDC": "V", "psig": "psi", "psia": "psi",
    "barg": "bar", "bara": "bar", "MM": "mm", "CM": "cm", "IN": "in", "FT": "ft",
}  # fmt: skip
"""Other words for a unit; of these, and of all of three letters or more, capitals are no others."""
LONG_PREFIX = {"milli": "m", "centi": "c", "micro": "u", "kilo": "k", "mega": "M", "nano": "n"}
WHOLE = {
    "1/min": "rpm", "min^-1": "rpm", "min-1": "rpm", "/min": "rpm", "r/min": "rpm",
    "U/min": "rpm", "Umin": "rpm", "tr/min": "rpm", "U/s": "rps", "r/s": "rps", "G": "gn",
    "g0": "gn", "g_n": "gn", "g's": "gn", "g-force": "gn", "ftlb": "ft lbf", "lbft": "ft lbf",
    "inlb": "in lbf", "lbin": "in lbf",
}  # fmt: skip
"""Units that are no products of others, or would be others as such."""
POUNDS = ("lb", "lbs", "LB", "LBS", "Lbs", "pound", "pounds", "Pound", "Pounds")
DOUBLE = {
    **dict.fromkeys(POUNDS, ("lbf", "lbm")), "oz": ("ozf", "ozm"), "g": ("gn", "gram"),
    "mg": ("mgn", "mgram"), "ug": ("ugn", "ugram"), "grad": ("deg", "gon"),
}  # fmt: skip
"""Units whose spelling has two meanings."""
USUAL = (
    "m", "m/s", "m/s^2", "m/s^3", "N", "N m", "rad", "rad/s", "rad/s^2", "Pa", "kg", "V", "A",
    "Wb", "W", "Hz", "s", "N/m", "N s/m", "N m/rad", "N m s/rad", "kg/s", "kg m^2",
    "m^2", "m^3", "m^3/s", "T", "Ohm", "H", "V/m", "N/V", "N/A",
)  # fmt: skip
"""What quantities are said to be in, in SI."""

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

    Where quantities are usually in one and not in the other, that is meant: in `ft-lb`, the pound
    is a force.
    """
    spelled = functools.reduce(lambda s, old: s.replace(old, _SPELLED[old]), _SPELLED, text.strip())
    spelled = WHOLE.get(spelled, spelled)
    found: dict[str, Unit] = {}
    for choice in itertools.product(*(DOUBLE[word] for word in _WORD.findall(spelled))):
        words = iter(choice)
        one = _WORD.sub(lambda match, words=words: next(words), spelled)
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
    except (ValueError, LookupError, RecursionError):
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


def _named(name: str) -> Unit:
    """The unit of one name, perhaps with a prefix.

    **Raises:** `LookupError` if there is none.
    """
    if name in ALIASES:
        return _named(ALIASES[name])
    if name in BASE:
        return Unit(1.0, tuple(int(name == base) for base in BASE))
    if name in _TABLE:
        factor, of = _TABLE[name]
        return Unit(factor, _ONE.powers).times(_unit(of) or _ONE, 1)
    for prefix, factor in PREFIXES.items():
        base = name.removeprefix(prefix)
        # No one measures in megametres: Mm is a slip for mm.
        if base != name and base in PREFIXED and name != "Mm":
            return Unit(factor, _ONE.powers).times(_named(base), 1)
    return _named(_word(name))


_TABLE = PREFIXED | PLAIN


def _word(name: str) -> str:
    """A word of three letters or more without its capitals and its plural, its prefix short.

    **Raises:** `LookupError` if it is none.
    """
    for word in (name.lower(), name.lower().removesuffix("s")):
        if len(word) > 2 and word != name and (word in ALIASES or word in _TABLE):
            return word
        for long, short in LONG_PREFIX.items():
            base = word.removeprefix(long)
            if base != word and ALIASES.get(base, base) in PREFIXED:
                return short + ALIASES.get(base, base)
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

MINUTE, HOUR = PLAIN["min"][0], PLAIN["h"][0]
DAY = 24 * HOUR
SECONDS = {
    **dict.fromkeys(("s", "S", "sec", "Sec", "secs", "second", "seconds"), 1.0),
    **dict.fromkeys(("ms", "msec", "millisecond", "milliseconds", "millis"), PREFIXES["m"]),
    **dict.fromkeys(("us", "µs", "μs", "usec", "microsecond", "microseconds", "micros"),
                    PREFIXES["u"]),
    **dict.fromkeys(("ns", "nsec", "nanosecond", "nanoseconds", "nanos"), PREFIXES["n"]),
    **dict.fromkeys(("min", "minute", "minutes"), MINUTE),
    **dict.fromkeys(("h", "hr", "hour", "hours"), HOUR),
    **dict.fromkeys(("d", "day", "days"), DAY),
}  # fmt: skip
"""Seconds in each unit of time."""


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
