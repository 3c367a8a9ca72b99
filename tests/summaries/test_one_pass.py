"""One pass over recordings of any length, against sums of the record as it is."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from nightly import by_day, nightly
from riecjax.criteria.criterion import DOLS, RIEC
from riecjax.criteria.test_functions import Boxcar, Bump, Hat
from riecjax.criteria.windows import AllWindows, RandomWindows
from riecjax.equations.equation import Equation
from riecjax.equations.term import Term
from riecjax.errors import ModelError
from riecjax.estimation.identify import identify
from riecjax.records.record import Record
from riecjax.summaries import one_pass
from riecjax.summaries.stage_sums import traced_sums
from riecjax.summaries.summarise import summarise
from riecjax.summaries.task import task

STEP = 0.005
EQUATION = Equation(
    Term("k", "x"), Term("c", "x", derivative=1, measured=("v",)), -Term(1.0, "u"), name="axis"
)
ALL = RIEC(AllWindows(0.05, 0.5))
KEY = jax.random.key(3)


def record_of(count, seed=0, gaps=()):
    rng = np.random.default_rng(seed)
    x, v = 0.01 * np.cumsum(rng.normal(size=(2, count)), axis=1) + 1.0
    u = 3.0 * x + 2.0 * v + rng.normal(size=count)
    for at in gaps:
        x[at] = np.nan
    return Record.from_samples({"x": x, "v": v, "u": u}, time_step=STEP)


def agree(record, criterion, key=None, rtol=1e-12):
    """The same moments in the same blocks as of the record that is not filled up."""
    asked = task(EQUATION, record, criterion, key, "none")
    plain = traced_sums(asked.procedure, record, asked.criterion, key)
    found = summarise(EQUATION, record, criterion, key=key, noise="none").recordings[0]
    assert int(found.blocks) == int(plain.blocks)
    assert float(found.block_seconds) == pytest.approx(float(plain.block_seconds))
    ours, theirs = found.stages[0][0], plain.stages[0][0]
    size = np.abs(np.asarray(theirs.moments)).max((0, 1))
    error = np.abs(np.asarray(ours.moments) - np.asarray(theirs.moments)).max((0, 1))
    assert (error <= rtol * size).all()
    np.testing.assert_allclose(ours.count, theirs.count, rtol=1e-12)


CRITERIA = {
    "boxcar": (ALL, None),
    "boxcar of order 6": (RIEC(AllWindows(0.05, 0.5), Boxcar(6)), None),
    "hat": (RIEC(AllWindows(0.05, 0.5), Hat()), None),
    "bump": (RIEC(AllWindows(0.05, 0.5), Bump(lengths=5)), None),
    "a law": (RIEC(AllWindows(0.05, 0.5, law=[1, 2, 0.5])), None),
    "random windows": (RIEC(RandomWindows(0.05, 0.5, 500)), KEY),
    "dols": (DOLS(), None),
}


@pytest.mark.parametrize("name", by_day(CRITERIA, "boxcar", "hat", "random windows", "dols"))
@pytest.mark.parametrize("count", [9001, *nightly([150, 4096])])
def test_filling_up_changes_nothing(name, count):
    criterion, key = CRITERIA[name]
    agree(record_of(count), criterion, key)


@pytest.mark.parametrize("name", ["boxcar", *nightly(["hat"])])
def test_nor_does_it_where_samples_are_missing(name):
    criterion, key = CRITERIA[name]
    agree(record_of(6000, gaps=(0, 1, 700, 4095, 5999)), criterion, key)


@pytest.mark.parametrize("quadrature", [2, *nightly([6])])
def test_parts_of_a_long_recording_count_each_window_once(quadrature, monkeypatch):
    monkeypatch.setattr("riecjax.summaries.one_pass.PART", 2**13)
    agree(record_of(20_001), RIEC(AllWindows(0.05, 0.5), Boxcar(quadrature)), rtol=1e-11)


def test_blocks_of_a_long_recording_pair_up():
    """The number of blocks is bounded, and pairs hold what blocks of twice the length do."""
    record = Record({name: record_of(300_000)[name] for name in ("x", "v", "u")}, STEP)
    criterion = RIEC(AllWindows(0.02, 0.1))
    found = summarise(EQUATION, record, criterion).recordings[0]
    assert 512 < int(found.blocks) <= 1024
    agree(record, criterion, rtol=1e-10)


def functions_compiled(work):
    """Names of what is compiled by some work, of the names that compiling shows."""
    names = []

    def listen(event: str, duration_secs: float, **about: str | int) -> None:
        if event.endswith("backend_compile_duration"):
            names.append(str(about.get("fun_name")))

    jax.monitoring.register_event_duration_secs_listener(listen)
    work()
    jax.monitoring.unregister_event_duration_listener(listen)
    return names


@pytest.mark.slow
def test_a_hundred_recordings_of_any_length_compile_four_functions_at_most():
    equation = Equation(Term("k_", "x"), Term("c_", "x", derivative=1), -Term(1.0, "u"), name="new")
    lengths = np.unique(np.geomspace(110, 300_000, 100).astype(int))
    long = record_of(lengths[-1])
    records = [long.part(0, int(count)) for count in lengths]

    def work():
        for record in records:
            summarise(equation, record, ALL, noise={"x": 1e-3, "v": 1e-3, "u": 0.5})

    names = functions_compiled(work)
    assert 1 <= sum("of_all_windows" in name for name in names) <= 4
    # Nor is anything else compiled for each of them.
    assert len(names) < 20


def test_sixteen_lengths_beside_one_another_compile_one_function_and_one_solver():
    equation = Equation(Term("k1", "x"), Term("c1", "x", derivative=1), -Term(1.0, "u"), name="new")
    records = [record_of(count) for count in range(5000, 5016)]
    names = functions_compiled(lambda: [identify(equation, record, ALL) for record in records])
    assert sum("of_all_windows" in name for name in names) == 1
    assert sum("_solve" in name for name in names) == 1


def test_an_expression_that_mixes_samples_is_not_filled_up():
    """Its mean would be that of what fills it up too; of a long recording it is refused."""

    def centred(signals):
        return signals["x"] - jnp.mean(signals["x"])

    record = record_of(3000)
    mixed = Equation(Term("k", centred), Term("c", "v"), -Term(1.0, "u"))
    beforehand = record.with_signals({"z": record["x"] - jnp.mean(record["x"])})
    plain = Equation(Term("k", "z"), Term("c", "v"), -Term(1.0, "u"))
    found = identify(mixed, record, ALL, noise="none")
    expected = identify(plain, beforehand, ALL, noise="none")
    np.testing.assert_allclose(found.theta, expected.theta, rtol=1e-10)
    long = record_of(one_pass.PART + 5)
    with pytest.raises(ModelError, match="centred mixes samples"):
        summarise(mixed, long, ALL)
