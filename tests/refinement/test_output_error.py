"""Output-error refinement: against SciPy, over windows of any length, and what it says of it."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
import pytest
import scipy.integrate
from jaxtyping import Array
from tests.machines import DRAG, drag_fleet
from tests.machines import DRAG_BOUND as BOUND
from tests.machines import DRAG_START as START
from tests.machines import DRAG_TRUTH as TRUTH
from tests.machines import drag_force as force
from tests.machines import drag_oscillator as oscillator
from tests.machines import drag_record as record
from tests.machines import drag_signals as signals

from nightly import nightly
from riecjax.equations.equation import Equation
from riecjax.equations.model import equation_system, simultaneous
from riecjax.equations.term import Term
from riecjax.errors import DataError, ModelError
from riecjax.estimation.constraints import Prior
from riecjax.estimation.identify import identify
from riecjax.records.noise_judgement import judged
from riecjax.records.preparation.filtering import differentiate
from riecjax.records.record import Record, shared_length, stack_records
from riecjax.refinement.optimum import RefinementStatus
from riecjax.refinement.output_error import (
    THRESHOLD,
    OutputError,
    Tiles,
    WholeRecord,
    _computed,
)
from riecjax.refinement.refine import refine
from riecjax.simulation.method import FixedStep
from riecjax.simulation.simulate import simulate
from riecjax.simulation.system import AbstractSystem
from riecjax.uncertainty.intervals import Sandwich

COUNT, RATE = DRAG.shape


@pytest.fixture(scope="module")
def noisy():
    return record(seed=0)


@pytest.fixture(scope="module")
def whole(noisy):
    return refine(oscillator(), noisy, START)


def costs_by_scipy(measured, sizes, points, threshold=np.inf):
    """Twice Huber's loss at several points by SciPy, integrated side by side.

    **Arguments:** `sizes` that errors are divided by; `threshold` beyond which they count once.
    """
    m, r, r2, k, x, v = np.transpose(points)

    def derivative(t, s):
        x, v = np.split(s, 2)
        return np.concatenate([v, (force(t) - r * v - r2 * v * abs(v) - k * x) / m])

    t = np.arange(COUNT) / RATE
    run = scipy.integrate.solve_ivp(
        derivative, (0, t[-1]), np.concatenate([x, v]), "DOP853", t, rtol=1e-10, atol=1e-12
    )
    total = np.zeros(len(points))
    for states, name in zip(np.split(run.y, 2), ("x", "dx")):
        off = np.abs(states.T - measured[name][:, None]) / sizes[name]
        near = np.minimum(off, threshold)
        total += np.sum(near * (2 * off - near), axis=0)
    return total


def vertices(refined, measured, sizes, threshold=np.inf):
    """Where SciPy's cost is least along each parameter, in steps of about a standard error."""
    p = np.concatenate([refined.theta, refined.search.initial_states[0]])
    steps = np.diag(np.concatenate([refined.standard_errors, [3e-3, 1e-2]]))
    points = [p, *(p - steps), *(p + steps)]
    centre, *around = costs_by_scipy(measured, sizes, points, threshold)
    below, above = np.split(np.array(around), 2)
    return centre, (below - above) / (2 * (below + above - 2 * centre))


def test_the_optimum_is_scipys(whole):
    measured = signals(0)
    centre, least = vertices(whole, measured, {n: measured[n].std() for n in ("x", "dx")})
    assert centre == pytest.approx(float(whole.search.cost), rel=1e-5)
    assert np.all(np.abs(least) < 0.01)


@pytest.mark.slow
@pytest.mark.parametrize("by", [OutputError(), *nightly([OutputError(Tiles(seconds=5.0))])])
def test_a_solver_of_optimistix_reaches_the_same_optimum(noisy, by):
    """Of windows, initial states are among its unknowns."""
    found = refine(oscillator(), noisy, START, by)
    other = refine(oscillator(), noisy, START, by, solver=optimistix.Dogleg(1e-8, 1e-8))
    assert found.search.converged
    assert other.search.converged
    away = np.abs(other.theta - found.theta) / np.asarray(found.standard_errors)
    assert away.max() < 1e-3
    np.testing.assert_allclose(other.standard_errors, found.standard_errors, rtol=1e-3)


