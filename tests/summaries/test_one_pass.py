"""One pass over recordings of any length, against sums of the record as it is."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import riecjax as rx
from compiling import functions_compiled
from nightly import by_day, nightly
from riecjax.summaries import one_pass
from riecjax.summaries.one_pass import recording_sums
from riecjax.summaries.summarise import ready, task

STEP = 0.005
EQUATION = rx.Equation(
    rx.Term("k", "x"),
    rx.Term("c", "x", derivative=1, measured=("v",)),
    -rx.Term(1.0, "u"),
    name="axis",
)
ALL = rx.RIEC(rx.AllWindows(0.05, 0.5))
KEY = jax.random.key(3)


def record_of(count, seed=0, gaps=()):
    rng = np.random.default_rng(seed)
    x, v = 0.01 * np.cumsum(rng.normal(size=(2, count)), axis=1) + 1.0
    u = 3.0 * x + 2.0 * v + rng.normal(size=count)
    for at in gaps:
        x[at] = np.nan
    return rx.Record.from_samples({"x": x, "v": v, "u": u}, time_step=STEP)


def difference(record, criterion, key=None):
    """From the moments that are traced, in the same blocks, over the largest of each."""
    asked = task(EQUATION, ready(rx.staged(EQUATION), record, "none"), criterion, key)
    plain = eqx.filter_jit(recording_sums)(asked.model, record, asked.criterion, key)
    found = rx.summarise(EQUATION, record, criterion, key=key, noise="none").recordings[0]
    assert int(found.blocks) == int(plain.blocks)
    assert float(found.block_seconds) == pytest.approx(float(plain.block_seconds))
    ours, theirs = found.stages[0][0], plain.stages[0][0]
    size = np.abs(np.asarray(theirs.moments)).max((0, 1))
    np.testing.assert_allclose(ours.count, theirs.count, rtol=1e-12)
    error = np.abs(np.asarray(ours.moments) - np.asarray(theirs.moments)).max((0, 1))
    return np.max(error / size)


CRITERIA = {
    "boxcar": (ALL, None),
    "boxcar of order 6": (rx.RIEC(rx.AllWindows(0.05, 0.5), rx.Boxcar(6)), None),
    "hat": (rx.RIEC(rx.AllWindows(0.05, 0.5), rx.Hat()), None),
    "bump": (rx.RIEC(rx.AllWindows(0.05, 0.5), rx.Bump(lengths=5)), None),
    "random windows": (rx.RIEC(rx.RandomWindows(0.05, 0.5, 500)), KEY),
    "dols": (rx.DOLS(), None),
}


@pytest.mark.parametrize("name", by_day(CRITERIA, "boxcar", "hat", "random windows", "dols"))
@pytest.mark.parametrize(
    ("count", "gaps"),
    [(9001, ()), (6000, (0, 1, 700, 4095, 5999)), *nightly([(150, ()), (4096, ())])],
)
def test_filling_up_changes_nothing(name, count, gaps):
    criterion, key = CRITERIA[name]
    assert difference(record_of(count, gaps=gaps), criterion, key) <= 1e-12


@pytest.mark.parametrize("quadrature", [2, *nightly([6])])
def test_parts_of_a_long_recording_count_each_window_once(quadrature, monkeypatch):
    monkeypatch.setattr("riecjax.summaries.one_pass.PART", 2**13)
    criterion = rx.RIEC(rx.AllWindows(0.05, 0.5), rx.Boxcar(quadrature))
    assert difference(record_of(20_001), criterion) <= 1e-11


def test_blocks_of_a_long_recording_pair_up():
    """The number of blocks is bounded, and pairs hold what blocks of twice the length do."""
    record = rx.Record({name: record_of(300_000)[name] for name in ("x", "v", "u")}, STEP)
    criterion = rx.RIEC(rx.AllWindows(0.02, 0.1))
    found = rx.summarise(EQUATION, record, criterion).recordings[0]
    assert 512 < int(found.blocks) <= 1024
    assert difference(record, criterion) <= 1e-10


def test_recordings_of_any_lengths_compile_nothing():
    equation = rx.Equation(
        rx.Term("k1", "x"), rx.Term("c1", "x", derivative=1), -rx.Term(1.0, "u"), name="new"
    )
    records = [record_of(count) for count in (500, 5001, 50_002)]
    assert not functions_compiled(lambda: [rx.identify(equation, each, ALL) for each in records])


def test_an_expression_that_mixes_samples_is_not_filled_up():
    """Its mean would be that of what fills it up too; of a long recording it is refused."""

    def centred(signals):
        return signals["x"] - jnp.mean(signals["x"])

    record = record_of(3000)
    mixed = rx.Equation(rx.Term("k", centred), rx.Term("c", "v"), -rx.Term(1.0, "u"))
    beforehand = record.with_signals({"z": record["x"] - jnp.mean(record["x"])})
    plain = rx.Equation(rx.Term("k", "z"), rx.Term("c", "v"), -rx.Term(1.0, "u"))
    found = rx.identify(mixed, record, ALL, noise="none", intervals=rx.Naive())
    expected = rx.identify(plain, beforehand, ALL, noise="none", intervals=rx.Naive())
    np.testing.assert_allclose(found.theta, expected.theta, rtol=1e-10)
    long = record_of(one_pass.PART + 5)
    with pytest.raises(rx.ModelError, match="centred mixes samples"):
        rx.summarise(mixed, long, ALL)
