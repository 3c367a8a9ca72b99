"""What noise adds, in sums that are cut, put together, kept in files and differentiated."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.machines import MACHINES, Shape

import riecjax as rx
from conftest import in_32_bit
from nightly import nightly
from riecjax.criteria.noise_moments import noise_moments
from riecjax.criteria.windows import StartBlocks
from riecjax.summaries.summarise import ready
from riecjax.summaries.summary import load

STEP = 0.01
STD = {"x": 0.01, "dx": 0.1, "u": 1.0}
EQUATION = rx.Equation(
    rx.Term("m", "dx", derivative=1),
    rx.Term("c", lambda s: s["dx"] * jnp.abs(s["dx"])),
    rx.Term("k", "x"),
    -rx.Term(1.0, "u"),
)
BOXCAR = rx.RIEC(rx.AllWindows(0.05, 0.4))
GIVEN = {"noise": STD, "intervals": rx.Sandwich()}


def record(count=1500, seed=0, gaps=()):
    rng = np.random.default_rng(100 + seed)
    waves = MACHINES["drag"].signals(drive=seed, shape=Shape(count, 100))
    arrays = {name: waves[name] + std * rng.normal(size=count) for name, std in STD.items()}
    for at in gaps:
        arrays["x"][at] = np.nan
    return rx.Record.from_samples(arrays, time_step=STEP)


def noise_of(sums):
    return noise_in(sums.stages[0][0])


def noise_in(equation, of="noise"):
    """What noise added to an equation's moments, in all or of each source."""
    found = getattr(equation, of)
    assert found is not None
    return np.asarray(found)


@pytest.mark.parametrize(
    ("test_function", "error"),
    # Of order 4, windows at the record's ends weigh a sample beyond these if there is one.
    [
        (rx.Boxcar(4), 1e-6),
        *nightly([(rx.Hat(4), 1e-6), (rx.Boxcar(2), 1e-9), (rx.Hat(2), 1e-8)]),
    ],
    ids=repr,
)
@pytest.mark.parametrize("count", [140_000, *nightly([1500])])
def test_a_record_in_chunks_adds_up_to_the_same_in_one_piece(count, test_function, error):
    criterion = rx.RIEC(BOXCAR.windows, test_function)
    (one,) = (r.record for r in ready(rx.staged(EQUATION), record(count, gaps=(300, 301)), STD))
    lags = criterion.law(one)
    blocks = StartBlocks(0, count, 1)
    noisy = criterion.noisy_columns(EQUATION, one)

    def products(columns):
        return test_function.moments(columns, lags, blocks, 128)[0]

    def weights():
        return test_function.noise_weights(noisy.columns, lags, blocks)

    total, of_source = jax.jit(lambda: noise_moments(noisy, blocks, weights, products))()
    found = rx.summarise(EQUATION, one, criterion).recordings[0].stages[0][0]
    size = np.sqrt(np.outer(np.diag(total[0]), np.diag(total[0])))
    assert (size > 0).all()
    for ours, theirs in (
        (noise_in(found).sum((0, 1)), total.sum(0)),
        (noise_in(found, "noise_of_source").sum((0, 1)), of_source.sum(0)),
    ):
        np.testing.assert_allclose(ours / size, theirs / size, rtol=0, atol=error)


def test_summaries_are_merged_saved_scaled_selected_and_cut(tmp_path):
    records = [record(1500, 1), record(2200, 2)]
    one, other = (rx.summarise(EQUATION, r, BOXCAR, noise=STD) for r in records)
    merged = one.merge(other)
    merged.save(tmp_path / "sums.npz")
    back = load(tmp_path / "sums.npz")
    assert jax.tree.structure(back) == jax.tree.structure(merged)
    for found, kept in zip(jax.tree.leaves(back), jax.tree.leaves(merged)):
        np.testing.assert_array_equal(found, kept)
    both = rx.identify(EQUATION, records, BOXCAR, **GIVEN)
    found = rx.estimate(EQUATION, back.scale(0.5), intervals=rx.Sandwich())
    np.testing.assert_allclose(found.theta, both.theta, rtol=1e-10)
    order = merged.digests.index(other.digests[0])
    chosen = rx.estimate(EQUATION, back.select(order), intervals=rx.Sandwich())
    alone = rx.identify(EQUATION, records[1], BOXCAR, **GIVEN)
    np.testing.assert_allclose(chosen.theta, alone.theta, rtol=1e-10)
    cut = other.leave_out(5.0, 9.0).recordings[0]
    kept = (np.arange(int(other.recordings[0].blocks)) + 1) * float(cut.block_seconds) <= 5.0
    kept |= np.arange(kept.size) * float(cut.block_seconds) >= 9.0
    np.testing.assert_array_equal(noise_of(cut), noise_of(other.recordings[0])[:, kept])


@pytest.mark.slow
def test_noise_none_is_least_squares_and_a_parameter_of_each_record_is_that_of_its_sums():
    records = [record(1500, 1), record(2200, 2)]
    summaries = [rx.summarise(EQUATION, r, BOXCAR, noise=STD).recordings[0] for r in records]

    # m of both, and c and k of each.
    gram, moment = np.zeros((5, 5)), np.zeros(5)
    for one, place in zip(summaries, ([0, 1, 3], [0, 2, 4])):
        sums = one.stages[0][0]
        clean = (np.asarray(sums.moments) - noise_in(sums)).sum((0, 1))
        gram[np.ix_(place, place)] += clean[1:, 1:]
        moment[place] += clean[1:, 0]
    found = rx.identify(EQUATION, records, BOXCAR, per_record=("c", "k"), **GIVEN)
    assert found.parameters == ("m", "c[1]", "c[2]", "k[1]", "k[2]")
    np.testing.assert_allclose(found.theta, np.linalg.solve(gram, moment), rtol=1e-9)
    plain = rx.identify(EQUATION, record(1500, 1), BOXCAR, noise="none", intervals=rx.Sandwich())
    assert plain.summary is not None
    assert plain.summary.recordings[0].stages[0][0].noise is None
    found = rx.identify(EQUATION, record(1500, 1), BOXCAR, **GIVEN)
    moments = np.asarray(plain.summary.recordings[0].stages[0][0].moments).sum((0, 1))
    expected = np.linalg.solve(moments[1:, 1:], moments[1:, 0])
    np.testing.assert_allclose(plain.theta, expected, rtol=1e-9)
    assert (np.abs(found.theta - plain.theta) > 0.2 * np.asarray(plain.standard_errors)).any()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("test_function", "error"), [(rx.Boxcar(), 1e-3), (rx.Hat(), 0.15)], ids=repr
)
def test_in_32_bit_as_much_is_taken_off(test_function, error):
    """Running sums over a chunk are of other sizes than a window's, and keep too few digits; what
    probes tell instead scatters by some percent."""
    criterion = rx.RIEC(rx.AllWindows(0.05, 0.2), test_function).fitted([record(16_000)])
    waves = jax.tree.map(np.asarray, record(16_000).arrays)

    def added(dtype):
        arrays = {name: np.asarray(wave, dtype) for name, wave in waves.items()}

        @jax.jit
        def summed(of):
            return rx.summarise(EQUATION, of, criterion, noise=STD).recordings[0]

        return noise_of(summed(rx.Record(arrays, dtype(STEP)))).sum((0, 1))

    exact = added(np.float64)
    with in_32_bit():
        rough = added(np.float32)
    assert rough.dtype == np.float32
    size = np.sqrt(np.outer(np.diag(exact), np.diag(exact)))
    np.testing.assert_allclose(rough / size, exact / size, rtol=0, atol=error)
