"""Output-error refinement: against SciPy, over windows of any length, and what it says of it."""

import jax
import numpy as np
import optimistix as optx
import pytest
import scipy.integrate
from tests.machines import DRAG
from tests.machines import DRAG_START as START
from tests.machines import DRAG_TRUTH as TRUTH
from tests.machines import drag_force as force
from tests.machines import drag_oscillator as oscillator
from tests.machines import drag_record as record
from tests.machines import drag_signals as signals

from nightly import nightly
from riecjax.criteria.windows import RandomWindows
from riecjax.errors import DataError, MissingSignalError, ModelError
from riecjax.estimation.identify import identify
from riecjax.models.oscillators import drag_oscillator_equation
from riecjax.records.noise_judgement import judged
from riecjax.records.preparation import differentiate
from riecjax.records.record import Record, stack_records
from riecjax.refinement.coordinates import Prior
from riecjax.refinement.optimum import RefinementStatus
from riecjax.refinement.output_error import OutputError, _computed
from riecjax.refinement.refine import refine
from riecjax.refinement.shots import RandomShots, Tiles
from riecjax.simulation.method import FixedStep

COUNT, RATE = DRAG.shape


def values(refined):
    return {name: float(refined[name]) for name in refined.parameters}


@pytest.fixture(scope="module")
def noisy():
    return record(seed=0)


@pytest.fixture(scope="module")
def whole(noisy):
    return refine(oscillator(), noisy, START)


def costs_by_scipy(seed, points):
    """The same sum of squares by SciPy at several points, integrated side by side."""
    measured = signals(seed)
    m, r, r2, k, x, v = np.transpose(points)

    def derivative(t, s):
        x, v = np.split(s, 2)
        return np.concatenate([v, (force(t) - r * v - r2 * v * abs(v) - k * x) / m])

    t = np.arange(COUNT) / RATE
    run = scipy.integrate.solve_ivp(
        derivative, (0, t[-1]), np.concatenate([x, v]), "DOP853", t, rtol=1e-10, atol=1e-12
    )
    x, v = np.split(run.y, 2)
    errors = [(s.T - measured[n][:, None]) / measured[n].std() for n, s in (("x", x), ("dx", v))]
    return np.sum(np.square(errors), axis=(0, 1))


def test_the_optimum_is_scipys(whole):
    """Along each parameter, SciPy's own cost is least where the refinement ended."""
    p = np.concatenate([whole.theta, whole.initial_states[0]])
    steps = np.diag(np.concatenate([whole.standard_errors, [3e-3, 1e-2]]))
    centre, *around = costs_by_scipy(0, [p, *(p - steps), *(p + steps)])
    assert centre == pytest.approx(float(whole.cost), rel=1e-5)
    below, above = np.split(np.array(around), 2)
    vertices = (below - above) / (2 * (below + above - 2 * centre))
    assert np.all(np.abs(vertices) < 0.01)


def test_it_says_what_it_did(whole):
    assert bool(whole.converged)
    assert 3 < int(whole.steps) < 15
    assert whole.findings() == []
    # The motion is slow beside a sample: more would cost and change nothing.
    assert whole.steps_label == "FixedStep(1)"
    x, v = (DRAG.signals()[name] for name in ("x", "dx"))
    np.testing.assert_allclose(np.asarray(whole.rms), [0.05 * x.std(), 0.05 * v.std()], rtol=0.03)
    assert np.all(np.asarray(whole.rms_before) > 5 * np.asarray(whole.rms))
    assert "m" in str(whole)
    assert "converged" in str(whole)
    for name, true in TRUTH.items():
        low, high = whole.interval(name, 0.999)
        assert low < true < high


@pytest.mark.parametrize(
    "shooting",
    [
        Tiles(seconds=0.5),
        *nightly([Tiles(samples=1), Tiles(seconds=5.0), RandomShots(RandomWindows(0.05, 2.0, 60))]),
    ],
    ids=["half a second", "one step", "five seconds", "random"],
)
@pytest.mark.parametrize("initial", ["measured", *nightly(["estimated"])])
def test_every_length_of_window_finds_the_truth_without_noise(shooting, initial):
    if initial == "estimated" and shooting == Tiles(samples=1):
        pytest.skip("two samples do not determine a start and parameters")
    by = OutputError(shooting, initial_states=initial)
    refined = refine(oscillator(), record(), START, by, key=jax.random.key(0))
    assert bool(refined.converged)
    for name, true in TRUTH.items():
        assert float(refined[name]) == pytest.approx(true, rel=1e-5)


