"""What texts say: numbers, dates and clocks, one by one and by the column."""

import contextlib
import functools
import itertools
import re
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute

from riecjax.errors import DataError
from riecjax.records.reading.times import unwrapped
from riecjax.records.reading.units import DAY, HOUR, MINUTE

MISSING = ("", "NaN", "nan", "NAN", "NA", "na", "N/A", "n/a", "<NA>", "null", "NULL", "Null",
           "None", "none", "-nan", "nan(ind)", "-nan(ind)", "NaT", "missing", "NO DATA", "No Data",
           "OVER", "Over", "OVLD", "OVERLOAD", "Overload", "OVERRANGE", "OverRange", "OVERFLOW",
           "Overflow", "+OVER", "-OVER", "OL", "+OL", "-OL")  # fmt: skip
"""What loggers and spreadsheets write where there is no value, or one past the sensor's range."""
_NOTHING = (
    r"-+|\*+|[+-]?1\.#(?:QNAN|SNAN|IND|INF)0*|#(?:N/A|DIV/0!|VALUE!|NUM!|REF!|NAME\?|NULL!)|#+"
)
_EXPONENT = r"(?:[eEdD][+-]?\d+)?"
_INFINITE = r"[+-]?(?:[iI]nf(?:inity)?|INF)"
# Thousands and a fraction: either sign can be only what it is.
_POINTED = r"[+-]?[1-9]\d{0,2}(?:,\d{2,3})*,\d{3}\.\d+"
_COMMAED = r"[+-]?[1-9]\d{0,2}(?:\.\d{3})+,\d+"
NUMBER = {
    ".": rf"^(?:[+-]?(?:\d+\.?\d*|\.\d+){_EXPONENT}|{_POINTED}|{_INFINITE})$",
    # Digits on both sides: a comma at the end of a field is a delimiter.
    ",": rf"^(?:[+-]?\d+(?:,\d+)?{_EXPONENT}|{_COMMAED}|{_INFINITE})$",
}
"""A number by its decimal sign."""
GROUPED = {
    ".": r"^[+-]?[1-9]\d{0,2}(?:,\d{3})+(?:\.\d*)?$",
    ",": r"^[+-]?[1-9]\d{0,2}(?:\.\d{3})+(?:,\d*)?$",
}
"""A number with its digits grouped in thousands, by its decimal sign."""
_NUMBER = {sign: re.compile(pattern) for sign, pattern in NUMBER.items()}
_MISSING_PATTERN = f"^(?:{'|'.join(map(re.escape, MISSING))}|{_NOTHING})$"
_MISSING = re.compile(_MISSING_PATTERN)


compute: Any = pyarrow.compute
"""Its functions are made on import, unseen by type checkers."""


def stripped(text: Any) -> Any:
    """A column of strings (PyArrow) without white space around, null where a value is missing."""
    text = compute.utf8_trim_whitespace(text)
    # No list of words and no scalar: for these PyArrow imports pandas, where there is one.
    missing = compute.match_substring_regex(text, _MISSING_PATTERN)
    return compute.if_else(missing, pa.nulls(1, pa.string())[0], text)


def numbers(text: Any, decimal: str, grouped: bool) -> np.ndarray | None:
    """A column of stripped strings as floats, NaN for null; `None` if some are no numbers.

    `grouped`: the other sign may separate thousands.
    """
    plain = text
    if decimal == ",":
        if compute.any(compute.match_substring(text, ".")).as_py():
            if not all_true(is_numeric(text, decimal, grouped)):
                return None
            plain = compute.replace_substring(plain, ".", "")
        plain = compute.replace_substring(plain, ",", ".")
    try:
        return floats(compute.cast(plain, pa.float64()))
    except pa.ArrowInvalid:
        pass
    if not all_true(is_numeric(text, decimal, grouped)):
        return None
    # What is a number but not to PyArrow: a plus sign, Fortran's exponents, thousands.
    for pattern, sign in ((r"^\+", ""), ("[dD]", "e"), (",", "")):
        plain = compute.replace_substring_regex(plain, pattern, sign)
    return floats(compute.cast(plain, pa.float64()))


def is_numeric(text: Any, decimal: str, grouped: bool) -> Any:
    """Which of a column of strings are numbers; null where null."""
    found = compute.match_substring_regex(text, NUMBER[decimal])
    return (
        compute.or_(found, compute.match_substring_regex(text, GROUPED[decimal]))
        if grouped
        else found
    )


