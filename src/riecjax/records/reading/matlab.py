"""Reading MATLAB files: v4 and v5 through SciPy, v7.3 through HDF5.

SciPy trusts a file of v5. It takes the type of an element for an index into a table of pointers,
reads the parts that an array's flags announce even where the array has ended, and reserves memory
for as many cells as are declared: a damaged file ends the process or fills the memory. So every
element is checked once before SciPy reads it. (SciPy in a separate process, as HDF5, would be as
safe, but starting that takes 0.4 s where reading takes 0.01 s.)
"""

import io
import math
import struct
import zlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from riecjax.records.reading import channels as limits
from riecjax.records.reading.channels import (
    Channels,
    check_column_count,
    check_names,
    check_unpacked,
    foreign_reader,
    vectors,
    with_structure_times,
    with_units_beside,
)
from riecjax.records.reading.child_process import read_apart
from riecjax.records.reading.hdf5 import DEEPEST, check_size, walk

V73 = b"MATLAB 7.3"
HDF5 = b"\x89HDF\r\n\x1a\n"
HEADER = 128
"""Bytes before the first element of a file of v5."""
MATRIX, COMPRESSED = 14, 15
PLAIN = {1, 2, 3, 4, 5, 6, 7, 9, 12, 13, 16, 17, 18}
"""Types of elements of numbers or letters, as "MAT-File Format" (MathWorks) numbers them."""
CELL, STRUCTURE, OBJECT, TEXT, SPARSE, FUNCTION, OPAQUE = 1, 2, 3, 4, 5, 16, 17
"""Classes of arrays; all others are numbers."""
LONGEST_WORD = 100
"""Letters of a text that may be a unit."""
COMPLEX = 0x800
"""Flag of an array with an imaginary part."""


def read_mat(file: Path) -> Channels:
    """Read a MAT file of version 4, 5 or 7.3.

    Fields of structures are called `struct.field`, elements of cells `cell{1}` (from 1, as in
    MATLAB), columns of matrices `matrix[0]` (from 0). A structure's `time` is the time of what
    lies in it, as in Simulink's structures with time.

    **Raises:** `DataError` for a damaged file or one that unpacks to too much; `MemoryError`.
    """
    with file.open("rb") as stream:
        start = stream.read(520)
    is_v73 = start.startswith(V73) or HDF5 in (start[:8], start[512:])
    return read_apart(_read_v73, file, "MAT (v7.3)") if is_v73 else _channels(*_read_v5(file))


def _channels(arrays: "Arrays", objects: "Objects") -> Channels:
    found = vectors({name: array for name, array in arrays.items() if not _is_word(array)})
    words = {name: str(array.flat[0]) for name, array in arrays.items() if _is_word(array)}
    left_out = dict.fromkeys(words, "it holds no real numbers") | {
        name: f"it is a {kind} of MATLAB, which only MATLAB reads: save its columns as vectors"
        for name, kind in objects.items()
    }
    found = with_units_beside(replace(found, left_out=found.left_out | left_out), words)
    return with_structure_times(found)


def _is_word(array: np.ndarray) -> bool:
    return array.dtype.kind == "U" and array.size == 1


Arrays = dict[str, np.ndarray]
Objects = dict[str, str]
"""Variables that are objects of MATLAB's, such as timetables, with their class."""


def _read_v5(file: Path) -> tuple[Arrays, Objects]:
    with foreign_reader("MAT"):
        import scipy.io

        source = io.BytesIO(_unpacked_v5(file.read_bytes()))
        names = [name for name, _, _ in scipy.io.whosmat(source) if name]
        check_names(names)
        if not all(name.isprintable() for name in names):
            raise ValueError("a variable's name is not text.")
        source.seek(0)
        variables = scipy.io.loadmat(source)
        arrays: Arrays = {}
        objects: Objects = {}
        for name, value in variables.items():
            if type(value).__name__ == "MatlabOpaque":
                described = np.asarray(value).flat[0]
                objects[_word(described["s0"])] = _word(described["s2"])
            elif not name.startswith("__"):
                for inner, array in _parts(name, value):
                    arrays[inner] = array
                    check_column_count(len(arrays))
    return arrays, objects


