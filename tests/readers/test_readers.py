"""What every reader keeps to, whatever its format: one table of contracts over the registry."""

import json
import os
import pickle
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import openpyxl
import pyarrow as pa
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st
from nptdms import ChannelObject, TdmsWriter
from pyarrow import parquet
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from damage import damaged, outcome
from riecjax.doubts.reading import read_record, read_recording
from riecjax.errors import DataError
from riecjax.records.reading import endings, read_channels

N = 60
TIME = np.arange(N) * 0.125
COLUMNS = {"t": TIME, "x": np.sin(TIME), "force": np.round(np.cos(3 * TIME), 6)}
Columns = dict[str, np.ndarray]


def write_text(path: Path, columns: Columns, delimiter: str = ",", decimal: str = ".") -> None:
    rows = np.stack(list(columns.values()), axis=1).tolist()
    lines = [delimiter.join(columns)]
    lines += [delimiter.join(repr(x).replace(".", decimal) for x in row) for row in rows]
    path.write_text("\n".join(lines) + "\n")


def write_npz(path: Path, columns: Columns, compressed: bool = False) -> None:
    (np.savez_compressed if compressed else np.savez)(path, **columns)  # pyright: ignore


def write_mat(path: Path, columns: Columns, compressed: bool = False) -> None:
    extra = {"name": "a test", "cell": np.array([[TIME], [np.stack([TIME] * 2)]], dtype=object)}
    scipy.io.savemat(path, {**columns, **extra}, do_compression=compressed)


def write_hdf5(path: Path, columns: Columns) -> None:
    with h5py.File(path, "w") as file:
        for name, values in columns.items():
            file.create_dataset(name, data=values[None, :], compression="gzip")


def write_parquet(path: Path, columns: Columns) -> None:
    parquet.write_table(pa.table({**columns, "remark": ["a"] * len(columns["t"])}), path)


def rows_of(columns: Columns) -> list[dict[str, float]]:
    return [dict(zip(columns, row)) for row in zip(*(v.tolist() for v in columns.values()))]


def write_json_lines(path: Path, columns: Columns) -> None:
    path.write_text("\n".join(map(json.dumps, rows_of(columns))) + "\n")


def write_json(path: Path, columns: Columns) -> None:
    path.write_text(json.dumps({"meta": {"rig": 3}, "data": rows_of(columns)}))


def write_sheet(path: Path, columns: Columns) -> None:
    book = openpyxl.Workbook()
    # Below a title, one column further to the right.
    book.worksheets[0].append(["a title"])
    for row in ([], list(columns), *zip(*(v.tolist() for v in columns.values()))):
        book.worksheets[0].append([None, *row])
    book.save(path)


def write_tdms(path: Path, columns: Columns) -> None:
    with TdmsWriter(str(path)) as out:
        out.write_segment([ChannelObject("rig", name, v) for name, v in columns.items()])


def write_mdf(path: Path, columns: Columns) -> None:
    asammdf = pytest.importorskip("asammdf")
    signals = [asammdf.Signal(v, columns["t"], name=n) for n, v in columns.items() if n != "t"]
    with asammdf.MDF(version="4.10") as file:
        file.append(signals)
        file.save(path, overwrite=True)


STORE = get_typestore(Stores.ROS2_HUMBLE)


def write_bag(path: Path, columns: Columns, storage: StoragePlugin = StoragePlugin.MCAP) -> None:
    """Each signal as a topic of its own, so that columns are called `/x.data`."""
    folder = path.parent / f"bag-{path.name}"
    number = STORE.types["std_msgs/msg/Float64"]
    kind = number.__msgtype__
    with Writer(folder, version=9, storage_plugin=storage) as out:
        for name, values in columns.items():
            topic = out.add_connection(f"/{name}", kind, typestore=STORE)
            for t, x in zip(columns["t"], values):
                out.write(topic, 10**18 + round(1e9 * t), STORE.serialize_cdr(number(x), kind))
    next(folder.glob(f"*{path.suffix}")).rename(path)


def write_database(path: Path, columns: Columns) -> None:
    write_bag(path, columns, StoragePlugin.SQLITE3)


