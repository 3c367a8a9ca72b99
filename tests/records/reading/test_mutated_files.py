"""Damaged and odd files of every format: a record of finite numbers, or one line that says why."""

import io
from collections.abc import Callable

import h5py
import numpy as np
import pyarrow as pa
import pytest
import scipy.io
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pyarrow import parquet

from damage import damaged, outcome
from nightly import nightly

N = 60
TIME = np.arange(N) * 0.125
COLUMNS = {"t": TIME, "x": np.sin(TIME), "force": np.round(np.cos(3 * TIME), 6)}


def csv_bytes(columns: dict[str, np.ndarray], delimiter: str = ",", decimal: str = ".") -> bytes:
    rows = np.stack(list(columns.values()), axis=1).tolist()
    lines = [delimiter.join(columns)]
    lines += [delimiter.join(repr(x).replace(".", decimal) for x in row) for row in rows]
    return ("\n".join(lines) + "\n").encode()


def npz_bytes(columns: dict[str, np.ndarray], compressed: bool = False) -> bytes:
    stream = io.BytesIO()
    (np.savez_compressed if compressed else np.savez)(stream, **columns)  # pyright: ignore
    return stream.getvalue()


def mat_bytes(columns: dict[str, np.ndarray], compressed: bool = False) -> bytes:
    stream = io.BytesIO()
    cell = np.empty((2, 1), dtype=object)
    cell[0, 0], cell[1, 0] = TIME, np.stack([TIME, TIME])
    extra = {"log": {"time": TIME, "signals": {"values": TIME}}, "cell": cell, "name": "a test"}
    scipy.io.savemat(stream, {**columns, **extra}, do_compression=compressed)
    return stream.getvalue()


def parquet_bytes(columns: dict[str, np.ndarray]) -> bytes:
    stream = io.BytesIO()
    parquet.write_table(pa.table({**columns, "remark": ["a"] * len(columns["t"])}), stream)
    return stream.getvalue()


def hdf5_bytes(columns: dict[str, np.ndarray]) -> bytes:
    stream = io.BytesIO()
    with h5py.File(stream, "w") as file:
        for name, values in columns.items():
            file.create_dataset(name, data=values[None, :], compression="gzip")
        file["log/time"] = TIME
        file["log/signals/values"] = TIME
    return stream.getvalue()


FILES: dict[str, tuple[str, bytes]] = {
    "CSV": (".csv", csv_bytes(COLUMNS)),
    "decimal comma": (".csv", csv_bytes(COLUMNS, ";", ",")),
    "white space": (".txt", b"# logger\n" + csv_bytes(COLUMNS, " ")),
    "NPZ": (".npz", npz_bytes(COLUMNS)),
    "compressed NPZ": (".npz", npz_bytes(COLUMNS, True)),
    "MAT": (".mat", mat_bytes(COLUMNS)),
    "compressed MAT": (".mat", mat_bytes(COLUMNS, True)),
    "MAT v7.3": (".mat", hdf5_bytes(COLUMNS)),
    "Parquet": (".parquet", parquet_bytes(COLUMNS)),
}
MAKERS: dict[str, Callable[[dict[str, np.ndarray]], bytes]] = {
    ".csv": csv_bytes,
    ".npz": npz_bytes,
    ".mat": mat_bytes,
    ".parquet": parquet_bytes,
}


@pytest.mark.parametrize("case", FILES)
def test_whole_files_are_read(tmp_path, case):
    ending, content = FILES[case]
    assert outcome(tmp_path / f"a{ending}", content) is None


@pytest.mark.parametrize("case", FILES)
def test_injured_files(tmp_path, case):
    ending, content = FILES[case]
    rng = np.random.default_rng(20240501)
    refused = [outcome(tmp_path / f"a{ending}", damaged(content, rng)) for _ in range(120)]
    assert sum(message is not None for message in refused) > 20


