"""What texts say: numbers, dates and clocks, one by one and by the column."""

import contextlib
import itertools
import re
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute

from riecjax.errors import DataError
from riecjax.records.reading.times import unwrapped
from riecjax.records.reading.units import DAY, HOUR, MINUTE, is_known

MISSING = ("", "NaN", "nan", "NAN", "NA", "na", "N/A", "n/a", "<NA>", "null", "NULL", "Null",
           "None", "none", "-nan", "nan(ind)", "-nan(ind)", "NaT", "missing", "NO DATA", "No Data",
           "OVER", "Over", "OVLD", "OVERLOAD", "Overload", "OVERRANGE", "OverRange", "OVERFLOW",
           "Overflow", "+OVER", "-OVER", "OL", "+OL", "-OL")  # fmt: skip
"""What loggers and spreadsheets write where there is no value, or one past the sensor's range."""
NO_RESULT = r"#(?:N/A|DIV/0!|VALUE!|NUM!|REF!|NAME\?|NULL!)"
"""What spreadsheets write for the value of a formula that has none."""
_EXPONENT = r"(?:[eEdD][+-]?\d+)?"
_BETWEEN = "['\N{RIGHT SINGLE QUOTATION MARK}\N{NARROW NO-BREAK SPACE}\xa0\x92]"
"""What separates thousands, and nothing else."""
# With a fraction the other sign can be only what separates thousands.
NUMBER = {
    sign: rf"^(?:[+-]?(?:\d+\{sign}?\d*|\{sign}\d+){_EXPONENT}"
    rf"|[+-]?\d{{1,3}}(?:{_BETWEEN}\d{{3}})+(?:\{sign}\d+)?"
    rf"|[+-]?[1-9]\d{{0,2}}(?:\{other}\d{{2,3}})*\{other}\d{{3}}\{sign}\d+"
    r"|[+-]?(?:[iI]nf(?:inity)?|INF))$"
    for sign, other in (".,", ",.")
}
"""A number by its decimal sign."""
GROUPED = {
    sign: rf"^[+-]?[1-9]\d{{0,2}}(?:\{other}\d{{3}})+(?:\{sign}\d*)?$"
    for sign, other in (".,", ",.")
}
"""A number with its digits grouped in thousands, by its decimal sign."""
_MEASURED = r"^(?P<number>[+-]?[\d.,]*\d(?:[eE][+-]?\d+)?) ?(?P<unit>[^\s\d,;.+-][^,;\t]*)$"
"""A number and its unit."""
_NOTHING = (
    rf"^(?:{'|'.join(map(re.escape, MISSING))}"
    rf"|-+|\*+|[+-]?1\.#(?:QNAN|SNAN|IND|INF)0*|{NO_RESULT}|#+)$"
)
_NUMBER = {sign: re.compile(pattern) for sign, pattern in NUMBER.items()}
_MISSING, _WITH_UNIT = re.compile(_NOTHING), re.compile(_MEASURED)


compute: Any = pyarrow.compute
"""Its functions are made on import, unseen by type checkers."""


def stripped(text: Any) -> Any:
    """A column of strings (PyArrow) without white space around, null where a value is missing."""
    text = compute.utf8_trim_whitespace(text)
    # No list of words and no scalar: for these PyArrow imports pandas, where there is one.
    missing = compute.match_substring_regex(text, _NOTHING)
    return compute.if_else(missing, pa.nulls(1, pa.string())[0], text)


def numbers(text: Any, decimal: str, grouped: bool) -> np.ndarray | None:
    """A column of strings, or of floats, as floats, NaN for null; `None` if some are no numbers.

    `grouped`: the other sign may separate thousands.
    """
    if text.type == pa.float64():
        return floats(text)
    if decimal == "." or not compute.any(compute.match_substring(text, ".")).as_py():
        with contextlib.suppress(pa.ArrowInvalid):
            return _cast(text if decimal == "." else compute.replace_substring(text, ",", "."))
    text = stripped(text)
    if not all_true(is_numeric(text, decimal, grouped)):
        return None
    # What is a number but not to PyArrow: thousands, a plus sign, Fortran's exponents.
    other = "," if decimal == "." else "."
    for pattern, sign in ((rf"\{other}|{_BETWEEN}|^\+", ""), (",", "."), ("[dD]", "e")):
        text = compute.replace_substring_regex(text, pattern, sign)
    return _cast(text)