def _word(text: object) -> str:
    return text.decode(errors="replace") if isinstance(text, bytes) else str(text)


def _unpacked_v5(content: bytes) -> bytes:
    """A file of v5 with its compressed variables unpacked and every element checked.

    A file of v4 passes as it is: what its headers declare beyond its end SciPy refuses.

    **Raises:** `ValueError` for elements that do not fit into the file, `DataError` past the
    largest size.
    """
    if len(content) < HEADER:
        raise ValueError("the file ends within its header.")
    if 0 in content[:4]:
        return content
    order = {b"IM": "<", b"MI": ">"}.get(content[126:128])
    if order is None:
        raise ValueError("it has no header of a MAT file.")
    parts = [content[:HEADER]]
    for kind, start, stop in _elements_v5(content, HEADER, len(content), order):
        body = content[start:stop]
        if kind == COMPRESSED:
            body = _inflated(body, limits.LARGEST_FILE - sum(map(len, parts)))
        else:
            body = struct.pack(order + "II", kind, stop - start) + body
        kind, start, stop = next(_elements_v5(body, 0, len(body), order))
        if kind != MATRIX:
            raise ValueError(f"a variable has the unknown type {kind}.")
        _check_array(body, start, stop, order)
        parts.append(body)
        check_unpacked(sum(map(len, parts)))
    return b"".join(parts)


def _inflated(packed: bytes, limit: int) -> bytes:
    stream = zlib.decompressobj()
    whole = stream.decompress(packed, max(limit, 1))
    if stream.unconsumed_tail:
        check_unpacked(limits.LARGEST_FILE + 1)
    if not stream.eof:
        raise ValueError("a compressed variable is cut off.")
    return whole


def _elements_v5(
    content: bytes, place: int, end: int, order: str
) -> Iterator[tuple[int, int, int]]:
    """Type, start and stop of the elements between two places, each with room for its bytes."""
    while place < end:
        if place + 8 > end:
            raise ValueError("an element is cut off.")
        kind, size = struct.unpack_from(order + "II", content, place)
        start, following = place + 8, place + 8 + size
        if kind >> 16:  # a small element: its size is beside its type, its bytes in the tag
            kind, size, start, following = kind & 0xFFFF, kind >> 16, place + 4, place + 8
            if size > 4:
                raise ValueError("a small element is too large.")
        elif kind != COMPRESSED:
            following += -size % 8
        if start + size > end:
            raise ValueError("an element is larger than its file.")
        yield kind, start, start + size
        place = following


def _check_array(content: bytes, start: int, stop: int, order: str, depth: int = 0) -> None:
    """Refuse an array whose elements are not those that its flags and its size announce.

    An array is flags, size, name, then its parts: the real and the imaginary numbers; or an array
    for each cell; or the names of its fields, and an array for each field of each structure.
    """
    if start == stop:
        return
    if depth > 2 * DEEPEST:
        raise ValueError("its structures lie too deep.")
    elements = list(_elements_v5(content, start, stop, order))
    kinds = [kind for kind, _, _ in elements]
    for kind, first, last in elements:
        if kind == MATRIX:
            _check_array(content, first, last, order, depth + 1)
        elif kind not in PLAIN:
            raise ValueError(f"an element has the unknown type {kind}.")
    data = [content[first:last] for _, first, last in elements[:6]]
    if len(data[0]) != 8:
        raise ValueError("an array has no flags.")
    flags = struct.unpack(order + "I4x", data[0])[0]
    kind, complex_parts = flags & 0xFF, bool(flags & COMPLEX)
    if kind in (FUNCTION, OPAQUE):
        return
    if len(data) < 3 or MATRIX in kinds[:3] or len(data[1]) < 8 or len(data[1]) % 4:
        raise ValueError("an array has no size or no name.")
    sides = np.frombuffer(data[1], order + "i4").tolist()
    count, inner = math.prod(sides), kinds.count(MATRIX)
    if min(sides) < 0:
        raise ValueError("an array has a negative size.")
    if count > stop - start and kind != SPARSE:
        raise ValueError(f"an array of {count} elements lies in {stop - start} bytes.")
    parts = {CELL: 0, STRUCTURE: 2, OBJECT: 3, TEXT: 1, SPARSE: 3 + complex_parts}
    expected = parts.get(kind, 1 + complex_parts)
    if len(kinds) - 3 - inner != expected or MATRIX in kinds[3 : 3 + expected]:
        raise ValueError(f"an array has {len(kinds) - 3 - inner} parts, not {expected}.")
    fields = 1 if kind == CELL else 0
    if kind in (STRUCTURE, OBJECT):
        longest, names = data[1 + expected : 3 + expected]
        width = int.from_bytes(longest, "little" if order == "<" else "big")
        fields = len(names) // max(width, 1)
    if inner != count * fields:
        raise ValueError(f"an array of {count} cells or structures holds {inner}.")