@pytest.mark.slow
def test_straight_lines_between_samples_are_another_answer_of_clean_data():
    """What they leave of each tone's force, pi^2 / (3 n^2), is 0.018 % of a mass at most here."""
    lines = refine(oscillator(), record(), START, OutputError(intersample="lines"))
    assert 1e-4 < 1 - float(lines["m"]) / TRUTH["m"] < 2e-4
    with pytest.raises(ModelError, match="'lines' or 'smooth'; got 'zoh'"):
        OutputError(intersample="zoh")  # pyright: ignore[reportArgumentType]


@pytest.mark.slow
def test_an_input_with_a_gap_is_smooth_on_either_side():
    held = signals()
    held["u"][1000:1003] = np.nan
    refined = refine(oscillator(), Record.from_samples(held, time_step=1 / RATE), START)
    assert refined.initial_states.shape == (2, 2)
    for name, true in TRUTH.items():
        assert float(refined[name]) == pytest.approx(true, rel=2e-5)


@pytest.mark.slow
def test_a_batch_of_smooth_inputs_is_its_members():
    records = [record(seed) for seed in (0, 1)]
    by = OutputError(method=FixedStep(1))

    def fit(arrays):
        return refine(oscillator(), Record(arrays, 1 / RATE), START, by).theta

    batch = jax.jit(jax.vmap(fit))(stack_records(records).arrays)
    alone = [refine(oscillator(), one, START, by).theta for one in records]
    np.testing.assert_allclose(batch, alone, rtol=1e-8)


def test_what_was_made_of_a_compared_signal_is_not_compared():
    """A velocity differentiated from the position has its noise, which hangs together in time."""
    formed = differentiate(judged(record(seed=0).select("x", "u")), "x", "dx")
    # From every second sample, where a sensor's noise is a source for each phase.
    assert _computed(formed, ("x", "dx")) == {"dx"}
    assert _computed(formed.every(2), ("x", "dx")) == {"dx"}
    # A sensor of its own, or a position that is not compared, is another matter.
    assert _computed(judged(record(seed=0)), ("x", "dx")) == set()
    assert _computed(formed, ("dx",)) == set()


@pytest.mark.slow
def test_what_was_made_of_a_compared_signal_is_compared_if_asked_for():
    formed = differentiate(judged(record(seed=0).select("x", "u")), "x", "dx")
    assert refine(oscillator(), formed, START).quantities == ("x",)
    asked = refine(oscillator(), formed, START, OutputError(channels=("x", "dx")))
    assert asked.quantities == ("x", "dx")


@pytest.mark.slow
def test_tiles_as_long_as_the_record_are_the_whole_record(noisy, whole):
    one = refine(oscillator(), noisy, START, OutputError(Tiles(samples=COUNT - 1)))
    np.testing.assert_allclose(one.theta, whole.theta, rtol=1e-9)
    np.testing.assert_allclose(one.covariance, whole.covariance, rtol=1e-6)


@pytest.mark.slow
def test_windows_with_starts_of_their_own_cost_little_precision(noisy, whole):
    tiled = refine(oscillator(), noisy, START, OutputError(Tiles(seconds=5.0)))
    assert tiled.initial_states.shape == (4, 2)
    ratio = np.asarray(tiled.standard_errors / whole.standard_errors)
    assert np.all((ratio > 0.9) & (ratio < 2))
    moved = np.asarray(tiled.theta - whole.theta) / np.asarray(tiled.standard_errors)
    assert np.all(np.abs(moved) < 2)


def test_a_state_that_is_not_recorded_is_estimated():
    held = {name: values for name, values in signals(1).items() if name != "dx"}
    refined = refine(oscillator(), Record.from_samples(held, time_step=1 / RATE), START)
    assert refined.quantities == ("x",)
    assert refined.initial_state_names == ("x", "dx")
    for name, true in TRUTH.items():
        low, high = refined.interval(name, 0.999)
        assert low < true < high


