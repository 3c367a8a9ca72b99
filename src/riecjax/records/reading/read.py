"""What a file holds, whatever its format."""

import importlib
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from riecjax.errors import DataError, RiecjaxError, printable
from riecjax.memory import require_memory
from riecjax.records.reading.channels import LARGEST_FILE, Channels, called, check_names, size_of
from riecjax.whole_files import no_file

TEXT = (".csv", ".tsv", ".txt", ".asc", ".dat", ".lvm", ".log", ".prn")
SHEETS = (".xlsx", ".xlsm")
READERS = {
    **dict.fromkeys(TEXT, "delimited.read_delimited"),
    ".npz": "channels.read_npz",
    ".mat": "matlab.read_mat",
    **dict.fromkeys((".h5", ".hdf5"), "hdf5.read_hdf5"),
    **dict.fromkeys((".jsonl", ".ndjson"), "json_objects.read_json_lines"),
    ".json": "json_objects.read_json",
    **dict.fromkeys(SHEETS, "spreadsheet.read_spreadsheet"),
    ".parquet": "parquet.read_parquet",
    ".tdms": "tdms.read_tdms",
    **dict.fromkeys((".mcap", ".db3", ".bag"), "ros_bag.read_ros_bag"),
    **dict.fromkeys((".mf4", ".mdf"), "mdf.read_mdf"),
}
"""Module and function that read a file, by its name's ending; imported where one is read."""

MEMORY_PER_BYTE = 8.0
MEMORY_PER_BYTE_OF_SHEETS = 20.0
"""What reading takes for each byte of a file."""
METADATA = "metadata.yaml"
"""What makes a folder a bag of ROS 2."""

LONGEST_MESSAGE = 2000
"""Characters of a message; names in a damaged file can be of any length."""


def read_channels(
    path: str | os.PathLike[str],
    *,
    delimiter: str | None = None,
    decimal: str | None = None,
    columns: Sequence[str] = (),
) -> Channels:
    """Read what a file holds, as named columns with units and notes on how it was read.

    **Arguments:** `delimiter`, `decimal` and `columns`, of a text file: how it delimits, its
    decimal sign, and the names of its columns, instead of detecting them; the last two also of a
    spreadsheet.

    **Raises:** `DataError` if the file cannot be read.
    """
    file = Path(path)
    try:
        reader = _reader(file)
    except OSError as error:  # of a name that is too long
        raise DataError(printable(f"cannot read '{file.name[:60]}': {error.strerror}.")) from None
    dialect = _dialect(file, delimiter, decimal, columns)
    each = MEMORY_PER_BYTE_OF_SHEETS if file.suffix.lower() in SHEETS else MEMORY_PER_BYTE
    require_memory(f"reading {file.name}", each * size_of(file), "Read a part of the file.")
    try:
        channels = reader(file, *dialect)
        # Nothing in names and words may steer a terminal.
        check_names(map(printable, channels.columns))
        return replace(
            called(channels, printable),
            units={printable(name): printable(unit) for name, unit in channels.units.items()},
            left_out={printable(name): printable(why) for name, why in channels.left_out.items()},
            notes=list(map(printable, channels.notes)),
            parts=list(map(printable, channels.parts)),
        )
    except RiecjaxError as error:
        raise _about(file, error) from None
    except OSError as error:
        said = f"{file.name}: cannot be read: {error.strerror or error}."
        raise DataError(printable(said)) from None


def _reader(file: Path) -> Callable[..., Channels]:
    is_bag = (file / METADATA).is_file()
    reader = READERS.get(".mcap" if is_bag else file.suffix.lower())
    if reader is None:
        raise DataError(
            f"cannot read '{file.name or file}': its ending must be one of {', '.join(READERS)}."
        )
    if not (file.is_file() or is_bag):
        raise DataError(no_file(file))
    if size_of(file) > LARGEST_FILE:
        raise DataError(f"{file.name}: larger than {LARGEST_FILE} bytes.")
    module, function = reader.split(".")
    return getattr(importlib.import_module(f"riecjax.records.reading.{module}"), function)


def _dialect(
    file: Path, delimiter: str | None, decimal: str | None, columns: Sequence[str]
) -> tuple[Any, ...]:
    """What the file's reader has to know besides the file."""
    ending = file.suffix.lower()
    # A tab as it can be typed.
    delimiter = "\t" if delimiter == "\\t" else delimiter
    if delimiter and ending not in TEXT:
        raise DataError(f"{file.name}: a delimiter is for text files.")
    if (decimal or columns) and ending not in TEXT + SHEETS:
        raise DataError(
            f"{file.name}: decimal sign and names of columns are for text files and spreadsheets."
        )
    if decimal not in (None, ".", ","):
        raise DataError(f"{file.name}: the decimal sign must be '.' or ','; got {decimal!r}.")
    if delimiter is not None and (
        len(delimiter) != 1 or delimiter in '"\r\n' or not delimiter.isascii()
    ):
        raise DataError(f"{file.name}: the delimiter must be one character; got {delimiter!r}.")
    if ending in SHEETS:
        return decimal, columns
    return (delimiter, decimal, columns) if ending in TEXT else ()


def _about(file: Path, error: RiecjaxError) -> RiecjaxError:
    """The same error in one line that begins with the file's name."""
    kind = type(error) if type(error).__init__ is RiecjaxError.__init__ else DataError
    return kind(printable(" ".join(f"{file.name}: {error}".split()))[:LONGEST_MESSAGE])
