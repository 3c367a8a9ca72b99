"""Reading MATLAB files: v4 and v5 through SciPy, v7.3 through HDF5, with the extra `hdf5`.

SciPy trusts a file of v5: a damaged one ends the process or asks for all memory, and so it is read
in a process of its own, as HDF5 is.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from riecjax.readers.hdf5 import DEEPEST, check_size, walk, word
from riecjax.records import reading

V73 = b"MATLAB 7.3"
HDF5 = b"\x89HDF\r\n\x1a\n"
HEADER = 512
"""Bytes before the content of a file of v7.3."""
LONGEST_WORD = 100
"""Letters of a text that may be a unit."""
Arrays = dict[str, np.ndarray]
Objects = dict[str, str]
"""Variables that are objects of MATLAB's, such as timetables, with their class."""


def read_mat(file: Path) -> reading.Channels:
    """Read a MAT file of version 4, 5 or 7.3.

    Fields of structures are called `struct.field`, elements of cells `cell{1}` (from 1, as in
    MATLAB), columns of matrices `matrix[0]` (from 0). A structure's `time` is the time of what
    lies in it, as in Simulink's structures with time.

    **Raises:** `DataError` for a damaged file, one that unpacks to too much, or where h5py is
    not installed, which version 7.3 needs; `MemoryError`.
    """
    with file.open("rb") as stream:
        start = stream.read(HEADER + len(HDF5))
    if start.startswith(V73) or HDF5 in (start[: len(HDF5)], start[HEADER:]):
        return read_v73(file)
    return read_v5(file)


def _channels(arrays: Arrays, objects: Objects) -> reading.Channels:
    found = reading.vectors({name: array for name, array in arrays.items() if not _is_word(array)})
    words = {name: str(array.flat[0]) for name, array in arrays.items() if _is_word(array)}
    left_out = dict.fromkeys(words, "it holds no real numbers") | {
        name: f"it is a {kind} of MATLAB, which only MATLAB reads: save its columns as vectors"
        for name, kind in objects.items()
    }
    found = reading.with_units_beside(replace(found, left_out=found.left_out | left_out), words)
    return reading.with_structure_times(found)


def _is_word(array: np.ndarray) -> bool:
    return array.dtype.kind == "U" and array.size == 1


@reading.apart("MAT", is_trusted=False)
def read_v5(file: Path) -> reading.Channels:
    """Read a file of version 4 or 5."""
    import scipy.io

    with file.open("rb") as stream:
        declared = [(name, shape) for name, shape, _ in scipy.io.whosmat(stream) if name]
    size = 8 * sum(math.prod(shape) for _, shape in declared)
    reading.check_declared(unpacked=size, names=[name for name, _ in declared])
    if not all(name.isprintable() for name, _ in declared):
        raise ValueError("a variable's name is not text.")
    with file.open("rb") as stream:
        variables = scipy.io.loadmat(stream)
    arrays: Arrays = {}
    objects: Objects = {}
    for name, value in variables.items():
        if type(value).__name__ == "MatlabOpaque":
            described = np.asarray(value).flat[0]
            objects[word(described["s0"])] = word(described["s2"])
        elif not name.startswith("__"):
            for inner, array in _parts(name, value):
                arrays[inner] = array
                reading.check_declared(len(arrays))
    return _channels(arrays, objects)


def _parts(name: str, value: Any, depth: int = 0) -> Iterator[tuple[str, np.ndarray]]:
    """The arrays of a variable of SciPy's, those in structures and cells included."""
    if hasattr(value, "toarray"):  # it is sparse
        reading.check_declared(unpacked=8 * math.prod(value.shape))
        value = value.toarray()
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


@reading.apart("MAT (v7.3)", needs="HDF5")
def read_v73(file: Path) -> reading.Channels:
    """Read a file of version 7.3."""
    import h5py

    with h5py.File(file, "r") as source:
        datasets = list(walk(source, ".", _elements))
        check_size([dataset for _, dataset in datasets], file)
        objects = {
            name: word(dataset.attrs.get("MATLAB_class", "object"))
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
    reading.check_declared(int(item.size or 0))
    references = enumerate(np.asarray(item[()]).reshape(-1), start=1)
    whole, _, field = name.rpartition(".")
    is_cell = item.attrs.get("MATLAB_class") == b"cell" or not whole
    return [
        (f"{name}{{{i}}}" if is_cell else f"{whole}({i}).{field}", item.file[reference])
        for i, reference in references
        if reference
    ]
