"""From bytes to text: encodings, and refusing what is no text."""

import codecs
import re

from riecjax.errors import DataError

_CHUNK = 2**20
_CONTROLS = re.compile(rb"[\x01-\x08\x0e-\x1a\x1c-\x1f\x7f]")


def as_utf8(content: bytes) -> tuple[bytes, list[str]]:
    """A text file's content in UTF-8 with lines ended by `\\n`, and what was decided.

    UTF-8 and UTF-16 are recognised; any other text is taken as Latin-1, which differs from other
    8-bit encodings in names but not in numbers.

    **Raises:** `DataError` for a binary file.
    """
    notes: list[str] = []
    if content.startswith(codecs.BOM_UTF8):
        content = content[len(codecs.BOM_UTF8) :]
    wide = _utf16(content)
    if wide:
        try:
            content = content.decode(wide).removeprefix("\ufeff").encode()
        except UnicodeError:
            raise DataError("not a text file in UTF-16; it is damaged.") from None
        notes.append("read as UTF-16")
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
    return content, notes


def _utf16(content: bytes) -> str | None:
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
