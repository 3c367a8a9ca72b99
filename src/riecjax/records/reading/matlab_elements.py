"""The elements of a MAT file of version 5, checked before they are read.

A count that damage has made huge would have SciPy ask for memory for that many elements. Here
each element must have room in the file for what it declares.
"""

import io
import struct
import zlib

from riecjax.records.reading.limits import LARGEST_FILE, check_unpacked

HEADER = 128
MATRIX, COMPRESSED = 14, 15
CELL, STRUCTURE, OBJECT, SPARSE = 1, 2, 3, 5
OPAQUE, FUNCTION = 17, 16
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
        if inner == MATRIX:
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


def _check_matrix(body: bytes, order: str, depth: int) -> None:
    """Refuse a matrix that declares more elements than it has bytes for."""
    if not body:
        return
    if depth > DEEPEST:
        raise ValueError("its structures lie too deep.")
    _, flags, place = _element(body, 0, order, len(body))
    kind = struct.unpack_from(order + "I", flags.ljust(4, b"\0"))[0] & 0xFF
    if kind in (OPAQUE, FUNCTION):
        return
    _, sides, place = _element(body, place, order, len(body))
    count = 1
    for side in struct.unpack(order + f"{len(sides) // 4}i", sides[: len(sides) // 4 * 4]):
        if side < 0:
            raise ValueError("an array has a negative size.")
        count *= side
    if kind == SPARSE:
        return
    if count > len(body):
        raise ValueError("an array declares more elements than it holds.")
    if kind not in (CELL, STRUCTURE, OBJECT):
        return
    _, _, place = _element(body, place, order, len(body))  # the name
    if kind == OBJECT:
        _, _, place = _element(body, place, order, len(body))  # the name of its class
    if kind in (STRUCTURE, OBJECT):
        _, _, place = _element(body, place, order, len(body))  # the longest field name
        _, _, place = _element(body, place, order, len(body))  # the field names
    while place < len(body):
        inner, inside, place = _element(body, place, order, len(body))
        if inner == MATRIX:
            _check_matrix(inside, order, depth + 1)


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
