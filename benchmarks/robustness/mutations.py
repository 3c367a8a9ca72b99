"""Recordings of known machines, and what loggers, cables, editors and disks do to their files.

A mutation takes a sound recording to one that a careful engineer would look at twice. Faults of
sensors are those of `benchmarks.recovery`. Left out are those that nobody could tell from the file
alone:

- With position and force only, a column that is scaled, or whose unit is wrong: the scaled record
  is the exact record of another machine. Its sign is judged where it makes a mass negative.
- The force scaled, even with all else recorded: a machine that is so many times heavier, damped
  and stiffer. (Position against velocity is judged.)
- Time scaled together with a rate that stays plausible, where no velocity is recorded.
- Changes below the noise: a flipped last digit, a repeated sample, a shift by less than a sample.
- Rows that are cut out with their time where the machine is at the same place at both ends.
"""

import contextlib
import functools
import io
import warnings
import zipfile
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import h5py
import numpy as np
import pyarrow as pa
import scipy.integrate
from pyarrow import parquet

from benchmarks.robustness.formats import ALL_WRITERS, WRITERS, Columns

TRUTH = {"m": 1.5, "r": 0.8, "r2": 0.5, "k": 20.0}
RATE, COUNT = 200, 4000
TONES = ((1.7, 0.0, 3.0), (3.1, 1.0, 4.0), (5.7, 2.0, 8.0), (9.3, 0.5, 14.0), (15.1, 3.0, 20.0))


class Rig(NamedTuple):
    """A recording without fault, and how one identifies from it."""

    columns: dict[str, np.ndarray]
    options: tuple[str, ...]


class Case(NamedTuple):
    """A file after a mutation; `file` is its name, `options` go with `identify`."""

    mutation: str
    file: str
    content: bytes
    options: tuple[str, ...]


def force(t: np.ndarray | float) -> np.ndarray | float:
    """Five tones, in N."""
    return sum(size * np.sin(w * t + phase) for w, phase, size in TONES)


@functools.cache
def rigs(seed: int = 0) -> tuple[Rig, Rig]:
    """An oscillator with drag: with its velocity recorded, and with its position only.

    Solved by SciPy at tight tolerance; each sensor has white noise, 0.1 % of its signal's rms, or
    0.001 % (an encoder's) where there is no velocity.
    """
    t = np.arange(COUNT) / RATE
    m, r, r2, k = TRUTH.values()
    run = scipy.integrate.solve_ivp(
        lambda t, s: [s[1], (force(t) - r * s[1] - r2 * s[1] * abs(s[1]) - k * s[0]) / m],
        (0, t[-1]),
        [0.0, 0.0],
        t_eval=t,
        rtol=1e-9,
        atol=1e-11,
    )
    exact = {"x": run.y[0], "dx": run.y[1], "u": np.asarray(force(t))}
    rng = np.random.default_rng(seed)

    def noisy(share: float, names: Sequence[str]) -> dict[str, np.ndarray]:
        measured = {n: exact[n] + share * np.std(exact[n]) * rng.normal(size=COUNT) for n in names}
        return {"t": t, **measured}

    common = ("--model", "drag-oscillator", "--json")
    hat = ("--test-function", "hat", "--quadrature", "4", "--alpha", "0.2", "--beta", "0.5")
    return (
        Rig(noisy(1e-3, ("x", "dx", "u")), common),
        Rig(noisy(1e-5, ("x", "u")), (*common, *hat)),
    )


# Mutations of columns: for files of every format.


def _pick(columns: Mapping[str, np.ndarray], rng: np.random.Generator) -> str:
    """One of the signals."""
    return str(rng.choice([name for name in columns if name != "t"]))


def _place(rng: np.random.Generator, length: int = 1) -> slice:
    """A stretch well inside."""
    start = int(rng.integers(300, COUNT - 300 - length))
    return slice(start, start + length)


def _with(columns: Mapping[str, np.ndarray], name: str, values: np.ndarray) -> Columns:
    return list({**columns, name: values}.items())


def _changed(
    columns: Mapping[str, np.ndarray], name: str, where: slice | np.ndarray, values: object
) -> Columns:
    return _with(columns, name, _set(columns[name], where, values))


def _rows(columns: Mapping[str, np.ndarray], rows: np.ndarray | slice) -> Columns:
    return [(name, values[rows]) for name, values in columns.items()]


def _signals(
    columns: Mapping[str, np.ndarray], change: Callable[[np.ndarray], np.ndarray]
) -> Columns:
    """Every signal changed, time as it was."""
    return [(n, v if n == "t" else change(v)) for n, v in columns.items()]