def test_the_optimum_of_hubers_loss_is_scipys_and_spikes_hardly_move_it():
    """Spikes of 20 standard deviations of the noise on a hundredth of the samples."""
    measured, rng = signals(0), np.random.default_rng(0)
    sigma = {name: 0.05 * signals()[name].std() for name in ("x", "dx")}
    for name, noise in sigma.items():
        where = rng.choice(COUNT, COUNT // 100, replace=False)
        measured[name][where] += 20 * noise * rng.choice([-1, 1], where.size)
    held = Record.from_samples(measured, time_step=1 / RATE)
    by = {"sigma": sigma, "method": FixedStep(1)}
    found = refine(oscillator(), held, START, OutputError(loss="huber", **by))
    plain = refine(oscillator(), held, START, OutputError(**by))
    known = judged(held).noise
    _, least = vertices(found, measured, {n: float(known.std(n)) for n in sigma}, THRESHOLD)
    # The loss is no parabola over two standard errors.
    assert np.all(np.abs(least) < 0.05)
    assert dict(found.search.by)["loss"] == "huber"
    off = np.asarray(found.theta) - np.array(list(TRUTH.values()))
    assert np.max(np.abs(off) / found.standard_errors) < 3.5
    assert np.all(np.asarray(found.standard_errors) < 0.8 * np.asarray(plain.standard_errors))


def assert_holds_the_truth(refined):
    for name, true in TRUTH.items():
        low, high = refined.interval(name, 0.999)
        assert low < true < high


def test_it_says_what_it_did(whole):
    assert bool(whole.search.converged)
    assert 3 < int(whole.search.steps) < 15
    assert whole.findings() == []
    # The motion is slow beside a sample: more would cost and change nothing.
    assert whole.search.steps_label == "FixedStep(1)"
    x, v = (DRAG.signals()[name] for name in ("x", "dx"))
    np.testing.assert_allclose(
        np.asarray(whole.search.rms), [0.05 * x.std(), 0.05 * v.std()], rtol=0.03
    )
    assert np.all(np.asarray(whole.search.rms_before) > 5 * np.asarray(whole.search.rms))
    assert "m" in str(whole)
    assert "converged" in str(whole)
    assert_holds_the_truth(whole)


@pytest.mark.parametrize(
    "shooting",
    [
        Tiles(seconds=0.5),
        *nightly([Tiles(samples=1), Tiles(seconds=5.0)]),
    ],
    ids=["half a second", "one step", "five seconds"],
)
@pytest.mark.parametrize("initial", ["measured", *nightly(["estimated"])])
def test_every_length_of_window_finds_the_truth_without_noise(shooting, initial):
    if initial == "estimated" and shooting == Tiles(samples=1):
        pytest.skip("two samples do not determine a start and parameters")
    by = OutputError(shooting, initial_states=initial)
    refined = refine(oscillator(), record(), START, by)
    assert bool(refined.search.converged)
    for name, true in TRUTH.items():
        assert float(refined[name]) == pytest.approx(true, rel=1e-5)


def test_what_was_made_of_a_compared_signal_is_not_compared():
    """A velocity differentiated from the position has its noise, which hangs together in time."""
    formed = differentiate(judged(record(seed=0).select("x", "u")), "x", "dx")
    # From every second sample, where a sensor's noise is a source for each phase.
    assert _computed(formed, ("x", "dx")) == {"dx"}
    assert _computed(formed.every(2), ("x", "dx")) == {"dx"}
    # A sensor of its own, or a position that is not compared, is another matter.
    assert _computed(judged(record(seed=0)), ("x", "dx")) == set()
    assert _computed(formed, ("dx",)) == set()


def test_a_state_that_is_not_recorded_is_estimated():
    held = {name: values for name, values in signals(1).items() if name != "dx"}
    refined = refine(oscillator(), Record.from_samples(held, time_step=1 / RATE), START)
    assert refined.search.quantities == ("x",)
    assert refined.search.initial_state_names == ("x", "dx")
    assert_holds_the_truth(refined)


@pytest.fixture(scope="module")
def two_masses():
    """The oscillator and a heavier one, recorded for unequal lengths."""
    (light,), (heavy,) = (drag_fleet(1, n, n, m=mass) for n, mass in ((2000, 1.5), (1600, 2.5)))
    return [light, heavy]


@pytest.mark.slow
def test_bounds_of_a_records_own_parameter_hold_in_each_or_in_one(two_masses):
    def fit(bounds):
        return refine(oscillator(), two_masses, START, per_record=("m",), bounds=bounds)

    free = refine(oscillator(), two_masses, START, per_record=("m",))
    assert refine(oscillator(), two_masses, free, max_steps=1).parameters == free.parameters
    wide = fit({"m": (0.0, 9.0)})
    np.testing.assert_array_equal(wide.theta, free.theta)
    both = fit({"m": (0.5, 1.4)})
    assert float(both["m[2]"]) == 1.4
    one_by_one = fit({"m[1]": (0.5, 1.4), "m[2]": (0.5, 1.4)})
    np.testing.assert_array_equal(both.theta, one_by_one.theta)
    # What is said of one recording goes before what is said of all, in either order.
    for bounds in ({"m": (0.0, 9.0), "m[2]": (0.0, 2.0)}, {"m[2]": (0.0, 2.0), "m": (0.0, 9.0)}):
        one = fit(bounds)
        assert float(one["m[2]"]) == 2.0
        named = fit({"m[1]": (0.0, 9.0), "m[2]": (0.0, 2.0)})
        np.testing.assert_array_equal(one.theta, named.theta)


def test_missing_samples_of_outputs_do_not_count_and_those_of_inputs_cut():
    held = signals(2)
    held["x"][300:500] = np.nan
    held["u"][1000:1003] = np.nan
    refined = refine(oscillator(), Record.from_samples(held, time_step=1 / RATE), START)
    assert refined.search.initial_states.shape == (2, 2)
    assert_holds_the_truth(refined)


@pytest.mark.raises_finding("at_bound")
def test_a_bound_is_kept_and_said(noisy, whole):
    refined = refine(oscillator(), noisy, START, bounds={"k": (5.0, 15.0), "m": (0.0, None)})
    assert float(refined["k"]) == 15.0
    assert refined.findings()[0].code == "at_bound"
    held = refine(oscillator(), noisy, START, known={"k": 15.0})
    np.testing.assert_allclose(refined.theta[:3], held.theta, rtol=1e-4)
    np.testing.assert_allclose(refined.standard_errors[:3], held.standard_errors, rtol=1e-3)
    again = refine(oscillator(), noisy, refined, bounds={"k": (5.0, 15.0)})
    np.testing.assert_allclose(again.theta, refined.theta, rtol=1e-4)
    free = refine(oscillator(), noisy, START, bounds={"k": (5.0, 30.0), "m": (0.0, None)})
    np.testing.assert_array_equal(free.theta, whole.theta)
    np.testing.assert_array_equal(free.covariance, whole.covariance)


@pytest.mark.parametrize(("name", "below", "std"), [("r", 0.03, 0.01), ("r2", 0.005, 0.0015)])
def test_a_prior_pulls_as_one_more_observation(noisy, whole, name, below, std):
    """In a problem this nearly linear, the posterior is that of two normal laws, also where the
    prior tells ten times as much as the data."""
    prior = Prior(float(whole[name]) - below, std)
    refined = refine(oscillator(), noisy, START, priors={name: prior})
    place = whole.parameters.index(name)
    # White noise: the inverse covariance is the information.
    information = np.linalg.inv(np.asarray(whole.covariance))
    information[place, place] += 1 / prior.std**2
    posterior = np.linalg.inv(information)
    pull = np.zeros(4)
    pull[place] = (prior.mean - float(whole[name])) / prior.std**2
    expected = np.asarray(whole.theta) + posterior @ pull
    error = np.sqrt(np.diag(posterior))
    assert abs(float(refined[name]) - float(whole[name])) > 0.6 * below
    assert np.all(np.abs(np.asarray(refined.theta) - expected) < 0.1 * error)
    np.testing.assert_allclose(refined.standard_errors[place], error[place], rtol=0.1)


@pytest.mark.raises_finding("refinement_not_converged")
def test_a_start_without_a_finite_residual_is_a_status(noisy):
    """A mass of zero has no acceleration."""
    refined = refine(oscillator(), noisy, START | {"m": 0.0})
    assert refined.search.status == RefinementStatus.not_finite
    assert refined.findings()[0].code == "refinement_not_converged"


EACH = {"per_record": ("m",), "records": [record(seed=0, count=500)] * 2}


@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        ({"start": {"mass": 1.0}}, ModelError, "unknown parameter 'mass'"),
        ({"bounds": {"k": (15.0, 30.0)}}, ModelError, "k starts at 10, which is not between"),
        ({"bounds": {"k": (3.0, 2.0)}}, ModelError, "wrong order"),
        ({"bounds": {"c": (3.0, 4.0)}}, ModelError, "bounds are given for 'c'"),
        ({"priors": {"k": (20.0, 0.0)}}, ModelError, "positive standard deviation"),
        ({"priors": {"k": (np.nan, 1.0)}}, ModelError, "prior of k is .*a finite mean"),
        ({"priors": {"k": 5}}, ModelError, r"prior of k is 5. Write \(mean, standard deviation\)"),
        ({"bounds": {"k": 5}}, ModelError, r"bounds of k are 5. Write \(lower, upper\), None wh"),
        ({"bounds": {"k": (1, 2, 3)}}, ModelError, r"Write \(lower, upper\), None where"),
        ({"by": OutputError(sigma={"z": 1.0})}, ModelError, "sigma is given for 'z', which is not"),
        ({"by": OutputError(sigma={"x": 0.0})}, ModelError, "sigma of x is 0.0: a standard devi"),
        ({"start": {"k": 10.0}, "known": {"m": np.nan}}, ModelError, "m is held at nan"),
        ({"known": START}, ModelError, "nothing is left to refine"),
        ({"by": OutputError(channels=("z",))}, ModelError, "no signal 'z' to compare"),
        ({"by": OutputError(initial_states={"z": 0.0})}, ModelError, "unknown state 'z'"),
        ({"records": []}, DataError, "at least one record"),
        (EACH | {"priors": {"m": (1.0, 0.0)}}, ModelError, r"prior of m\[1\] needs a positive"),
        (EACH | {"bounds": {"m": (3.0, 4.0)}}, ModelError, r"m\[1\] starts at 1, which is not"),
        (EACH | {"bounds": {"m[3]": (0.0, 4.0)}}, ModelError, r"bounds are given for 'm\[3\]'"),
    ],
)
def test_what_cannot_be_done_is_said(noisy, arguments, error, words):
    settings = {"records": noisy, "start": START, **arguments}
    with pytest.raises(error, match=words):
        refine(oscillator(), **settings)


