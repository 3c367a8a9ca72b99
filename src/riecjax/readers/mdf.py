"""Reading measurement files in ASAM MDF (.mf4, .mdf), with the extra `mdf`."""

from pathlib import Path
from typing import Any

import numpy as np

from riecjax.errors import DataError
from riecjax.records import reading

IDENTIFICATIONS = (b"MDF ", b"UnFinMF ")
"""What an MDF file begins with, finished or not."""


@reading.apart("MDF", needs="MDF")
def read_mdf(file: Path) -> reading.Channels:
    """Read an MDF file: every channel group has its own time axis.

    A channel keeps its name; one whose name stands in several groups becomes `name (group 2)`,
    groups counted from 1. The times are called `time`, or `time (group 2)`. On some damaged files
    the library ends the whole process, so it reads in one of its own.

    **Raises:** `DataError` for a damaged file, or where asammdf is not installed; `MemoryError`.
    """
    with file.open("rb") as stream:
        if not stream.read(8).startswith(IDENTIFICATIONS):
            raise DataError("not a readable MDF file: it has no header of an MDF file.")
    import asammdf

    with file.open("rb") as stream, asammdf.MDF(stream) as source:
        whole = reading.Channels({})
        names = [channel.name for group in source.groups for channel in group.channels]
        count = sum(g.channel_group.cycles_nr * len(g.channels) for g in source.groups)
        reading.check_declared(len(names), 8 * count)
        for place, group in enumerate(source.groups):
            time = f"time (group {place + 1})" if len(source.groups) > 1 else "time"
            for index, channel in enumerate(group.channels):
                if index == source.masters_db.get(place):
                    continue
                signal: Any = source.get(group=place, index=index)
                is_repeated = names.count(channel.name) > 1 or channel.name == time
                name = f"{channel.name} (group {place + 1})" if is_repeated else channel.name
                samples = np.asarray(signal.samples)
                if samples.ndim != 1 or samples.dtype.kind not in "fiub":
                    whole.left_out[name] = "it holds no single numbers"
                    continue
                whole.take(name, samples.astype(float), str(signal.unit or ""))
                invalid = getattr(signal, "invalidation_bits", None)
                if invalid is not None:
                    whole.columns[name][np.asarray(invalid, bool)] = np.nan
                whole.columns[time] = np.asarray(signal.timestamps, float)
                whole.time_of[name] = time
    whole.note_left_out("channel")
    return whole
