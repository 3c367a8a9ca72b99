"""What a unit is in SI, however it is spelled: `m/s^2`, `m s-2`, `N·mm`, `ft-lb`, `U/min`.

Not pint: importing it and building its registry takes 0.23 s, an eighth of a second run of
`identify`; and it takes `g` for grams and knows no `U/min`.
"""

import functools
import itertools
import math
import re
from collections.abc import Mapping
from typing import NamedTuple

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
    "l": (1e-3, "m^3"), "L": (1e-3, "m^3"),
}  # fmt: skip
"""Units that take a prefix: factor, and unit that is multiplied by it."""
PLAIN = {
    "micron": (1e-6, "m"), "in": (0.0254, "m"), "ft": (0.3048, "m"), "yd": (0.9144, "m"),
    "mil": (2.54e-5, "m"), "mile": (1609.344, "m"), "mph": (0.44704, "m/s"),
    "kph": (1 / 3.6, "m/s"), "kn": (1852 / 3600, "m/s"), "fps": (0.3048, "m/s"),
    "ips": (0.0254, "m/s"), "deg": (TURN / 360, "rad"), "gon": (TURN / 400, "rad"),
    "arcmin": (TURN / 21600, "rad"), "arcsec": (TURN / 1296000, "rad"), "rev": (TURN, "rad"),
    "dps": (TURN / 360, "rad/s"), "rps": (TURN, "rad/s"), "kgf": (GRAVITY, "N"),
    "gf": (1e-3 * GRAVITY, "N"), "dyn": (1e-5, "N"), "ozf": (POUND_FORCE / 16, "N"),
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
    powers = {unit.powers: unit.factor for unit in readings(other).values()}
    return some.strip() == other.strip() or any(
        math.isclose(unit.factor, powers.get(unit.powers, 0.0)) for unit in readings(some).values()
    )


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
    except (ValueError, LookupError):
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
        total = total.times(*_power(tokens, sign))
        if not tokens or tokens[0] == ")":
            return total
        operator = tokens.pop(0)
        if operator not in ("*", "/"):
            raise ValueError


def _power(tokens: list[str], sign: int) -> tuple[Unit, int]:
    """The next factor, and its power."""
    token = tokens.pop(0)
    if token == "(":
        factor = _product(tokens)
        tokens.remove(")")
    else:
        factor = _ONE if token == "1" else _named(token)
    given = bool(tokens) and tokens[0].strip("^()")[-1:].isdigit()
    return factor, sign * (int(tokens.pop(0).strip("^()")) if given else 1)


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
