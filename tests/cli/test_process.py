"""The command line as a process: signals, streams that take nothing, and what is left behind."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from riecjax.whole_files import LEFT_BEHIND

# In the background or under nohup tests inherit ignored signals, as their children then would.
LISTENING = (
    "import os, signal, sys; "
    "[signal.signal(each, signal.SIG_DFL) for each in (signal.SIGINT, signal.SIGHUP)]; "
    "os.execv(sys.executable, [sys.executable, *sys.argv[1:]])"
)
BEGUN = """
import signal, sys, time
from pathlib import Path
from riecjax.cli import start
start.end_on_signals()
from riecjax.whole_files import temporary
with temporary(Path.cwd()) as file:
    file.write_text("half of it")
    print("begun", flush=True)
    try:
        {doing}
    except BaseException:
        pass
"""
HANG_UP = getattr(signal, "SIGHUP", signal.SIGTERM)
"""Which Windows has not."""
DOING = {
    "waiting": "time.sleep(60)",
    "importing": "import slow",
    "computing": "while True: pass",
}


@contextlib.contextmanager
def begun(code: str, folder: Path) -> Iterator[subprocess.Popen[str]]:
    """A process that runs this code and has printed a line."""
    with subprocess.Popen(
        [sys.executable, "-c", LISTENING, "-c", code],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "begun\n"
            yield process
        finally:
            process.kill()


@pytest.mark.parametrize(
    ("doing", "number", "status", "line"),
    [
        ("waiting", signal.SIGINT, 130, "riecjax: interrupted.\n"),
        ("importing", signal.SIGINT, 130, "riecjax: interrupted.\n"),
        ("computing", signal.SIGINT, 130, "riecjax: interrupted.\n"),
        ("computing", signal.SIGTERM, 143, "riecjax: terminated.\n"),
        ("waiting", HANG_UP, 129, "riecjax: hung up.\n"),
    ],
)
def test_a_signal_ends_it_with_one_line_and_leaves_nothing(tmp_path, doing, number, status, line):
    (tmp_path / "slow.py").write_text("import time; time.sleep(60)")
    with begun(BEGUN.format(doing=DOING[doing]), tmp_path) as process:
        time.sleep(0.1)
        process.send_signal(number)
        out, err = process.communicate(timeout=20)
    assert (process.returncode, out, err) == (status, "", line)
    assert [path.name for path in tmp_path.iterdir() if LEFT_BEHIND.fullmatch(path.name)] == []


def test_a_signal_that_was_ignored_stays_so(tmp_path):
    code = BEGUN.format(doing='time.sleep(0.3); print("done")')
    ignoring = "import signal; signal.signal(signal.SIGHUP, signal.SIG_IGN)\n"
    with begun(ignoring + code, tmp_path) as process:
        process.send_signal(signal.SIGHUP)
        assert process.communicate(timeout=20) == ("done\n", "")
        assert process.returncode == 0


def test_a_signal_waits_until_finished_files_are_in_their_places(tmp_path):
    doing = """
        from riecjax.whole_files import committing
        with committing:
            time.sleep(0.5)
            Path("moved").touch()
        time.sleep(60)"""
    with begun(BEGUN.format(doing=doing), tmp_path) as process:
        time.sleep(0.2)
        process.terminate()
        process.communicate(timeout=20)
    assert process.returncode == 143
    assert [path.name for path in tmp_path.iterdir()] == ["moved"]


def shell(command: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """What bash makes of a command line with `riecjax` in it; `$?` as its status."""
    script = f'riecjax() {{ "{sys.executable}" -m riecjax "$@"; }}\nset -o pipefail\n{command}'
    words = ["bash", "-c", script]
    return subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)


@pytest.mark.parametrize(
    ("command", "status", "line"),
    [
        ("riecjax models > /dev/full", 1, "the output cannot be written or read: No space left"),
        ("riecjax models --json > /dev/full", 1, "the output cannot be written or read: No space"),
        ("riecjax --help > /dev/full", 1, "the output cannot be written or read: No space left"),
        ("riecjax models >&-", 1, "the output cannot be written or read: Bad file descriptor"),
        ("riecjax models | true", 1, None),
        ("riecjax models 2> /dev/full > models", 0, None),
        ("riecjax models 2>&- > models", 0, None),
        ("riecjax models <&- > models", 0, None),
        ("riecjax nonsense 2> /dev/full", 2, None),
    ],
)
def test_streams_that_take_nothing(tmp_path, command, status, line):
    done = shell(command, tmp_path)
    assert done.returncode == status, done.stderr
    assert done.stdout == ""
    assert done.stderr.startswith(f"riecjax: {line}" if line else "")
    assert done.stderr.count("\n") == (1 if line else 0)
    assert (tmp_path / "models").exists() == ("> models" in command)


def test_a_file_never_takes_the_place_of_a_closed_stream(tmp_path):
    code = """
from riecjax.cli import start
start.open_standard_streams()
with open("kept", "w") as file:
    for stream in (1, 2):
        try:
            os.write(stream, b"lost")
        except OSError:
            pass
"""
    words = f"\"{sys.executable}\" -c 'import os{code}' >&- 2>&-"
    assert subprocess.run(["bash", "-c", words], cwd=tmp_path, check=False).returncode == 0
    assert (tmp_path / "kept").read_text() == ""


WRITING = """
from pathlib import Path
from riecjax.whole_files import temporary
with temporary(Path()) as new:
    new.write_bytes(b"t,x")
    new.replace("drive.csv")
print("begun")
"""


def test_a_killed_process_leaves_what_is_swept_a_day_later(tmp_path):
    with begun(BEGUN.format(doing="time.sleep(60)"), tmp_path) as killed:
        killed.kill()
        killed.communicate()
    (left,) = tmp_path.iterdir()
    for names in ([left.name, "drive.csv"], ["drive.csv"]):
        with begun(WRITING, tmp_path) as writing:
            writing.communicate()
        assert sorted(path.name for path in tmp_path.iterdir()) == names
        # A day later no one is writing to it any more.
        if left.exists():
            os.utime(left, (0, 0))


@pytest.mark.slow
def test_names_that_are_text_in_no_encoding(tmp_path):
    model = "import riecjax as rx\nm = rx.Equation(rx.Term('k', 'x'), -rx.Term(1.0, 'u'))"
    rows = [f"{i / 100},{np.sin(i / 9)},{2 * np.sin(i / 9) + 0.1 * np.cos(i)}" for i in range(500)]
    for name, lines in ((b"caf\xe9.py", [model]), (b"dr\xefve\x1b[31m.csv", ["t,x,u", *rows])):
        (tmp_path / os.fsdecode(name)).write_text("\n".join(lines))
    fit = "--criterion dols --no-sweep --refine none"
    done = shell(f"riecjax identify dr*.csv --model caf*.py {fit} --out $'r\\xe9s'", tmp_path)
    assert done.returncode == 0, done.stderr
    assert "\x1b" not in done.stdout
    report = (tmp_path / os.fsdecode(b"r\xe9s") / "report.html").read_text()
    assert r"dr\udcefve" in report
    assert "\x1b" not in report
