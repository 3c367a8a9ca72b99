from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from nightly import nightly
from riecjax.criteria.criterion import DOLS, RIEC
from riecjax.criteria.test_functions import Boxcar
from riecjax.criteria.windows import RandomWindows
from riecjax.equations.equation import Equation
from riecjax.equations.procedure import simultaneous, staged
from riecjax.equations.term import Term
from riecjax.errors import DataError, IdentifiabilityError, ModelError
from riecjax.estimation.identify import identify
from riecjax.models.quarter_car.identification import quarter_car_by_body, quarter_car_by_wheel
from riecjax.models.quarter_car.reconstruction import quarter_car_source, reconstructed
from riecjax.paper.reproduction import identification_record
from riecjax.records.record import Record
from riecjax.uncertainty.intervals import Naive

fit = partial(identify, intervals=Naive())
"""For tests that ask for no intervals."""

KEY = jax.random.key(7)

# An oscillator m x'' + d x' + k x = u along exact sinusoids: no model error whatever.
TRUTH = {"m": 2.0, "d": 0.7, "k": 40.0}
WAVES = ((1.0, 3.0, 0.2), (0.4, 7.1, 1.3), (0.1, 12.7, 2.9))


def oscillator(*terms):
    return Equation(
        Term(1.0, "u"),
        -Term(
            "m", "x", derivative=2, measured=("v", "a"), unit="kg", **(terms[0] if terms else {})
        ),
        -Term("d", "x", derivative=1, measured=("v",), unit="N s/m"),
        -Term("k", "x", unit="N/m"),
        name="oscillator",
    )


def exact_signals(step=0.01, duration=5.0, noise=0.0, seed=0):
    t = np.arange(round(duration / step) + 1) * step
    x = sum(a * np.sin(w * t + p) for a, w, p in WAVES)
    v = sum(a * w * np.cos(w * t + p) for a, w, p in WAVES)
    a = sum(-a * w**2 * np.sin(w * t + p) for a, w, p in WAVES)
    error = noise * np.random.default_rng(seed).normal(size=t.size)
    u = TRUTH["m"] * a + TRUTH["d"] * v + TRUTH["k"] * x + error
    return {"x": x, "v": v, "a": a, "u": u}


def exact_record(step=0.01, duration=5.0, noise=0.0, seed=0):
    return Record.from_samples(exact_signals(step, duration, noise, seed), time_step=step)


def windows(count=400, between_samples=False):
    windows = RandomWindows(0.1, 1.0, count, between_samples=between_samples)
    return RIEC(windows, Boxcar(2))


def assert_relative(found, expected, tolerance):
    found, expected = np.asarray(found), np.asarray(expected)
    assert np.max(np.abs(found - expected) / np.abs(expected)) < tolerance


# The paper's staged procedure in plain NumPy.


def numpy_rows(criterion, signals, step, derivative, columns):
    """Rows of `columns` (samples each); `derivative` names those that stand for x' as (x, x')."""
    if isinstance(criterion, DOLS):
        return np.stack([s[1] if i in derivative else s for i, s in enumerate(columns)], axis=1)
    n = len(signals["x1"])
    drawn = criterion.windows.draw(KEY, n, jnp.asarray(step))
    at = np.arange(n)
    rows = []
    for a, b in zip(np.asarray(drawn.start), np.asarray(drawn.stop)):
        inner = np.arange(np.ceil(a), np.floor(b) + 1)
        nodes = np.unique(np.concatenate([[a], inner, [b]]))
        row = []
        for i, samples in enumerate(columns):
            if i in derivative:
                row.append(np.diff(np.interp([a, b], at, samples[0]))[0])
            else:
                row.append(step * np.trapezoid(np.interp(nodes, at, samples), nodes))
        rows.append(row)
    return np.array(rows)


def numpy_quarter_car(criterion, record, by_wheel):
    s = {name: np.asarray(values) for name, values in record.arrays.items()}
    roofs = [np.interp(s["x3"] - s["x4"], (-0.8, -0.3, 0.3, 0.8), e) for e in np.eye(4)]
    # np.interp stops at its ends, where roof functions continue their end segments.
    v, (a, b) = s["x3"] - s["x4"], (np.array([-0.8, -0.3]), np.array([0.3, 0.8]))
    low, high = v < -0.8, v > 0.8
    roofs[0][low], roofs[1][low] = (a[1] - v[low]) / 0.5, (v[low] - a[0]) / 0.5
    roofs[2][high], roofs[3][high] = (b[1] - v[high]) / 0.5, (v[high] - b[0]) / 0.5
    unsprung, sprung = (s["x3"], s["dx3"]), (s["x4"], s["dx4"])
    columns = [s["F_t"], s["x1"], unsprung, sprung, s["x2"], *roofs]
    rows = numpy_rows(criterion, s, float(record.time_step), {2, 3}, columns)
    force, x1, dx3, dx4 = rows[:, :4].T
    (tyre,) = np.linalg.lstsq(x1[:, None], force)[0]
    wheel, body = np.linalg.lstsq(np.stack([dx3, dx4], 1), force)[0]
    target = force - wheel * dx3 if by_wheel else body * dx4
    return np.array([tyre, wheel, body, *np.linalg.lstsq(rows[:, 4:], target)[0]])