def test_before_and_after_are_on_one_basis(noisy, whole):
    """From the answer as its start, there is nothing that could differ but the initial states."""
    again = refine(oscillator(), noisy, whole.values)
    assert float(again.cost_before) == pytest.approx(float(whole.cost), rel=1e-6)
    np.testing.assert_allclose(again.rms_before, whole.rms, rtol=1e-4)
    assert "initial states estimated for each, FixedStep(1)" in str(again)


@pytest.mark.slow
def test_an_equation_is_refined_from_its_integral_estimate(noisy, whole):
    equation = drag_oscillator_equation()
    estimate = identify(equation, noisy)
    refined = refine(equation, noisy, estimate)
    np.testing.assert_allclose(np.asarray(refined.theta), np.asarray(whole.theta), rtol=1e-6)
    assert dict(refined.units)["r2"] == "N s^2/m^2"


def test_known_values_stay_and_others_follow(noisy):
    refined = refine(oscillator(), noisy, START, known={"k": 20.0})
    assert refined.parameters == ("m", "r", "r2")
    assert float(refined["k"]) == 20.0
    assert float(refined["m"]) == pytest.approx(1.5, rel=0.01)


HEAVIER = 2.5


@pytest.fixture(scope="module")
def two_masses():
    """The oscillator and a heavier one, recorded for unequal lengths."""

    def run(mass, seed):
        _, r, r2, k = TRUTH.values()
        t = np.arange(1001) / RATE
        found = scipy.integrate.solve_ivp(
            lambda t, s: [s[1], (force(t) - r * s[1] - r2 * s[1] * abs(s[1]) - k * s[0]) / mass],
            (0, 10),
            [0.1, 0.0],
            t_eval=t,
            rtol=1e-9,
            atol=1e-11,
        )
        rng = np.random.default_rng(seed)
        noise = 0.01 * found.y.std(axis=1)[:, None] * rng.standard_normal(found.y.shape)
        x, v = found.y + noise
        count = 1001 - 200 * seed
        samples = {"u": force(t)[:count], "x": x[:count], "dx": v[:count]}
        return Record.from_samples(samples, time_step=1 / RATE)

    return [run(1.5, 0), run(HEAVIER, 1)]


@pytest.mark.slow
def test_several_records_with_a_value_of_their_own(two_masses):
    refined = refine(oscillator(), two_masses, START, per_record=("m",))
    assert refined.parameters == ("m[1]", "m[2]", "r", "r2", "k")
    for name, true in {"m[1]": 1.5, "m[2]": HEAVIER, "r": 0.8, "r2": 0.5, "k": 20.0}.items():
        low, high = refined.interval(name, 0.999)
        assert low < true < high
        assert float(refined[name]) == pytest.approx(true, rel=0.05)
    assert refined.initial_states.shape == (2, 2)


@pytest.mark.slow
def test_bounds_of_a_records_own_parameter_hold_in_each_or_in_one(two_masses):
    def fit(bounds):
        return refine(oscillator(), two_masses, START, per_record=("m",), bounds=bounds)

    free = refine(oscillator(), two_masses, START, per_record=("m",))
    wide = fit({"m": (0.0, 9.0)})
    np.testing.assert_allclose(wide.theta, free.theta, rtol=1e-5)
    both = fit({"m": (0.5, 1.4)})
    assert 1.39 < float(both["m[2]"]) <= 1.4
    one_by_one = fit({"m[1]": (0.5, 1.4), "m[2]": (0.5, 1.4)})
    np.testing.assert_array_equal(both.theta, one_by_one.theta)
    # What is said of one recording goes before what is said of all, in either order.
    for bounds in ({"m": (0.0, 9.0), "m[2]": (0.0, 2.0)}, {"m[2]": (0.0, 2.0), "m": (0.0, 9.0)}):
        one = fit(bounds)
        assert 1.99 < float(one["m[2]"]) <= 2.0
        named = fit({"m[1]": (0.0, 9.0), "m[2]": (0.0, 2.0)})
        np.testing.assert_array_equal(one.theta, named.theta)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"priors": {"m": (1.0, 0.0)}}, r"prior of m\[1\] needs a positive"),
        ({"bounds": {"m": (3.0, 4.0)}}, r"m\[1\] starts at 1, which is not between"),
        ({"bounds": {"m[3]": (0.0, 4.0)}}, r"bounds are given for 'm\[3\]'"),
        ({"bounds": {"m": (0.0, 4.0)}, "known": {"m": 1.0}}, "bounds are given for 'm'"),
    ],
)
def test_bounds_and_priors_are_checked_in_each_record(two_masses, settings, words):
    with pytest.raises(ModelError, match=words):
        refine(oscillator(), two_masses, START, per_record=("m",), **settings)


