"""Tasks on processes that end, and schedulers that are gone."""

import re
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from functools import partial
from types import ModuleType
from typing import Any

import pytest
from fleet_tasks import dies, dies_at_first, squares
from tests.machines import drag_fleet as drives

import riecjax as rx
from nightly import nightly
from riecjax.fleets import engine as module
from riecjax.fleets.engine import Each, Lost, engine
from riecjax.models.catalogue import object_of_file

BESIDE = """
import jax.numpy as jnp

ONE = jnp.ones(())

def size(speed):
    return abs(speed) * ONE
"""
USERS = """
import riecjax as rx
from beside import size

class Sloped(rx.Hat):
    pass

def drag(signals):
    return signals["dx"] * size(signals["dx"])

CRITERION = rx.RIEC(rx.AllWindows(0.2, 2.0), Sloped())

MODEL = rx.Equation(
    rx.Term("m", "x", derivative=2, measured=("dx",)),
    rx.Term("r", "x", derivative=1, measured=("dx",)),
    rx.Term("r2", drag),
    rx.Term("k", "x"),
    -rx.Term("one", "u", known=1.0),
)
"""


def answers(each: Each, task: Callable[[list[int]], Any]) -> dict:
    """To three numbers, each answer or why there is none."""
    found = {}
    for numbers, answer in each(task, range(3), lambda _: module.LARGEST):
        found |= zip(numbers, [answer] if isinstance(answer, Lost) else answer)
    return found


def test_without_processes_tasks_are_done_here():
    with engine(0) as each:
        assert answers(each, squares) == {n: n**2 for n in range(3)}


@pytest.mark.slow
def test_processes_that_end_cost_no_task_and_one_that_ends_all_is_given_up(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "LOST_WORKERS", 2)
    with engine(2) as each:
        assert answers(each, partial(dies_at_first, tmp_path)) == {n: n for n in range(3)}
        found = answers(each, dies)
    assert isinstance(found.pop(1), Lost)
    assert found == {0: 0, 2: 2}


@pytest.mark.parametrize("processes", [1, *nightly([2])])
def test_a_fleet_is_the_same_to_the_bit_on_processes_as_without(tmp_path, processes):
    """With a model and a test function of the user's own file, which only this process has loaded,
    with what lies beside it."""
    (tmp_path / "drives").mkdir()
    for i, record in enumerate(drives(4, 1500, 3)):
        rx.write_record(tmp_path / f"drives/{i}.parquet", record)
    (tmp_path / "own.py").write_text(USERS)
    (tmp_path / "beside.py").write_text(BESIDE)
    model = rx.find_model(f"{tmp_path}/own.py:MODEL")
    criterion = object_of_file(f"{tmp_path}/own.py:CRITERION")
    (tmp_path / "own.py").unlink()
    (tmp_path / "beside.py").unlink()
    for workers in (0, processes):
        settings = {"criterion": criterion, "out": tmp_path / f"out{workers}"}
        rx.fleet(model, tmp_path / "drives", workers=workers, **settings)
    for name in ("summaries.parquet", "estimates.parquet"):
        alone, beside = (tmp_path / f"out{workers}" / name for workers in (0, processes))
        assert alone.read_bytes() == beside.read_bytes()


@pytest.mark.slow
def test_a_model_that_cannot_be_sent_or_read_elsewhere_is_said(monkeypatch):
    here = ModuleType("only_here")
    exec("def drag(signals): return signals", vars(here))
    monkeypatch.setitem(sys.modules, "only_here", here)
    with engine(1) as each:
        with pytest.raises(rx.ModelError, match=r"cannot be sent to other processes: .*workers=0"):
            answers(each, partial(print, threading.Lock()))
        with pytest.raises(rx.DataError, match=r"cannot read the model: ModuleNotFound.*only_here"):
            answers(each, here.drag)
        assert answers(each, squares) == {n: n**2 for n in range(3)}


def started() -> tuple[subprocess.Popen[str], str]:
    """A scheduler of its own process, and its address."""
    command = [sys.executable, "-m", "distributed.cli.dask_scheduler"]
    options = ["--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
    process = subprocess.Popen([*command, *options], stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    for line in process.stderr:
        if found := re.search(r"tcp://127\.0\.0\.1:\d+", line):
            return process, found[0]
    raise AssertionError("it printed no address")


def test_a_scheduler_that_is_killed_ends_the_run_in_words():
    process, address = started()
    try:
        with engine(scheduler=address) as each:
            process.send_signal(signal.SIGKILL)
            with pytest.raises(rx.DataError, match=r"is gone\. What was summed is kept"):
                answers(each, squares)
    finally:
        process.kill()
        process.communicate()


def test_a_scheduler_that_does_not_answer_is_said(monkeypatch):
    monkeypatch.setattr(module, "WAITS", 1.0)
    silent = "tcp://127.0.0.1:9"
    refused = pytest.raises(rx.DataError, match=f"no scheduler of Dask answers at {silent}")
    with refused, engine(scheduler=silent):
        raise AssertionError("it answered")


def test_processes_that_do_not_start_are_said(monkeypatch):
    import distributed  # which imports what POSIX alone has

    def failing(**_):
        raise RuntimeError("Nanny failed to start.")

    monkeypatch.setattr(distributed, "LocalCluster", failing)
    with pytest.raises(rx.DataError, match="processes do not start: Nanny failed"), engine(1):
        raise AssertionError("they started")
