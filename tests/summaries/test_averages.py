"""Averages and activity of an equation against loops over samples and rows."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from riecjax.criteria.criterion import DOLS, RIEC
from riecjax.criteria.test_functions import Hat
from riecjax.criteria.windows import AllWindows
from riecjax.equations.equation import Equation
from riecjax.equations.noisy_columns import Columns
from riecjax.equations.procedure import as_procedure
from riecjax.equations.term import Term
from riecjax.estimation.excitation import excitation_of
from riecjax.estimation.parameters import Sharing
from riecjax.estimation.stages import sizes_in_bursts
from riecjax.linear_algebra import factor_of_rows
from riecjax.records.noise import noise_level
from riecjax.records.record import Record
from riecjax.summaries.averages import activity, averaged_rows, hat_half, thinned
from riecjax.summaries.normal_equations import NormalEquations
from riecjax.summaries.summarise import summarise

STEP, COUNT = 0.01, 400
HATS = RIEC(AllWindows(0.1, 0.4), Hat())


def columns_of(orders, seed=0, present=None, count=COUNT):
    """Random columns, with means, in the orders that are named and zero in the others."""
    rng = np.random.default_rng(seed)
    values = np.zeros((3, 2, count))
    for order in orders:
        values[order] = rng.normal([[3.0], [-20.0]], 1.0, (2, count))
    mask = None if present is None else jnp.asarray(present)
    return Columns(jnp.asarray(values), mask, jnp.asarray(STEP), ("a",))


def mean_under_hat(values, centre, half):
    """Mean of `sum_k d^k/dt^k values[k]` under a hat, by parts and with trapezia."""
    if not half:
        return values[0][:, centre]
    left = slice(centre - half, centre + 1)
    right = slice(centre, centre + half + 1)
    # Two passes of trapezia weigh neighbours 1/4, 1/2, 1/4 and these with the hat.
    distance = np.abs(np.arange(-half - 1, half + 2))
    weights = np.convolve(np.maximum(half - distance, 0), [0.25, 0.5, 0.25], "valid") / half**2
    plain = values[0][:, centre - half : centre + half + 1] @ weights
    slope = np.trapezoid(values[1][:, right], dx=STEP) - np.trapezoid(values[1][:, left], dx=STEP)
    ends = values[2][:, centre - half] + values[2][:, centre + half] - 2 * values[2][:, centre]
    return plain + (slope + ends) / (half * STEP) ** 2


@pytest.mark.parametrize("orders", [(0,), (1,), (2,), (0, 1, 2)])
@pytest.mark.parametrize("half", [0, 1, 7])
def test_rows_are_means_under_hats_that_lie_on_samples_present(orders, half):
    held = 350
    present = np.ones(COUNT, bool)
    present[[40, 41, 200, 345]] = False
    columns = columns_of(orders, present=present)
    values = np.array(columns.values)
    # What is held at a gap or behind the record's end has no meaning.
    values[:, :, 200] = np.nan
    values[:, :, held:] = 1e9
    columns = Columns(jnp.asarray(values), columns.present, columns.time_step, columns.parameters)
    centres = np.arange(-3, COUNT + 3)
    rows, kept = jax.jit(averaged_rows)(columns, half, jnp.asarray(centres), held)

    there = present & (np.arange(COUNT) < held)
    reached = [np.arange(c - half, c + half + 1) for c in centres]
    expected = [r[0] >= 0 and r[-1] < held and there[r].all() for r in reached]
    np.testing.assert_array_equal(kept, expected)
    means = [mean_under_hat(values, c, half) for c in centres[np.asarray(kept)]]
    np.testing.assert_allclose(np.asarray(rows)[expected], means, rtol=1e-9, atol=1e-8)
    assert not np.any(np.asarray(rows)[~np.asarray(kept)])


def test_derivatives_by_parts_are_those_of_the_motion():
    t = STEP * np.arange(COUNT)
    w = 3.0
    values = np.zeros((3, 3, COUNT))
    values[0, 0], values[1, 1], values[2, 2] = (
        -(w**2) * np.sin(w * t),
        w * np.cos(w * t),
        np.sin(w * t),
    )
    columns = Columns(jnp.asarray(values), None, jnp.asarray(STEP), ("v", "x"))
    half = 20
    centres = np.arange(half, COUNT - half)
    rows, kept = averaged_rows(columns, half, jnp.asarray(centres), COUNT)
    assert np.all(kept)
    # A hat of h seconds to a side takes (sin(w h / 2) / (w h / 2))^2 of a sinusoid.
    share = np.sinc(w * half * STEP / 2 / np.pi) ** 2
    expected = -(w**2) * np.sin(w * t[centres]) * share
    np.testing.assert_allclose(rows, np.stack([expected] * 3, axis=1), atol=2e-4 * w**2)


@pytest.mark.slow
def test_single_precision_keeps_what_varies_beside_a_large_mean():
    count = 20_000
    rng = np.random.default_rng(0)
    wave = np.sin(0.3 * np.arange(count)) + 0.1 * rng.normal(size=count)
    rows = {}
    for bits in (32, 64):
        with jax.enable_x64(bits == 64):
            columns = Columns(
                jnp.asarray(np.stack([wave, wave + 1e3])[None]), None, jnp.asarray(STEP), ("a",)
            )
            centres = jnp.arange(10, count - 10)
            found, _ = averaged_rows(columns, 10, centres, count)
            rows[bits] = np.asarray(found, float)
    assert np.max(np.abs(rows[32] - rows[64])) < 1e-3


@pytest.mark.parametrize("count", [2, 60])
def test_a_factor_has_the_lengths_and_fits_of_its_rows(count):
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(count, 3)) * [1e-3, 1.0, 1e3] + [5.0, 0.0, 1e4]
    kept = np.arange(count) % 5 != 3
    factor = factor_of_rows(rows, kept)
    extended = np.concatenate([np.ones((kept.sum(), 1)), rows[kept]], axis=1)
    np.testing.assert_allclose(factor.T @ factor, extended.T @ extended, rtol=1e-12)
    np.testing.assert_array_equal(factor, np.triu(factor))
    assert np.all(np.diagonal(factor) >= 0)
    np.testing.assert_allclose(factor[0], np.sqrt(kept.sum()) * extended.mean(axis=0), rtol=1e-12)


def test_a_factor_has_the_singular_values_of_its_rows_however_near_collinear():
    rng = np.random.default_rng(0)
    a = rng.normal(size=900)
    # Too near for the Gram matrix, whose condition is the square of 1e9.
    rows = np.stack([2 * a + 1e-9 * rng.normal(size=900), a, a + 1e-9 * rng.normal(size=900)], 1)
    factor = factor_of_rows(rows, np.ones(900, bool))
    extended = np.concatenate([np.ones((900, 1)), rows], axis=1)
    expected = np.linalg.svd(extended, compute_uv=False)
    np.testing.assert_allclose(np.linalg.svd(factor, compute_uv=False), expected, rtol=1e-5)


def test_no_rows_are_a_factor_of_zero():
    np.testing.assert_array_equal(
        factor_of_rows(np.ones((4, 2)), np.zeros(4, bool)), np.zeros((3, 3))
    )


def test_activity_is_powers_and_products_of_what_is_there():
    columns = columns_of((0, 1, 2), seed=1)
    there = np.ones(COUNT, bool)
    there[[40, 41, 200]] = False
    found = jax.jit(activity)(columns, jnp.asarray(there))
    zero, one, two = np.asarray(columns.values)
    np.testing.assert_allclose(found.square, np.sum(zero[:, there] ** 2, axis=1))
    np.testing.assert_allclose(found.fourth, np.sum(zero[:, there] ** 4, axis=1))
    slopes = np.gradient(one, STEP, axis=1)
    bends = np.gradient(np.gradient(two, STEP, axis=1), STEP, axis=1)
    inside = [there[max(i - 2, 0) : i + 3].all() for i in range(COUNT)]
    equation = (zero + slopes + bends)[:, inside]
    np.testing.assert_allclose(found.gram, equation @ equation.T)
    assert float(found.samples) == COUNT - 6 - 5


def test_activity_of_two_stretches_adds_up():
    columns = Columns(columns_of((0,)).values[:1], None, jnp.asarray(STEP), ("a",))
    there = jnp.arange(COUNT) % 7 != 2
    first, second = (
        activity(columns.stretch(a, n), there[a : a + n]) for a, n in ((0, 150), (150, 250))
    )
    for one, other in zip(
        jax.tree.leaves(first + second), jax.tree.leaves(activity(columns, there))
    ):
        np.testing.assert_allclose(one, other, rtol=1e-13)


@pytest.mark.parametrize(
    ("criterion", "held", "half"),
    [(HATS, 4000, 10), (HATS, 12, 5), (RIEC(AllWindows(1e-3, 4e-3)), 99, 1), (DOLS(), 99, 0)],
)
def test_hats_are_as_long_as_a_typical_window(criterion, held, half):
    assert int(hat_half(criterion, held, np.asarray(STEP))) == half
    assert int(jax.jit(lambda n: hat_half(criterion, n, jnp.asarray(STEP)))(held)) == half


def record_of_bursts(seed, offset=0.0):
    """A force on a known mass and on something that acts at one sample in 20."""
    rng = np.random.default_rng(seed)
    t = STEP * np.arange(2000)
    x, v, a = (np.sin(t + n * np.pi / 2) for n in range(3))
    acts = 0.1 * (rng.uniform(size=2000) < 0.05)
    force = 2.0 * a + acts + offset + 4.0 * x
    return Record.from_samples({"x": x, "v": v, "a": a, "s": acts, "F": force}, time_step=STEP)


BURSTS = Equation(
    Term("m", "x", derivative=2, measured=("v", "a"), known=2.0),
    Term("f", "s"),
    Term("k", "x"),
    Term("offset", lambda signals: jnp.ones_like(signals["x"])),
    Term(-1.0, "F"),
)


@pytest.mark.slow
@pytest.mark.parametrize("criterion", [HATS, DOLS()])
def test_sizes_in_bursts_are_those_of_the_samples_where_a_term_acts(criterion):
    records = [record_of_bursts(0, 1.0), record_of_bursts(1, 7.0)]
    procedure = as_procedure(BURSTS)
    seen = summarise(procedure, records, criterion).recordings
    sharing = Sharing(BURSTS.parameters, ("offset",), 2)
    values = {"m": 2.0, "offset[1]": 1.0, "offset[2]": 7.0, "f": 1.0, "k": 4.0}
    values = {name: jnp.asarray(value) for name, value in values.items()}
    sizes = sizes_in_bursts(0, sharing, seen, values, ("f", "k"), ("f", "k"))
    # What is known of the force is all but f s + k x; where f acts its column is 0.1.
    target = max(np.mean((4.0 * r["x"] + r["s"]) ** 2) for r in records)
    x = np.concatenate([r["x"] for r in records])
    expected = np.sqrt(np.sum(x**4) / 3 / np.sum(x**2) / target)
    assert sizes["f"] == pytest.approx(0.1 / np.sqrt(3 * target), rel=1e-3)
    assert sizes["k"] == pytest.approx(expected, rel=1e-3)
    # A term under a derivative is left out, recorded or not.
    named = sizes_in_bursts(0, sharing, seen, values, ("m", "f"), ("m", "f"))
    assert named["m"] == 0
    assert named["f"] > 0


def test_excitation_follows_from_normal_equations():
    rng = np.random.default_rng(0)
    y, a, b, c = rng.normal(size=(4, 500))
    b = b + 2 * a
    rows = np.stack([y, a, b, c], axis=1)
    total = NormalEquations(
        jnp.asarray(rows.T @ rows), jnp.asarray(500.0), ("known", "first", "second")
    )
    noise = jnp.diag(jnp.asarray([9.0, 9.0, 0.04, 0.25]))
    found = excitation_of(total, noise, ("second", "first"), "law")
    size = np.sqrt([np.mean(c**2), np.mean(b**2)])
    np.testing.assert_allclose(found.size, size, rtol=1e-12)
    np.testing.assert_allclose(found.noise_share, [0.5, 0.2] / size, rtol=1e-12)
    sine = np.sqrt(1 - (b @ c) ** 2 / (b @ b) / (c @ c))
    np.testing.assert_allclose(found.own_share, sine, rtol=1e-10)


def test_the_noise_of_a_long_signal_is_looked_for_in_stretches_of_all_of_it():
    rng = np.random.default_rng(0)
    smooth = np.sin(0.01 * np.arange(200_000))
    noise = 0.1 * rng.normal(size=200_000)
    assert float(noise_level(smooth + noise)) == pytest.approx(0.1, rel=0.05)
    # In its last quarter alone, and in less than half of it, noise is none of the whole.
    late = np.where(np.arange(200_000) < 150_000, 0.0, noise)
    assert float(noise_level(smooth + late)) < 1e-6
    # Most of it noisy, but for its first 40 %.
    most = np.where(np.arange(200_000) < 80_000, 0.0, noise)
    assert float(noise_level(smooth + most)) > 0.01
    short = (smooth + noise)[: 2**14]
    mean_square = np.mean(np.diff(short, n=6) ** 2) / 924
    assert float(noise_level(short)) == pytest.approx(np.sqrt(mean_square), rel=1e-3)


def test_an_equation_that_holds_for_samples_holds_for_means_of_them():
    """Under hats of as many seconds, thinned columns of a smooth motion give the same rows."""
    t = STEP * np.arange(4000)
    values = np.zeros((3, 2, 4000))
    values[0, 0], values[1, 1] = np.cos(1.3 * t), np.sin(1.3 * t) / 1.3
    present = np.ones(4000, bool)
    present[1923] = False
    columns = Columns(jnp.asarray(values), jnp.asarray(present), jnp.asarray(STEP), ("a",))
    centres = np.arange(0, 4000, 160)
    _, kept = averaged_rows(columns, 64, jnp.asarray(centres), 4000)
    fewer = thinned(columns, 16)
    means, there = averaged_rows(fewer, 4, jnp.asarray(centres // 16), 4000 // 16)
    both = np.asarray(kept & there)
    assert both.sum() > 20
    # A derivative's integral is its primitive's difference, of means too: the two columns agree.
    one, other = np.asarray(means)[both].T
    np.testing.assert_allclose(one, other, rtol=1e-2, atol=1e-3)
    # Means lie half of their length after the sample that they begin at.
    later, _ = averaged_rows(columns, 64, jnp.asarray(centres // 16 * 16 + 8), 4000)
    np.testing.assert_allclose(np.asarray(means)[both], np.asarray(later)[both], atol=2e-2)
    # The gap takes the mean it lies in with it.
    assert not there[1920 // 160]