def measured(text: Any, decimal: str, grouped: bool) -> tuple[np.ndarray | None, str]:
    """A column of strings as [`numbers`][], and the one unit behind all of them, or none."""
    if (plain := numbers(text, decimal, grouped)) is not None:
        return plain, ""
    text = stripped(text)
    found = compute.extract_regex(text, _MEASURED)
    number, behind = found.flatten()
    units = compute.unique(compute.drop_null(behind)).to_pylist()
    if found.null_count > text.null_count or len(units) != 1 or not is_known(units[0]):
        return None, ""
    return numbers(number, decimal, grouped), units[0]


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
    chunks = column.chunks if isinstance(column, pa.ChunkedArray) else [column]
    filled = (compute.coalesce(chunk, _NAN) if chunk.null_count else chunk for chunk in chunks)
    return np.concatenate([np.empty(0), *map(np.from_dlpack, filled)])


def _cast(column: Any) -> np.ndarray:
    """Strings or truth values as floats; `ArrowInvalid` for a string that is no number."""
    return floats(compute.cast(column, pa.float64()))


def all_true(mask: Any) -> bool:
    """Whether a column of truth values holds no False; nulls do not count."""
    return compute.all(mask).as_py() is not False


_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_MONTH = rf"(?P<name>(?i:{'|'.join(_MONTHS)}))[a-z]*\.?"
_ZONE = (
    r"(?:Z|z|(?:UTC|GMT)?(?:\+|(?P<west>-))(?P<ahead>\d{1,2})(?::?(?P<more>\d{2}))?"
    r"|UTC|GMT|[A-Z]{3,4})"
)
_DATES = (
    r"(?P<year>\d{4})[-/.](?P<month>\d{1,2})[-/.](?P<day>\d{1,2})",
    r"(?P<first>\d{1,2})[-/.](?P<second>\d{1,2})[-/.](?P<year>\d{4}|\d{2})",
    rf"(?P<day>\d{{1,2}})[- ]{_MONTH}[- ,]+(?P<year>\d{{4}}|\d{{2}})",
    rf"{_MONTH} (?P<day>\d{{1,2}}), ?(?P<year>\d{{4}})",
    r"(?P<year>\d{4})(?P<month>\d{2})(?P<day>\d{2})",
    r"(?P<days>\d+) days?",
    "",
)
_TIMES_OF_DAY = (
    r"(?P<hours>\d{1,4}):(?P<minutes>[0-5]?\d)"
    r"(?::(?P<seconds>[0-5]?\d|60)(?:[.,:](?P<fraction>\d*))?)?",
    r"(?P<hours>\d\d)(?P<minutes>\d\d)(?P<seconds>\d\d)(?:[.,](?P<fraction>\d+))?",
)
PATTERNS = (
    # ISO 8601 (also compact), or as spreadsheets and MATLAB write it; or a time of day, or an
    # elapsed one, alone.
    *(
        rf"^(?:[A-Z][a-z]{{2}},? )?{date}[T ,]*{clock}"
        rf"\s*(?:(?:(?P<am>[Aa])|(?P<pm>[Pp]))\.?[Mm]\.?)?\s*{_ZONE}?(?:\[[^\]]*\])?$"
        for date, clock in itertools.product(_DATES, _TIMES_OF_DAY)
    ),
    # Minutes, seconds and their fraction, all that a spreadsheet's `mm:ss.0` shows of a time.
    r"^(?P<minutes>[0-5]?\d):(?P<seconds>[0-5]\d)[.,](?P<fraction>\d+)$",
    # Day of the year and time of day, as IRIG and recorders in flight tests have it.
    r"^(?P<days>[0-3]\d\d):(?P<hours>\d\d):(?P<minutes>[0-5]\d):(?P<seconds>[0-5]\d)"
    r"[.,](?P<fraction>\d+)$",
)
"""Time stamps; each group but `name` holds digits, or one sign."""
_ANY = re.sub(r"\?P<\w+>", "", "|".join(PATTERNS))
"""The same as one, whose groups have no names, of which each may be there once."""
_STAMP = re.compile(_ANY)


def bare_number(field: str) -> str:
    """A number without the unit behind it."""
    found = _WITH_UNIT.fullmatch(field)
    return found["number"] if found and is_known(found["unit"]) else field