@pytest.fixture(scope="module")
def drive():
    source = quarter_car_source(reconstructed())
    return identification_record(source, jax.random.key(0)).record


QUARTER_CAR_CRITERIA = {
    "on samples": RIEC(RandomWindows(0.05, 0.5, 1000), Boxcar(2)),
    "between samples": RIEC(RandomWindows(0.05, 0.5, 1000, between_samples=True)),
    "DOLS": DOLS(),
}


@pytest.mark.parametrize(
    ("by", "criterion"),
    [
        ("body", "on samples"),
        *nightly([("body", "between samples"), ("body", "DOLS"), ("wheel", "on samples")]),
    ],
)
def test_the_staged_quarter_car_agrees_with_plain_numpy(drive, criterion, by):
    procedure = {"body": quarter_car_by_body, "wheel": quarter_car_by_wheel}[by]()
    chosen = QUARTER_CAR_CRITERIA[criterion]
    found = fit(procedure, drive, chosen, key=KEY, noise="none")
    expected = numpy_quarter_car(chosen, drive, by == "wheel")
    assert found.parameters == ("K_t", "M_us", "M_s", "K_s", "F_1", "F_2", "F_3", "F_4")
    assert_relative(found.theta, expected, 1e-9)
    assert found.stage_names == ("tyre", "masses", by)


# Data without model error: every criterion finds the truth.


def test_dols_finds_the_truth_to_rounding_where_the_model_is_exact():
    found = fit(oscillator(), exact_record(), DOLS())
    assert_relative(found.theta, list(TRUTH.values()), 1e-12)


# The trapezoidal rule errs by the share (w h)^2 / 12 at angular frequency w.
FASTEST = max(w for _, w, _ in WAVES)


def share_of_error(step, between_samples):
    """Relative error of each parameter, over the trapezoidal rule's on the fastest wave."""
    criterion = windows(2000, between_samples)
    found = fit(oscillator(), exact_record(step), criterion, key=KEY, noise="none")
    error = np.abs(np.asarray(found.theta) / list(TRUTH.values()) - 1)
    return error / ((FASTEST * step) ** 2 / 12)


@pytest.mark.parametrize("step", [0.02, 0.005])
def test_riec_between_samples_finds_the_same_with_a_tenth_of_that_error(step):
    # Interpolation damps a wave by the same share in every term, so that most of the error cancels.
    assert (share_of_error(step, True) < 0.1).all()


# Several records, known values, stages together.


def noisy(duration, seed):
    return exact_record(duration=duration, noise=3.0, seed=seed)


def test_several_records_of_unequal_length_are_one_regression():
    records = [noisy(3.0, 0), noisy(5.0, 1)]
    found = identify(oscillator(), records, DOLS())
    A = np.concatenate([np.stack([r["a"], r["v"], r["x"]], axis=1) for r in records])
    y = np.concatenate([np.asarray(r["u"]) for r in records])
    assert_relative(found.theta, np.linalg.lstsq(A, y)[0], 1e-11)
    alone = [identify(oscillator(), r, DOLS()) for r in records]
    assert found.block_count == sum(e.block_count for e in alone)
    assert float(found.stages[0].count) == 301 + 501


def test_each_record_draws_windows_with_a_key_of_its_own():
    records, criterion = [noisy(3.0, 0), noisy(5.0, 1)], windows()
    found = fit(oscillator(), records, criterion, key=KEY)
    parts = [
        eqx.filter_jit(criterion.rows)(oscillator(), r, k)
        for r, k in zip(records, jax.random.split(KEY, 2))
    ]
    A = np.concatenate([p.regressors for p in parts])
    y = np.concatenate([p.target for p in parts])
    assert_relative(found.theta, np.linalg.lstsq(A, y)[0], 1e-10)


def test_a_known_parameter_is_held_and_the_others_are_fitted_around_it():
    record = noisy(5.0, 0)
    found = fit(oscillator(), record, DOLS(), known={"m": 2.5})
    s = {name: np.asarray(record[name]) for name in "xvau"}
    expected = np.linalg.lstsq(np.stack([s["v"], s["x"]], 1), s["u"] - 2.5 * s["a"])[0]
    assert found.parameters == ("d", "k")
    assert_relative(found.theta, expected, 1e-11)
    assert float(found["m"]) == 2.5
    assert list(found) == ["d", "k", "m"]
    assert found.covariance.shape == (2, 2)
    assert "known" in str(found)


