"""Units as written in column names and unit rows: `Accel [m/s2]`, `force (N)`."""

import re

_ATOM = (
    r"(?:(?:da|[fpnuµμmcdhkMGT])?(?:m|s|g|N|Pa|V|A|W|J|Hz|K|C|F|T|H|Ohm|Ω|rad|l|L|bar|eV|Nm|S|mol)"
    r"|%|‰|°[CF]?|deg[CF]?|rev|rpm|psi|lbf?|kips?|in|inch|ft|mph|kn|min|h|hr|[sS]ec|seconds?|dB"
    r"|[cC]ounts?|Volts?|Amps?|1|-)"
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
