"""What the memory does not hold is refused before it starts."""

import os

import pytest
from command_line import call, quarter_car_columns, write_csv

from riecjax import runtime as memory
from riecjax.runtime import free_memory, require_memory

CAR = ("--model", "quarter-car", "--no-sweep", "--refine", "none")


def test_what_the_memory_does_not_hold_is_refused_with_both_numbers(monkeypatch):
    monkeypatch.setattr(memory, "free_memory", lambda: 2e9)
    require_memory("reading", 1.9e9)
    with pytest.raises(MemoryError, match=r"reading takes about 3 GB of memory, and 2 GB are free"):
        require_memory("reading", 3e9, "Read less.")


def test_free_memory_lies_between_what_is_unused_and_all_there_is():
    page = os.sysconf("SC_PAGE_SIZE")
    whole = page * os.sysconf("SC_PHYS_PAGES")
    assert 0.3 * page * os.sysconf("SC_AVPHYS_PAGES") < free_memory() <= whole


def test_a_container_may_leave_less_and_cached_files_count_as_free(monkeypatch, tmp_path):
    monkeypatch.setattr(memory, "CONTROL_GROUP", tmp_path)
    monkeypatch.setattr(memory, "MEMORY", tmp_path / "none")
    assert free_memory() == float("inf")
    (tmp_path / "memory.max").write_text("1000\n")
    (tmp_path / "memory.current").write_text("700\n")
    (tmp_path / "memory.stat").write_text("anon 500\ninactive_file 150\n")
    assert free_memory() == 450
    (tmp_path / "memory.max").write_text("max\n")
    assert free_memory() == float("inf")


@pytest.fixture
def drive(tmp_path):
    return write_csv(tmp_path / "drive.csv", quarter_car_columns())


def refused(capsys, drive, *options: str) -> str:
    """The message of a document and of a line."""
    result = call(capsys, "identify", drive, *CAR, *options, "--json")
    assert result.status == 1
    error = result.document["error"]
    assert error["code"] == "memory"
    assert result.err == f"riecjax: {error['message']}\n"
    return error["message"]


@pytest.mark.parametrize(
    ("options", "what"),
    [
        (("--upsample", "20"), "resampling to 5.6e+04 samples"),
        (("--windows", "100000"), "assessing the model on 400 samples"),
    ],
)
def test_what_does_not_fit_is_refused_before_it_starts(capsys, drive, monkeypatch, options, what):
    monkeypatch.setattr(memory, "free_memory", lambda: 3e6)
    message = refused(capsys, drive, *options)
    assert message.startswith(what)
    assert "0.003 GB are free" in message


def test_what_xla_cannot_allocate_is_one_line(capsys, drive, monkeypatch):
    from riecjax.assessment import assess

    def refuse(*_, **__):
        raise RuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 40402639744 bytes.")

    monkeypatch.setattr(assess, "summarise", refuse)
    message = refused(capsys, drive)
    assert "40402639744 bytes" in message
    assert "--windows" in message or "fewer windows" in message


def test_on_a_terminal_a_line_says_what_is_done_and_elsewhere_each_tenth(monkeypatch, capsys):
    import io
    from types import SimpleNamespace

    from rich.console import Console

    from riecjax.cli import progress

    clock = [100.0]
    monkeypatch.setattr(progress, "time", SimpleNamespace(monotonic=lambda: clock[0]))
    text = io.StringIO()
    line, console = progress.Progress(), Console(file=text, force_terminal=True, width=100)
    clock[0] = 112.4
    console.print(line)
    line.refining(0.25)
    clock[0] = 113.6
    console.print(line)
    for clock[0], done in ((120.0, 0), (124.0, 3)):
        line.count("summing", done, 10, 4_000_000 * bool(done))
    console.print(line)
    first, second, third = text.getvalue().splitlines()
    assert first == "reading, and compiling what was not compiled before: 12 s"
    assert second == "refining: step 1, sum of squares 0.25: 14 s"
    assert third == "summing: 3 of 10, 1,000 thousand samples/s, 9 s left: 24 s"
    plain = progress.Progress(lines=True)
    for clock[0], done in ((130.0, 0), (131.0, 1), (132.0, 2), (150.0, 20)):
        plain.count("summing", done, 20)
    lines = ("0 of 20", "2 of 20, 18 s left", "20 of 20")
    assert capsys.readouterr().err == "".join(f"riecjax: summing: {line}\n" for line in lines)
