"""MDF files are read in a process of their own, whose end, by whatever cause, is one line here."""

import contextlib
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

from riecjax.errors import DataError, RiecjaxError
from riecjax.records.reading import child_process
from riecjax.records.reading import mdf as measurement
from riecjax.records.reading.read import read_channels

TIME = np.arange(400) * 0.01


@pytest.fixture
def whole(tmp_path) -> Path:
    asammdf = pytest.importorskip("asammdf")
    signal, slow = asammdf.Signal, TIME[::4]
    with asammdf.MDF(version="4.10") as file:
        file.append([signal(np.sin(TIME), TIME, name="x", unit="m")])
        file.append([signal(np.cos(slow), slow, name="F", unit="N")])
        file.append([signal(np.array([b"a", b"b"]), slow[:2], name="text", encoding="utf-8")])
        return Path(file.save(tmp_path / "whole.mf4"))


def flipped(content: bytes, rng: np.random.Generator) -> bytes:
    """One to four bits, in the headers of blocks, where addresses and sizes stand."""
    blocks = [at for at in range(0, len(content) - 80, 8) if content[at : at + 2] == b"##"]
    damaged = bytearray(content)
    for block in rng.choice(blocks, int(rng.integers(1, 5))):
        damaged[int(block) + int(rng.integers(0, 80))] ^= 1 << int(rng.integers(0, 8))
    return bytes(damaged)


@pytest.mark.portable
def test_what_the_process_hands_over_is_what_the_file_holds(whole):
    here, there = measurement._read(whole), read_channels(whole)
    assert list(there.columns) == list(here.columns)
    for name, values in here.columns.items():
        np.testing.assert_array_equal(there.columns[name], values)
    assert there.units == here.units == {"x": "m", "F": "N"}
    assert there.time_of == here.time_of
    assert there.left_out == here.left_out == {"text": "it holds no single numbers"}
    assert there.notes == here.notes


@pytest.mark.slow
def test_flipped_bits_in_headers(whole, tmp_path):
    content, rng = whole.read_bytes(), np.random.default_rng(20240501)
    path, messages = tmp_path / "a.mf4", []
    for _ in range(18):
        path.write_bytes(flipped(content, rng))
        try:
            channels = read_channels(path)
        except RiecjaxError as error:
            messages.append(str(error))
        else:
            assert all(values.dtype == float for values in channels.columns.values())
    assert len(messages) > 5
    for message in messages:
        assert message.startswith("a.mf4: not a readable MDF file: ")
        assert "\n" not in message


LIBRARIES = {
    "crash": "import os, signal\nos.kill(os.getpid(), signal.SIGSEGV)",
    "aborts as Windows does": "import os\nos._exit(3)",
    "quits": "import os\nos._exit(0)",
    "leaves": "raise SystemExit(0)",
    "fails": "def MDF(stream):\n    raise RuntimeError('two\\nlines')",
    "out of memory": "def MDF(stream):\n    raise MemoryError",
    "asks for too much": "def MDF(stream):\n    return bytearray(2**40)",
    "hangs": "import time\ntime.sleep(10**6)",
    "loops in C": "import itertools\nany(itertools.repeat(0))",
}
"""A loop in C, while which Python handles no signal."""


@pytest.mark.parametrize("library", LIBRARIES)
def test_whatever_the_library_does(tmp_path, monkeypatch, capfd, library):
    (tmp_path / "asammdf.py").write_text(f"print('noise')\n{LIBRARIES[library]}\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(
        child_process, "PATIENCE", 2.0 if library in ("hangs", "loops in C") else 60.0
    )
    (tmp_path / "a.mf4").write_bytes(b"MDF     4.10    ")
    if library in ("out of memory", "asks for too much"):
        with pytest.raises(MemoryError):
            read_channels(tmp_path / "a.mf4")
    else:
        with pytest.raises(DataError, match=r"^a\.mf4: not a readable MDF file: .*\.$|: two$"):
            read_channels(tmp_path / "a.mf4")
    assert capfd.readouterr() == ("", "")


@pytest.mark.portable
def test_windows_shows_no_dialog_after_a_crash(monkeypatch):
    shown = []
    windows = SimpleNamespace(
        SEM_FAILCRITICALERRORS=1, SEM_NOGPFAULTERRORBOX=2, SetErrorMode=shown.append
    )
    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.setitem(sys.modules, "msvcrt", windows)
    monkeypatch.setitem(sys.modules, "resource", None)
    child_process._limit_resources()
    assert shown == [3]


def test_modules_in_the_working_folder_are_not_imported(whole, tmp_path, monkeypatch):
    (tmp_path / "json.py").write_text("raise RuntimeError")
    (tmp_path / "numpy.py").write_text("raise RuntimeError")
    monkeypatch.chdir(tmp_path)
    assert "x" in read_channels("whole.mf4").columns


def test_one_process_reads_file_after_file(tmp_path):
    files = [tmp_path / f"{i}.h5" for i in range(4)]
    for path in files[::2]:
        with h5py.File(path, "w") as file:
            file["x"] = TIME
    for path in files[1::2]:
        path.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(500))
    processes = []
    for i, path in enumerate(files):
        with pytest.raises(DataError) if i % 2 else contextlib.nullcontext():
            np.testing.assert_array_equal(read_channels(path).columns["x"], TIME)
        processes.append(child_process._readers[0].process)
    assert len(set(processes)) == 1
    processes[0].kill()
    processes[0].wait()
    assert "x" in read_channels(files[0]).columns


def test_the_process_ends_with_the_one_that_asks(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["x"] = TIME
    code = (
        "import os, signal, sys; from riecjax.records.reading import child_process, read\n"
        "read.read_channels(sys.argv[1]); reader = child_process._readers[0]\n"
        "print(reader.out.parent, flush=True)\n"
        "os.kill(os.getpid(), signal.SIGKILL)"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "a.h5")]
    folder = subprocess.run(command, capture_output=True, text=True).stdout.strip()
    deadline = time.monotonic() + 20
    while Path(folder).exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not Path(folder).exists()