def _set(values: np.ndarray, where: slice | np.ndarray, to: object) -> np.ndarray:
    changed = values.copy()
    changed[where] = to
    return changed


def _texts(values: np.ndarray) -> np.ndarray:
    return np.array([f"{value:.9g}" for value in values])


def clean(columns, rng):
    return list(columns.items())


def shuffled_signals(columns, rng):
    """Rows in any order beside a time that was sorted again."""
    order = rng.permutation(COUNT)
    return _signals(columns, lambda values: values[order])


def swapped_blocks(columns, rng):
    """Two seconds and two others in each other's place, time as it was."""
    a, b = 200 * int(rng.integers(1, 8)), 200 * int(rng.integers(10, 17))
    order = np.arange(COUNT)
    order[a : a + 400], order[b : b + 400] = order[b : b + 400].copy(), order[a : a + 400].copy()
    return _signals(columns, lambda values: values[order])


def repeated_rows(columns, rng):
    block = _place(rng, 100)
    order = np.r_[0 : block.stop, block.start : COUNT]
    return _rows(columns, order)


def repeated_block(columns, rng):
    """A buffer that is written twice, in the place of the next one."""
    block = _place(rng, 200)
    order = np.arange(COUNT)
    order[block.stop : block.stop + 200] = order[block]
    return _signals(columns, lambda values: values[order])


def swapped_columns(columns, rng):
    a, b = rng.choice(list(columns), 2, replace=False)
    return [({a: b, b: a}.get(name, name), values) for name, values in columns.items()]


def dropped_column(columns, rng):
    name = str(rng.choice(list(columns)))
    return [(n, v) for n, v in columns.items() if n != name]


def duplicated_column(columns, rng):
    """A second column of a name, with other samples."""
    name = str(rng.choice(list(columns)))
    other = str(rng.choice([n for n in columns if n != name]))
    return [*columns.items(), (name, columns[other])]


def renamed_column(columns, rng):
    name = str(rng.choice(list(columns)))
    return [({name: str(rng.choice(["y", "X", "zeit"]))}.get(n, n), v) for n, v in columns.items()]


def many_nan(columns, rng):
    name = _pick(columns, rng)
    share = rng.choice([0.001, 0.01, 0.3, 1.0])
    return _changed(columns, name, rng.random(COUNT) < share, np.nan)


def text_entry(columns, rng):
    name = str(rng.choice(list(columns)))
    values = _texts(columns[name]).astype(object)
    some = rng.choice(COUNT, int(rng.choice([1, 3, 100])), replace=False)
    values[some] = str(rng.choice(["ERR", "-", "over range", "#REF!", "1,5", "12:30"]))
    return _with(columns, name, values.astype(str))


def wrapped(columns, rng):
    """A counter that overflows: values leave one end of the range and come in at the other."""
    name = _pick(columns, rng)
    limit = rng.uniform(0.3, 0.85) * np.abs(columns[name]).max()
    return _with(columns, name, (columns[name] + limit) % (2 * limit) - limit)


def huge(columns, rng):
    name = str(rng.choice(list(columns)))
    at = _place(rng) if rng.random() < 0.7 else slice(None)
    return _changed(columns, name, at, rng.choice([1e160, -1e300, 1.7e308]))


def infinite(columns, rng):
    name = str(rng.choice(list(columns)))
    return _changed(columns, name, _place(rng), rng.choice([-np.inf, np.inf]))


def scaled_time(columns, rng):
    """With a velocity beside it."""
    return _with(columns, "t", columns["t"] * rng.choice([1e3, 60.0, 0.5, 1e-3]))


def changed_stamp(columns, rng):
    at = _place(rng)
    by = 10.0 ** rng.uniform(-2.5, 4) * rng.choice([-1, 1])
    return _changed(columns, "t", at, columns["t"][at] + by)


def reversed_rows(columns, rng):
    """Backwards in time; half of them with the stamps put in order, which turns damping round."""
    backward = _rows(columns, slice(None, None, -1))
    if rng.random() < 0.5:
        return backward
    return _signals(columns, lambda v: v[::-1])


def spliced(columns, rng):
    """A second cut out, and the time counted on as if nothing were missing."""
    start = _place(rng, 200).start
    rows = dict(_rows(columns, np.r_[0:start, start + 200 : COUNT]))
    return list({**rows, "t": columns["t"][: COUNT - 200]}.items())


def offset_jump(columns, rng):
    """From some time on, 1 to 1e3 times the signal's rms beside what it should be."""
    name = _pick(columns, rng)
    by = np.std(columns[name]) * 10.0 ** rng.uniform(0, 3) * rng.choice([-1, 1])
    at = slice(_place(rng).start, None)
    return _changed(columns, name, at, columns[name][at] + by)


