"""Records from pandas data frames and xarray data sets, without importing either library."""

from dataclasses import replace
from typing import Any

import numpy as np

from riecjax.errors import DataError
from riecjax.records.reading.channels import Channels, check_declared, vectors
from riecjax.records.reading.selection import record_from_channels
from riecjax.records.reading.times import TIME_COLUMNS
from riecjax.records.record import Record
from riecjax.settings import Frame, taking


@taking(Frame)
def from_dataframe(frame: Any, settings: Frame) -> Record:
    """Make a record from a pandas data frame: one signal for each column of numbers.

    Time is the column `time`, or an index of date-times, durations or floats (seconds), or a
    column called `t` or `time`. Date-times count in seconds from the first. Columns without
    numbers are left out. The other arguments are those of [`read_record`][].

    **Raises:** `DataError` without a time or for samples that do not make a record, `ModelError`
    for a formula.
    """
    arrays: dict[str, np.ndarray] = {}
    # Counts are no times. `t` is looked for before any other name of time.
    is_time = getattr(frame.index.dtype, "kind", "O") in "mMf" and settings.time is None
    if is_time and settings.time_step is None and frame.index.name not in frame.columns:
        arrays["t"] = _numbers(frame.index)
    names = [".".join(map(str, n)) if isinstance(n, tuple) else str(n) for n in frame.columns]
    check_declared(names=names)
    for place, name in enumerate(names):
        arrays.setdefault(name, _numbers(frame.iloc[:, place]))
    return _record(vectors(arrays), settings, settings.time)


@taking(Frame)
def from_dataset(dataset: Any, settings: Frame) -> Record:
    """Make a record from an xarray data set: one signal for each variable over time.

    Time is the coordinate `time`, or the only one that may be time by its name or its type.
    A variable of two dimensions becomes `name[0]`, `name[1]`, ... Units are the variables'
    attribute `units`. The other arguments are those of [`read_record`][].

    **Raises:** `DataError` without a time or for samples that do not make a record, `ModelError`
    for a formula.
    """
    axis = settings.time if settings.time_step is None else None
    there = ", ".join(map(str, dataset.coords)) or "none"
    if axis is not None and axis not in dataset.coords:
        raise DataError(f"there is no coordinate '{axis}'; there are: {there}.")
    if axis is None and settings.time_step is None:
        along = [name for name in dataset.dims if name in dataset.coords]
        times = [name for name in TIME_COLUMNS if name in along][:1]
        times = times or [name for name in along if dataset[name].dtype.kind in "mM"]
        if len(times) != 1:
            raise DataError(f"time= must name the coordinate that is time; there are: {there}.")
        axis = times[0]
    over = {n: v for n, v in dataset.data_vars.items() if axis is None or axis in v.dims}
    over |= {axis: dataset[axis]} if axis is not None else {}
    arrays, units = dict[str, np.ndarray](), dict[str, str]()
    for name, variable in over.items():
        values = _numbers(variable if axis is None else variable.transpose(axis, ...))
        rows = values.reshape(len(values), -1).T if values.ndim > 1 else ()
        parts = {f"{name}[{place}]": row for place, row in enumerate(rows)} or {str(name): values}
        arrays |= parts
        if unit := variable.attrs.get("units"):
            units |= dict.fromkeys(parts, str(unit))
    channels = vectors(arrays)
    # Stamps are in seconds already.
    channels = replace(channels, units=units | channels.units)
    return _record(channels, settings, axis)


def _record(channels: Channels, settings: Frame, time: object) -> Record:
    renamed = {**settings.rename} | ({"t": str(time)} if time is not None else {})
    return record_from_channels(channels, replace(settings, rename=renamed)).record


def _numbers(series: Any) -> np.ndarray:
    """A column as NumPy has it, NaN where there is no value, however pandas marks it."""
    kind = getattr(series.dtype, "kind", "O")
    if isinstance(series.dtype, np.dtype) or kind not in "iufbM":
        return np.asarray(series)
    if kind == "M":  # of a time zone
        return series.to_numpy("datetime64[ns]")
    return series.to_numpy(float, na_value=np.nan)
