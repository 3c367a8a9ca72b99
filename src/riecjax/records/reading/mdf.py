"""Reading measurement files in ASAM MDF (.mf4, .mdf), with the extra `mdf`.

On some damaged files the library ends the whole process instead of raising an error. So it runs in
a separate process, which is this module as a program: `python -m <this> FILE OUT.npz`.
"""

import contextlib
import importlib.util
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from riecjax.errors import DataError
from riecjax.records.reading.channels import (
    LARGEST_FILE,
    Channels,
    check_column_count,
    check_unpacked,
    foreign_reader,
)

IDENTIFICATIONS = (b"MDF ", b"UnFinMF ")
"""What an MDF file begins with, finished or not."""
PATIENCE = 60.0
"""Seconds that reading may take, besides those that the file's size explains."""
SLOWEST_READING = 5e6
"""Bytes a second."""
MEMORY = 4 * LARGEST_FILE
"""Bytes that the reading process may ask for."""
OUT_OF_MEMORY = 3
"""Exit status of the reading process."""


def read_mdf(file: Path) -> Channels:
    """Read an MDF file: every channel group has its own time axis.

    A channel keeps its name; one whose name stands in several groups becomes `name (group 2)`,
    groups counted from 1. The times are called `time`, or `time (group 2)`.

    **Raises:** `DataError` for a damaged file, or where asammdf is not installed; `MemoryError`.
    """
    if importlib.util.find_spec("asammdf") is None:
        raise DataError(
            "to read MDF files, install the package's extra: pip install 'riecjax[mdf]'."
        )
    with file.open("rb") as stream:
        if not stream.read(8).startswith(IDENTIFICATIONS):
            raise DataError("not a readable MDF file: it has no header of an MDF file.")
    limit = PATIENCE + file.stat().st_size / SLOWEST_READING
    # What the library leaves behind when it crashes goes with this folder.
    with tempfile.TemporaryDirectory(prefix="riecjax-", ignore_cleanup_errors=True) as folder:
        out = Path(folder) / "channels.npz"
        try:
            status = _run_reader(file, out, limit)
        except subprocess.TimeoutExpired:
            raise DataError(
                f"not a readable MDF file: reading it took longer than {limit:.0f} s."
            ) from None
        if status == OUT_OF_MEMORY:
            raise MemoryError
        if status != 0 or not out.is_file():
            raise DataError(
                "not a readable MDF file: its reader crashed, as it does on damaged files."
            )
        return _unpacked(out)


def _run_reader(file: Path, out: Path, limit: float) -> int:
    """Run the reading process for `limit` seconds at most, and return its exit status."""
    paths = os.pathsep.join(os.path.abspath(path) for path in sys.path)
    places = dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(out.parent))
    return subprocess.run(
        # -P: it finds its modules where this process does, and not in the working folder.
        [sys.executable, "-P", "-m", __spec__.name, str(file.absolute()), str(out)],
        env={**os.environ, **places, "PYTHONPATH": paths},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        timeout=limit,
        check=False,
    ).returncode


def _unpacked(out: Path) -> Channels:
    with np.load(out) as archive:
        described = json.loads(archive["described"].tobytes())
        if "error" in described:
            raise DataError(described["error"])
        names = described.pop("columns")
        return Channels({name: archive[str(i)] for i, name in enumerate(names)}, **described)


def _pack(file: Path, out: Path) -> None:
    """Read a file and write what it holds, or what is wrong with it."""
    columns: dict[str, np.ndarray] = {}
    try:
        found = _read(file)
        columns = found.columns
        described = {**vars(found), "columns": list(columns)}
    except DataError as error:
        described = {"error": str(error)}
    arrays: dict[str, Any] = {str(i): values for i, values in enumerate(columns.values())}
    np.savez(out, described=np.frombuffer(json.dumps(described).encode(), np.uint8), **arrays)


def _read(file: Path) -> Channels:
    import asammdf

    with foreign_reader("MDF"), file.open("rb") as stream, asammdf.MDF(stream) as source:
        _check_size(source)
        return _channels(source)


def _check_size(source: Any) -> None:
    check_column_count(sum(len(group.channels) for group in source.groups))
    check_unpacked(
        8 * sum(group.channel_group.cycles_nr * len(group.channels) for group in source.groups)
    )


def _channels(source: Any) -> Channels:
    columns: dict[str, np.ndarray] = {}
    units: dict[str, str] = {}
    time_of: dict[str, str] = {}
    left_out: dict[str, str] = {}
    names = [channel.name for group in source.groups for channel in group.channels]
    several = len(source.groups) > 1
    for place, group in enumerate(source.groups):
        time = f"time (group {place + 1})" if several else "time"
        masters = source.masters_db
        for index, channel in enumerate(group.channels):
            if index == masters.get(place):
                continue
            signal = source.get(group=place, index=index)
            repeated = names.count(channel.name) > 1 or channel.name == time
            name = f"{channel.name} (group {place + 1})" if repeated else channel.name
            samples = np.asarray(signal.samples)
            if samples.ndim != 1 or samples.dtype.kind not in "fiub":
                left_out[name] = "it holds no single numbers"
                continue
            columns[name] = _masked(signal, samples)
            columns[time] = np.asarray(signal.timestamps, float)
            time_of[name] = time
            if signal.unit:
                units[name] = str(signal.unit)
    notes = [f"channel '{name}' left out: {why}" for name, why in left_out.items()]
    return Channels(columns, units, time_of, left_out, notes)


def _masked(signal: Any, samples: np.ndarray) -> np.ndarray:
    """Samples as floats, NaN where the file marks them as invalid."""
    values = samples.astype(float)
    invalid = getattr(signal, "invalidation_bits", None)
    if invalid is not None:
        values[np.asarray(invalid, bool)] = np.nan
    return values


def _limit_resources() -> None:
    """Keep damaged sizes from the machine's memory, and crashes from its disk."""
    with contextlib.suppress(ImportError, ValueError, OSError):
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))


if __name__ == "__main__":
    _limit_resources()
    try:
        _pack(Path(sys.argv[1]), Path(sys.argv[2]))
    except MemoryError:
        sys.exit(OUT_OF_MEMORY)
