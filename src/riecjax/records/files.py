"""Reading records from files and writing them: CSV, NPZ and MATLAB v5.

Files are data: nothing in them is executed (NPZ members with Python objects are refused).
"""

import csv
import os
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import scipy.io

from riecjax.errors import DataError
from riecjax.records.record import Record

TIME_COLUMNS = ("t", "time", "Time", "T", "time_s", "t_s")
"""Column names taken as time, in this order of preference; `--map t=COLUMN` names another."""

LARGEST_FILE = 4 * 2**30
"""Bytes a file may hold, unpacked, before it is refused."""


def read_record(
    path: str | os.PathLike[str],
    *,
    rename: Mapping[str, str] | None = None,
    scale: Mapping[str, float] | None = None,
    units: Mapping[str, str] | None = None,
) -> Record:
    """Read a record from a CSV, NPZ or MAT (v5) file.

    A CSV file has a header row of column names. NPZ and MAT files hold one array for each
    signal; arrays of other lengths than the time, such as settings, are left out. One column must
    be time in seconds, called `t` or `time` or renamed to `t`.

    **Arguments:**

    - `rename`: new signal name to column name, as in `{"q": "qm"}`; columns that are not named
      keep their names.
    - `scale`: column name (as in the file) to the factor that turns it into SI units.
    - `units`: signal name to unit.

    **Raises:** `DataError` if the file cannot be read, a named column is missing, or the samples
    do not make a record (see [`Record.from_samples`][]).
    """
    file = Path(path)
    columns = _reader(file)(file)
    if not columns:
        raise DataError(f"{file.name}: no columns of numbers were found.")
    try:
        return _record(columns, rename or {}, scale or {}, units or {})
    except DataError as error:
        raise DataError(f"{file.name}: {error}") from None


def write_record(path: str | os.PathLike[str], record: Record) -> None:
    """Write a record to CSV, NPZ or MAT, by the file name's ending, with time as column `t`.

    The file appears whole or not at all: it is written under a temporary name and renamed.

    **Raises:** `DataError` for another ending or a folder that cannot be written to.
    """
    file = Path(path)
    check_writable(file)
    writer = WRITERS[file.suffix.lower()]
    if "t" in record.arrays:
        raise DataError("a signal called 't' would take the place of time; give it another name.")
    columns = {"t": np.asarray(record.time)} | {
        name: np.asarray(values) for name, values in record.arrays.items()
    }
    write_whole(file, lambda temporary: writer(temporary, columns))


def check_writable(file: Path) -> None:
    """Raise `DataError` if no record can be written to `file`, before the work to make one."""
    if file.suffix.lower() not in WRITERS:
        raise DataError(
            f"cannot write '{file.name}': its ending must be one of {', '.join(WRITERS)}."
        )
    if not file.parent.is_dir():
        raise DataError(f"cannot write '{file}': there is no folder '{file.parent}'.")
    if file.is_dir():
        raise DataError(f"cannot write '{file}': it is a folder.")


def write_whole(file: Path, write: Callable[[Path], None]) -> None:
    """Let `write` fill a temporary file beside `file`, then rename it: whole or not at all."""
    try:
        handle, name = tempfile.mkstemp(dir=file.parent, suffix=f".tmp{file.suffix}")
    except OSError as error:
        raise DataError(f"cannot write '{file}': {error.strerror}.") from None
    os.close(handle)
    temporary = Path(name)
    try:
        write(temporary)
        mask = os.umask(0)
        os.umask(mask)
        temporary.chmod(0o666 & ~mask)
        temporary.replace(file)
    except OSError as error:
        raise DataError(f"cannot write '{file}': {error.strerror}.") from None
    finally:
        temporary.unlink(missing_ok=True)


def _record(
    columns: Mapping[str, np.ndarray],
    rename: Mapping[str, str],
    scale: Mapping[str, float],
    units: Mapping[str, str],
) -> Record:
    for column in (*rename.values(), *scale):
        if column not in columns:
            raise DataError(f"there is no column '{column}'; there are: {', '.join(columns)}.")
    scaled = {name: values * scale.get(name, 1.0) for name, values in columns.items()}
    taken = set(rename.values())
    signals = {name: values for name, values in scaled.items() if name not in taken}
    signals |= {name: scaled[column] for name, column in rename.items()}
    time_name = next((name for name in TIME_COLUMNS if name in signals), None)
    if time_name is None:
        raise DataError(
            f"there is no time column ('t' or 'time'); there are: {', '.join(columns)}. Name it by "
            f"renaming it to t (on the command line: --map t=COLUMN)."
        )
    time = signals.pop(time_name)
    signals = {name: values for name, values in signals.items() if values.size == time.size}
    for name in rename:
        if name not in signals and name != time_name:
            raise DataError(
                f"column '{rename[name]}' has another length than the time, {time.size} samples."
            )
    return Record.from_samples(signals, time=time, units=units)


def _reader(file: Path) -> Callable[[Path], dict[str, np.ndarray]]:
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


