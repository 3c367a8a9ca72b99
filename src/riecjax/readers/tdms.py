"""Reading measurement files of LabVIEW (TDMS), with the extra `tdms`."""

import contextlib
import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from riecjax.records.reading.channels import (
    Channels,
    check_column_count,
    check_extra,
    check_names,
    check_unpacked,
    foreign_reader,
    with_structure_times,
    without_common_group,
)
from riecjax.records.reading.child_process import read_apart
from riecjax.records.reading.times import find_time

UNITS = ("unit_string", "NI_UnitDescription", "unit", "Unit")
"""Properties that state a channel's unit."""


def read_tdms(file: Path) -> Channels:
    """Read a TDMS file: channels called `group/channel`, or `channel` where there is one group.

    In a group without a channel of time, a channel's time begins at its `wf_start_offset` and
    steps by its `wf_increment`; it is called `group/time`, and `time (2)` where others differ. Time
    stamps count from the channel's first.

    **Raises:** `DataError` for a damaged file, or where npTDMS is not installed; `MemoryError`.
    """
    check_extra("nptdms", "TDMS", "tdms")
    return read_apart(_read, file, "TDMS")


def _read(file: Path) -> Channels:
    whole = Channels({})
    with foreign_reader("TDMS"), file.open("rb") as stream, _quietly():
        from nptdms import TdmsFile

        source = TdmsFile.read_metadata(stream)
        channels = [channel for group in source.groups() for channel in group.channels()]
        check_column_count(len(channels))
        check_unpacked(8 * sum(map(len, channels)), file.stat().st_size)
        stream.seek(0)
        with TdmsFile.open(stream) as source:
            for group in source.groups():
                _add_group(whole, group)
    whole.notes.extend(f"channel '{name}' left out: {why}" for name, why in whole.left_out.items())
    return with_structure_times(without_common_group(whole, "/"), "/")


@contextlib.contextmanager
def _quietly() -> Iterator[None]:
    """Without what the library prints of files that end too early; it reads them to their end."""
    from nptdms.log import log_manager

    before = log_manager.log_level
    log_manager.set_level(logging.CRITICAL)
    try:
        yield
    finally:
        log_manager.set_level(before)


def _add_group(whole: Channels, group: Any) -> None:
    """Add a group's channels and their times to what a file holds."""
    read = {channel.name: _samples(channel) for channel in group.channels()}
    check_names([*whole.columns, *(f"{group.name}/{name}" for name in read)])
    units: dict[str, str] = {}
    for channel in group.channels():
        name, values = channel.name, read[channel.name]
        if values is None:
            whole.left_out[f"{group.name}/{name}"] = "it holds no real numbers"
        elif unit := _unit(channel):
            units[name] = unit
    columns = {name: values for name, values in read.items() if values is not None}
    if find_time(columns, units, None) is None:
        _add_times(whole, group, columns)
    whole.columns.update({f"{group.name}/{name}": values for name, values in columns.items()})
    whole.units.update({f"{group.name}/{name}": unit for name, unit in units.items()})


def _samples(channel: Any) -> np.ndarray | None:
    values = np.asarray(channel[:])
    if values.dtype.kind == "M":
        ticks = values.astype("datetime64[us]").astype(np.int64)
        return (ticks - ticks[:1]) * 1e-6
    return values.astype(float) if values.dtype.kind in "fiub" else None


def _unit(channel: Any) -> str:
    stated = (channel.properties.get(name) for name in UNITS)
    return next((unit for unit in stated if isinstance(unit, str) and unit), "")


def _add_times(whole: Channels, group: Any, columns: dict[str, np.ndarray]) -> None:
    """Add times by increments, one for all channels that agree on it."""
    axes: dict[tuple[float, float, int], str] = {}
    for channel in group.channels():
        step = channel.properties.get("wf_increment")
        if channel.name not in columns or not isinstance(step, int | float) or not step > 0:
            continue
        start = float(channel.properties.get("wf_start_offset", 0.0))
        axis = (float(step), start, columns[channel.name].size)
        name = axes.setdefault(axis, f"{group.name}/time" + f" ({len(axes) + 1})" * bool(axes))
        whole.columns[name] = start + step * np.arange(axis[2])
        whole.time_of[f"{group.name}/{channel.name}"] = name