@pytest.mark.slow
def test_a_prior_of_all_leaves_out_the_record_whose_value_is_known(two_masses):
    settings = {"known": {"m[2]": HEAVIER}, "priors": {"m": Prior(1.4, 1e-4)}}
    refined = refine(oscillator(), two_masses, START, per_record=("m",), **settings)
    assert refined.parameters == ("m[1]", "r", "r2", "k")
    assert float(refined["m[1]"]) == pytest.approx(1.4, abs=1e-3)


def test_missing_samples_of_outputs_do_not_count_and_those_of_inputs_cut():
    held = signals(2)
    held["x"][300:500] = np.nan
    held["u"][1000:1003] = np.nan
    refined = refine(oscillator(), Record.from_samples(held, time_step=1 / RATE), START)
    assert refined.initial_states.shape == (2, 2)
    for name, true in TRUTH.items():
        low, high = refined.interval(name, 0.999)
        assert low < true < high


@pytest.mark.raises_finding("at_bound")
def test_a_bound_is_kept_and_said(noisy, whole):
    refined = refine(oscillator(), noisy, START, bounds={"k": (5.0, 15.0), "m": (0.0, None)})
    assert 14.99 < float(refined["k"]) <= 15.0
    assert refined.findings()[0].code == "at_bound"
    held = refine(oscillator(), noisy, START, known={"k": 15.0})
    # The bound is reached to a millionth of its range.
    np.testing.assert_allclose(refined.theta[:3], held.theta, rtol=1e-4)
    np.testing.assert_allclose(refined.standard_errors[:3], held.standard_errors, rtol=1e-3)
    free = refine(oscillator(), noisy, START, bounds={"k": (5.0, 30.0), "m": (0.0, None)})
    np.testing.assert_allclose(free.theta, whole.theta, rtol=1e-6)
    np.testing.assert_allclose(free.covariance, whole.covariance, rtol=1e-4)


def test_a_prior_pulls_as_one_more_observation(noisy, whole):
    """In a problem this nearly linear, the posterior is that of two normal laws."""
    prior = Prior(float(whole["r"]) - 0.03, 0.01)
    refined = refine(oscillator(), noisy, START, priors={"r": prior})
    place = whole.parameters.index("r")
    # White noise: the inverse covariance is the information.
    information = np.linalg.inv(np.asarray(whole.covariance))
    information[place, place] += 1 / prior.std**2
    posterior = np.linalg.inv(information)
    pull = np.zeros(4)
    pull[place] = (prior.mean - float(whole["r"])) / prior.std**2
    expected = np.asarray(whole.theta) + posterior @ pull
    error = np.sqrt(np.diag(posterior))
    assert abs(float(refined["r"]) - float(whole["r"])) > 0.02
    assert np.all(np.abs(np.asarray(refined.theta) - expected) < 0.1 * error)
    np.testing.assert_allclose(refined.standard_errors[place], error[place], rtol=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    "solver",
    [optx.LevenbergMarquardt(1e-8, 1e-8), optx.Dogleg(1e-8, 1e-8), optx.BFGS(1e-8, 1e-8)],
    ids=["levenberg-marquardt", "dogleg", "bfgs"],
)
def test_other_solvers_of_optimistix_find_the_same(noisy, whole, solver):
    start = {name: 1.02 * float(value) for name, value in whole.values.items()}
    refined = refine(oscillator(), noisy, start, solver=solver, max_steps=300)
    np.testing.assert_allclose(refined.theta, whole.theta, rtol=1e-4)


@pytest.mark.raises_finding("refinement_not_converged")
def test_too_few_steps_are_a_status(noisy):
    refined = refine(oscillator(), noisy, START, max_steps=2)
    assert not bool(refined.converged)
    assert refined.status == RefinementStatus.out_of_steps
    assert refined.findings()[0].code == "refinement_not_converged"
    assert "max_steps" in refined.reason


@pytest.mark.slow
def test_progress_is_reported(noisy):
    seen: list[float] = []
    refined = refine(oscillator(), noisy, START, progress=lambda cost: seen.append(float(cost)))
    jax.effects_barrier()
    assert len(seen) == int(refined.steps)
    assert seen == sorted(seen, reverse=True)
    assert seen[-1] == pytest.approx(float(refined.cost))


