"""Writing records to files: CSV, NPZ, MATLAB v5 and Parquet, whole or not at all."""

import csv
import os
import re
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import scipy

from riecjax.errors import DataError
from riecjax.records.record import Record
from riecjax.records.time_base import STEP_TOLERANCE
from riecjax.whole_files import require_plain, write_file

Columns = Mapping[str, np.ndarray]
FORMULA = r"(^|[;|,\t]\s*)(?=[=+@-])"
"""Where a spreadsheet would take a name for a formula, or what it splits off a name."""


def write_record(path: str | os.PathLike[str], record: Record) -> None:
    """Write a record to CSV, NPZ, MAT or Parquet, by the file name's ending, time as column `t`.

    A gap is written as NaN, in CSV as an empty field; a pause is one in the times. Only
    Parquet keeps units. In CSV a name that a spreadsheet would take for a formula has a `'` before
    its sign, which is dropped where it is read. The file appears whole or not at all: it is written
    under a temporary name and renamed.

    **Raises:** `DataError` for another ending, a name that the format cannot hold, or a folder
    that cannot be written to.
    """
    file = Path(path)
    check_writable(file)
    if "t" in record.arrays:
        raise DataError("a signal called 't' would take the place of time; give it another name.")
    # NaN in gaps, without the samples that mark pauses.
    signals = {name: signal.with_nan for name, signal in record.by_name.items()}
    columns = {"t": np.asarray(record.time, dtype=float)} | signals
    if record.stamps is not None:
        # Samples that mark a pause: no signal has a value there, and they are off the even grid.
        time, step = columns["t"], float(record.time_step)
        empty = np.all(np.isnan([*signals.values()]), axis=0)
        off = np.abs(np.diff(time) - step) > STEP_TOLERANCE * step
        # An empty sample beside a pause is a real one, and the pause's lies midway; at an end of a
        # record that was cut there is nothing to lie midway of.
        middles = 0.5 * (time[:-2] + time[2:])
        empty[1:-1] &= np.isclose(time[1:-1], middles, rtol=0, atol=1e-6 * step)
        valid = ~(empty & (np.append(off, False) | np.insert(off, 0, False)))
        columns = {name: values[valid] for name, values in columns.items()}
    ending = file.suffix.lower()
    allowed, refusal = NAMES.get(ending, (lambda name: True, ""))
    if refused := [name for name in columns if not allowed(name)]:
        raise DataError(f"{refused[0]!r} cannot {refusal}.")
    write_file(file, lambda path: WRITERS[ending](path, columns, dict(record.units)))


def check_writable(file: Path) -> None:
    """Raise `DataError` if no record can be written to `file`, before the work to make one."""
    if file.suffix.lower() not in WRITERS:
        raise DataError(
            f"cannot write '{file.name}': its ending must be one of {', '.join(WRITERS)}."
        )
    try:
        if not file.parent.is_dir():
            raise DataError(f"cannot write '{file}': there is no folder '{file.parent}'.")
        require_plain(file)
    except OSError as error:
        raise DataError(f"cannot write '{file}': {error.strerror}.") from None
    if not os.access(file.parent, os.W_OK):
        raise DataError(f"cannot write '{file}': its folder may not be written to.")


def _write_csv(file: Path, columns: Columns, units: Mapping[str, str]) -> None:
    table = np.column_stack(list(columns.values()))
    with file.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(re.sub(FORMULA, r"\1'", name) for name in columns)
        # 17 digits bring every 64-bit number back exactly.
        writer.writerows(["" if x != x else f"{x:.17g}" for x in row] for row in table.tolist())


def write_npz(file: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write arrays by name to an NPZ archive of exactly this file name."""
    # NumPy's savez takes names as keywords, and so not all names.
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, values in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, values, allow_pickle=False)


def _write_mat(file: Path, columns: Columns, units: Mapping[str, str]) -> None:
    with file.open("wb") as stream:
        scipy.io.savemat(stream, dict(columns), oned_as="column")


def _write_parquet(file: Path, columns: Columns, units: Mapping[str, str]) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    units = {"t": "s", **units}
    fields = [
        pa.field(name, pa.float64(), metadata={"unit": units[name]} if name in units else None)
        for name in columns
    ]
    table = pa.table(list(columns.values()), schema=pa.schema(fields))
    with file.open("wb") as stream:
        parquet.write_table(table, stream, write_page_checksum=True)


WRITERS: dict[str, Callable[[Path, Columns, Mapping[str, str]], None]] = {
    ".csv": _write_csv,
    ".npz": lambda file, columns, _: write_npz(file, columns),
    ".mat": _write_mat,
    ".parquet": _write_parquet,
}
"""How a record is written, by the file name's ending."""
NAMES: dict[str, tuple[Callable[[str], object], str]] = {
    ".csv": (
        lambda name: name.isprintable() and name == name.strip() and name.strip('"') == name != "",
        "name a column in CSV; rename it or write NPZ",
    ),
    # What unpacks an archive would write others elsewhere, and cut at a null character.
    ".npz": (
        lambda name: not re.search(r"^[A-Za-z]:|^[/\\]|(^|[/\\])\.\.([/\\]|$)|\0", name),
        "be a member of an archive; rename it",
    ),
    ".mat": (
        lambda name: re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,30}", name),
        "be a variable in a MAT file; rename it or write CSV or NPZ",
    ),
}
"""Which names a format can hold, and what is said of others."""
