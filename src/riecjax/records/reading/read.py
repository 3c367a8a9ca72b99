"""What a file holds, whatever its format."""

import importlib
import inspect
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from riecjax.errors import DataError, RiecjaxError, printable, require
from riecjax.extensions import extension, extension_names
from riecjax.memory import require_memory
from riecjax.records.reading.channels import (
    LARGEST_FILE,
    Channels,
    called,
    check_declared,
    first_sentence,
    size_of,
)
from riecjax.whole_files import no_file

READERS = {
    **dict.fromkeys(
        (".csv", ".tsv", ".txt", ".asc", ".dat", ".lvm", ".log", ".prn"), "delimited.read_delimited"
    ),
    ".npz": "channels.read_npz",
    **dict.fromkeys((".jsonl", ".ndjson"), "json_objects.read_json_lines"),
    ".json": "json_objects.read_json",
    ".parquet": "parquet.read_parquet",
}
"""Module and function that read a file, by its name's ending; imported where one is read. Readers
of further endings are extensions."""

MEMORY_PER_BYTE = 8.0
"""What reading takes for each byte of a file; a reader that takes more asks for it itself."""

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
        # A folder is read by a file in it.
        readers = extension_names("readers") if file.is_dir() else ()
        inside = [member for member in readers if (file / member).is_file()]
        name = inside[0] if inside else file.suffix.lower()
        if name in READERS:
            module, function = READERS[name].split(".")
            source = importlib.import_module(f"riecjax.records.reading.{module}")
            reader: Any = getattr(source, function)
        else:
            reader = extension("readers", name.removeprefix("."))
        if reader is None:
            listed = ", ".join(endings())
            raise DataError(
                f"cannot read '{file.name or file}': its ending must be one of {listed}."
            )
        if not inside and not file.is_file():
            raise DataError(no_file(file))
        if size_of(file) > LARGEST_FILE:
            raise DataError(f"{file.name}: larger than {LARGEST_FILE} bytes.")
        takes = inspect.signature(reader).parameters
        # A tab as it can be typed.
        delimiter = "\t" if delimiter == "\\t" else delimiter
        if delimiter and "delimiter" not in takes:
            raise DataError(f"{file.name}: a delimiter is for text files.")
        if (decimal and "decimal" not in takes) or (columns and "columns" not in takes):
            raise DataError(
                f"{file.name}: decimal sign and names of columns are for text files and "
                f"spreadsheets."
            )
        if decimal not in (None, ".", ","):
            raise DataError(f"{file.name}: the decimal sign must be '.' or ','; got {decimal!r}.")
        if delimiter is not None and (
            len(delimiter) != 1 or delimiter in '"\r\n' or not delimiter.isascii()
        ):
            raise DataError(f"{file.name}: the delimiter must be one character; got {delimiter!r}.")
        given = {"delimiter": delimiter, "decimal": decimal, "columns": columns}
        dialect = {name: value for name, value in given.items() if name in takes}
        require_memory(
            f"reading {file.name}", MEMORY_PER_BYTE * size_of(file), "Read a part of the file."
        )
    except OSError as error:  # of a name that is too long
        raise DataError(printable(f"cannot read '{file.name[:60]}': {error.strerror}.")) from None
    try:
        channels = reader(file, **dialect)
        require("what its reader returned", channels, Channels, "a reader that returns Channels")
        for name, samples in channels.columns.items():
            if getattr(samples, "ndim", 0) != 1 or samples.dtype != float:
                raise DataError(
                    f"its reader gave column '{name}' as {type(samples).__name__}, not as a vector "
                    f"of 64-bit floats."
                )
        # Nothing in names and words may steer a terminal.
        check_declared(names=map(printable, channels.columns))
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
        raise _about(file, DataError(f"cannot be read: {error.strerror or error}.")) from None
    except (Exception, SystemExit) as error:
        if isinstance(error, MemoryError) or file.suffix.lower() in READERS:
            raise
        # Of a reader from elsewhere anything may come.
        raise _about(file, DataError(f"its reader failed: {first_sentence(error)}")) from error


def endings() -> tuple[str, ...]:
    """Endings of names of files that can be read, the core's own first."""
    further = (f".{name}" for name in extension_names("readers") if "." not in name)
    return tuple(dict.fromkeys((*READERS, *further)))


def _about(file: Path, error: RiecjaxError) -> RiecjaxError:
    """The same error in one line that begins with the file's name."""
    kind = type(error) if type(error).__init__ is RiecjaxError.__init__ else DataError
    return kind(printable(" ".join(f"{file.name}: {error}".split()))[:LONGEST_MESSAGE])