MAKERS: dict[str, tuple[str, Callable[..., None]]] = {
    "CSV": (".csv", write_text),
    "decimal comma": (".csv", lambda path, c: write_text(path, c, ";", ",")),
    "white space": (".txt", lambda path, c: write_text(path, c, " ")),
    "NPZ": (".npz", write_npz),
    "compressed NPZ": (".npz", lambda path, c: write_npz(path, c, True)),
    "MAT": (".mat", write_mat),
    "compressed MAT": (".mat", lambda path, c: write_mat(path, c, True)),
    "MAT v7.3": (".mat", write_hdf5),
    "HDF5": (".h5", write_hdf5),
    "JSON lines": (".jsonl", write_json_lines),
    "JSON": (".json", write_json),
    "Parquet": (".parquet", write_parquet),
    "Excel": (".xlsx", write_sheet),
    "TDMS": (".tdms", write_tdms),
    "bag": (".mcap", write_bag),
    "bag in a database": (".db3", write_database),
    "MDF": (".mf4", write_mdf),
}
EXTRAS = {
    "Excel": "excel",
    "TDMS": "tdms",
    "bag": "ros",
    "MDF": "mdf",
    "HDF5": "hdf5",
    "MAT v7.3": "hdf5",
}
"""What has to be installed for a format, as its error says."""
NAMES_FREELY = ("CSV", "NPZ", "Parquet", "HDF5", "JSON lines", "JSON", "TDMS", "MDF")
"""Formats in which a column may be called anything."""
LIBRARIES = {"MAT", "HDF5", "Parquet", "Excel", "TDMS", "bag", "MDF"}


@pytest.fixture(scope="module")
def content(tmp_path_factory) -> Callable[[str], tuple[str, bytes]]:
    """Ending and bytes of the good table in a format."""
    made: dict[str, bytes] = {}

    def of(case: str) -> tuple[str, bytes]:
        ending, write = MAKERS[case]
        if case not in made:
            path = tmp_path_factory.mktemp("made") / f"a{ending}"
            write(path, COLUMNS)
            made[case] = path.read_bytes()
        return ending, made[case]

    return of


@pytest.fixture
def file(tmp_path, content) -> Callable[[str], Path]:
    """A file of the good table in a format."""

    def of(case: str) -> Path:
        ending, held = content(case)
        path = tmp_path / f"a{ending}"
        path.write_bytes(held)
        return path

    return of


def named(case: str, *names: str) -> dict[str, str]:
    """Which columns these signals are."""
    return {name: f"/{name}.data" if "bag" in case else name for name in names}


def test_every_reader_keeps_to_the_contracts():
    alike = {".hdf5": ".h5", ".ndjson": ".jsonl", ".xlsm": ".xlsx", ".bag": ".mcap", ".mdf": ".mf4"}
    text = {".tsv", ".asc", ".dat", ".lvm", ".log", ".prn"}
    made = {ending for ending, _ in MAKERS.values()}
    assert {alike.get(ending, ending) for ending in endings()} - text == made


@pytest.mark.portable
@pytest.mark.parametrize("case", MAKERS)
def test_what_is_read_is_what_was_written(file, case):
    record = read_record(file(case), rename=named(case, "x", "force"))
    # Excel keeps 16 digits.
    for name in ("x", "force"):
        np.testing.assert_allclose(record[name], COLUMNS[name], rtol=2e-16 if case != "Excel" else
                                   1e-15)  # fmt: skip
    assert float(record.time_step) == pytest.approx(0.125, rel=1e-9)


@pytest.mark.parametrize("case", MAKERS)
def test_signals_are_renamed_scaled_and_converted_alike(file, case):
    column = named(case, "x")["x"]
    record = read_record(file(case), rename={"q": column, "p": column}, scale={"p": 2.0},
                         units={"q": "mm"})  # fmt: skip
    np.testing.assert_allclose(record["q"], 1e-3 * COLUMNS["x"], rtol=1e-14)
    np.testing.assert_allclose(record["p"], 2 * COLUMNS["x"], rtol=1e-14)
    assert dict(record.units)["q"] == "m"
    with pytest.raises(DataError, match=r"^a\.\w+: there is no column 'nothing'; there are: "):
        read_record(file(case), rename={"y": "nothing"})


@pytest.mark.parametrize("case", MAKERS)
@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9])
def test_a_cut_file_is_a_shorter_record_or_one_line(tmp_path, content, case, share):
    ending, whole = content(case)
    message = outcome(tmp_path / f"a{ending}", whole[: int(share * len(whole))])
    assert message is not None or share > 0