@pytest.mark.slow
@pytest.mark.parametrize("case", ["MAT", "MAT v7.3", "NPZ", "Parquet"])
def test_single_flipped_bits(tmp_path, case):
    ending, content = FILES[case]
    rng = np.random.default_rng(7)
    for place in rng.integers(0, len(content), 120):
        flipped = bytearray(content)
        flipped[place] ^= 1 << int(rng.integers(0, 8))
        outcome(tmp_path / f"a{ending}", bytes(flipped))


numbers = st.one_of(
    st.floats(),
    st.sampled_from([1e308, -1e308, 1e-320, np.nan, np.inf, -np.inf, 0.0, 2.0**53, 1e300]),
)


@st.composite
def tables(draw: st.DrawFn) -> dict[str, np.ndarray]:
    """The good table with numbers replaced, rows mixed up, and columns left out or doubled."""
    columns = {name: values.copy() for name, values in COLUMNS.items()}
    for _ in range(draw(st.integers(0, 3))):
        name = draw(st.sampled_from(sorted(columns)))
        columns[name][draw(st.integers(0, N - 1))] = draw(numbers)
    if draw(st.integers(0, 4)) == 0:
        order = draw(st.permutations(range(N)))
        columns = {name: values[order] for name, values in columns.items()}
    length = draw(st.one_of(st.just(N), st.integers(0, 4)))
    columns = {name: values[:length] for name, values in columns.items()}
    if draw(st.integers(0, 4)) == 0:
        columns.pop(draw(st.sampled_from(sorted(columns))))
    if columns and draw(st.integers(0, 4)) == 0:
        columns[draw(st.text(max_size=6))] = next(iter(columns.values()))
    return columns or {"x": np.zeros(0)}


@pytest.mark.parametrize("ending", [".csv", ".npz", *nightly([".parquet"])])
@given(tables())
@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow], derandomize=True
)
def test_tables_with_odd_numbers_rows_and_columns(tmp_path_factory, ending, columns):
    path = tmp_path_factory.getbasetemp() / f"odd{ending}"
    try:
        if ending == ".parquet":
            stream = io.BytesIO()
            parquet.write_table(pa.table(columns), stream)
            content = stream.getvalue()
        else:
            content = MAKERS[ending](columns)
    except (UnicodeEncodeError, ValueError):
        return
    outcome(path, content)


ALPHABET = st.sampled_from(
    [*'0123456789.,;:\t|" -+eEtx#%/[]()\n\n\n\r', "NaN", "1.5", "é", "\ufeff"]
)


@given(st.lists(ALPHABET, max_size=60).map("".join), st.booleans())
@settings(max_examples=250, deadline=None, derandomize=True)
def test_any_text_at_all(tmp_path_factory, text, headed):
    path = tmp_path_factory.getbasetemp() / "any.csv"
    outcome(path, (("t,x\n" if headed else "") + text).encode())


@given(st.binary(max_size=80), st.sampled_from([".csv", ".npz", ".mat", ".parquet"]))
@settings(max_examples=150, deadline=None, derandomize=True)
def test_any_bytes_at_all(tmp_path_factory, content, ending):
    outcome(tmp_path_factory.getbasetemp() / f"any{ending}", content)


@pytest.mark.parametrize("case", FILES)
@pytest.mark.parametrize("ending", [".csv", ".npz", ".mat", ".parquet"])
def test_wrong_endings(tmp_path, case, ending):
    own, content = FILES[case]
    message = outcome(tmp_path / f"a{ending}", content)
    text = {".csv", ".txt"}
    assert (message is None) == (own == ending or {own, ending} <= text)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-32", "cp037", "latin-1", "shift_jis"])
@pytest.mark.parametrize("case", ["CSV", "decimal comma", "white space"])
def test_encodings(tmp_path, case, encoding):
    _, content = FILES[case]
    text = content.decode().replace("force", "größe" if encoding != "shift_jis" else "力")
    message = outcome(tmp_path / "a.csv", text.encode(encoding))
    assert (message is None) == (encoding != "cp037")


@pytest.mark.parametrize("ending", [".csv", ".npz", ".mat", ".parquet"])
def test_empty_files(tmp_path, ending):
    assert outcome(tmp_path / f"a{ending}", b"") is not None