WHOLE = OutputError(method=FixedStep(1))
SEEDS = 100


@eqx.filter_jit
def refine_all(records, by, intervals):
    def one(arrays):
        found = refine(oscillator(), Record(arrays, 1 / RATE), START, by, intervals=intervals)
        return found.theta, found.standard_errors, found.search.converged

    return jax.vmap(one)(records.arrays)


@pytest.mark.slow
def test_errors_reach_the_cramer_rao_bound_and_are_told():
    records = stack_records([record(seed) for seed in range(SEEDS)])
    theta, errors, converged = refine_all(records, WHOLE, Sandwich())
    truth, bound = (np.array(list(values.values())) for values in (TRUTH, BOUND))
    assert np.all(converged)
    rms = np.sqrt(np.mean((np.asarray(theta) / truth - 1) ** 2, axis=0))
    # A root mean square of a hundred draws is known to 7 %.
    assert np.all(rms < 1.1 * bound)
    assert np.all(rms > 0.8 * bound)
    np.testing.assert_allclose(np.mean(np.asarray(errors) / truth, axis=0), bound, rtol=0.1)


class Decay(AbstractSystem):
    """x' = -a b x: only the product is determined."""

    a: Array
    b: Array

    states = (("x", "m"),)

    def derivative(self, state, inputs):
        return -(self.a * self.b) * state