def test_a_value_known_to_a_term_counts_as_one_given_to_identify_which_overrides_it():
    record = noisy(5.0, 0)
    by_term = fit(oscillator({"known": 2.5}), record, DOLS())
    by_call = fit(oscillator(), record, DOLS(), known={"m": 2.5})
    np.testing.assert_array_equal(by_term.theta, by_call.theta)
    overridden = fit(oscillator({"known": 9.0}), record, DOLS(), known={"m": 2.5})
    np.testing.assert_array_equal(overridden.theta, by_call.theta)


def stiffness():
    return Equation(Term(1.0, "f"), -Term("k", "x", unit="N/m"), name="spring")


def spring_record():
    s = exact_signals(noise=3.0)
    force = TRUTH["k"] * s["x"] + 2.0 * np.random.default_rng(9).normal(size=s["x"].size)
    return Record.from_samples(s | {"f": force}, time_step=0.01)


def test_simultaneous_equations_are_one_stacked_regression():
    record = spring_record()
    found = fit(simultaneous(stiffness(), oscillator()), record, DOLS())
    s = {name: np.asarray(record[name]) for name in record.signals}
    zero = np.zeros_like(s["x"])
    top, low = np.stack([s["x"], zero, zero], 1), np.stack([s["x"], s["a"], s["v"]], 1)
    expected = np.linalg.lstsq(np.concatenate([top, low]), np.concatenate([s["f"], s["u"]]))[0]
    assert found.parameters == ("k", "m", "d")
    assert_relative(found.theta, expected, 1e-11)
    assert len(found.stages) == 1


@pytest.mark.slow
def test_staged_equations_take_what_came_before_as_known():
    record = spring_record()
    found = identify(staged(stiffness(), oscillator()), record, DOLS())
    first = identify(stiffness(), record, DOLS())
    second = identify(oscillator(), record, DOLS(), known={"k": first["k"]})
    np.testing.assert_allclose(found["k"], first["k"], rtol=1e-14)
    assert_relative(found.theta[1:], second.theta, 1e-12)
    # The uncertainty of k reaches what is found with it.
    assert (np.asarray(found.standard_errors[1:]) != np.asarray(second.standard_errors)).all()


def test_a_stage_whose_parameters_are_all_known_is_passed_over():
    found = fit(staged(stiffness(), oscillator()), spring_record(), DOLS(), known={"k": 40.0})
    assert found.parameters == ("m", "d")
    assert found.stage_names == ("oscillator",)


# Transformations.


def with_scale(record, scale):
    return record.with_signals({"x": scale * record["x"]})


@pytest.mark.slow
def test_derivatives_with_respect_to_the_signals_agree_with_finite_differences():
    record = noisy(5.0, 0)

    @jax.jit
    def theta(scale):
        return fit(oscillator(), with_scale(record, scale), windows(), key=KEY).theta

    at, step = jnp.asarray(1.2), 1e-5
    difference = (theta(at + step) - theta(at - step)) / (2 * step)
    np.testing.assert_allclose(jax.jacfwd(theta)(at), difference, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(jax.jacrev(theta)(at), difference, rtol=1e-7, atol=1e-9)


def test_jit_and_vmap_over_keys_equal_a_loop():
    record, keys = noisy(5.0, 0), jax.random.split(KEY, 3)

    def one(key):
        found = identify(oscillator(), record, windows(), key=key)
        return found.theta, found.covariance

    batch = jax.jit(jax.vmap(one))(keys)
    loop = [one(key) for key in keys]
    for i, values in enumerate(loop):
        for found, expected in zip(batch, values):
            np.testing.assert_allclose(found[i], expected, rtol=1e-9)
    assert np.abs(np.diff(batch[0], axis=0)).min() > 0


def test_the_covariance_of_a_traced_record_is_that_of_the_record_itself():
    record = noisy(10.0, 0)
    eager = identify(oscillator(), record, windows(), key=KEY)
    traced = jax.jit(lambda r: identify(oscillator(), r, windows(), key=KEY).covariance)(record)
    assert eager.block_count == 5
    np.testing.assert_allclose(traced, eager.covariance, rtol=1e-9)


def test_the_same_key_gives_the_same_answer_to_the_last_bit_and_another_key_another():
    record = noisy(5.0, 0)
    first, again, other = (
        fit(oscillator(), record, windows(), key=jax.random.key(k)).theta for k in (1, 1, 2)
    )
    np.testing.assert_array_equal(first, again)
    assert (first != other).all()


TRACES = []


def counted_displacement(signals):
    TRACES.append(1)
    return signals["x"]


def fresh_problem(seed, alpha, beta, coefficient, known):
    """New objects and new numbers throughout; the same shapes and signals."""
    equation = Equation(
        Term(coefficient, "u"),
        -Term("m", "v", derivative=1, known=known),
        -Term("d", "v"),
        -Term("k", counted_displacement),
    )
    criterion = RIEC(RandomWindows(alpha, beta, 50))
    return equation, noisy(3.0, seed), criterion, jax.random.key(seed)


def test_nothing_compiles_anew_for_new_numbers_in_problems_of_one_shape():
    compiled = []

    def listen(event, *_, **__):
        if event == "/jax/core/compile/backend_compile_duration":
            compiled.append(event)

    def run(seed, alpha, beta, coefficient, known):
        equation, record, criterion, key = fresh_problem(seed, alpha, beta, coefficient, known)
        jax.block_until_ready(fit(equation, record, criterion, key=key).theta)

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        run(0, 0.1, 0.5, 1.0, 2.0)
        assert compiled  # the listener hears compilations
        traces = len(TRACES)
        compiled.clear()
        run(1, 0.2, 0.45, 1.5, 2.1)
        # 0-dimensional arrays in place of numbers.
        run(2, np.array(0.15), np.array(0.48), np.array(1.2), np.array(1.9))
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)
    assert not compiled
    assert len(TRACES) == traces


