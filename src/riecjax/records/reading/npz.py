"""Reading NPZ archives of NumPy arrays, without ever unpickling."""

import zipfile
from pathlib import Path
from typing import IO

import numpy as np

from riecjax.records.reading.channels import (
    Channels,
    check_column_count,
    check_names,
    check_unpacked,
    foreign_reader,
    vectors,
)


def read_npz(file: Path) -> Channels:
    """Read an NPZ archive: vectors by their name, matrices as `name[0]`, `name[1]`, ...

    **Raises:** `DataError` for a damaged archive, one that unpacks to too much, and one with
    Python objects, which are never made.
    """
    with foreign_reader("NPZ"), zipfile.ZipFile(file) as archive:
        members = archive.infolist()
        check_column_count(len(members))
        check_unpacked(sum(member.file_size for member in members), file.stat().st_size)
        check_names(member.filename.removesuffix(".npy") for member in members)
        arrays = {}
        for member in members:
            with archive.open(member) as stream:
                arrays[member.filename.removesuffix(".npy")] = read_array(stream, member.file_size)
    return vectors(arrays)


def read_array(stream: IO[bytes], size: int) -> np.ndarray:
    """One array, once its declared shape is known to fit into the bytes that are there.

    **Raises:** `ValueError` if it does not, or for Python objects, which are never made.
    """
    version = np.lib.format.read_magic(stream)
    header = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }.get(version)
    if header is None:
        raise ValueError(f"arrays of version {version} are not read.")
    shape, fortran, dtype = header(stream)
    if dtype.hasobject:
        raise ValueError("it holds Python objects.")
    count = 1
    for side in shape:
        count *= side
    if min(shape, default=1) < 0 or count * dtype.itemsize > size:
        raise ValueError("an array is larger than its file.")
    flat = np.frombuffer(stream.read(), dtype=dtype, count=count)
    return flat.reshape(shape, order="F" if fortran else "C")
