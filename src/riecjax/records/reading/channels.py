"""What a file holds, whatever its format: named columns, the limits on reading them, and NPZ, which
holds no more.
"""

import contextlib
import importlib
import inspect
import math
import os
import re
import warnings
import zipfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import IO, Any

import numpy as np

from riecjax.errors import DataError, RiecjaxError, printable, require
from riecjax.extensions import extension, extension_names
from riecjax.records.reading.times import TIME_COLUMNS
from riecjax.records.reading.units import split_unit
from riecjax.runtime import require_memory
from riecjax.whole_files import no_file

LARGEST_FILE = 4 * 2**30
"""Bytes a file may hold, unpacked, before it is refused."""
MOST_COLUMNS = 10_000
"""Columns a file may hold before it is refused."""
NUMBERED = "column {}"
"""What a column without a name is called, by its number from 1."""
HIGHEST_PACKING = 1100
"""Bytes that one byte of a deflated file can hold (1032), with its headers."""

LONGEST_REASON = 200
"""Characters of a library's error that are passed on; some quote the whole file."""


def check_declared(
    columns: int = 0, unpacked: int = 0, packed: int | None = None, names: Iterable[str] = ()
) -> None:
    """Refuse a file for what it declares, before anything is made of it.

    **Arguments:** `columns`: how many; `unpacked`: bytes, of which the file holds `packed` ones;
    `names` of columns.

    **Raises:** `DataError` past `MOST_COLUMNS`, past `LARGEST_FILE` or what any packing could give,
    and for two columns of one name.
    """
    count = Counter(names)
    columns = max(columns, count.total())
    if columns > MOST_COLUMNS:
        raise DataError(f"has {columns} columns; at most {MOST_COLUMNS} are read.")
    if unpacked > LARGEST_FILE:
        raise DataError(f"unpacks to {unpacked} bytes; at most {LARGEST_FILE} are read.")
    if packed is not None and unpacked > HIGHEST_PACKING * (packed + 2**16):
        raise DataError(f"declares {unpacked} bytes in a file of {packed} bytes; it is damaged.")
    for name, times in count.items():
        if times > 1:
            raise DataError(f"two columns are called '{name}'.")


def size_of(file: Path) -> int:
    """Bytes of a file, or of all files in a folder."""
    files = file.iterdir() if file.is_dir() else [file]
    return sum(one.stat().st_size for one in files if one.is_file())


@contextlib.contextmanager
def foreign_reader(kind: str, is_trusted: bool = True) -> Iterator[None]:
    """Run a library on a file that may be damaged: any error becomes one `DataError`.

    Libraries raise whatever a damaged file leads them to. `MemoryError` passes, as it need not be
    the file's fault, unless the library is not trusted: one that asks for whatever size stands in a
    damaged file before it finds that the file ends.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except RiecjaxError:
        raise
    except MemoryError:
        if is_trusted:
            raise
        said = f"not a readable {kind} file: it declares more than memory holds."
        raise DataError(said) from None
    except Exception as error:
        raise DataError(f"not a readable {kind} file: {first_sentence(error)}") from None


def first_sentence(error: BaseException) -> str:
    """The start of an exception's first line, or its type where it has none."""
    said = (str(error).strip().splitlines() or [""])[0][:LONGEST_REASON]
    # An absent key says no more than its name, an end of the process no more than its status.
    is_bare = not said or isinstance(error, KeyError | SystemExit)
    return f"{type(error).__name__} {said}" if is_bare else said


WIDEST_MATRIX = 1000
"""Columns of a matrix past which it is a picture and not a set of channels."""