def _read_csv(file: Path) -> dict[str, np.ndarray]:
    try:
        with file.open(newline="", encoding="utf-8-sig") as stream:
            delimiter = _delimiter(stream.read(65536))
            stream.seek(0)
            names = _column_names(file, next(csv.reader(stream, delimiter=delimiter), []))
            rows = [line for line in stream if line.strip()]
    except UnicodeDecodeError:
        raise DataError(f"{file.name}: not a text file in UTF-8.") from None
    except csv.Error as error:
        raise DataError(f"{file.name}: {_first_sentence(error)}") from None
    except OSError as error:
        raise DataError(f"{file.name}: cannot be read: {error.strerror}.") from None
    if not rows:
        raise DataError(f"{file.name}: there are no samples below the column names.")
    try:
        table = np.loadtxt(rows, delimiter=delimiter, ndmin=2, comments=None)
    except ValueError as error:
        where = _first_bad_line(file, delimiter, len(names))
        raise DataError(f"{file.name}: {where or _first_sentence(error)}") from None
    if table.shape[1] != len(names):
        raise DataError(
            f"{file.name}: {len(names)} column names but {table.shape[1]} columns of numbers."
        )
    return dict(zip(names, table.T))


def _column_names(file: Path, header: list[str]) -> list[str]:
    names = [name.strip() for name in header]
    if not any(names) or all(_is_number(name) for name in names):
        raise DataError(f"{file.name}: the first row must name the columns.")
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise DataError(f"{file.name}: two columns are called '{twice}'.")
    return names


def _first_bad_line(file: Path, delimiter: str, columns: int) -> str:
    """In words, the first line below the header that is not one number for each column."""
    with file.open(newline="", encoding="utf-8-sig") as stream:
        reader = csv.reader(stream, delimiter=delimiter)
        next(reader)
        for row in reader:
            if not any(field.strip() for field in row):
                continue
            if len(row) != columns:
                return f"line {reader.line_num} has {len(row)} values for {columns} columns."
            for field in row:
                if not _is_number(field):
                    return f"line {reader.line_num}: {field.strip()[:40]!r} is not a number."
    return ""


def _read_npz(file: Path) -> dict[str, np.ndarray]:
    try:
        with zipfile.ZipFile(file) as archive:
            size = sum(member.file_size for member in archive.infolist())
        if size > LARGEST_FILE:
            raise DataError(f"{file.name}: unpacks to {size} bytes, more than is read.")
        with np.load(file, allow_pickle=False) as arrays:
            return _vectors({name: arrays[name] for name in arrays.files})
    except (DataError, MemoryError):
        raise
    except Exception as error:  # a damaged archive lets out whatever zlib, zip or NumPy raise
        raise DataError(f"{file.name}: not a readable NPZ file: {_first_sentence(error)}") from None


def _read_mat(file: Path) -> dict[str, np.ndarray]:
    try:
        variables = scipy.io.loadmat(file)
    except NotImplementedError:
        raise DataError(
            f"{file.name}: a MATLAB v7.3 file; save it with save(..., '-v7') to read it here."
        ) from None
    except MemoryError:
        raise
    except Exception as error:  # loadmat lets out whatever a damaged file provokes in it
        raise DataError(f"{file.name}: not a readable MAT file: {_first_sentence(error)}") from None
    return _vectors({k: v for k, v in variables.items() if not k.startswith("__")})


def _vectors(arrays: Mapping[str, object]) -> dict[str, np.ndarray]:
    """Numeric arrays with one long side, as vectors of floats."""
    vectors = {}
    for name, values in arrays.items():
        array = np.asarray(values)
        if array.dtype.kind in "fiub" and array.size > 1 and array.size == max(array.shape):
            vectors[name] = array.reshape(-1).astype(float)
    return vectors


def _write_csv(file: Path, columns: Mapping[str, np.ndarray]) -> None:
    table = np.column_stack(list(columns.values()))
    with file.open("w", newline="", encoding="utf-8") as stream:
        csv.writer(stream, lineterminator="\n").writerow(columns)
        # 17 digits bring every 64-bit number back exactly.
        np.savetxt(stream, table, delimiter=",", fmt="%.17g")


def _write_npz(file: Path, columns: Mapping[str, np.ndarray]) -> None:
    # NumPy's savez takes names as keywords, and so not all names.
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, values in columns.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, values, allow_pickle=False)


def _write_mat(file: Path, columns: Mapping[str, np.ndarray]) -> None:
    for name in columns:
        if not (name.isidentifier() and name.isascii() and name[0].isalpha()) or len(name) > 31:
            raise DataError(
                f"'{name}' cannot be a variable in a MAT file; rename it or write CSV or NPZ."
            )
    with file.open("wb") as stream:
        scipy.io.savemat(stream, dict(columns), oned_as="column")


def _delimiter(text: str) -> str:
    first = text.splitlines()[0] if text.strip() else ""
    return max((",", ";", "\t"), key=first.count)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _first_sentence(error: Exception) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0]


READERS = {".csv": _read_csv, ".npz": _read_npz, ".mat": _read_mat}
WRITERS = {".csv": _write_csv, ".npz": _write_npz, ".mat": _write_mat}