def huge_spikes(columns, rng):
    """A few samples near the largest number, in one signal or in all."""
    at = rng.choice(COUNT, int(rng.integers(1, 40)), replace=False)
    spikes = rng.choice([1e300, -1e300, 1.7e308], at.size)
    if rng.random() < 0.3:
        return _signals(columns, lambda values: _set(values, at, spikes))
    return _changed(columns, _pick(columns, rng), at, spikes)


def extreme_scale(columns, rng):
    """All signals, or one, so large or small that squares overflow or vanish."""
    factor = float(rng.choice([1e300, 1e-300, 1e160, 1e-170, 5e-324]))
    if rng.random() < 0.5:
        return _signals(columns, lambda values: values * factor)
    name = _pick(columns, rng)
    return _with(columns, name, columns[name] * factor)


def silent(columns, rng):
    return _signals(columns, np.zeros_like)


NAMES_OF_ATTACKERS = (
    "=HYPERLINK(0)", "+1", "-2+3", "@SUM(A1)", "x" * 3000, "\x1b[2J\x1b]0;a\x07", "\u202egnp.x",
    "../../x", "/etc/x", "$\\frac{x$", "<script>alert(1)</script>", "[/red]", "a\tb", "a\rb", "",
    "%s%n", "{0.__class__}", "x\x00y", "\ud7ff", "'; --", "__class__", "nan", "1e5", "t ", "力",
)  # fmt: skip


def hostile_names(columns, rng):
    """Of a column that nobody needs, or in place of a signal's."""
    new = str(rng.choice(NAMES_OF_ATTACKERS))
    if rng.random() < 0.5:
        return [*columns.items(), (new, columns["x"])]
    old = _pick(columns, rng)
    return [(new if name == old else name, values) for name, values in columns.items()]


def mixed(columns, rng):
    """Two or three at once, of those that can still be told."""
    for place in rng.choice(len(MIXABLE), int(rng.integers(2, 4)), replace=False):
        # What one has taken away the next may look for in vain.
        with contextlib.suppress(KeyError, IndexError, ValueError, TypeError):
            columns = dict(MIXABLE[place](columns, rng))
    return list(columns.items())


def _named(*mutations: Callable[..., Any]) -> dict[str, Callable[..., Any]]:
    return {mutation.__name__.replace("_", " "): mutation for mutation in mutations}


def _any(change: Callable[[np.ndarray], np.ndarray], *, signal: bool = False) -> Any:
    """Of the values of any one column, or of a signal."""

    def mutation(columns, rng):
        name = _pick(columns, rng) if signal else str(rng.choice(list(columns)))
        return _with(columns, name, change(columns[name]))

    return mutation


COLUMN_MUTATIONS = {
    **_named(clean),
    # To one of a few lengths, each of which compiles anew.
    "truncated rows": lambda columns, rng: _rows(
        columns, slice(int(rng.choice([0, 1, 2, 5, 40, 99, 150, 3000])))
    ),
    "shuffled rows": lambda columns, rng: _rows(columns, rng.permutation(COUNT)),
    **_named(shuffled_signals, swapped_blocks, repeated_rows, repeated_block, swapped_columns),
    **_named(dropped_column, duplicated_column, renamed_column, many_nan),
    "nan in time": lambda c, rng: _changed(c, "t", _place(rng, int(rng.integers(1, 4))), np.nan),
    **_named(text_entry),
    "text column": _any(lambda values: np.full(COUNT, "on")),
    "numbers as text": _any(_texts),
    "whole numbers": _any(lambda values: np.round(values).astype(np.int32), signal=True),
    "half precision": _any(lambda values: values.astype(np.float16).astype(np.float32)),
    **_named(wrapped, huge, infinite, scaled_time, changed_stamp),
    "still time": lambda columns, rng: _with(columns, "t", np.full(COUNT, 5.0)),
    "coarse time": lambda c, rng: _with(c, "t", np.round(c["t"], int(rng.choice([0, 1, 2])))),
    **_named(reversed_rows, spliced, offset_jump, huge_spikes, extreme_scale),
    **_named(silent, hostile_names, mixed),
}
NEED_VELOCITY = (scaled_time,)
"""Whose marks only a second signal of the same motion bears."""
MIXABLE = tuple(m for m in COLUMN_MUTATIONS.values() if m not in (clean, mixed, *NEED_VELOCITY))


# Mutations of files.

Bytes = Callable[[str, bytes, np.random.Generator], tuple[str, bytes]]


