"""Reading measurement files of LabVIEW (TDMS), with the extra `tdms`."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from riecjax.records import reading

UNITS = ("unit_string", "NI_UnitDescription", "unit", "Unit")
"""Properties that state a channel's unit."""


@reading.apart("TDMS", needs="TDMS")
def read_tdms(file: Path) -> reading.Channels:
    """Read a TDMS file: channels called `group/channel`, or `channel` where there is one group.

    In a group without a channel of time, a channel's time begins at its `wf_start_offset` and
    steps by its `wf_increment`; it is called `group/time`, and `time (2)` where others differ. Time
    stamps count from the channel's first.

    **Raises:** `DataError` for a damaged file, or where npTDMS is not installed; `MemoryError`.
    """
    from nptdms import TdmsFile

    with file.open("rb") as stream:
        source = TdmsFile.read_metadata(stream)
        channels = [channel for group in source.groups() for channel in group.channels()]
        names = [f"{channel.group_name}/{channel.name}" for channel in channels]
        reading.check_declared(0, 8 * sum(map(len, channels)), file.stat().st_size, names)
        stream.seek(0)
        with TdmsFile.open(stream) as source:
            whole = reading.joined(
                {group.name: _group(group.channels()) for group in source.groups()}
            )
    whole.note_left_out("channel")
    # Groups of it are no parts before their times tell.
    return reading.with_structure_times(
        reading.without_common_group(replace(whole, parts=[]), "/"), "/"
    )


def _group(channels: Sequence[Any]) -> reading.Channels:
    """Channels of a group by their own names, with the times that their increments give."""
    group = reading.vectors({channel.name: channel[:] for channel in channels})
    for channel in channels:
        stated = (channel.properties.get(name) for name in UNITS)
        unit = next((unit for unit in stated if isinstance(unit, str) and unit), None)
        if unit and channel.name in group.columns:
            group.units[channel.name] = unit
    if reading.find_time(group.columns, group.units, None) is not None:
        return group
    axes: dict[tuple[float, float, int], str] = {}
    for channel in channels:
        step = channel.properties.get("wf_increment")
        if channel.name not in group.columns or not isinstance(step, int | float) or not step > 0:
            continue
        start = float(channel.properties.get("wf_start_offset", 0.0))
        axis = (float(step), start, group.columns[channel.name].size)
        # One for all channels that agree on it.
        name = axes.setdefault(axis, "time" + f" ({len(axes) + 1})" * bool(axes))
        group.columns[name] = start + step * np.arange(axis[2])
        group.time_of[channel.name] = name
    return group