@dataclass(frozen=True)
class Channels:
    """Named columns of numbers, as a file holds them.

    **Fields:**

    - `columns`: name to samples, each a vector of 64-bit floats; NaN in gaps.
      Lengths may differ.
    - `units`: column to its unit, where the file states one.
    - `time_of`: column to the column with its time, in files with several time axes.
    - `left_out`: name to the reason why this part of the file is no column.
    - `notes`: what was decided on reading, in words.
    - `nested`: whether names tell of structures or groups, some of which may be recordings.
    - `scalars`: name to a single value beside the columns, which formulas may use.
    - `parts`: groups that the format itself sets apart, sheets of a workbook: columns of one are
      called `part/column`.
    """

    columns: dict[str, np.ndarray]
    units: dict[str, str] = field(default_factory=dict)
    time_of: dict[str, str] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    nested: bool = False
    parts: list[str] = field(default_factory=list)
    scalars: dict[str, float] = field(default_factory=dict)

    def named(self, column: str) -> tuple[str, str | None]:
        """A column's name without its unit, and the unit that the file or the name states."""
        name, unit = split_unit(column, self.nested)
        return name, self.units.get(column) or unit

    @property
    def short(self) -> dict[str, str]:
        """Columns to their names without units."""
        return {column: self.named(column)[0] for column in self.columns}

    def take(self, name: str, values: np.ndarray | None, unit: str = "", why: str = "") -> None:
        """Add a column, in its unit where it has one; leave out what is none, with the reason."""
        if values is None:
            self.left_out[name] = why
            return
        self.columns[name] = values
        if unit:
            self.units[name] = unit

    def take_all(self, other: "Channels") -> None:
        """Add what another one holds, but for its notes."""
        self.columns.update(other.columns)
        self.units.update(other.units)
        self.time_of.update(other.time_of)
        self.left_out.update(other.left_out)
        self.scalars.update(other.scalars)

    def note_left_out(self, kind: str) -> None:
        """Note why each part that is left out is, which the format calls `kind`."""
        notes = (f"{kind} '{name}' left out: {why}" for name, why in self.left_out.items())
        self.notes.extend(map(str.lstrip, notes))


def vectors(arrays: Mapping[str, object]) -> Channels:
    """Numeric arrays as columns: vectors by their name, matrices as `name[0]`, `name[1]`, ...

    The long side of a matrix is that of the samples. Dates, durations and stamps as text are
    seconds. Single values are scalars. Left out are square matrices, other text and objects, with
    the reason.
    """
    found = Channels({})
    for name, values in arrays.items():
        array, unit = _real(np.asarray(values))
        sides = () if array is None else [side for side in array.shape if side != 1]
        if array is None:
            found.left_out[name] = "it holds no real numbers"
        elif not array.size:
            found.left_out[name] = "it is empty"
        elif len(sides) == 1:
            found.take(name, array.reshape(-1).astype(float), unit)
        elif len(sides) == 2 and sides[0] != sides[1] and min(sides) <= WIDEST_MATRIX:
            matrix = array.reshape(sides)
            by_channel = enumerate(matrix if sides[0] < sides[1] else matrix.T)
            found.columns.update({f"{name}[{i}]": row.astype(float) for i, row in by_channel})
        elif not sides:
            found.scalars[name] = float(array.flat[0])
        else:
            found.left_out[name] = f"its shape {array.shape} is not that of channels over time"
        if len(found.columns) > MOST_COLUMNS:
            raise DataError(f"has more than {MOST_COLUMNS} columns; no more are read.")
    return found


def _real(array: np.ndarray) -> tuple[np.ndarray | None, str]:
    """An array's real numbers, `None` if it has none, and their unit where they were stamps."""
    if array.dtype.kind in "mM":
        return seconds_of(array), "s"
    if array.dtype.kind == "S":
        array = np.char.decode(array, "utf-8", "replace")
    if array.dtype.kind == "U":
        # It loads PyArrow, which numbers do without.
        from riecjax.records.reading.literals import of_texts

        return of_texts(array.tolist()) if array.ndim == 1 and array.size > 1 else (None, "")
    if array.dtype.kind == "c" and not np.imag(array).any():
        array = np.real(array)
    return (array if array.dtype.kind in "fiub" else None), ""


def seconds_of(stamps: np.ndarray) -> np.ndarray:
    """NumPy's date-times as seconds from the first, and durations in seconds; NaN for NaT."""
    if np.datetime_data(stamps.dtype)[0] not in ("s", "ms", "us", "ns"):
        stamps = stamps.astype(f"{stamps.dtype.kind}8[us]")
    gaps = np.isnat(stamps)
    # Counted from the first before they become floats, which hold only 16 digits.
    if stamps.dtype.kind == "M":
        stamps = stamps - (stamps[~gaps][0] if not gaps.all() else stamps[:1])
    return np.where(gaps, np.nan, stamps / np.timedelta64(1, "s"))


