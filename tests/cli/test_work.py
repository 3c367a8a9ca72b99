"""What a long run takes is said beforehand, and refused where the memory does not hold it."""

import json
import os

import numpy as np
import pytest
from command_line import call, quarter_car_columns, write_csv

from riecjax import work
from riecjax.work import Work, expect, free_memory, in_time, listening

CAR = ("--model", "quarter-car", "--no-sweep", "--refine", "none")


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(7.26, "7.3 s"), (119, "120 s"), (120, "2 min"), (9000, "2.5 h"), (400_000, "4.6 days")],
)
def test_times_have_two_digits_in_the_unit_that_suits(seconds, words):
    assert in_time(seconds) == words


def test_work_names_what_is_worth_naming():
    assert Work(125, 2.14e9).words == "about 2.1 min and 2.1 GB of memory"
    assert Work(40, 1e6).words == "about 40 s"
    assert not Work(9, 1e9).is_much
    assert Work(11, 0).is_much
    assert Work(0, 3e9).is_much


def test_everyone_who_listens_is_told_and_nobody_afterwards():
    heard, inner = [], []
    with listening(lambda *said: heard.append(said)):
        with listening(lambda *said: inner.append(said)):
            expect("one", Work(1, 2))
        expect("two", Work(3, 4))
    expect("three", Work(5, 6))
    assert heard == [("one", (1, 2)), ("two", (3, 4))]
    assert inner == heard[:1]


def test_what_the_memory_does_not_hold_is_refused_with_both_numbers(monkeypatch):
    monkeypatch.setattr(work, "free_memory", lambda: 2e9)
    expect("reading", Work(0, 1.9e9))
    with pytest.raises(MemoryError, match=r"reading takes about 3 GB of memory, and 2 GB are free"):
        expect("reading", Work(0, 3e9), "Read less.")


def test_free_memory_lies_between_what_is_unused_and_all_there_is():
    page = os.sysconf("SC_PAGE_SIZE")
    whole = page * os.sysconf("SC_PHYS_PAGES")
    assert 0.3 * page * os.sysconf("SC_AVPHYS_PAGES") < free_memory() <= whole


def test_a_container_may_leave_less_and_cached_files_count_as_free(monkeypatch, tmp_path):
    monkeypatch.setattr(work, "CONTROL_GROUP", tmp_path)
    monkeypatch.setattr(work, "MEMORY", tmp_path / "none")
    assert free_memory() == float("inf")
    (tmp_path / "memory.max").write_text("1000\n")
    (tmp_path / "memory.current").write_text("700\n")
    (tmp_path / "memory.stat").write_text("anon 500\ninactive_file 150\n")
    assert free_memory() == 450
    (tmp_path / "memory.max").write_text("max\n")
    assert free_memory() == float("inf")


@pytest.fixture
def drive(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return write_csv(tmp_path / "drive.csv", quarter_car_columns())


@pytest.mark.slow
def test_a_long_run_is_announced_on_standard_error(capsys, drive, monkeypatch):
    monkeypatch.setattr(work, "LONG", 0.01)
    result = call(capsys, "identify", drive, *CAR, "--json")
    assert result.status == 0
    assert result.document["parameters"]
    announced = [line for line in result.err.splitlines() if line.startswith("riecjax: ")]
    assert len(announced) == 1
    assert announced[0].startswith("riecjax: assessing the model on 400 samples takes about 0.0")


@pytest.mark.parametrize(
    ("options", "what"),
    [
        (("--upsample", "20"), "resampling to 5.6e+04 samples"),
        (("--windows", "100000"), "assessing the model on 400 samples"),
    ],
)
def test_what_does_not_fit_is_refused_before_it_starts(capsys, drive, monkeypatch, options, what):
    monkeypatch.setattr(work, "free_memory", lambda: 3e6)
    result = call(capsys, "identify", drive, *CAR, *options, "--json")
    assert result.status == 1
    error = json.loads(result.out)["error"]
    assert error["code"] == "memory"
    assert error["message"].startswith(what)
    assert "0.003 GB are free" in error["message"]
    assert result.err == f"riecjax: {error['message']}\n"


def test_a_refinement_that_was_asked_for_is_counted_before_it_starts(monkeypatch):
    import riecjax as rx
    from riecjax.assessment import refining

    def stop(*_, **__):
        raise InterruptedError

    monkeypatch.setattr(refining, "refine_with_misfit", stop)
    time = np.arange(0, 20, 0.01)
    signals = {
        "x": np.sin(3 * time) + np.sin(7 * time),
        "u": np.sin(3 * time) - 5 * np.sin(7 * time),
    }
    signals["dx"] = 3 * np.cos(3 * time) + 7 * np.cos(7 * time)
    record = rx.Record.from_samples(signals, time_step=0.01)
    model = rx.Equation(
        rx.Term("m", "dx", derivative=1), rx.Term("k", "x"), -rx.Term(1.0, "u"), name="body"
    )
    heard = {}
    with listening(heard.__setitem__), pytest.raises(InterruptedError):
        rx.assess(model, record, refine=rx.OutputError(), sweep=False)
    assert heard["refining by simulation"].seconds > 0


def test_random_windows_are_counted_with_the_draws_that_show_their_scatter(monkeypatch):
    """Of 4 parameters and a target, 80 bytes for each window are kept at the very least."""
    import riecjax as rx
    from riecjax.assessment.asked import expect_assessing

    heard = {}
    monkeypatch.setattr(work, "free_memory", lambda: 1e15)
    columns = quarter_car_columns()
    del columns["t"]
    record = rx.Record(columns, 0.005)
    model = rx.find_model("duffing").build_procedure()
    criterion = rx.RIEC(rx.RandomWindows(0.05, 0.5, 10_000_000))
    with listening(lambda what, cost: heard.update({what.partition(" ")[0]: cost})):
        expect_assessing(model, [record], criterion)
        expect_assessing(model, [record], criterion, checking=True)
    assert heard["checking"].bytes > 8e8
    assert heard["assessing"].seconds > 3 * heard["checking"].seconds


def test_what_xla_cannot_allocate_is_one_line(capsys, drive, monkeypatch):
    from riecjax.assessment import assess

    def refuse(*_, **__):
        raise RuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 40402639744 bytes.")

    monkeypatch.setattr(assess, "summarise", refuse)
    result = call(capsys, "identify", drive, *CAR, "--json")
    assert result.status == 1
    error = json.loads(result.out)["error"]
    assert error["code"] == "memory"
    assert "40402639744 bytes" in error["message"]
    assert "--windows" in error["message"] or "fewer windows" in error["message"]
