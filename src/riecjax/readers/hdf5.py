"""Reading HDF5 files, with the extra `hdf5`; MATLAB's v7.3 walks through them as well."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from riecjax.errors import DataError
from riecjax.records import reading

DEEPEST = 16
"""Groups within groups past which a file is not followed."""
MOST_ITEMS = 100_000
"""Links and references that are followed before a file is refused."""
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
        datasets = dict(walk(source))
        for name, dataset in [*datasets.items()]:
            if sum(side > 1 for side in dataset.shape) > 2:
                why = f"its shape {dataset.shape} is not that of channels over time"
                whole.left_out[name] = why
                del datasets[name]
        check_size([*datasets.values()], file)
        for name, dataset in datasets.items():
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


def check_size(datasets: list[Any], file: Path) -> None:
    """Refuse datasets that declare more numbers than are read, or than the file can hold."""
    size = sum(d.size * d.dtype.itemsize for d in datasets)
    reading.check_declared(unpacked=size, packed=file.stat().st_size)


def walk(
    source: Any,
    separator: str = "/",
    inside: Callable[[str, Any], list[tuple[str, Any]] | None] = lambda name, dataset: None,
) -> Iterator[tuple[str, Any]]:
    """Datasets of a file with their names, in the file's order.

    Links to other files are not followed. A group that several links lead to is entered once, and
    so is a dataset of references, which may lead to itself.

    **Arguments:** `inside`: what a dataset refers to, by name, to be walked in its place; `None`
    for a dataset that counts itself.
    """
    import h5py

    # Two objects are equal, and have one hash, where they lie at one address in the file.
    entered, columns, followed = set(), 0, 0
    waiting: list[tuple[str, Any, int]] = [("", source, 0)]
    while waiting:
        name, item, depth = waiting.pop()
        if depth > DEEPEST or item in entered:
            continue
        if isinstance(item, h5py.Group):
            _check_items(followed + len(item))
            before = name + separator if name else ""
            within = [
                (before + key, item[key])
                for key in map(str, item)
                # MATLAB keeps what references lead to in groups of such names.
                if not (name == "" and key.startswith("#"))
                and isinstance(item.get(key, getlink=True), h5py.HardLink)
            ]
        elif (
            isinstance(item, h5py.Dataset)
            and (item.shape or item.dtype.kind in "fiub")
            and not (item.shape is None or item.is_virtual or item.external)
        ):
            within = inside(name, item)
        else:
            continue
        if within is None:
            columns += 1
            reading.check_declared(columns)
            yield name, item
        else:
            entered.add(item)
            followed += len(within)
            _check_items(followed)
            waiting += [(inner, each, depth + 1) for inner, each in reversed(within)]


def _check_items(count: int) -> None:
    if count > MOST_ITEMS:
        raise DataError(
            f"has {count} groups and references or more; at most {MOST_ITEMS} are read."
        )


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