def _kept(change: Callable[[bytes, np.random.Generator], bytes]) -> Bytes:
    """The name of the file stays."""
    return lambda file, content, rng: (file, change(content, rng))


def flipped_header(file, content, rng):
    """Bits among the first and the last 300 bytes."""
    ends = content[:300] + content[-300:]
    ends = _flipped(ends, rng, int(rng.integers(1, 6)))
    return file, ends[:300] + content[300:-300] + ends[-300:]


def _flipped(content: bytes, rng: np.random.Generator, count: int) -> bytes:
    flipped = bytearray(content)
    for place in rng.integers(0, len(content), count):
        flipped[place] ^= 1 << int(rng.integers(0, 8))
    return bytes(flipped)


def zeroed_block(file, content, rng):
    """A sector that was never written."""
    start = int(rng.integers(0, len(content)))
    size = min(int(rng.choice([8, 64, 512, 4096])), len(content) - start)
    return file, content[:start] + bytes(size) + content[start + size :]


def lost_block(file, content, rng):
    start = int(rng.integers(0, len(content)))
    return file, content[:start] + content[start + int(rng.integers(1, 5000)) :]


def inserted_bytes(file, content, rng):
    start = int(rng.integers(0, len(content)))
    return file, content[:start] + rng.bytes(int(rng.integers(1, 50))) + content[start:]


def wrong_ending(file, content, rng):
    endings = [name for name in (*ALL_WRITERS, "a.mf4", "a.txt", "a.xls", "a") if name != file]
    return str(rng.choice(endings)), content


BYTE_MUTATIONS = {
    "truncated bytes": _kept(lambda whole, rng: whole[: int(len(whole) * rng.uniform(0, 1))]),
    "flipped bit": _kept(lambda whole, rng: _flipped(whole, rng, 1)),
    "flipped bits": _kept(lambda whole, rng: _flipped(whole, rng, int(rng.integers(2, 60)))),
    **_named(flipped_header, zeroed_block, lost_block, inserted_bytes, wrong_ending),
    "garbage": _kept(lambda _, rng: rng.bytes(int(rng.integers(1, 20_000)))),
    "empty": _kept(lambda *_: b""),
}


# Mutations of text files.


def empty_cells(file, content, rng):
    lines = content.decode().split("\n")
    for at in rng.integers(1, len(lines) - 1, int(rng.choice([1, 5, 100]))):
        cells = lines[at].split(",")
        cells[int(rng.integers(0, len(cells)))] = ""
        lines[at] = ",".join(cells)
    return file, "\n".join(lines).encode()


def ragged(file, content, rng):
    lines = content.decode().split("\n")
    at = int(rng.integers(1, len(lines) - 1))
    lines[at] = lines[at].rpartition(",")[0] if rng.random() < 0.5 else lines[at] + ",7"
    return file, "\n".join(lines).encode()


def blank_lines(file, content, rng):
    lines = content.split(b"\n")
    for at in sorted(rng.integers(1, len(lines) - 1, 3))[::-1]:
        lines.insert(int(at), b"" if rng.random() < 0.5 else b",,,")
    return file, b"\n".join(lines)


def lost_points(file, content, rng):
    """One number, or a column, whose decimal sign is gone or has become a comma."""
    lines = content.decode().split("\n")
    column = int(rng.integers(1, lines[0].count(",") + 1))
    rows = range(1, len(lines) - 1) if rng.random() < 0.5 else [int(rng.integers(1, len(lines)))]
    new = str(rng.choice(["", ","]))
    for at in rows:
        cells = lines[at].split(",")
        if column < len(cells):
            cells[column] = cells[column].replace(".", new)
        lines[at] = ",".join(cells)
    return file, "\n".join(lines).encode()


def repeated_header(file, content, rng):
    """Two files put one after the other."""
    lines = content.split(b"\n")
    at = int(rng.integers(1, len(lines) - 1))
    return file, b"\n".join([*lines[:at], lines[0], *lines[at:]])


ENCODINGS = ["utf-16", "utf-16-le", "utf-32", "cp500", "utf-8-sig"]
TEXT_MUTATIONS = {
    "lost header": _kept(lambda text, rng: text.partition(b"\n")[2]),
    "only header": _kept(lambda t, rng: t.partition(b"\n")[0] + b"\n" * int(rng.integers(0, 3))),
    "other encoding": _kept(lambda text, rng: text.decode().encode(str(rng.choice(ENCODINGS)))),
    **_named(empty_cells, ragged, blank_lines, lost_points, repeated_header),
    "old line ends": _kept(
        lambda text, rng: text.replace(b"\n", b"\r" if rng.random() < 0.5 else b"\r\n")
    ),
}