@pytest.mark.parametrize("case", MAKERS)
def test_an_injured_file_is_a_sound_record_or_one_line(tmp_path, content, case):
    """Crashes of a library take its process with them, and half a second: fewer of these."""
    ending, whole = content(case)
    rng = np.random.default_rng(20240501)
    count = 10 if any(case.endswith(name) for name in LIBRARIES) or "bag" in case else 120
    refused = [outcome(tmp_path / f"a{ending}", damaged(whole, rng)) for _ in range(count)]
    assert sum(message is not None for message in refused) >= count / 6


@pytest.mark.parametrize("case", ["CSV", "NPZ", "MAT", "HDF5", "Parquet", "JSON lines", "TDMS"])
@pytest.mark.parametrize("ending", [".csv", ".npz", ".mat", ".parquet", ".json"])
def test_a_wrong_ending_is_read_alike_or_said(tmp_path, content, case, ending):
    own, held = content(case)
    alike = ({".jsonl", ".json"}, {".h5", ".mat"}, {own})
    message = outcome(tmp_path / f"a{ending}", held)
    assert (message is None) == any({own, ending} <= kinds for kinds in alike)


HOSTILE = "F\x1b]0;owned\x07\u202e\x9b2J"
SHOWN = "F\\x1b]0;owned\\x07\\u202e\\x9b2J"


@pytest.mark.parametrize("case", NAMES_FREELY)
def test_names_that_would_steer_a_terminal_are_escaped(tmp_path, case):
    ending, write = MAKERS[case]
    path = tmp_path / f"a\x1b[2J{ending}"
    write(path, {"t": TIME, HOSTILE: COLUMNS["x"]})
    recording = read_recording(path)
    assert list(recording.record.arrays) == [SHOWN]
    said = [recording.name, *recording.steps, *(f.message for f in recording.findings)]
    assert all(map(str.isprintable, [*said, *recording.left_out, *recording.left_out.values()]))
    with pytest.raises(DataError) as refused:
        read_recording(path, rename={"F": "G\x1b"}, part="x\x1b")
    assert str(refused.value).isprintable()


def test_names_that_are_one_when_escaped(tmp_path):
    np.savez(tmp_path / "a.npz", **{"t": np.arange(5), "x\x1b": np.ones(5), "x\\x1b": np.ones(5)})
    with pytest.raises(DataError, match=r"two columns are called 'x\\x1b'"):
        read_record(tmp_path / "a.npz")


@pytest.mark.parametrize("case", EXTRAS)
def test_without_its_library_the_extra_is_named(file, monkeypatch, case):
    path = file(case)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(DataError, match=rf'pip install "riecjax\[{EXTRAS[case]}\]"'):
        read_channels(path)


@pytest.mark.parametrize("case", [c for c in MAKERS if " " not in c])
def test_a_larger_file_than_is_read_is_refused(file, monkeypatch, case):
    monkeypatch.setattr("riecjax.records.reading.channels.LARGEST_FILE", 100)
    with pytest.raises(DataError, match=r"a\.\w+: larger than 100 bytes"):
        read_channels(file(case))


@pytest.mark.parametrize("ending", [*endings(), ".xyz", ""])
def test_what_is_no_plain_file_is_never_opened(tmp_path, ending):
    os.mkfifo(tmp_path / f"pipe{ending}")
    (tmp_path / f"zero{ending}").symlink_to("/dev/zero")
    for name in (f"pipe{ending}", f"zero{ending}", f"absent{ending}", "a" * 5000 + ending):
        with pytest.raises(DataError) as refused:
            read_channels(tmp_path / name)
        assert "\n" not in str(refused.value)
        if ending in endings() and not name.startswith("a"):
            assert "is a pipe or device, and no file" in str(refused.value)


class Payload:
    def __init__(self, target: Path):
        self.target = target

    def __reduce__(self):
        return (os.mkdir, (str(self.target),))


def test_objects_in_npz_are_refused_and_not_executed(tmp_path):
    trap = tmp_path / "executed"
    pickled = np.array([Payload(trap)] * 5, dtype=object)
    np.savez(tmp_path / "a.npz", t=TIME[:5], x=pickled)
    with pytest.raises(DataError, match=r"'x' was left out: it holds Python objects"):
        read_record(tmp_path / "a.npz")
    (tmp_path / "b.npz").write_bytes(pickle.dumps(Payload(trap)))
    with pytest.raises(DataError, match="not a readable NPZ file"):
        read_record(tmp_path / "b.npz")
    # What lies beside objects is read all the same.
    np.savez(tmp_path / "a.npz", t=TIME, x=TIME, about=pickled)
    assert set(read_record(tmp_path / "a.npz").arrays) == {"x"}
    assert not trap.exists()