def with_units_beside(channels: Channels, texts: Mapping[str, str]) -> Channels:
    """The same with the units that stand beside columns: `x_unit`, or `x.unit` beside `x.values`.

    Beside several columns of one structure a unit is none of theirs.
    """
    units = dict(channels.units)
    for name, text in texts.items():
        found = _UNIT_BESIDE.fullmatch(name)
        if found is None or not text.strip():
            continue
        within = [c for c in channels.columns if c.startswith(f"{found['of']}.")]
        inner = [c for c in within if c[len(found["of"]) + 1 :] not in TIME_COLUMNS]
        own = [found["of"]] if found["of"] in channels.columns else inner
        if len(own) == 1:
            units.setdefault(own[0], text.strip())
    return replace(channels, units=units)


_UNIT_BESIDE = re.compile(r"(?P<of>.+?)(?:[._]|(?<=[a-z]))[uU]nits?")


def with_structure_times(channels: Channels, separator: str = ".") -> Channels:
    """Assign to each column `a.b.values` its time, `a.b.time` or else `a.time`, of equal length.

    Names count as those of structures or groups, whose levels `separator` tells apart.
    """
    time_of = dict(channels.time_of)
    for name, values in channels.columns.items():
        group = name
        while separator in group:
            group = group.rpartition(separator)[0]
            times = (f"{group}{separator}{time}" for time in TIME_COLUMNS)
            found = next((time for time in times if time in channels.columns), None)
            if found and channels.columns[found].size == values.size:
                time_of[name] = found
                break
    return replace(channels, time_of=time_of, nested=True)


def without_common_group(channels: Channels, separator: str) -> Channels:
    """The same with names that begin below the group in which all columns lie."""
    group = f"{next(iter(channels.columns), '').partition(separator)[0]}{separator}"
    is_common = channels.columns and all(name.startswith(group) for name in channels.columns)
    # The stroke of a unit, as in `v (m/s)`, parts no groups.
    if not is_common or {*group} & {*"[("}:
        return channels
    return without_common_group(called(channels, lambda n: n.removeprefix(group)), separator)


def joined(parts: Mapping[str, Channels]) -> Channels:
    """Parts as one, columns called `part/column`."""
    whole = Channels({}, parts=list(parts))
    for name, part in parts.items():
        whole.take_all(called(part, f"{name}/{{}}".format))
        whole.notes.extend(f"{name}: {note}" for note in part.notes)
    return whole


def called(channels: Channels, new: Callable[[str], str]) -> Channels:
    """The same with its columns called otherwise."""
    return replace(
        channels,
        columns={new(name): values for name, values in channels.columns.items()},
        units={new(name): unit for name, unit in channels.units.items()},
        time_of={new(name): new(time) for name, time in channels.time_of.items()},
        left_out={new(name): why for name, why in channels.left_out.items()},
        # A scalar that would be called as another one keeps its whole name.
        scalars={
            name if new(name) in channels.scalars else new(name): value
            for name, value in channels.scalars.items()
        },
    )


def read_npz(file: Path) -> Channels:
    """Read an NPZ archive: vectors by their name, matrices as `name[0]`, `name[1]`, ...

    Fields of structured arrays are columns; Python objects are never made.

    **Raises:** `DataError` for a damaged archive, and one that unpacks to too much.
    """
    with foreign_reader("NPZ"), zipfile.ZipFile(file) as archive:
        members = archive.infolist()
        names = [member.filename.removesuffix(".npy") for member in members]
        size = sum(member.file_size for member in members)
        check_declared(0, size, file.stat().st_size, names)
        made = 0
        for member in members:
            with archive.open(member) as stream:
                shape, _, dtype = _header(stream)
            is_table = sum(side > 1 for side in shape) <= 2
            made += 8 * math.prod(shape) * max(len(dtype.names or ()), 1) * is_table
        check_declared(unpacked=made)
        require_memory("reading its arrays", 2 * made, "Read a part of the file.")
        arrays: dict[str, np.ndarray] = {}
        left_out = {}
        for name, member in zip(names, members):
            with archive.open(member) as stream:
                array = read_array(stream, member.file_size)
            if array is None:
                left_out[name] = "it holds Python objects, which are not read"
            else:
                fields = array.dtype.names or ()
                inner = {field: array[field] for field in fields} if fields else {name: array}
                check_declared(names=[*arrays, *inner])
                arrays |= inner
    found = vectors(arrays)
    found.left_out.update(left_out)
    return found


