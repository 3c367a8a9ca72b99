"""Reading HDF5 files, with the extra `hdf5`; MATLAB's v7.3 walks through them as well."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from riecjax.records import reading

UNITS = ("units", "unit", "Units", "Unit", "UNITS", "UNIT")
"""Attributes that state a dataset's unit."""

SCALES = ("scale", "Scale", "gain", "Gain", "factor", "slope", "sensitivity")
"""Attributes of counts by which they may be multiplied, or divided, or were."""


@reading.apart("HDF5", needs="HDF5")
def read_hdf5(file: Path) -> reading.Channels:
    """Read an HDF5 file: datasets called by their path, as `run/position`.

    The path begins below the group that holds all of them. Fields of a table (a structured type)
    are columns as datasets are, those of a matrix `name[0]`, `name[1]`, ... Attributes `units`
    state units; `scale_factor`, `add_offset` and `_FillValue` are applied, as NetCDF means them. A
    group's `time` is the time of what lies in it.

    **Raises:** `DataError` for a damaged file, one that unpacks to too much, or where h5py is not
    installed; `MemoryError`.
    """
    import h5py

    arrays: dict[str, Any] = {}
    stated: dict[str, str] = {}
    whole = reading.Channels({})
    with h5py.File(file, "r") as source:
        found, left_out = datasets(source, file)
        whole.left_out.update(left_out)
        for name, dataset in found.items():
            columns, notes = _columns(name, dataset)
            whole.notes.extend(notes)
            reading.check_declared(names=[*arrays, *columns])
            arrays |= columns
            # One unit for all columns of a dataset, or one for each.
            attribute = next((dataset.attrs[key] for key in UNITS if key in dataset.attrs), ())
            units = [word(unit) for unit in np.ravel(attribute)]
            scale = next((key for key in SCALES if _number(dataset, key) is not None), "")
            if scale and dataset.dtype.kind in "iu":
                units = [f"{u or 'counts'}{reading.BY_ATTRIBUTE}{scale}" for u in units or [""]]
            units *= len(columns) if len(units) == 1 else 1
            if len(units) == len(columns):
                stated |= dict(zip(columns, units))
    whole.note_left_out("dataset")
    whole.take_all(reading.vectors(arrays))
    for column in whole.columns:
        if unit := stated.get(column) or stated.get(column.split("[")[0]):
            whole.units[column] = unit
    return reading.with_structure_times(reading.without_common_group(whole, "/"), "/")


def word(text: object) -> str:
    """A text, which an attribute may hold as bytes."""
    return text.decode(errors="replace") if isinstance(text, bytes) else str(text)


def datasets(
    source: Any,
    file: Path,
    separator: str = "/",
    inside: Callable[[str, Any], dict[str, Any] | None] = lambda name, dataset: None,
) -> tuple[dict[str, Any], dict[str, str]]:
    """Datasets of a file by name, in the file's order, and why others are left out.

    Links to other files are not followed. A group that several links lead to is entered once, and
    so is a dataset of references, which may lead to itself. Single values count if they are
    numbers.

    **Arguments:** `inside`: what a dataset refers to, by name, to be walked in its place; `None`
    for a dataset that counts itself.

    **Raises:** `DataError` for more of them, or more links in one group, than columns are read, and
    where they declare more numbers than are read, or than the file can hold.
    """
    import h5py

    # Two objects are equal, and have one hash, where they lie at one address in the file.
    found, left_out, entered, size = {}, {}, set(), 0
    waiting: list[tuple[str, Any]] = [("", source)]
    while waiting:
        name, item = waiting.pop()
        if item in entered:
            continue
        shape = getattr(item, "shape", None)
        if hasattr(item, "keys"):  # it is a group
            reading.check_declared(len(item))
            before = name + separator if name else ""
            within = {
                before + key: item[key]
                for key in map(str, item)
                # MATLAB keeps what references lead to in groups of such names.
                if not (name == "" and key.startswith("#"))
                and isinstance(item.get(key, getlink=True), h5py.HardLink)
            }
        elif shape is None or item.is_virtual or item.external:
            continue
        else:
            within = inside(name, item) if shape or item.dtype.kind in "fiub" else {}
        if within is not None:
            entered.add(item)
            waiting += reversed(within.items())
        elif sum(side > 1 for side in item.shape) > 2:
            left_out[name] = f"its shape {shape} is not that of channels over time"
        else:
            found[name] = item
            size += item.size * item.dtype.itemsize
            reading.check_declared(len(found), size, file.stat().st_size)
    return found, left_out


def _columns(name: str, dataset: Any) -> tuple[dict[str, np.ndarray], list[str]]:
    """A dataset's numbers or texts, of a table its fields, and how counts became numbers."""
    import h5py

    if h5py.check_string_dtype(dataset.dtype):
        return {name: np.asarray(dataset.asstr(errors="replace")[()]).astype(str)}, []
    values = np.asarray(dataset[()])
    if values.dtype.names is not None:
        return {f"{name}/{field}": values[field] for field in values.dtype.names}, []
    packed = [_number(dataset, key) for key in ("scale_factor", "add_offset")]
    if packed == [None, None]:
        return {name: values}, []
    fill = _number(dataset, "_FillValue")
    factor, offset = (1.0 if packed[0] is None else packed[0]), packed[1] or 0.0
    unpacked = np.where(values == fill, np.nan, factor * values.astype(float) + offset)
    return {name: unpacked}, [f"'{name}': times {factor:g} plus {offset:g}, as its attributes say"]


def _number(dataset: Any, attribute: str) -> float | None:
    value = np.ravel(dataset.attrs.get(attribute, ()))
    return float(value[0]) if value.size == 1 and value.dtype.kind in "iuf" else None