def test_a_start_without_a_finite_residual_is_a_status(noisy):
    """A mass of zero has no acceleration."""
    refined = refine(oscillator(), noisy, START | {"m": 0.0})
    assert refined.status == RefinementStatus.not_finite
    assert refined.findings()[0].code == "refinement_not_converged"


@pytest.mark.slow
def test_weights_are_the_users(noisy, whole):
    same = OutputError(sigma={"x": signals(0)["x"].std(), "dx": signals(0)["dx"].std()})
    np.testing.assert_allclose(
        refine(oscillator(), noisy, START, same).theta, whole.theta, rtol=1e-7
    )
    only = refine(oscillator(), noisy, START, OutputError(channels=("x",)))
    nearly = refine(oscillator(), noisy, START, OutputError(sigma={"x": 1.0, "dx": 1e6}))
    np.testing.assert_allclose(nearly.theta, only.theta, rtol=1e-5)


def test_starts_that_are_known_are_held(noisy):
    refined = refine(oscillator(), noisy, START, OutputError(initial_states={"x": 0.0, "dx": 0.0}))
    assert refined.initial_states.shape == (1, 0)
    assert float(refined["k"]) == pytest.approx(20.0, rel=0.01)


@pytest.mark.slow
def test_every_second_sample_is_the_record_of_every_second_sample(noisy):
    by = OutputError(every=2, method=FixedStep(1), channels=("x",))
    every = refine(oscillator(), noisy, START, by)
    held = signals(0)
    held["x"][1::2] = np.nan
    missing = Record.from_samples(held, time_step=1 / RATE)
    other = refine(oscillator(), missing, START, OutputError(method=FixedStep(1), channels=("x",)))
    np.testing.assert_allclose(every.theta, other.theta, rtol=1e-3)


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
        ({"priors": {"k": (None, 1.0)}}, ModelError, r"Write \(mean, standard deviation\)"),
        ({"bounds": {"k": 5}}, ModelError, r"bounds of k are 5. Write \(lower, upper\), None wh"),
        ({"bounds": {"k": ("a", 2)}}, ModelError, r"Write \(lower, upper\), None where"),
        ({"bounds": {"k": (1, 2, 3)}}, ModelError, r"Write \(lower, upper\), None where"),
        ({"by": OutputError(sigma={"z": 1.0})}, ModelError, "sigma is given for 'z', which is not"),
        ({"by": OutputError(sigma={"x": 0.0})}, ModelError, "sigma of x is 0.0: a standard devi"),
        ({"by": OutputError(sigma={"x": np.nan})}, ModelError, "sigma of x is nan"),
        ({"start": {"k": 10.0}, "known": {"m": np.nan}}, ModelError, "m is held at nan"),
        ({"known": START}, ModelError, "nothing is left to refine"),
        ({"by": OutputError(channels=("z",))}, ModelError, "no signal 'z' to compare"),
        ({"by": OutputError(RandomShots(RandomWindows(0.1, 1.0, 5)))}, ModelError, "need a key"),
        ({"by": OutputError(initial_states={"z": 0.0})}, ModelError, "unknown state 'z'"),
        ({"records": []}, DataError, "at least one record"),
    ],
)
def test_what_cannot_be_done_is_said(noisy, arguments, error, words):
    settings = {"records": noisy, "start": START, "by": None, **arguments}
    with pytest.raises(error, match=words):
        refine(
            oscillator(),
            settings.pop("records"),
            settings.pop("start"),
            settings.pop("by"),
            **settings,
        )


def test_a_missing_input_is_named():
    held = {name: values for name, values in signals().items() if name != "u"}
    with pytest.raises(MissingSignalError, match="u"):
        refine(oscillator(), Record.from_samples(held, time_step=1 / RATE), START)


def test_a_wrong_kind_of_model_is_refused(noisy):
    with pytest.raises(ModelError, match="cannot be simulated"):
        refine(3.0, noisy, START)


@pytest.mark.parametrize("length", [{}, {"seconds": 1.0, "samples": 3}, {"samples": 0}])
def test_tiles_need_one_positive_length(length):
    with pytest.raises(ModelError, match="tiles need"):
        Tiles(**length)
