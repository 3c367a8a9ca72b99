"""Units as written in column names and unit rows: `Accel [m/s2]`, `force (N)`."""

import re

_ATOM = (
    r"(?:(?:da|[fpnuµμmcdhkMGT])?(?:m|s|g|N|Pa|V|A|W|J|Hz|K|C|F|T|H|Ohm|Ω|rad|l|L|bar|eV|Nm|S|mol)"
    r"|%|‰|°[CF]?|deg[CF]?|rev|rpm|psi|lbf?|kips?|in|inch|ft|mph|kn|min|h|hr|[sS]ec|seconds?|dB"
    r"|[cC]ounts?|1|-)"
)
_POWER = r"(?:\^?[(]?-?\d[)]?|[⁻¹²³⁴]+|\*\*-?\d)?"
UNIT = re.compile(rf"{_ATOM}{_POWER}(?:[/*·. ]{_ATOM}{_POWER})*")
_BRACKETS = re.compile(r"\[([^\[\]]*)\]|\(([^()]*)\)|<([^<>]*)>")
_SUFFIXED = re.compile(r"(?P<name>.*\S)\s*(?:\[(?P<square>[^\[\]]+)\]|\((?P<round>[^()]+)\))\s*")
_SEPARATOR = re.compile(r"\s*/\s*|\s*,\s+|\s+in\s+")
_RATE = re.compile(r"(?:[kcmu]?m|k?N|rad|deg|°|rev|in|ft|l|L|U|1)/.*")
"""What is a unit as a whole: `m/s` is no m in seconds, as `F/kN` is a force in kN."""

SECONDS = {
    **dict.fromkeys(("s", "S", "sec", "Sec", "secs", "second", "seconds"), 1.0),
    **dict.fromkeys(("ms", "msec", "millisecond", "milliseconds"), 1e-3),
    **dict.fromkeys(("us", "µs", "μs", "usec", "microsecond", "microseconds"), 1e-6),
    **dict.fromkeys(("ns", "nsec", "nanosecond", "nanoseconds"), 1e-9),
    **dict.fromkeys(("min", "minute", "minutes"), 60.0),
    **dict.fromkeys(("h", "hr", "hour", "hours"), 3600.0),
}
"""Seconds in each unit of time."""


NOT_SI = {
    "km": ("m", 1e3),
    "dm": ("m", 0.1),
    "cm": ("m", 0.01),
    "mm": ("m", 1e-3),
    "um": ("m", 1e-6),
    "µm": ("m", 1e-6),
    "in": ("m", 0.0254),
    "inch": ("m", 0.0254),
    "ft": ("m", 0.3048),
    "mm/s": ("m/s", 1e-3),
    "cm/s": ("m/s", 0.01),
    "km/h": ("m/s", 1 / 3.6),
    "mph": ("m/s", 0.44704),
    "mm/s2": ("m/s^2", 1e-3),
    # Accelerometers' g; nothing that moves is weighed in grams.
    "g": ("m/s^2", 9.80665),
    "gn": ("m/s^2", 9.80665),
    "mg": ("m/s^2", 9.80665e-3),
    "kN": ("N", 1e3),
    "MN": ("N", 1e6),
    "mN": ("N", 1e-3),
    "daN": ("N", 10.0),
    "lbf": ("N", 4.4482216152605),
    "kNm": ("N m", 1e3),
    "deg": ("rad", 0.017453292519943295),
    "°": ("rad", 0.017453292519943295),
    "deg/s": ("rad/s", 0.017453292519943295),
    "°/s": ("rad/s", 0.017453292519943295),
    "rpm": ("rad/s", 0.10471975511965977),
    "bar": ("Pa", 1e5),
    "kPa": ("Pa", 1e3),
    "MPa": ("Pa", 1e6),
    "t": ("kg", 1e3),
}
"""Units that loggers write and models do not compute in: the SI unit, and the factor to it."""


def is_unit(text: str) -> bool:
    """Whether a field of a row is a unit, and not a name: in brackets, or of known units."""
    bracketed = _BRACKETS.fullmatch(text)
    return bool(bracketed or UNIT.fullmatch(text))


def bare_unit(text: str) -> str:
    """A unit without the brackets around it."""
    bracketed = _BRACKETS.fullmatch(text)
    return next(filter(None, bracketed.groups()), "") if bracketed else text


def split_unit(column: str) -> tuple[str, str | None]:
    """A column's name without its unit, and the unit: `("force", "N")` of `force (N)`.

    In square brackets anything but an index is a unit; in round ones and behind a stroke, a comma
    or `in` only a known unit is, as in `speed (left)`, `force / kN`, `Weg in mm`. `m/s` is a name.
    """
    for separator in _SEPARATOR.finditer("" if _RATE.fullmatch(column) else column):
        head, tail = column[: separator.start()].strip(), column[separator.end() :].strip()
        tail = tail[1:-1] if tail.startswith("(") and tail.endswith(")") else tail
        if head and head.count("(") == head.count(")") and UNIT.fullmatch(tail):
            return head, tail
    found = _SUFFIXED.fullmatch(column)
    if found and found["square"] and not found["square"].strip().isdigit():
        return found["name"], found["square"].strip()
    if found and found["round"] and UNIT.fullmatch(found["round"].strip()):
        return found["name"], found["round"].strip()
    return column, None
