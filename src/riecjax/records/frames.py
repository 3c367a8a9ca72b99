"""Records from pandas data frames and xarray data sets, without importing either library."""

from dataclasses import replace
from typing import Any

import numpy as np

from riecjax.errors import DataError
from riecjax.records.reading.channels import Channels, seconds_of, vectors
from riecjax.records.reading.selection import record_from_channels
from riecjax.records.reading.times import TIME_COLUMNS
from riecjax.records.reading.units import split_unit
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
    channels, renamed = Channels({}), dict(settings.rename)
    for place, label in enumerate(frame.columns):
        name = ".".join(map(str, label)) if isinstance(label, tuple) else str(label)
        if name in channels.columns or name in channels.left_out:
            raise DataError(f"two columns are called '{name}'.")
        if (values := _numbers(frame.iloc[:, place])) is None:
            channels.left_out[name] = f"it holds {frame.dtypes.iloc[place]}, not numbers"
        else:
            channels.columns[name] = values
            unit = split_unit(name)[1]
            channels.units.update({name: unit} if unit else {})
    if settings.time is not None:
        renamed["t"] = settings.time
    # Counts are no times.
    elif (
        "t" not in renamed
        and settings.time_step is None
        and getattr(frame.index.dtype, "kind", "O") in "mMf"
        and frame.index.name not in channels.columns
        and (index := _numbers(frame.index)) is not None
    ):
        # `t` is looked for before any other name of time.
        channels = replace(channels, columns={"t": index} | channels.columns | {"t": index})
    return record_from_channels(channels, replace(settings, rename=renamed)).record


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
    if axis is not None and axis not in dataset.coords:
        there = ", ".join(map(str, dataset.coords))
        raise DataError(f"there is no coordinate '{axis}'; there are: {there}.")
    if axis is None and settings.time_step is None:
        along = [name for name in dataset.dims if name in dataset.coords]
        times = [name for name in TIME_COLUMNS if name in along][:1]
        times = times or [name for name in along if dataset[name].dtype.kind in "mM"]
        if len(times) != 1:
            raise DataError(
                "time= must name the coordinate that is time; there are:"
                f" {', '.join(map(str, along)) or 'none'}."
            )
        axis = times[0]
    channels, arrays = Channels({}), dict[str, np.ndarray]()
    for name, variable in ((str(label), each) for label, each in dataset.data_vars.items()):
        if axis is not None and axis not in variable.dims:
            channels.left_out[name] = f"it does not depend on {axis}"
        elif (values := _numbers(variable.transpose(*[axis] * (axis is not None), ...))) is None:
            channels.left_out[name] = f"it holds {variable.dtype}, not numbers"
        else:
            parts = {name: values} if values.ndim == 1 else {
                f"{name}[{place}]": column
                for place, column in enumerate(values.reshape(values.shape[0], -1).T)
            }  # fmt: skip
            arrays |= parts
            unit = variable.attrs.get("units")
            channels.units.update(dict.fromkeys(parts, str(unit)) if unit else {})
    renamed = dict(settings.rename)
    if axis is not None:
        name = str(axis)
        if (values := _numbers(dataset[axis])) is None:
            raise DataError(f"the coordinate '{name}' holds no times.")
        arrays[name] = values
        if dataset[axis].attrs.get("units") and dataset[axis].dtype.kind in "fiu":
            channels.units.update(dict.fromkeys((name, "t"), str(dataset[axis].attrs["units"])))
        renamed["t"] = name
    channels = replace(channels, columns=vectors(arrays).columns)
    return record_from_channels(channels, replace(settings, rename=renamed)).record


def _numbers(series: Any) -> np.ndarray | None:
    """Numbers as floats, date-times and durations in seconds; `None` for anything else.

    NaN where there is no value, however pandas marks it.
    """
    if (kind := getattr(series.dtype, "kind", "O")) in "mM":
        if getattr(series.dtype, "tz", None) is not None:
            series = type(series)(series.to_numpy("datetime64[ns]"))
        return seconds_of(np.asarray(series))
    if kind in "iufb":
        try:
            return series.to_numpy(dtype=float, na_value=np.nan)
        except TypeError:  # xarray's has no such arguments
            return np.asarray(series.to_numpy(), dtype=float)
    return None
