"""Files as recordings, whose signals a model's kinematics brings to one time."""

import os

from riecjax.doubts.kinematics import align
from riecjax.records.record import Record
from riecjax.records.recording import Recording, every_recording, only_recording
from riecjax.settings import Reading, taking


@taking(Reading)
def read_record(path: str | os.PathLike[str], settings: Reading) -> Record:
    """Read a record from a file of any format that [`read_recording`][] reads.

    With the same keywords and errors, but only the signals.
    """
    return only_recording(path, settings, align).record


@taking(Reading)
def read_recording(path: str | os.PathLike[str], settings: Reading) -> Recording:
    """Read a recording from a text file, Excel, NPZ, MAT, HDF5, JSON, Parquet, MDF, TDMS or a bag.

    Time is a column in seconds, called `t` or `time` or renamed to `t`; where the file states
    another unit of time (`time [ms]`) it is converted. Signals are converted to SI from the units
    that the file states, or `units` does.
    Without `rename` every column as long as the time is a signal. [`read_channels`][] lists what a
    file holds, and the readers of the formats say how columns are named in files that hold more.

    **Arguments:** `model`, a `Model`, whose units the signals get, and which says which signals are
    derivatives of others, to be formed if the file lacks them; and the keywords of
    [`Select`][riecjax.settings.Select], [`Read`][riecjax.settings.Read] and
    [`Prepare`][riecjax.settings.Prepare].

    **Raises:** `DataError` if the file cannot be read, holds several recordings and no `part` is
    chosen, a named column is absent, the samples do not make a record (see
    [`Record.from_samples`][]), or a step is not possible; `ModelError` for a formula that is not
    understood.
    """
    return only_recording(path, settings, align)


@taking(Reading)
def read_recordings(path: str | os.PathLike[str], settings: Reading) -> list[Recording]:
    """Read all recordings that a file holds, each as [`read_recording`][] reads one.

    Elements of a cell or an array of structures of MATLAB, groups with the same channels in HDF5
    and TDMS, sheets with the same columns: `part` of each recording says which it is, as
    `runs(2)`. Columns are called as if a part were alone in its file: `x`, not `runs(2).x`. A
    part of which no record can be made is left out, with a finding; a file that is one recording
    gives a list of one.

    **Arguments** and errors as of [`read_recording`][]; of errors of parts, the first is raised
    where none can be read.
    """
    return every_recording(path, settings, align)
