"""Numbers as text, one by one and by the column."""

import re
from typing import Any

import numpy as np

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


def is_number(text: str, decimal: str) -> bool:
    """Whether a text is a number with this decimal sign."""
    return _NUMBER[decimal].fullmatch(text) is not None


def is_gap(text: str) -> bool:
    """Whether a text stands for a value that there is not."""
    return _MISSING.fullmatch(text) is not None


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
            if not all_true(is_numeric(text, decimal, grouped)):
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