# Errors.


def unknown_target():
    return Equation(Term("m", "a"), Term("k", "x"), name="free")


ERRORS = {
    "unknown name": (
        lambda: fit(oscillator(), exact_record(), DOLS(), known={"mass": 1.0}),
        ModelError,
        ["unknown parameter 'mass'", "m, d, k"],
    ),
    "all unknown": (
        lambda: fit(unknown_target(), exact_record(), DOLS()),
        ModelError,
        ["free: every coefficient is unknown", "Fix one of m, k", "--set NAME=VALUE"],
    ),
    "no key": (
        lambda: fit(oscillator(), exact_record(), windows()),
        ModelError,
        ["need a key: key=jax.random.key(seed)"],
    ),
    "all known": (
        lambda: fit(oscillator(), exact_record(), DOLS(), known=TRUTH),
        ModelError,
        ["every parameter is known"],
    ),
    "no record": (
        lambda: fit(oscillator(), [], DOLS()),
        DataError,
        ["at least one record"],
    ),
    "too short": (
        lambda: fit(oscillator(), exact_record(duration=0.5), windows(), key=KEY),
        DataError,
        ["beta = 1 s, is longer than the record, 0.5 s", "Choose a smaller beta"],
    ),
    "one of two records too short": (
        lambda: fit(oscillator(), [exact_record(), exact_record(duration=0.5)], windows(), key=KEY),
        DataError,
        ["longer than the record, 0.5 s"],
    ),
    "missing signal": (
        lambda: fit(oscillator(), exact_record().select("u", "v"), windows(), key=KEY),
        DataError,
        ["no signal 'x'; it has: u, v", "--map x=COLUMN"],
    ),
    "missing derivative": (
        lambda: fit(oscillator(), exact_record().select("u", "x", "v"), DOLS()),
        DataError,
        ["second time derivative of x, as signal 'a'", "--test-function hat"],
    ),
    "fewer windows than parameters": (
        lambda: fit(oscillator(), exact_record(), windows(2), key=KEY),
        IdentifiabilityError,
        ["oscillator: the record cannot tell these apart", "--set NAME=VALUE"],
    ),
}


@pytest.mark.parametrize("case", ERRORS)
def test_what_cannot_be_identified_is_refused_in_one_line_with_a_remedy(case):
    attempt, error, words = ERRORS[case]
    with pytest.raises(error) as caught:
        attempt()
    message = str(caught.value)
    assert "\n" not in message
    for word in words:
        assert word in message


def test_a_missing_estimate_names_those_that_exist():
    found = fit(oscillator(), exact_record(), DOLS())
    with pytest.raises(ModelError, match="no estimated parameter 'mass'; there are: m, d, k"):
        found["mass"]


def test_an_equation_that_nothing_anchors_is_refused_among_others():
    cart = Equation(Term("m", "a"), -Term(1.0, "f"), name="cart")
    loose = Equation(Term("p", "a"), Term("q", "f"), name="loose")
    linked = Equation(Term("m", "f"), Term("q", "a"), name="linked")
    with pytest.raises(ModelError, match="loose"):
        simultaneous(cart, loose).plan(set())
    assert simultaneous(cart, linked).plan(set()) == [("cart + linked", ("m", "q"))]
