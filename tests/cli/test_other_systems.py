"""What Windows does differently, done to the command line here: drives, code pages, pipes."""

import contextlib
import errno
import io
import ntpath
import os
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from command_line import write_csv
from test_job_files import context

from riecjax import whole_files
from riecjax.cli import command
from riecjax.cli import main as entry
from riecjax.cli.command import read_job
from riecjax.reporting.answer import as_typed

ODD = "Weg β"
RESISTANCE = """
import riecjax as rx

coil = rx.Equation(rx.Term("R", "i", unit="Ω"), -rx.Term(1.0, "u", unit="V"), name="coil")
"""


def redirected(*arguments: str) -> bytes:
    """What a command writes to a file on Windows of Western Europe."""
    stream = io.TextIOWrapper(io.BytesIO(), "cp1252")
    with contextlib.redirect_stdout(stream), pytest.raises(SystemExit) as ended:
        entry.main(list(arguments))
    assert ended.value.code == 0
    stream.seek(0)
    return stream.buffer.read()


@pytest.mark.portable
def test_paths_with_drives_in_a_job(monkeypatch):
    windows = SimpleNamespace(path=ntpath, sep="\\")
    monkeypatch.setattr(whole_files, "os", windows)
    monkeypatch.setattr(command, "os", windows)
    typed = ["D:\\data\\run 1.csv", "data\\2.csv", "--model", "C:\\rig\\own.py:axis"]
    given = context([*typed, "--validate", "last.csv", "--map", "q=C:\\x"])
    here = given.as_job()
    assert here["records"] == ["D:/data/run 1.csv", "data/2.csv"]
    assert here["model"] == "C:/rig/own.py:axis"
    assert here["map"] == {"q": "C:\\x"}
    assert given.as_job(Path("out"))["records"] == ["D:/data/run 1.csv", "../data/2.csv"]
    # From another drive no relative path leads here.
    elsewhere = given.as_job(Path("Q:\\out"))
    assert elsewhere["records"][1] == os.path.abspath("data/2.csv").replace(os.sep, "/")
    assert elsewhere["validate"] == [os.path.abspath("last.csv").replace(os.sep, "/")]
    assert elsewhere["model"] == "C:/rig/own.py:axis"

    again = context(["--job", str(saved(elsewhere))])
    assert again.model_name == "C:\\rig\\own.py:axis"
    assert again.files[0] == Path("D:\\data\\run 1.csv")


def saved(options: dict) -> Path:
    lines = [f"{key} = {options[key]!r}" for key in ("model", "records")]
    file = Path("job.toml")
    file.write_text("\n".join(lines), encoding="utf-8")
    return file


@pytest.mark.portable
@pytest.mark.parametrize("encoding", ["ascii", "utf-8-sig", "utf-16"])
def test_a_job_that_was_redirected_is_read(encoding):
    time = np.arange(50) * 0.1
    write_csv(Path("run.csv"), {"t": time, "q": time**2, "Kraft": np.cos(time)})
    given = ("--model", "emps", "--map", f"force={ODD}", "--remove-offset", "😀")
    printed = redirected("init", "run.csv", *given).decode("ascii")
    # cmd.exe writes it as it is, PowerShell in another encoding.
    Path("job.toml").write_bytes(printed.encode(encoding))
    options, _ = read_job(Path("job.toml"))
    assert options["map"]["force"] == ODD
    assert options["remove-offset"] == ["😀"]


@pytest.mark.portable
def test_a_sign_that_the_code_page_lacks_is_no_error():
    Path("coil.py").write_text(RESISTANCE, encoding="utf-8")
    assert "\\u03a9" in redirected("models", "coil.py").decode("cp1252")


@pytest.mark.portable
@pytest.mark.parametrize(
    ("system", "number", "quiet"),
    [("linux", errno.EPIPE, True), ("win32", errno.EINVAL, True), ("linux", errno.EINVAL, False)],
)
def test_output_that_no_one_reads_any_more(monkeypatch, capsys, system, number, quiet):
    def write(*_: object, **__: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(entry.cli, "main", write)
    # The test's own output must remain.
    written = {"dup2": lambda old, new: os.close(old), "open": os.open, "O_WRONLY": os.O_WRONLY}
    monkeypatch.setattr(entry, "os", SimpleNamespace(devnull=os.devnull, **written))
    monkeypatch.setattr(sys, "stdout", SimpleNamespace(fileno=lambda: 1, flush=write))
    monkeypatch.setattr(sys, "platform", system)
    assert entry.run(["models"]) == 1
    told = capsys.readouterr().err
    assert told == (
        "" if quiet else "riecjax: the output cannot be written or read: Invalid argument.\n"
    )


@pytest.mark.parametrize(
    ("system", "typed"),
    [
        ("linux", "riecjax identify 'C:\\a b\\run.csv' --map 'x=a b'"),
        ("win32", 'riecjax identify "C:\\a b\\run.csv" --map "x=a b"'),
    ],
)
def test_commands_are_quoted_for_the_system_s_shell(monkeypatch, system, typed):
    monkeypatch.setattr(sys, "platform", system)
    assert as_typed(["identify", "C:\\a b\\run.csv", "--map", "x=a b"]) == typed