def _parts(name: str, value: object, depth: int = 0) -> Iterator[tuple[str, np.ndarray]]:
    """The arrays of a variable of SciPy's, those in structures and cells included."""
    import scipy.sparse

    if scipy.sparse.issparse(value):
        sparse: Any = value
        check_unpacked(8 * math.prod(sparse.shape))
        value = sparse.toarray()
    array = np.asarray(value)
    if depth > DEEPEST or type(value).__name__ in ("MatlabOpaque", "MatlabFunction"):
        return
    # Counted along columns, as MATLAB counts.
    elements = array.reshape(-1, order="F")
    if array.dtype.names:
        for place, element in enumerate(elements, start=1):
            whole = name if elements.size == 1 else f"{name}({place})"
            for field in array.dtype.names:
                yield from _parts(f"{whole}.{field}", element[field], depth + 1)
    elif array.dtype.kind == "O":
        for place, element in enumerate(elements, start=1):
            yield from _parts(f"{name}{{{place}}}", element, depth + 1)
    elif array.dtype.kind in "fiubcU":
        yield name, array


def _read_v73(file: Path) -> Channels:
    with foreign_reader("MAT (v7.3)"):
        import h5py

        with h5py.File(file, "r") as source:
            datasets = list(walk(source, ".", _elements))
            check_size([dataset for _, dataset in datasets], file)
            objects = {
                name: _word(dataset.attrs.get("MATLAB_class", "object"))
                for name, dataset in datasets
                if "MATLAB_object_decode" in dataset.attrs
            }
            plain = {name: _array(d) for name, d in datasets if name not in objects}
            return _channels(plain, objects)


def _array(dataset: Any) -> np.ndarray:
    """A dataset's numbers, or its text; what MATLAB calls empty is stored as its size."""
    if dataset.attrs.get("MATLAB_empty", 0):
        return np.zeros(0)
    values = np.asarray(dataset[()])
    if dataset.attrs.get("MATLAB_class") != b"char":
        return values
    return np.array(["".join(map(chr, values.reshape(-1)[:LONGEST_WORD]))])


def _elements(name: str, item: Any) -> list[tuple[str, Any]] | None:
    """What a cell, or a field of an array of structures, refers to; `None` for numbers."""
    import h5py

    if item.dtype.kind in "fiub":
        return None
    if h5py.check_ref_dtype(item.dtype) is not h5py.Reference:
        return []
    check_column_count(int(item.size or 0))
    references = enumerate(np.asarray(item[()]).reshape(-1), start=1)
    whole, _, field = name.rpartition(".")
    is_cell = item.attrs.get("MATLAB_class") == b"cell" or not whole
    return [
        (f"{name}{{{i}}}" if is_cell else f"{whole}({i}).{field}", item.file[reference])
        for i, reference in references
        if reference
    ]