def test_a_state_that_nothing_records_is_refined_as_its_refusal_says():
    """A spring's force z of which an equation of its own tells, z' = k v."""
    motion = Equation(Term("m", "v", derivative=1), Term("c", "v"), Term(1.0, "z"), Term(-1.0, "F"))
    model = simultaneous(motion, Equation(Term(-1.0, "z", derivative=1), Term("k", "v")))
    truth = {"m": 2.0, "c": 3.0, "k": 50.0}
    force = Record.from_samples({"F": np.random.default_rng(0).normal(size=500)}, time_step=0.02)
    made = simulate(equation_system(model, truth), force).record
    held = force.with_signals({"v": made["v"]})
    with pytest.raises(DataError, match=r"no signal 'z'.* rx.refine\(model, record, start\)"):
        identify(model, held)
    by = OutputError(intersample="lines", method=FixedStep(2))
    refined = refine(model, held, {name: 0.8 * value for name, value in truth.items()}, by)
    np.testing.assert_allclose([refined[name] for name in truth], [*truth.values()], rtol=1e-4)


@pytest.fixture(scope="module")
def decaying():
    t = np.arange(400) / 100
    noise = 0.01 * np.random.default_rng(0).normal(size=400)
    held = Record.from_samples({"x": np.exp(-0.7 * t) + noise}, time_step=0.01)
    return Decay(jnp.asarray(1.0), jnp.asarray(1.0)), held


