"""The elements of a MAT file of version 5, checked before they are read.

A count that damage has made huge would have SciPy ask for memory for that many elements. Here
each element must have room in the file for what it declares.
"""

import io
import struct
import zlib
from collections.abc import Iterator

from riecjax.records.reading.channels import LARGEST_FILE, check_unpacked

HEADER = 128
MATRIX, COMPRESSED = 14, 15
WIDTHS = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8, 16: 1, 17: 2, 18: 4}
"""Bytes of a number by the type of an element."""
CELL, STRUCTURE, OBJECT, TEXT, SPARSE = 1, 2, 3, 4, 5
OPAQUE, FUNCTION = 17, 16
COMPLEX = 0x800
"""Flag of an array with an imaginary part."""
DEEPEST = 32


def inflated(content: bytes) -> io.BytesIO:
    """The same file with its compressed variables unpacked, after a check of every element.

    Files of version 4 pass as they are.

    **Raises:** `ValueError` for elements that do not fit into the file, `DataError` past the
    largest size.
    """
    if len(content) < HEADER:
        raise ValueError("the file ends within its header.")
    if 0 in content[:4]:
        _check_version_4(content)
        return io.BytesIO(content)
    order = {b"IM": "<", b"MI": ">"}.get(content[126:128])
    if order is None:
        raise ValueError("it has no header of a MAT file.")
    parts = [content[:HEADER]]
    place, size = HEADER, HEADER
    while place < len(content):
        kind, body, place = _element(content, place, order, len(content))
        whole = _inflate(body, LARGEST_FILE - size) if kind == COMPRESSED else None
        if whole is None:
            whole = struct.pack(order + "II", kind, len(body)) + body
        inner, inside, _ = _element(whole, 0, order, len(whole))
        if inner != MATRIX:
            raise ValueError(f"a variable has the unknown type {inner}.")
        _check_matrix(inside, order, 0)
        parts.append(whole)
        size += len(whole)
        check_unpacked(size)
    return io.BytesIO(b"".join(parts))


def _inflate(body: bytes, limit: int) -> bytes:
    stream = zlib.decompressobj()
    whole = stream.decompress(body, max(limit, 1))
    if stream.unconsumed_tail:
        check_unpacked(LARGEST_FILE + 1)
    if not stream.eof:
        raise ValueError("a compressed variable is cut off.")
    return whole


def _element(content: bytes, place: int, order: str, end: int) -> tuple[int, bytes, int]:
    """Type and bytes of the element at `place`, and the place of the next one."""
    if place + 8 > end:
        raise ValueError("an element is cut off.")
    kind, size = struct.unpack_from(order + "II", content, place)
    if kind >> 16:  # a small element: its size stands beside its type, its bytes in the tag
        if kind >> 16 > 4:
            raise ValueError("a small element is too large.")
        return kind & 0xFFFF, content[place + 4 : place + 4 + (kind >> 16)], place + 8
    if place + 8 + size > end:
        raise ValueError("an element is larger than its file.")
    stop = place + 8 + size
    padded = stop if kind == COMPRESSED else min(stop + -size % 8, end)
    return kind, content[place + 8 : stop], padded


def _elements(body: bytes, place: int, order: str) -> Iterator[tuple[int, bytes]]:
    while place < len(body):
        kind, inside, place = _element(body, place, order, len(body))
        yield kind, inside


def _check_matrix(body: bytes, order: str, depth: int) -> None:
    """Refuse a matrix that declares other elements than it has, or of a type that there is not.

    SciPy takes an element's type for an index into a table.
    """
    if not body:
        return
    if depth > DEEPEST:
        raise ValueError("its structures lie too deep.")
    elements = list(_elements(body, 0, order))
    for kind, inside in elements:
        if kind == MATRIX:
            _check_matrix(inside, order, depth + 1)
        elif kind not in WIDTHS:
            raise ValueError(f"an element has the unknown type {kind}.")
    flags = elements[0][1]
    word = struct.unpack_from(order + "I", flags.ljust(4, b"\0"))[0]
    kind, parts = word & 0xFF, 2 if word & COMPLEX else 1
    if kind in (OPAQUE, FUNCTION):
        return
    if len(elements) < 3:
        raise ValueError("an array has no size or no name.")
    count = _count(elements[1][1], order)
    inner = sum(each == MATRIX for each, _ in elements)
    if kind == CELL and inner != count:
        raise ValueError(f"a cell array of {count} elements holds {inner}.")
    if kind in (STRUCTURE, OBJECT):
        _check_fields(elements, inner, count, order, 3 if kind == STRUCTURE else 4)
    elif kind == SPARSE and len(elements) != 5 + parts:
        raise ValueError("a sparse array is not complete.")
    elif kind == TEXT:
        _check_numbers(elements[3:], count, 1, exactly=False)
    elif kind not in (CELL, SPARSE):
        _check_numbers(elements[3:], count, parts, exactly=True)


def _check_numbers(
    parts: list[tuple[int, bytes]], count: int, expected: int, exactly: bool
) -> None:
    """Refuse an array whose real or imaginary part has not as many numbers as it declares.

    Of texts there may be more bytes than letters.
    """
    if len(parts) != expected:
        raise ValueError(f"an array has {len(parts)} parts, not {expected}.")
    for kind, data in parts:
        held = len(data) // WIDTHS.get(kind, 1)
        if kind == MATRIX or (held != count if exactly else held < count):
            raise ValueError(f"an array of {count} elements holds {held}.")


def _count(sides: bytes, order: str) -> int:
    if len(sides) < 8:
        raise ValueError("an array has no size.")
    count = 1
    for side in struct.unpack(order + f"{len(sides) // 4}i", sides[: len(sides) // 4 * 4]):
        if side < 0:
            raise ValueError("an array has a negative size.")
        count *= side
    return count


def _check_fields(
    elements: list[tuple[int, bytes]], inner: int, count: int, order: str, place: int
) -> None:
    """Refuse a structure whose fields are not those that it names."""
    longest, names = (inside for _, inside in elements[place : place + 2])
    width = struct.unpack_from(order + "i", longest)[0]
    if width <= 0 or inner != count * (len(names) // width):
        raise ValueError(f"an array of {count} structures holds {inner} fields.")


def _check_version_4(content: bytes) -> None:
    """Refuse matrices of version 4 that declare more elements than the file has bytes."""
    place = 0
    while place + 20 <= len(content):
        order = "<" if struct.unpack_from("<i", content, place)[0] in range(5000) else ">"
        code, rows, columns, imaginary, name = struct.unpack_from(order + "5i", content, place)
        width = {0: 8, 1: 4, 2: 4, 3: 2, 4: 2, 5: 1}.get(code // 10 % 10)
        if width is None or min(rows, columns, name) < 0:
            raise ValueError("it has no header of a MAT file.")
        size = rows * columns * width * (2 if imaginary else 1)
        place += 20 + name + size
        if place > len(content):
            raise ValueError("an array is larger than its file.")