# Files that are large once they are read.


def million_columns(rng):
    names = ",".join(f"c{i}" for i in range(10**6))
    row = ",".join(["1"] * 10**6)
    return "a.csv", f"{names}\n{row}\n{row}\n".encode()


def zip_bomb(rng):
    """Zeros, packed to a thousandth: bytes that make 5 GB of numbers, or 128 MiB of numbers."""
    size, stream = int(rng.choice([38 * 2**24, 2**27])), io.BytesIO()
    kind, width = ("<f8", 8) if size == 2**27 else ("|u1", 1)
    header = {"descr": kind, "fortran_order": False, "shape": (size // width,)}
    with (
        zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open("x.npy", "w", force_zip64=True) as member,
    ):
        np.lib.format.write_array_header_1_0(member, header)
        for _ in range(size // 2**24):
            member.write(bytes(2**24))
    return "a.npz", stream.getvalue()


def parquet_bomb(rng):
    stream = io.BytesIO()
    count = int(rng.choice([6 * 10**8, 2 * 10**7]))
    table = pa.table({"x": pa.array(np.zeros(2 * 10**7, bool))})
    with parquet.ParquetWriter(stream, table.schema, compression="zstd") as writer:
        for _ in range(count // 2 // 10**7):
            writer.write_table(table)
    return "a.parquet", stream.getvalue()


def hdf5_bomb(rng):
    """A dataset of which nothing is stored, or of which all is zero."""
    stream = io.BytesIO()
    with h5py.File(stream, "w") as file:
        file["t"] = np.arange(COUNT) / RATE
        if rng.random() < 0.5:
            file.create_dataset("x", (10**12,), "f8", chunks=(2**20,), compression="gzip")
        else:
            zeros = np.zeros(10**7)
            file.create_dataset("x", data=zeros, chunks=(2**20,), compression="gzip")
    return "a.mat", stream.getvalue()


def linked_objects(rng):
    """Groups, or cells of references, each of which leads to all."""
    stream, count = io.BytesIO(), int(rng.integers(2, 30))
    with h5py.File(stream, "w") as file:
        file["t"] = np.arange(COUNT) / RATE
        if rng.random() < 0.5:
            objects = [file.create_group(f"g{i}") for i in range(count)]
            for group in objects:
                for i, each in enumerate(objects):
                    group[f"l{i}"] = each
        else:
            objects = [file.create_dataset(f"c{i}", (count,), h5py.ref_dtype) for i in range(count)]
            for cell in objects:
                cell.attrs["MATLAB_class"] = np.bytes_("cell")
                cell[:] = [each.ref for each in objects]
    return str(rng.choice(["a.mat", "a.h5"])), stream.getvalue()


LARGE = _named(million_columns, zip_bomb, parquet_bomb, hdf5_bomb, linked_objects)
"""Made whole, and not of a recording."""

BY_NAME = {**COLUMN_MUTATIONS, **TEXT_MUTATIONS, **BYTE_MUTATIONS, **LARGE}
NAMES = tuple(BY_NAME)


def mutated(
    name: str,
    machines: tuple[Rig, Rig],
    rng: np.random.Generator,
    formats: Sequence[str] = tuple(WRITERS),
) -> Case:
    """A file after this mutation, of a rig and in one of the formats, both drawn by chance."""
    which, mutation = int(rng.random() < 0.3), BY_NAME[name]
    if name in LARGE:
        file, content = mutation(rng)
        return Case(name, file, content, machines[0].options)
    if name in TEXT_MUTATIONS:
        file, content = mutation("a.csv", _sound("a.csv", which, machines), rng)
        return Case(name, file, content, machines[which].options)
    file = str(rng.choice(list(formats)))
    if name in BYTE_MUTATIONS:
        file, content = mutation(file, _sound(file, which, machines), rng)
        return Case(name, file, content, machines[which].options)
    rig = machines[0] if mutation in NEED_VELOCITY else machines[which]
    columns = mutation(rig.columns, rng)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            content = ALL_WRITERS[file](columns)
        except Exception:
            # What a format cannot hold, such as a text among numbers, NPZ can.
            file, content = "a.npz", ALL_WRITERS["a.npz"](columns)
    return Case(name, file, content, rig.options)


_MADE: dict[tuple[str, int], bytes] = {}


def _sound(file: str, which: int, machines: tuple[Rig, Rig]) -> bytes:
    """A recording without fault, which is written once."""
    if (file, which) not in _MADE:
        _MADE[file, which] = ALL_WRITERS[file](list(machines[which].columns.items()))
    return _MADE[file, which]