def kinds_of(fields: list[str], decimal: str) -> str:
    """What fields hold, a letter for each: `M`, nothing; `N`, a number; `S`, a time stamp; `D`, a
    number of the other decimal sign, which names no column; `T`, any other text."""
    other = "." if decimal == "," else ","
    # A number of 6 or 14 digits is a number.
    return "".join(
        "N" if _NUMBER[decimal].fullmatch(field)
        else "M" if _MISSING.fullmatch(field)
        else "D" if _NUMBER[other].fullmatch(field)
        else "N" if _NUMBER[decimal].fullmatch(bare_number(field))
        else "S" if _STAMP.fullmatch(field)
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
    parts = _parts(text)
    days, clock = _days(parts), _clock(parts)
    # Where the fraction has no leading zeros, `:5` and `:10` count thousandths.
    counts = parts["count"] / 10 ** np.nanmax(parts["places"])
    found: list[np.ndarray] = []
    for fraction in (parts["fraction"], counts):
        dial = DAY if "hours" in parts else HOUR
        one = unwrapped(clock + fraction, dial) if days is None else days * DAY + (clock + fraction)
        found.append(one - _first(one))
    return next((one for one in found if not _runs_back(one)), found[0])


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


def _first(values: np.ndarray) -> float:
    return next(iter(values[~np.isnan(values)]), 0.0)


def _parts(text: Any) -> dict[str, np.ndarray]:
    """What stamps say, as numbers by the groups of [`PATTERNS`][], NaN where they say nothing.

    The digits of a fraction are a `count` of that many `places` as well.
    """
    text = text.combine_chunks() if isinstance(text, pa.ChunkedArray) else text
    parts: dict[str, np.ndarray] = {}
    left = _cast(compute.is_valid(text)) > 0
    while left.any():
        sample = text[int(np.argmax(left))].as_py()
        pattern = next(pattern for pattern in PATTERNS if re.match(pattern, sample))
        found = compute.extract_regex(text, pattern)
        here = left & (_cast(compute.is_valid(found)) > 0)
        said = dict(zip(re.findall(r"P<(\w+)>", pattern), found.flatten(), strict=True))
        said |= {"count": said["fraction"], "places": said["fraction"]}
        for name, group in said.items():
            values = _number(name, group)[here]
            parts.setdefault(name, np.full(len(text), np.nan))[here] = values
        left &= ~here
    return parts


def _number(name: str, group: Any) -> np.ndarray:
    """Digits as numbers, names of months by their place from 1, signs by their number."""
    for place, month in enumerate(_MONTHS if name == "name" else (), start=1):
        group = compute.replace_substring_regex(group, f"(?i){month}", str(place))
    if name in ("am", "pm", "west", "places"):
        return _cast(compute.utf8_length(group))
    zero = "0." if name == "fraction" else "0"
    return _cast(compute.replace_substring_regex(group, "^", zero))


def _days(parts: dict[str, np.ndarray]) -> np.ndarray | None:
    """Days since the first of each stamp, NaN for none; `None` for times of day alone."""
    if not parts.keys() & {"year", "days"}:
        return None
    if "year" not in parts:
        # Elapsed times show no days where there are none.
        orders = [np.where(np.isnan(parts["fraction"]), np.nan, np.nan_to_num(parts["days"]))]
    elif "days" not in parts:
        orders = [_since_1970(parts, "first", "second"), _since_1970(parts, "second", "first")]
    else:
        raise DataError("it holds both dates and days without a date.")
    orders = [days - _first(days) for days in orders if days is not None and not _runs_back(days)]
    if not orders:
        raise DataError("it holds dates that do not exist, or that run back.")
    # Where both orders make sense, one passes midnight and the other leaps by a month.
    return min(orders, key=lambda days: days[~np.isnan(days)][-1])


def _since_1970(parts: dict[str, np.ndarray], month_in: str, day_in: str) -> np.ndarray | None:
    """Days since 1970, NaN for stamps without a date; `None` where a date does not exist."""
    dated = ~np.isnan(parts["year"])

    def said(*names: str) -> np.ndarray:
        each = [parts[name][dated] for name in names if name in parts]
        return np.nansum(each, axis=0).astype(int)

    years, months, days = said("year"), said("month", "name", month_in), said("day", day_in)
    years = (years + 2000 * (years < 100) - 1970).astype("M8[Y]")
    in_month = years.astype("M8[M]") + (months - 1)
    in_day = in_month.astype("M8[D]") + (days - 1)
    if (in_month.astype("M8[Y]") != years).any() or (in_day.astype("M8[M]") != in_month).any():
        return None
    found = np.full(dated.size, np.nan)
    found[dated] = in_day.astype(float)
    return found


def _clock(parts: dict[str, np.ndarray]) -> np.ndarray:
    """Whole seconds of the day, as of UTC where the stamp states a zone's shift."""
    names = ("hours", "minutes", "seconds", "am", "pm", "west", "ahead", "more")
    each = (np.nan_to_num(parts.get(name, np.zeros(1))) for name in names)
    hours, minutes, full, am, pm, west, ahead, more = each
    hours = np.where(am + pm > 0, hours % 12 + 12 * pm, hours)
    # How far a zone is ahead of UTC; one that is a name says nothing.
    shift = HOUR * ahead + MINUTE * more
    return HOUR * hours + MINUTE * minutes + full - np.where(west > 0, -shift, shift)