def declared_zip(path: Path) -> None:
    np.savez_compressed(path, x=np.zeros(1000))
    held = bytearray(path.read_bytes())
    # The size in the central directory, which is what a reader goes by.
    place = held.index(b"PK\x01\x02") + 24
    held[place : place + 4] = (2**31).to_bytes(4, "little")
    path.write_bytes(held)


def declared_array(path: Path) -> None:
    shape = {"descr": "<f8", "fortran_order": False, "shape": (2**40,)}
    with zipfile.ZipFile(path, "w") as archive, archive.open("x.npy", "w") as member:
        np.lib.format.write_array_header_1_0(member, shape)


def declared_dataset(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file.create_dataset("x", (2**40,), dtype="f8", chunks=(2**20,))


def cells_in_mat(path: Path) -> None:
    """A cell that claims a hundred million elements where there are three."""
    cell = np.array([[np.arange(5.0)], [np.arange(6.0)], [np.arange(7.0)]], dtype=object)
    scipy.io.savemat(path, {"c": {"inner": cell}})
    sides, claimed = (np.array([n, 1], np.int32).tobytes() for n in (3, 10**8))
    assert path.read_bytes().count(sides) == 1
    path.write_bytes(path.read_bytes().replace(sides, claimed))


DECLARED = {
    "a.npz": (declared_zip, "declares 2147483648 bytes|larger than its file"),
    "b.npz": (declared_array, "unpacks to|an array is larger"),
    "c.h5": (declared_dataset, "unpacks to 8796093022208 bytes"),
    "d.mat": (declared_dataset, "unpacks to 8796093022208 bytes"),
    "f.mat": (cells_in_mat, "not a readable MAT file"),
}


@pytest.mark.parametrize("name", DECLARED)
def test_what_a_file_declares_is_checked_before_it_is_read(tmp_path, name):
    make, words = DECLARED[name]
    make(tmp_path / name)
    with pytest.raises(DataError, match=words):
        read_channels(tmp_path / name)


def test_a_new_name_in_each_line_is_refused(tmp_path):
    rows = [json.dumps({"t": k, f"x{k}": 1}) for k in range(2000)]
    (tmp_path / "a.jsonl").write_text("\n".join(rows))
    with pytest.raises(DataError, match="2001 names and only 4000 values; give a field the same"):
        read_channels(tmp_path / "a.jsonl")


ALPHABET = [*'0123456789.,;:\t|" -+eEtx#%/[]()\n\n\n\r', "NaN", "1.5", "é", "\ufeff"]
TEXTS = st.lists(st.sampled_from(ALPHABET), max_size=60).map("".join)


@given(TEXTS, st.booleans())
@settings(max_examples=250, deadline=None, derandomize=True)
def test_any_text_at_all(tmp_path_factory, text, headed):
    path, whole = tmp_path_factory.getbasetemp() / "any.csv", "t,x\n" * headed + text
    # In whatever encoding, it is the same record in order or the same message.
    assert outcome(path, whole.encode()) == outcome(path, whole.encode("utf-16"))


@pytest.mark.parametrize("ending", [".npz", ".mat"])
def test_arrays_that_are_not_samples_are_left_out(tmp_path, ending):
    extra = {"gtau": np.array([[35.1507]]), "gains": np.array([1.0, 2.0]),
             "picture": np.zeros((5, 5)), "comment": np.array("measured on Tuesday")}  # fmt: skip
    path = tmp_path / f"a{ending}"
    write = scipy.io.savemat if ending == ".mat" else lambda path, c: np.savez(path, **c)
    write(path, {**COLUMNS, **extra})
    assert set(read_record(path).arrays) == {"x", "force"}
    with pytest.raises(DataError, match=r"'gains' has another length than the time, 60 samples"):
        read_record(path, rename={"k": "gains"})


def test_two_arrays_of_one_name_are_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for values in (TIME, TIME):
            with archive.open("x.npy", "w") as member:
                np.save(member, values)
    for name in ("one.mat", "two.mat"):
        scipy.io.savemat(tmp_path / name, {"x": TIME})
    # After the header of 128 bytes come the variables, one behind the other.
    one, two = ((tmp_path / name).read_bytes() for name in ("one.mat", "two.mat"))
    (tmp_path / "a.mat").write_bytes(one + two[128:])
    for name in ("a.npz", "a.mat"):
        with pytest.raises(DataError, match=rf"^{name}: two columns are called 'x'\.$"):
            read_channels(tmp_path / name)
