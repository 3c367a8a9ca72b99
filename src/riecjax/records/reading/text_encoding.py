"""A text file's bytes as UTF-8, whatever it was written in."""

import codecs
import re

from riecjax.errors import DataError

OTHER_FORMATS = {
    b"PK\x03\x04": "an Excel workbook or another zip archive",
    b"\x1f\x8b": "packed by gzip",
    b"\xd0\xcf\x11\xe0": "a workbook of Excel before 2007 (.xls)",
    b"\x89HDF": "an HDF5 file",
    b"MATLAB": "a MATLAB file",
    b"TDSm": "a TDMS file",
    b"PAR1": "a Parquet file",
}
"""What a file that begins so is, whatever its name."""
_ARABIC = str.maketrans("٠١٢٣٤٥٦٧٨٩۰۱۲۳۴۵۶۷۸۹٫", "01234567890123456789.", "٬")
_IN_ARABIC = re.compile(rb"\xd9[\xa0-\xa9]|\xdb[\xb0-\xb9]")
_CHUNK = 2**20
_CONTROLS = re.compile(rb"[\x01-\x08\x0e-\x1a\x1c-\x1f\x7f]")


def as_utf8(content: bytes) -> tuple[bytes, list[str]]:
    """A text file's content in UTF-8 with lines ended by `\\n`, and what was decided.

    UTF-8, UTF-16, and UTF-32 with a mark are recognised; any other text is taken as Latin-1, which
    differs from other 8-bit encodings in names but not in numbers. Digits of Arabic and Persian
    become those of ASCII, the sign of minus a hyphen; what has no width goes.

    **Raises:** `DataError` for a binary file.
    """
    for start, kind in OTHER_FORMATS.items():
        if content.startswith(start):
            raise DataError(f"it is {kind}, whatever its name says; unpack, rename or export it.")
    notes: list[str] = []
    wide = _wide(content)
    if wide:
        called = wide[:6].upper()
        try:
            content = content.decode(wide).encode()
        except UnicodeError:
            raise DataError(f"not a text file in {called}; it is damaged.") from None
        notes.append(f"read as {called}")
    whole = content.rstrip(b"\0")
    if 0 < len(whole) < len(content):
        notes.append(f"{len(content) - len(whole)} bytes of 0 at the end left out")
        content = whole
    place = content.find(b"\0")
    if place >= 0:
        raise DataError(f"not a text file in UTF-8: byte {place} is 0, as in binary files.")
    if not _is_utf8(content):
        if _CONTROLS.search(content[:_CHUNK]):
            raise DataError("not a text file in UTF-8: it holds binary control characters.")
        content = content.decode("latin-1").encode()
        notes.append("read as Latin-1, not being UTF-8")
    if b"\r" in content:
        content = content.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    for invisible in (codecs.BOM_UTF8, "\u200b".encode()):
        content = content.replace(invisible, b"") if invisible in content else content
    if b"\xe2\x88\x92" in content:
        content = re.sub(rb"\xe2\x88\x92(?=[\d.,])", b"-", content)
    if _IN_ARABIC.search(content[:_CHUNK]):
        content = content.decode().translate(_ARABIC).encode()
    return content, notes


def _wide(content: bytes) -> str | None:
    """The encoding of two or four bytes a letter that a text is in."""
    if content.startswith((codecs.BOM_UTF32_LE, codecs.BOM_UTF32_BE)):
        return "utf-32"
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    # Without a mark: digits and delimiters have a zero as every other byte.
    head = content[:4096]
    half = len(head) // 2
    if half < 2:
        return None
    if head[1::2].count(0) > 0.9 * half and 0 not in head[::2]:
        return "utf-16-le"
    if head[::2].count(0) > 0.9 * half and 0 not in head[1::2]:
        return "utf-16-be"
    return None


def _is_utf8(content: bytes) -> bool:
    decoder = codecs.getincrementaldecoder("utf-8")()
    try:
        for start in range(0, len(content), _CHUNK):
            decoder.decode(content[start : start + _CHUNK])
        decoder.decode(b"", final=True)
    except UnicodeDecodeError:
        return False
    return True
