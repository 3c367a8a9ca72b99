"""Reading a recording from a file, whatever its format."""

import os
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from riecjax.errors import DataError, RiecjaxError
from riecjax.records.reading.channels import LARGEST_FILE, Channels, read_npz
from riecjax.records.reading.delimited import read_delimited
from riecjax.records.reading.matlab import read_mat
from riecjax.records.reading.mdf import read_mdf
from riecjax.records.reading.parquet import read_parquet
from riecjax.records.reading.selection import Selection, record_from_channels
from riecjax.records.record import Record

TEXT = (".csv", ".tsv", ".txt")
READERS: dict[str, Callable[[Path], Channels]] = {
    **dict.fromkeys(TEXT, read_delimited),
    ".npz": read_npz,
    ".mat": read_mat,
    ".parquet": read_parquet,
    ".mf4": read_mdf,
    ".mdf": read_mdf,
}
"""How a file is read, by its name's ending."""

LONGEST_MESSAGE = 2000
"""Characters of a message; names in a damaged file can be of any length."""


def read_record(
    path: str | os.PathLike[str],
    *,
    rename: Mapping[str, str] | None = None,
    scale: Mapping[str, float] | None = None,
    units: Mapping[str, str] | None = None,
    derive: Mapping[str, str] | None = None,
    time_step: float | None = None,
    resample: float | None = None,
    delimiter: str | None = None,
    decimal: str | None = None,
) -> Record:
    """Read a record from a CSV, TSV, TXT, NPZ, MAT, Parquet, or MDF file.

    Time is a column in seconds, called `t` or `time` or renamed to `t`; where the file states
    another unit of time (`time [ms]`) it is converted. Other units are noted but not converted.
    Without `rename` every column as long as the time is a signal. How names are made in files that
    hold more than columns is documented by their readers; [`read_channels`][] lists them.

    **Arguments:**

    - `rename`: new signal name to column name, as in `{"q": "qm"}`; columns that are not named
      keep their names. A unit in brackets may be left out of a column's name.
    - `scale`: column name (as in the file) or signal name to the factor that turns it into SI
      units.
    - `units`: signal name to unit, before those that the file states.
    - `derive`: signal name to a formula of signals, as in `{"force": "35.15 * vir"}`; see
      [`derived`][]. Formulas are computed in their order, last of all.
    - `time_step`: seconds between samples, for files without time.
    - `resample`: rate in Hz of the even grid to which all signals are brought: for uneven
      samples, and for files in which signals have different times.
    - `delimiter`, `decimal`: of a text file, where they cannot be recognised.

    **Raises:** `DataError` if the file cannot be read, a named column is missing, or the samples
    do not make a record (see [`Record.from_samples`][]); `ModelError` for a formula that is not
    understood.
    """
    channels = read_channels(path, delimiter=delimiter, decimal=decimal)
    selection = Selection(rename or {}, scale or {}, units or {}, derive or {}, time_step, resample)
    try:
        # Damaged numbers overflow; what is not finite is found and named.
        with np.errstate(all="ignore"):
            return record_from_channels(channels, selection)
    except RiecjaxError as error:
        raise _about(Path(path), error) from None


def read_channels(
    path: str | os.PathLike[str], *, delimiter: str | None = None, decimal: str | None = None
) -> Channels:
    """Read what a file holds, as named columns with units and notes on how it was read.

    **Raises:** `DataError` if the file cannot be read.
    """
    file = Path(path)
    reader = _reader(file)
    _check_dialect(file, delimiter, decimal)
    try:
        if file.suffix.lower() in TEXT:
            return read_delimited(file, delimiter, decimal)
        return reader(file)
    except RiecjaxError as error:
        raise _about(file, error) from None
    except OSError as error:
        raise DataError(f"{file.name}: cannot be read: {error.strerror or error}.") from None


def _reader(file: Path) -> Callable[[Path], Channels]:
    reader = READERS.get(file.suffix.lower())
    if reader is None:
        raise DataError(
            f"cannot read '{file.name or file}': its ending must be one of {', '.join(READERS)}."
        )
    if not file.is_file():
        raise DataError(f"there is no file '{file}'.")
    if file.stat().st_size > LARGEST_FILE:
        raise DataError(f"{file.name}: larger than {LARGEST_FILE} bytes.")
    return reader


def _check_dialect(file: Path, delimiter: str | None, decimal: str | None) -> None:
    if (delimiter or decimal) and file.suffix.lower() not in TEXT:
        raise DataError(f"{file.name}: delimiter and decimal sign are for text files.")
    if decimal not in (None, ".", ","):
        raise DataError(f"{file.name}: the decimal sign must be '.' or ','; got {decimal!r}.")
    if delimiter is not None and (
        len(delimiter) != 1 or delimiter in '"\r\n' or not delimiter.isascii()
    ):
        raise DataError(f"{file.name}: the delimiter must be one character; got {delimiter!r}.")


def _about(file: Path, error: RiecjaxError) -> RiecjaxError:
    """The same error in one line that begins with the file's name."""
    kind = type(error) if type(error).__init__ is RiecjaxError.__init__ else DataError
    return kind(" ".join(f"{file.name}: {error}".split())[:LONGEST_MESSAGE])
