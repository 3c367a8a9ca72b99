"""Numbers and time stamps as text, one by one and by the column."""

import re
from typing import Any

import numpy as np

MISSING = ("", "-", "--", "NaN", "nan", "NAN", "NA", "na", "N/A", "n/a", "#N/A", "<NA>", "null",
           "NULL", "Null", "None", "none", "1.#QNAN", "-1.#IND", "1.#IND", "-nan", "nan(ind)",
           "-nan(ind)", "NaT")  # fmt: skip
"""What loggers and spreadsheets write where there is no value."""
_EXPONENT = r"(?:[eEdD][+-]?\d+)?"
_INFINITE = r"[+-]?(?:[iI]nf(?:inity)?|INF)"
NUMBER = {
    ".": rf"^(?:[+-]?(?:\d+\.?\d*|\.\d+){_EXPONENT}|{_INFINITE})$",
    # Digits on both sides: a comma at the end of a field is a delimiter.
    ",": rf"^(?:[+-]?\d+(?:,\d+)?{_EXPONENT}|{_INFINITE})$",
}
"""A number by its decimal sign."""
GROUPED = {
    ".": r"^[+-]?[1-9]\d{0,2}(?:,\d{3})+(?:\.\d*)?$",
    ",": r"^[+-]?[1-9]\d{0,2}(?:\.\d{3})+(?:,\d*)?$",
}
"""A number with its digits grouped in thousands, by its decimal sign."""
STAMP = (
    r"^(?:(\d{4}-\d{2}-\d{2})[T ])?(\d{1,4}):([0-5]\d):([0-5]\d|60)([.,]\d*)?(Z|[+-]\d{2}:?\d{2})?$"
)
"""A time stamp: ISO 8601 date and time, or HH:MM:SS alone."""
_NUMBER = {sign: re.compile(pattern) for sign, pattern in NUMBER.items()}
_STAMP = re.compile(STAMP)
_MISSING = frozenset(MISSING)
_MISSING_PATTERN = "^(?:" + "|".join(re.escape(word) for word in MISSING) + ")$"
DAY = 86400.0


def kind_of(text: str, decimal: str) -> str:
    """What a field holds: `M`, nothing; `N`, a number; `S`, a time stamp; `T`, any other text."""
    if text in _MISSING:
        return "M"
    if _NUMBER[decimal].fullmatch(text):
        return "N"
    return "S" if ":" in text and _STAMP.fullmatch(text) else "T"


def compute() -> Any:
    """The module `pyarrow.compute`; its functions are made on import, unseen by type checkers."""
    import pyarrow.compute

    return pyarrow.compute


def stripped(text: Any) -> Any:
    """A column of strings (PyArrow) without white space around, null where a value is missing."""
    import pyarrow as pa

    pc = compute()
    text = pc.utf8_trim_whitespace(text)
    # No list of words and no scalar: for these PyArrow imports pandas, where there is one.
    missing = pc.match_substring_regex(text, _MISSING_PATTERN)
    return pc.if_else(missing, pa.nulls(1, pa.string())[0], text)


def numbers(text: Any, decimal: str, grouped: bool) -> np.ndarray | None:
    """A column of stripped strings as floats, NaN for null; `None` if some are no numbers.

    `grouped`: the other sign may separate thousands.
    """
    import pyarrow as pa

    pc = compute()
    plain = text
    if decimal == ",":
        if pc.any(pc.match_substring(text, ".")).as_py():
            if not grouped or not all_true(is_numeric(text, decimal, grouped)):
                return None
            plain = pc.replace_substring(plain, ".", "")
        plain = pc.replace_substring(plain, ",", ".")
    try:
        return floats(pc.cast(plain, pa.float64()))
    except pa.ArrowInvalid:
        pass
    if not all_true(is_numeric(text, decimal, grouped)):
        return None
    # What is a number but not to PyArrow: a plus sign, Fortran's exponents, thousands.
    for pattern, sign in ((r"^\+", ""), ("[dD]", "e"), (",", "")):
        plain = pc.replace_substring_regex(plain, pattern, sign)
    return floats(pc.cast(plain, pa.float64()))


def is_numeric(text: Any, decimal: str, grouped: bool) -> Any:
    """Which of a column of strings are numbers; null where null."""
    pc = compute()
    found = pc.match_substring_regex(text, NUMBER[decimal])
    return pc.or_(found, pc.match_substring_regex(text, GROUPED[decimal])) if grouped else found


def are_stamps(text: Any) -> Any:
    """Which of a column of strings are time stamps; null where null."""
    return compute().match_substring_regex(text, STAMP)


def seconds(text: Any) -> np.ndarray:
    """A column of time stamps as seconds from the first, NaN for null.

    Stamps without a date may pass midnight; zones are taken into account.
    """
    stamps = text.to_pylist()
    found = [_STAMP.fullmatch(stamp) if stamp is not None else None for stamp in stamps]
    days = np.array([m[1] if m and m[1] else "NaT" if m is None else "1970-01-01" for m in found],
                    dtype="datetime64[D]")  # fmt: skip
    first = next((day for day in days if not np.isnat(day)), np.datetime64("1970-01-01"))
    # Whole days since the first are exact, and small enough to leave nanoseconds to the clock.
    whole = np.where(np.isnat(days), np.nan, (days - first).astype("int64").astype(float))
    clock = np.array([_clock(match) if match else np.nan for match in found], dtype=float)
    dated = any(match is not None and match[1] for match in found)
    since = whole * DAY + clock if dated else unwrapped(clock)
    known = since[~np.isnan(since)]
    return since - known[0] if known.size else since


def unwrapped(clock: np.ndarray) -> np.ndarray:
    """Seconds of the day, carried on past midnight; NaN stays."""
    known = ~np.isnan(clock)
    steps = np.diff(clock[known], prepend=clock[known][:1])
    carried = clock.copy()
    carried[known] += DAY * np.cumsum(steps < -0.5 * DAY)
    return carried


def _clock(stamp: re.Match[str]) -> float:
    _, hours, minutes, whole, fraction, zone = stamp.groups()
    since = 3600 * int(hours) + 60 * int(minutes) + int(whole)
    if zone and zone != "Z":
        digits = zone[1:].replace(":", "")
        shift = 3600 * int(digits[:2]) + 60 * int(digits[2:])
        since -= shift if zone[0] == "+" else -shift
    return since + (float("0." + (fraction[1:] or "0")) if fraction else 0.0)


def floats(column: Any) -> np.ndarray:
    """A column of PyArrow's 64-bit floats, shape `(n,)`, NaN for null."""
    import pyarrow as pa

    # PyArrow's own conversions, of a single number too, import pandas wherever that is installed.
    whole = column.combine_chunks() if isinstance(column, pa.ChunkedArray) else column
    bare = pa.Array.from_buffers(
        pa.float64(), len(whole), [None, whole.buffers()[1]], offset=whole.offset
    )
    values = np.array(np.from_dlpack(bare))
    if whole.null_count:
        null = compute().cast(whole.is_null(), pa.uint8())
        values[np.from_dlpack(null).astype(bool)] = np.nan
    return values


def all_true(mask: Any) -> bool:
    """Whether a column of truth values holds no False; nulls do not count."""
    return compute().all(mask).as_py() is not False
