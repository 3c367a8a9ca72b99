"""Units as written in column names and unit rows: `Accel [m/s2]`, `force (N)`."""

import re

from riecjax.records.reading.unit_expressions import readings

NO_FACTOR = frozenset(
    ("%", "‰", "°C", "°F", "degC", "degF", "Celsius", "celsius", "dB", "counts", "Counts", "count",
     "Count", "1", "-")
)  # fmt: skip
"""Units that are more, or less, than a factor."""
SHORT = frozenset(("t", "d", "D"))
"""Names of one letter that are not taken for units."""
_BRACKETS = re.compile(r"\[([^\[\]]*)\]|\(([^()]*)\)|<([^<>]*)>")
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

SECONDS = {
    **dict.fromkeys(("s", "S", "sec", "Sec", "secs", "second", "seconds"), 1.0),
    **dict.fromkeys(("ms", "msec", "millisecond", "milliseconds", "millis"), 1e-3),
    **dict.fromkeys(("us", "µs", "μs", "usec", "microsecond", "microseconds", "micros"), 1e-6),
    **dict.fromkeys(("ns", "nsec", "nanosecond", "nanoseconds", "nanos"), 1e-9),
    **dict.fromkeys(("min", "minute", "minutes"), 60.0),
    **dict.fromkeys(("h", "hr", "hour", "hours"), 3600.0),
    **dict.fromkeys(("d", "day", "days"), 86400.0),
}
"""Seconds in each unit of time."""


def is_known(text: str) -> bool:
    """Whether a text is a unit and, alone, no name."""
    return text not in SHORT and (
        text in NO_FACTOR or text.lower() in SECONDS or bool(readings(text))
    )


def is_unit(text: str) -> bool:
    """Whether a field of a row is a unit, and not a name: in brackets, or of known units."""
    return bool(_BRACKETS.fullmatch(text)) or is_known(text)


def bare_unit(text: str) -> str:
    """A unit without the brackets around it."""
    bracketed = _BRACKETS.fullmatch(text)
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
