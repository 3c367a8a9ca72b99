"""What a file holds, whatever its format."""

import os
from collections.abc import Callable, Sequence
from pathlib import Path

from riecjax.errors import DataError, RiecjaxError
from riecjax.records.reading.channels import LARGEST_FILE, Channels, read_npz
from riecjax.records.reading.delimited import read_delimited
from riecjax.records.reading.matlab import read_mat
from riecjax.records.reading.mdf import read_mdf
from riecjax.records.reading.parquet import read_parquet

TEXT = (".csv", ".tsv", ".txt", ".asc", ".dat", ".lvm")
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


def read_channels(
    path: str | os.PathLike[str],
    *,
    delimiter: str | None = None,
    decimal: str | None = None,
    columns: Sequence[str] = (),
) -> Channels:
    """Read what a file holds, as named columns with units and notes on how it was read.

    **Arguments:** `delimiter`, `decimal` and `columns`, of a text file: how it delimits, its
    decimal sign, and the names of its columns, instead of detecting them.

    **Raises:** `DataError` if the file cannot be read.
    """
    file = Path(path)
    reader = _reader(file)
    _check_dialect(file, delimiter, decimal, columns)
    try:
        if file.suffix.lower() in TEXT:
            return read_delimited(file, delimiter, decimal, columns)
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


def _check_dialect(
    file: Path, delimiter: str | None, decimal: str | None, columns: Sequence[str]
) -> None:
    if (delimiter or decimal or columns) and file.suffix.lower() not in TEXT:
        raise DataError(
            f"{file.name}: delimiter, decimal sign and names of columns are for text files."
        )
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