# PyArrow's own conversions, of a single number too, import pandas wherever that is installed.
_NAN = pa.Array.from_buffers(pa.float64(), 1, [None, pa.py_buffer(np.full(1, np.nan))])[0]


def floats(column: Any) -> np.ndarray:
    """A column of PyArrow's 64-bit floats, shape `(n,)`, NaN for null."""
    whole = column.combine_chunks() if isinstance(column, pa.ChunkedArray) else column
    return np.array(np.from_dlpack(compute.coalesce(whole, _NAN)))


def all_true(mask: Any) -> bool:
    """Whether a column of truth values holds no False; nulls do not count."""
    return compute.all(mask).as_py() is not False


_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_ZONE = r"(?:Z|z|(?:UTC|GMT)?[+-]\d{1,2}(?::?\d{2})?|UTC|GMT|[A-Z]{3,4})"
_DATES = (
    r"(?P<year>\d{4})[-/.](?P<month>\d{1,2})[-/.](?P<day>\d{1,2})",
    r"(?P<first>\d{1,2})[-/.](?P<second>\d{1,2})[-/.](?P<year>\d{4}|\d{2})",
    r"(?P<day>\d{1,2})[- ](?P<name>[A-Za-z]{3})[a-z]*\.?[- ,]+(?P<year>\d{4}|\d{2})",
    r"(?P<name>[A-Z][a-z]{2})[a-z]*\.? (?P<day>\d{1,2}), ?(?P<year>\d{4})",
    r"(?P<year>\d{4})(?P<month>\d{2})(?P<day>\d{2})",
    r"(?P<days>\d+) days?",
    "",
)
_TIMES_OF_DAY = (
    r"(?P<hours>\d{1,4}):(?P<minutes>[0-5]?\d)"
    r"(?::(?P<seconds>[0-5]?\d|60)(?P<fraction>[.,:]\d+|\.|,)?)?",
    r"(?P<hours>\d\d)(?P<minutes>\d\d)(?P<seconds>\d\d)(?P<fraction>[.,]\d+)?",
)
PATTERNS = (
    # ISO 8601 (also compact), or as spreadsheets and MATLAB write it; or a time of day, or an
    # elapsed one, alone.
    *(
        rf"^(?:[A-Z][a-z]{{2}},? )?{date}[T ,]*{clock}\s*(?P<half>[AaPp]\.?[Mm]\.?)?"
        rf"\s*(?P<zone>{_ZONE})?(?:\[[^\]]*\])?$"
        for date, clock in itertools.product(_DATES, _TIMES_OF_DAY)
    ),
    # Minutes, seconds and their fraction, all that a spreadsheet's `mm:ss.0` shows of a time.
    r"^(?P<minutes>[0-5]?\d):(?P<seconds>[0-5]\d)(?P<fraction>[.,]\d+)$",
    # Day of the year and time of day, as IRIG and recorders in flight tests have it.
    r"^(?P<days>[0-3]\d\d):(?P<hours>\d\d):(?P<minutes>[0-5]\d):(?P<seconds>[0-5]\d)"
    r"(?P<fraction>[.,]\d+)$",
)
"""Time stamps."""
_COMPILED = tuple(map(re.compile, PATTERNS))
_ANY = re.sub(r"\?P<\w+>", "", "|".join(PATTERNS))
"""The same as one, whose groups have no names, of which each may be there once."""


def kinds_of(fields: list[str], decimal: str) -> str:
    """What fields hold, a letter for each: `M`, nothing; `N`, a number; `S`, a time stamp; `D`, a
    number of the other decimal sign, which names no column; `T`, any other text."""
    other = "." if decimal == "," else ","
    # A number of 6 or 14 digits is a number.
    return "".join(
        "M" if _MISSING.fullmatch(field)
        else "N" if _NUMBER[decimal].fullmatch(field)
        else "S" if _match(field)
        else "D" if _NUMBER[other].fullmatch(field)
        else "T"
        for field in fields
    )  # fmt: skip


def are_stamps(text: Any) -> Any:
    """Which of a column of strings are time stamps; null where null."""
    return compute.match_substring_regex(text, _ANY)


