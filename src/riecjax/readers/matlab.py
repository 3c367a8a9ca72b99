"""Reading MATLAB files: v4 and v5 through SciPy, v7.3 through HDF5, with the extra `hdf5`.

SciPy trusts a file of v5: a damaged one ends the process or asks for all memory, and so it is read
in a process of its own, as HDF5 is.
"""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from riecjax.readers.hdf5 import datasets, word
from riecjax.records import reading

HDF5 = b"\x89HDF\r\n\x1a\n"
HEADER = 512
"""Bytes before the content of a file of v7.3."""
OBJECT = "it is a {} of MATLAB, which only MATLAB reads: save its columns as vectors"
LONGEST_WORD = 100
"""Letters of a text that may be a unit."""


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
    return (read_v73 if HDF5 in (start[: len(HDF5)], start[HEADER:]) else read_v5)(file)


def _channels(arrays: dict[str, np.ndarray], left_out: dict[str, str]) -> reading.Channels:
    found = reading.vectors(arrays)
    found.left_out.update(left_out)
    words = {n: str(a.flat[0]) for n, a in arrays.items() if a.dtype.kind == "U" and a.size == 1}
    return reading.with_structure_times(reading.with_units_beside(found, words))


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
    arrays: dict[str, np.ndarray] = {}
    left_out: dict[str, str] = {}
    for name, value in variables.items():
        if type(value).__name__ == "MatlabOpaque":
            described = np.asarray(value).flat[0]
            left_out[word(described["s0"])] = OBJECT.format(word(described["s2"]))
        elif not name.startswith("__"):
            for inner, array in _parts(name, value):
                arrays[inner] = array
                reading.check_declared(len(arrays))
    return _channels(arrays, left_out)


def _parts(name: str, value: Any) -> Iterator[tuple[str, np.ndarray]]:
    """The arrays of a variable of SciPy's, those in structures and cells included."""
    if hasattr(value, "toarray"):  # it is sparse
        reading.check_declared(unpacked=8 * math.prod(value.shape))
        value = value.toarray()
    array = np.asarray(value)
    if type(value).__name__ in ("MatlabOpaque", "MatlabFunction"):
        return
    # Counted along columns, as MATLAB counts.
    elements = array.reshape(-1, order="F")
    if array.dtype.names:
        for place, element in enumerate(elements, start=1):
            whole = name if elements.size == 1 else f"{name}({place})"
            for field in array.dtype.names:
                yield from _parts(f"{whole}.{field}", element[field])
    elif array.dtype.kind == "O":
        for place, element in enumerate(elements, start=1):
            yield from _parts(f"{name}{{{place}}}", element)
    elif array.dtype.kind in "fiubcU":
        yield name, array


@reading.apart("MAT (v7.3)", needs="HDF5")
def read_v73(file: Path) -> reading.Channels:
    """Read a file of version 7.3."""
    import h5py

    with h5py.File(file, "r") as source:
        found, left_out = datasets(source, file, ".", _elements)
        left_out |= {
            name: OBJECT.format(word(dataset.attrs.get("MATLAB_class", "object")))
            for name, dataset in found.items()
            if "MATLAB_object_decode" in dataset.attrs
        }
        return _channels({n: _array(d) for n, d in found.items() if n not in left_out}, left_out)


def _array(dataset: Any) -> np.ndarray:
    """A dataset's numbers, or its text; what MATLAB calls empty is stored as its size."""
    if dataset.attrs.get("MATLAB_empty", 0):
        return np.zeros(0)
    values = np.asarray(dataset[()])
    if dataset.attrs.get("MATLAB_class") != b"char":
        return values
    return np.array(["".join(map(chr, values.reshape(-1)[:LONGEST_WORD]))])


def _elements(name: str, item: Any) -> dict[str, Any] | None:
    """What a cell, or a field of an array of structures, refers to; `None` for numbers."""
    import h5py

    if item.dtype.kind in "fiub":
        return None
    if h5py.check_ref_dtype(item.dtype) is not h5py.Reference:
        return {}
    reading.check_declared(int(item.size or 0))
    references = enumerate(np.asarray(item[()]).reshape(-1), start=1)
    whole, _, field = name.rpartition(".")
    is_cell = item.attrs.get("MATLAB_class") == b"cell" or not whole
    return {
        f"{name}{{{i}}}" if is_cell else f"{whole}({i}).{field}": item.file[reference]
        for i, reference in references
        if reference
    }