def read_array(stream: IO[bytes], size: int) -> np.ndarray | None:
    """One array of the NPY format, once its declared shape is known to fit into its bytes.

    `None` for Python objects, which are never made.

    **Raises:** `ValueError` if it does not fit.
    """
    shape, fortran, dtype = _header(stream)
    if dtype.hasobject:
        return None
    count = math.prod(shape)
    if min(shape, default=1) < 0 or count * dtype.itemsize > size:
        raise ValueError("an array is larger than its file.")
    flat = np.frombuffer(stream.read(), dtype=dtype, count=count)
    return flat.reshape(shape, order="F" if fortran else "C")


def _header(stream: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype]:
    """Shape, whether it runs along columns, and type of the array that follows."""
    if (version := np.lib.format.read_magic(stream)) not in ((1, 0), (2, 0)):
        raise ValueError(f"arrays of version {version} are not read.")
    return getattr(np.lib.format, f"read_array_header_{version[0]}_0")(stream)


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
    file, suffix = Path(path), Path(path).suffix.lower()
    # A tab as it can be typed.
    delimiter = "\t" if delimiter == "\\t" else delimiter
    given = {"delimiter": delimiter, "decimal": decimal, "columns": columns}
    try:
        # A folder is read by a file in it.
        readers = extension_names("readers") if file.is_dir() else ()
        inside = [member for member in readers if (file / member).is_file()]
        if suffix in READERS and not inside:
            module, function = READERS[suffix].split(".")
            source = importlib.import_module(f"riecjax.records.reading.{module}")
            reader: Any = getattr(source, function)
        else:
            reader = extension("readers", inside[0] if inside else suffix.removeprefix("."))
        if reader is None:
            allowed = f"its ending must be one of {', '.join(endings())}"
            raise DataError(f"cannot read '{file.name or file}': {allowed}.")
        if not inside and not file.is_file():
            raise DataError(no_file(file))
    except OSError as error:  # of a name that is too long
        raise DataError(printable(f"cannot read '{file.name[:60]}': {error.strerror}.")) from None
    try:
        if size_of(file) > LARGEST_FILE:
            raise DataError(f"larger than {LARGEST_FILE} bytes.")
        takes = inspect.signature(reader).parameters
        if needless := [name for name, value in given.items() if value and name not in takes]:
            kinds = "text files" + " and spreadsheets" * (needless[0] != "delimiter")
            raise DataError(f"'{needless[0]}' is for {kinds}.")
        if decimal not in (None, ".", ","):
            raise DataError(f"the decimal sign must be '.' or ','; got {decimal!r}.")
        if not re.fullmatch('[^"\r\n\x80-\U0010ffff]', delimiter or ","):
            raise DataError(f"the delimiter must be one character; got {delimiter!r}.")
        memory = MEMORY_PER_BYTE * size_of(file)
        require_memory(f"reading {file.name}", memory, "Read a part of the file.")
        channels = reader(file, **{name: value for name, value in given.items() if name in takes})
        require("what its reader returned", channels, Channels, "a reader that returns Channels")
        for name, samples in channels.columns.items():
            if getattr(samples, "ndim", 0) != 1 or samples.dtype != float:
                kind = type(samples).__name__
                raise DataError(
                    f"its reader gave column '{name}' as {kind}, not as a vector of 64-bit floats."
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
    except (Exception, SystemExit) as error:
        said = ""
        if isinstance(error, OSError):
            said = f"cannot be read: {error.strerror or error}."
        elif not isinstance(error, RiecjaxError):
            # Of a reader from elsewhere anything may come.
            if isinstance(error, MemoryError) or suffix in READERS:
                raise
            said = f"its reader failed: {first_sentence(error)}"
        cause = None if isinstance(error, RiecjaxError) else error
        raise about(file.name, error, said) from cause


def endings() -> tuple[str, ...]:
    """Endings of names of files that can be read, the core's own first."""
    further = (f".{name}" for name in extension_names("readers") if "." not in name)
    return tuple(dict.fromkeys((*READERS, *further)))


def about(name: str, error: BaseException, said: str = "") -> RiecjaxError:
    """The same error in one line that begins with a file's name; `said` instead of its words."""
    said = said or str(error)
    prefix = "" if said.startswith(f"{name}: ") else f"{name}: "
    kind = type(error) if isinstance(error, RiecjaxError) else DataError
    # An error that takes more than words says them anew.
    kind = kind if kind.__init__ is RiecjaxError.__init__ else DataError
    return kind(" ".join(printable(prefix + said).split())[:LONGEST_MESSAGE])