def seconds(text: Any) -> np.ndarray:
    """A column of time stamps as seconds from the first, NaN for null.

    Stamps without a date may pass midnight; zones are taken into account, by their shift from UTC,
    where a stamp states it in digits. Whether the day or the month comes first in `1/2/2024`, is
    told by the column: one of them stays below 13, time does not run back, and no logger leaps by a
    month where it could pass midnight.

    **Raises:** `DataError` for dates that do not exist, or that run back.
    """
    matches = [None if stamp is None else _match(stamp) for stamp in text.to_pylist()]
    stamps = [match and match.groupdict(default="") for match in matches]
    days = _days(stamps)
    dial = DAY if any(stamp and "hours" in stamp for stamp in stamps) else HOUR

    def since(places: int) -> np.ndarray:
        clock = np.array([_clock(stamp, places) if stamp else np.nan for stamp in stamps])
        return unwrapped(clock, dial) if days is None else days * DAY + clock

    found = since(0)
    if _runs_back(found):
        # Where the fraction has no leading zeros, `:5` and `:10` count thousandths.
        places = max(len(stamp["fraction"] or ".") for stamp in stamps if stamp) - 1
        counted = since(places)
        found = found if _runs_back(counted) else counted
    return found - _first(found)


def of_texts(values: Any) -> tuple[np.ndarray | None, str]:
    """Numbers or time stamps that stand there as text, and their unit where they are stamps.

    `None` for other text, and where there is none.

    **Arguments:** `values`: a list, or a column of strings (PyArrow).
    """
    if isinstance(values, list):
        values = pa.array([None if v is None else str(v) for v in values], pa.string())
    texts = stripped(values)
    if texts.null_count == len(texts):
        return None, ""
    found = numbers(texts, ".", False)
    if found is None and all_true(are_stamps(texts)):
        return seconds(texts), "s"
    return found, ""


def _runs_back(since: np.ndarray) -> bool:
    return bool((np.diff(since[~np.isnan(since)]) < 0).any())


def _match(text: str) -> re.Match[str] | None:
    return next(filter(None, (pattern.fullmatch(text) for pattern in _COMPILED)), None)


def _first(values: np.ndarray) -> float:
    known = values[~np.isnan(values)]
    return known[0] if known.size else 0.0


def _days(stamps: list[dict[str, str] | None]) -> np.ndarray | None:
    """Days since the first of each stamp, NaN for none; `None` for times of day alone."""
    said = {part for stamp in stamps if stamp for part in stamp}
    if not said & {"year", "days"}:
        return None
    # Elapsed times show no days where there are none.
    dateless = np.nan if "year" in said else 0.0
    orders = []
    for day_first in (False, True) if "first" in said else (False,):
        with contextlib.suppress(ValueError):
            each = [_day(stamp, day_first, dateless) if stamp else np.nan for stamp in stamps]
            days = np.array(each) - _first(np.array(each))
            orders += [] if _runs_back(days) else [days]
    if not orders:
        raise DataError("it holds dates that do not exist, or that run back.")
    # Where both orders make sense, one passes midnight and the other leaps by a month.
    return min(orders, key=lambda days: days[~np.isnan(days)][-1])


def _day(stamp: dict[str, str], day_first: bool, dateless: float) -> float:
    """Days since 1970; of an elapsed time, its days.

    **Raises:** `ValueError` for a date that does not exist.
    """
    if "year" not in stamp:
        return float(stamp.get("days", dateless))
    year = int(stamp["year"]) + (2000 if len(stamp["year"]) == 2 else 0)
    name = stamp.get("name", "").lower()
    month, day = stamp.get("first", stamp.get("month")), stamp.get("second", stamp.get("day"))
    if "first" in stamp and day_first:
        month, day = day, month
    return _days_since_1970(year, int(month or (*_MONTHS, name).index(name) + 1), int(day or 0))


@functools.lru_cache
def _days_since_1970(year: int, month: int, day: int) -> float:
    return float(np.datetime64(f"{year:04d}-{month:02d}-{day:02d}", "D").astype(int))


def _clock(stamp: dict[str, str], places: int = 0) -> float:
    """Seconds of the day, as of UTC where the stamp states a zone's shift.

    **Arguments:** `places`: of the fraction, where that is a count of its last one.
    """
    hours, minutes, full = (int(stamp.get(part) or 0) for part in ("hours", "minutes", "seconds"))
    if half := stamp.get("half", "")[:1].lower():
        hours = hours % 12 + (12 if half == "p" else 0)
    since = HOUR * hours + MINUTE * minutes + full
    # How far a zone is ahead of UTC; one that is a name says nothing.
    if ahead := re.search(r"([+-])(\d\d?):?(\d\d)?$", stamp.get("zone", "")):
        since -= float(f"{ahead[1]}1") * (HOUR * int(ahead[2]) + MINUTE * int(ahead[3] or 0))
    digits = stamp["fraction"][1:].zfill(places)
    return since + (float(f"0.{digits}") if digits else 0.0)
