"""Files are read in a process of their own, whose end, by whatever cause, is one line here."""

import contextlib
import os
import select
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from riecjax.errors import DataError
from riecjax.records.reading import child_process
from riecjax.records.reading.channels import read_channels

TIME = np.arange(400) * 0.01
CODE = {
    "crash": "import os, signal\nos.kill(os.getpid(), signal.SIGSEGV)",
    "quits": "import os\nos._exit(0)",
    "leaves": "raise SystemExit(0)",
    "fails": "def MDF(stream):\n    raise RuntimeError('two\\nlines')",
    "asks for too much": "def MDF(stream):\n    return bytearray(2**40)",
    "hangs": "import time\ntime.sleep(10**6)",
    # A loop in C, while which Python handles no signal.
    "loops in C": "import itertools\nany(itertools.repeat(0))",
}


@pytest.fixture
def whole(tmp_path) -> Path:
    with h5py.File(tmp_path / "whole.h5", "w") as file:
        file["x"] = TIME
    return tmp_path / "whole.h5"


@pytest.mark.parametrize("library", CODE)
def test_whatever_the_library_does(tmp_path, monkeypatch, capfd, library):
    (tmp_path / "asammdf.py").write_text(f"print('noise')\n{CODE[library]}\n")
    monkeypatch.syspath_prepend(tmp_path)
    if library in ("hangs", "loops in C"):
        monkeypatch.setattr(child_process, "PATIENCE", 2.0)
    (tmp_path / "a.mf4").write_bytes(b"MDF     4.10    ")
    if library == "asks for too much":
        with pytest.raises(MemoryError):
            read_channels(tmp_path / "a.mf4")
    else:
        with pytest.raises(DataError, match=r"^a\.mf4: not a readable MDF file: .*\.$|: two$"):
            read_channels(tmp_path / "a.mf4")
    assert capfd.readouterr() == ("", "")


def test_modules_in_the_working_folder_are_not_imported(whole, tmp_path, monkeypatch):
    for name in ("json.py", "numpy.py"):
        (tmp_path / name).write_text("raise RuntimeError")
    monkeypatch.chdir(tmp_path)
    assert "x" in read_channels("whole.h5").columns


def test_one_process_reads_file_after_file(whole, tmp_path):
    damaged = tmp_path / "damaged.h5"
    damaged.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(500))
    processes = set()
    for path in (whole, damaged, whole, damaged):
        with pytest.raises(DataError) if path == damaged else contextlib.nullcontext():
            np.testing.assert_array_equal(read_channels(path).columns["x"], TIME)
        processes.add(child_process._readers[0].process)
    assert len(processes) == 1
    # One that was killed, or whose folder was swept, is replaced.
    (process,) = processes
    process.kill()
    process.wait()
    assert "x" in read_channels(whole).columns
    child_process._readers[0].out.unlink()
    child_process._readers[0].out.parent.rmdir()
    assert "x" in read_channels(whole).columns


def test_the_process_ends_with_the_one_that_asks(whole):
    code = (
        "import os, signal, sys; from riecjax.records.reading import channels, child_process\n"
        "channels.read_channels(sys.argv[1]); reader = child_process._readers[0]\n"
        "print(reader.process.pid, reader.out.parent, flush=True); sys.stdin.read()\n"
        "os.kill(os.getpid(), signal.SIGKILL)"
    )
    command, pipe = [sys.executable, "-c", code, str(whole)], subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as asking:
        assert asking.stdout is not None
        process, folder = asking.stdout.readline().split()
        ended = os.pidfd_open(int(process))
        assert Path(folder).is_dir()
    select.select([ended], [], [])
    os.close(ended)
    assert not Path(folder).exists()


def test_a_fork_leaves_the_reader_of_its_parent_alone(whole):
    code = (
        "import os, sys; from riecjax.records.reading import channels, child_process\n"
        "read = lambda: channels.read_channels(sys.argv[1]); read()\n"
        "reader, fork = child_process._readers[0], os.fork()\n"
        "if not fork: read(); sys.exit(child_process._readers[0] is reader)\n"
        "status = os.waitpid(fork, 0)[1]\n"
        "print(status, child_process._readers[0] is reader, reader.is_usable)"
    )
    said = subprocess.check_output([sys.executable, "-c", code, str(whole)], text=True)
    assert said.split() == ["0", "True", "True"]