@pytest.mark.raises_finding("undetermined")
def test_parameters_that_make_up_for_each_other_are_called_undetermined(decaying):
    model, held = decaying
    both = refine(model, held, {"a": 0.5, "b": 1.1})
    assert float(both["a"] * both["b"]) == pytest.approx(0.7, rel=0.05)
    (found,) = both.findings()
    assert found.code == "undetermined"
    assert "when a, b change together" in found.message
    assert np.all(np.isnan(both.standard_errors))


def test_a_shared_length_is_a_quarter_longer_at_most():
    every = np.arange(2, 5000)
    shared = np.array([shared_length(int(n)) for n in every])
    assert np.all(shared >= every)
    assert np.all(shared <= 1.25 * every + 1)
    assert np.all(np.diff(shared) >= 0)
    assert len(set(shared[every > 1024])) <= 10


@pytest.mark.parametrize(
    "shooting", [WholeRecord(), *nightly([Tiles(samples=150)])], ids=["whole", "tiles"]
)
def test_what_a_record_is_filled_up_with_tells_nothing(shooting: WholeRecord):
    """Traced, a record is not filled up."""
    given = record(seed=1, count=930)
    by = OutputError(shooting, method=FixedStep(4))

    def fit(arrays: dict[str, Array]) -> tuple[Array, Array, Array]:
        found = refine(oscillator(), Record(arrays, given.time_step), START, by)
        return found.theta, found.standard_errors, found.search.rms

    for one, two in zip(fit(given.arrays), jax.jit(fit)(given.arrays)):
        np.testing.assert_allclose(one, two, rtol=1e-6)


class Hidden(AbstractSystem):
    """x' = c x^2, of which only y = x + 1 is recorded."""

    c: Array
    states: ClassVar = (("x", ""),)
    outputs: ClassVar = (("y", ""),)

    def derivative(self, state: Array, inputs: Array) -> Array:
        return self.c * state**2

    def output(self, state: Array, inputs: Array) -> dict[str, Array]:
        return {"y": state[0] + 1}


@pytest.mark.parametrize("count", [896, 897])
def test_steps_are_chosen_by_the_motion_within_the_record(count: int):
    """From 897 samples on it is filled up to 1024, past where the motion escapes."""
    t = np.arange(count) / 1000
    seen = Record.from_samples({"y": 1 + 1 / (1 - 0.98 * t)}, time_step=1e-3)
    found = refine(
        Hidden(jnp.asarray(0.95)), seen, {"c": 0.95}, OutputError(initial_states={"x": 1.0})
    )
    assert float(found["c"]) == pytest.approx(0.98, rel=1e-4)
    assert found.search.steps_label == "FixedStep(1)"
