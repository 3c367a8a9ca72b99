"""Reading MATLAB files: v4 and v5 through SciPy, v7.3 through HDF5."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from riecjax.records.reading.channels import (
    Channels,
    check_column_count,
    check_names,
    check_unpacked,
    foreign_reader,
    vectors,
    with_structure_times,
)
from riecjax.records.reading.matlab_elements import inflated

V73 = b"MATLAB 7.3"
HDF5 = b"\x89HDF\r\n\x1a\n"
DEEPEST = 16
"""Structures within structures past which a file is not followed."""


def read_mat(file: Path) -> Channels:
    """Read a MAT file of version 4, 5 or 7.3.

    Fields of structures are called `struct.field`, elements of cells `cell{1}` (from 1, as in
    MATLAB), columns of matrices `matrix[0]` (from 0). A structure's `time` is the time of what
    lies in it, as in Simulink's structures with time.

    **Raises:** `DataError` for a damaged file or one that unpacks to too much.
    """
    with file.open("rb") as stream:
        start = stream.read(520)
    if start.startswith(V73) or HDF5 in (start[:8], start[512:]):
        return with_structure_times(vectors(_read_v73(file)))
    return with_structure_times(vectors(_read_v5(file)))


def _read_v5(file: Path) -> dict[str, np.ndarray]:
    with foreign_reader("MAT"):
        import scipy.io

        source = inflated(file.read_bytes())
        check_names(name for name, _, _ in scipy.io.whosmat(source) if name)
        source.seek(0)
        variables = scipy.io.loadmat(source, verify_compressed_data_integrity=True)
        arrays: dict[str, np.ndarray] = {}
        for name, value in variables.items():
            if not name.startswith("__"):
                for inner, array in _parts(name, value):
                    arrays[inner] = array
                    check_column_count(len(arrays))
    return arrays


def _parts(name: str, value: object, depth: int = 0) -> Iterator[tuple[str, np.ndarray]]:
    """The arrays of a variable of SciPy's, those in structures and cells included."""
    array = np.asarray(value)
    if depth > DEEPEST or type(value).__name__ in ("MatlabOpaque", "MatlabFunction"):
        return
    elements = array.reshape(-1)
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


def _read_v73(file: Path) -> dict[str, np.ndarray]:
    with foreign_reader("MAT (v7.3)"):
        import h5py

        arrays: dict[str, np.ndarray] = {}
        with h5py.File(file, "r") as source:
            datasets = list(_datasets(source))
            sizes = [dataset.size * dataset.dtype.itemsize for _, dataset in datasets]
            check_unpacked(sum(sizes), file.stat().st_size)
            for name, dataset in datasets:
                arrays[name] = np.asarray(dataset[()])
    return arrays


def _datasets(source: Any) -> Iterator[tuple[str, Any]]:
    """Numeric datasets by the name of the variable in MATLAB; links to other files are not
    followed."""
    import h5py

    count = 0
    waiting = [(name, source, name, 0) for name in source if not name.startswith("#")]
    waiting.reverse()
    while waiting:
        key, group, name, depth = waiting.pop()
        if not isinstance(group.get(key, getlink=True), h5py.HardLink) or depth > DEEPEST:
            continue
        item = group[key]
        if isinstance(item, h5py.Group):
            waiting += [
                (inner, item, f"{name}.{inner}", depth + 1) for inner in reversed(list(item))
            ]
            continue
        for inner, dataset in _elements(source, name, item):
            count += 1
            check_column_count(count)
            yield inner, dataset


def _elements(source: Any, name: str, item: Any) -> Iterator[tuple[str, Any]]:
    """A dataset, or those that a cell (or an array of structures) refers to."""
    import h5py

    if not isinstance(item, h5py.Dataset) or not item.shape or item.is_virtual or item.external:
        return
    if item.attrs.get("MATLAB_empty", 0):
        return
    if item.dtype.kind in "fiub" and item.attrs.get("MATLAB_class") != b"char":
        yield name, item
    elif h5py.check_ref_dtype(item.dtype) is h5py.Reference:
        check_column_count(int(item.size or 0))
        for place, reference in enumerate(np.asarray(item[()]).reshape(-1, order="F"), start=1):
            target = source[reference] if reference else None
            if isinstance(target, h5py.Dataset) and target.dtype.kind in "fiub" and target.shape:
                yield f"{name}{{{place}}}", target
