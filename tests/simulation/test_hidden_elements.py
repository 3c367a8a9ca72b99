"""Systems with hidden modes and springs in series, against matrices by hand and SciPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tests.machines import BODY, body_matrix
from tests.machines import LAG_MODEL as MODEL
from tests.machines import LAG_TRUTH as TRUTH

import riecjax as rx
from riecjax.equations.equation_system import EquationSystem
from riecjax.equations.expressions import difference
from riecjax.equations.model import Model
from riecjax.equations.quantity import Quantity
from riecjax.refinement.objective import as_parametric_system
from riecjax.simulation.linearisation import linearise

VALUES = {"m": 2.0, "c": 0.7, "k": 90.0, "M_mode": 0.5, "K_mode": 60.0, "B_mode": 0.8}


def oscillator(sign: float = 1.0) -> rx.Equation:
    """m x'' + c x' + k x = u, the velocity recorded as v and the acceleration as a."""
    return rx.Equation(
        rx.Term("m", "x", derivative=2, measured=("v", "a"), unit="kg", sign=sign),
        rx.Term("c", "v", sign=sign),
        rx.Term("k", "x", sign=sign),
        rx.Term(-sign, "u"),
        name="oscillator",
    )


def matrix(m: float, c: float, k: float, *modes: tuple[float, float, float]) -> np.ndarray:
    """State matrix of x, v and then d, w of each mode, from Newton's law for each mass."""
    size = 2 + 2 * len(modes)
    found = np.zeros((size, size))
    found[0, 1] = 1.0
    found[1, :2] = -k / m, -c / m
    for i, (mass, stiffness, damping) in enumerate(modes):
        d, w = 2 + 2 * i, 3 + 2 * i
        found[1, [d, 1, w]] += np.array([-stiffness, -damping, damping]) / m
        found[d, [1, w]] = 1.0, -1.0
        found[w, [d, 1, w]] = np.array([stiffness, damping, -damping]) / mass
    return found


@pytest.mark.parametrize("on", ["x", "v"])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_body_and_mass_move_as_newton_says(on, sign):
    made = rx.equation_system(rx.staged(oscillator(sign)).with_elements(rx.HiddenMode(on)), VALUES)
    assert made.state_names == ("x", "v", "mode_deflection", "mode_velocity")
    assert dict(made.states)["mode_deflection"] == "m"
    expected = matrix(2.0, 0.7, 90.0, (0.5, 60.0, 0.8))
    state, inputs = linearise(made)
    np.testing.assert_allclose(state, expected, atol=1e-12)
    np.testing.assert_allclose(inputs, [[0], [0.5], [0], [0]], atol=1e-12)
    time = np.arange(301) * 0.01
    push = np.array([0, 0.5, 0, 0])
    start = [0.1, -0.2, 0.03, 0.4]
    truth = solve_ivp(
        lambda t, s: expected @ s + push * (3 * t - 1),
        (0, 3),
        start,
        t_eval=time,
        rtol=1e-10,
        atol=1e-12,
    ).y
    record = rx.Record({"u": 3 * time - 1}, 0.01)
    found = rx.simulate(made, record, initial_state=dict(zip(made.state_names, start))).record
    for name, samples in zip(made.state_names, truth):
        np.testing.assert_allclose(found[name], samples, atol=1e-7)
    np.testing.assert_allclose(found["a"], (expected @ truth)[1] + (3 * time - 1) / 2, atol=1e-5)


FIRST = rx.Equation(
    rx.Term("p", "a", derivative=1), rx.Term("q", "b", derivative=1), -rx.Term(1.0, "u")
)
SECOND = rx.Equation(
    rx.Term("q", "a", derivative=1), rx.Term("r", "b", derivative=1), rx.Term("c", "b")
)


def test_a_mode_moves_every_equation_that_holds_its_body():
    """As the same system written out: the mass an equation of its own, M w' in both others."""
    values = {**VALUES, "p": 3.0, "q": 2.0, "r": 5.0}
    modes = rx.staged(FIRST, SECOND).with_elements(rx.HiddenMode("b"))
    mass = rx.Term("M_mode", "w", derivative=1)
    stretching = difference("b", "w")
    written = rx.staged(
        rx.Equation(*FIRST.terms, mass),
        rx.Equation(*SECOND.terms, mass),
        rx.Equation(mass, -rx.Term("K_mode", "d"), -rx.Term("B_mode", stretching)),
    )
    made = rx.equation_system(modes, values)
    truth = rx.equation_system(written, values, rates={"d": stretching})
    assert made.state_names == ("a", "b", "mode_deflection", "mode_velocity")
    order = np.array([truth.state_names.index(name) for name in ("a", "b", "d", "w")])
    for found, expected in zip(linearise(made), linearise(truth)):
        expected = expected[order]
        expected = expected[:, order] if expected.shape[1] == 4 else expected
        np.testing.assert_allclose(found, expected, atol=1e-12)


QUARTER_CAR = {"K_t": 178e3, "M_us": 25.0, "M_s": 200.0, "K_s": 20e3}
DAMPER = {f"F_{i}": 1500.0 * v for i, v in enumerate((-0.8, -0.3, 0.3, 0.8), 1)}
MOUNT = {"M_mode": 100.0, "K_mode": 300e3, "B_mode": 4000.0}


def quarter_car() -> np.ndarray:
    """State matrix of x1 ... x4, d, w with a linear damper."""
    k_t, m_u, m_s, k_s = QUARTER_CAR.values()
    mass, k, b = MOUNT.values()
    c = 1500.0
    return np.array(
        [
            [0, 0, -1, 0, 0, 0],
            [0, 0, 1, -1, 0, 0],
            [k_t / m_u, -k_s / m_u, -c / m_u, c / m_u, 0, 0],
            [0, k_s / m_s, c / m_s, -(c + b) / m_s, -k / m_s, b / m_s],
            [0, 0, 0, 1, 0, -1],
            [0, 0, 0, b / mass, k / mass, -b / mass],
        ]
    )


@pytest.mark.parametrize("name", ["quarter-car", "quarter-car-wheel"])
def test_quarter_car_carries_an_engine(name):
    model = rx.find_model(name).with_elements(rx.HiddenMode("x4"))
    assert [(q.name, q.unit) for q in model.parameters[-3:]] == [
        ("M_mode", "kg"),
        ("K_mode", "N/m"),
        ("B_mode", "N s/m"),
    ]
    assert {q.name for q in model.parameters} == set(model.parameter_names)
    values = {k: jnp.asarray(v) for k, v in {**QUARTER_CAR, **DAMPER, **MOUNT}.items()}
    road = rx.Record({"v_r": np.zeros(50)}, 0.005)
    driven = model.identified_system(values, road)
    assert isinstance(driven, EquationSystem)
    assert driven.state_names == ("x1", "x2", "x3", "x4", "mode_deflection", "mode_velocity")
    state, inputs = linearise(driven)
    np.testing.assert_allclose(state, quarter_car(), rtol=1e-10, atol=1e-9)
    np.testing.assert_allclose(inputs, np.eye(6)[:, :1], atol=1e-12)
    every = as_parametric_system(model, road)
    assert jax.tree.structure(every.build(values)) == jax.tree.structure(driven)
    forced = model.identified_system(values, rx.Record({"x1": np.zeros(9), "x2": np.zeros(9)}, 0.1))
    assert isinstance(forced, EquationSystem)
    state, inputs = linearise(forced)
    np.testing.assert_allclose(state, quarter_car()[2:, 2:], rtol=1e-10, atol=1e-9)
    np.testing.assert_allclose(inputs, quarter_car()[2:, :2], rtol=1e-10, atol=1e-9)


def test_a_mode_is_simulated_by_equations_where_a_system_of_ones_own_lacks_it():
    class Free(rx.simulation.AbstractSystem):
        states = (("a", ""), ("b", ""))
        inputs = (("u", ""),)

    inputs = (Quantity("u", "N", ""),)
    plain = Model("cart", "", rx.staged(FIRST, SECOND), inputs=inputs, system=lambda _: Free())
    values = dict.fromkeys(plain.parameter_names, 2.0) | {"q": 0.5}
    assert isinstance(plain.build_system(values), Free)
    model = plain.with_elements(rx.HiddenMode("a"))
    values = dict.fromkeys(model.parameter_names, 2.0) | {"q": 0.5}
    record = rx.Record({"u": np.zeros(20)}, 0.1)
    assert isinstance(model.identified_system(values, record), EquationSystem)
    arrays = {name: np.array(value) for name, value in values.items()}
    assert isinstance(as_parametric_system(model, record).build(arrays), EquationSystem)
    assert isinstance(model.build_system(values), EquationSystem)


def recorded(seconds: float) -> rx.Record:
    """The oscillator with its mode under a random force, of which x and v are recorded."""
    model = rx.staged(oscillator()).with_elements(rx.HiddenMode("x"))
    force = 20 * np.random.default_rng(0).normal(size=round(seconds / 0.02))
    inputs = rx.Record({"u": force}, 0.02)
    start = {"x": 0.1, "v": 1.0, "mode_velocity": 1.0}
    made = rx.simulate(rx.equation_system(model, VALUES), inputs, initial_state=start)
    return made.record.select("u", "x", "v")


def test_validation_starts_a_mode_carried_along():
    model = rx.staged(oscillator()).with_elements(rx.HiddenMode("x"))
    held = rx.validation.validate_held_out(rx.equation_system(model, VALUES), recorded(5.0))
    assert dict(held.started_from) == {
        "x": "measured",
        "v": "measured",
        "mode_deflection": "carried",
        "mode_velocity": "carried",
    }
    assert held.predicts
    assert float(held.signals["x"].fit) > 99.99
    assert "mode" not in held.verdict
    plain = rx.validation.validate_held_out(rx.equation_system(oscillator(), VALUES), recorded(5.0))
    assert float(plain.signals["x"].fit) < 60


@pytest.mark.slow
def test_refinement_finds_the_mode_again():
    model = rx.staged(oscillator()).with_elements(rx.HiddenMode("x"))
    start = {name: 1.1 * value for name, value in VALUES.items()}
    by = rx.OutputError(intersample="lines")
    refined = rx.refine(model, recorded(5.0), start, by)
    assert refined.search.initial_state_names == ("x", "v", "mode_deflection", "mode_velocity")
    for name, value in VALUES.items():
        np.testing.assert_allclose(refined.values[name], value, rtol=1e-4)
    assert dict(refined.units)["K_mode"] == "N/m"


POINTS = (-1.0, -0.3, 0.0, 0.3, 1.0)
MAP = {f"F_{i}": f for i, f in enumerate((-900.0, -500.0, 0.0, 400.0, 700.0), 1)}
WHEEL = {"M": 30.0, "K": 20e3, **MAP, "K_series": 300e3}
RATES = {"d": difference("v", "u")}


def wheel() -> Model:
    """A wheel below a body that moves by u: F = M v' + K d + map(v - u), d' = v - u."""
    equation = rx.Equation(
        rx.Term(1.0, "F"),
        -rx.Term("M", "v", derivative=1, unit="kg"),
        -rx.Term("K", "d", unit="N/m"),
        -rx.Terms("F", rx.roof(POINTS), of=difference("v", "u"), unit="N"),
        name="wheel",
        unit="N",
    )
    return rx.staged(equation).with_elements(rx.SeriesSpring("F_2"))


def push(t: np.ndarray) -> np.ndarray:
    return 1500 * np.sin(12 * t) + 900 * np.sin(31 * t + 1) + 500 * np.sin(70 * t)


def moved(t: np.ndarray) -> np.ndarray:
    return 0.2 * np.sin(7 * t)


def recorded_wheel(seconds: float, step: float = 0.002) -> rx.Record:
    """The wheel as SciPy solves it, its damper seeing the velocity at which it pulls as much."""
    forces = np.array(list(MAP.values()))

    def inner(f):
        # Beyond the map its end segments go on.
        low, high = np.diff(POINTS)[[0, -1]] / np.diff(forces)[[0, -1]]
        beyond = np.minimum(f - forces[0], 0) * low + np.maximum(f - forces[-1], 0) * high
        return np.interp(f, forces, POINTS) + beyond

    def rates(t, state):
        v, d, f = state
        across = v - moved(t)
        return [(push(t) - 20e3 * d - f) / 30.0, across, 300e3 * (across - inner(f))]

    times = step * np.arange(round(seconds / step))
    solved = solve_ivp(
        rates, (0, times[-1]), [0, 0, 0], t_eval=times, rtol=1e-8, atol=1e-9, max_step=step
    ).y
    signals = {"v": solved[0], "d": solved[1], "series_force": solved[2]}
    return rx.Record({**signals, "F": push(times), "u": moved(times)}, step)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_linear_element_lags_as_its_matrix_says(sign):
    terms = MODEL.stages[0][0].terms
    equation = rx.Equation(*(-t if sign < 0 else t for t in terms), name="body")
    model = rx.staged(equation).with_elements(rx.SeriesSpring("c"))
    made = rx.equation_system(model, TRUTH, rates={"x": "v"})
    assert made.state_names == ("v", "x", "series_force")
    expected = body_matrix(TRUTH["c"], series=TRUTH["K_series"])[np.ix_([1, 0, 2], [1, 0, 2])]
    state, inputs = linearise(made)
    np.testing.assert_allclose(state, expected, atol=1e-9)
    np.testing.assert_allclose(inputs, [[1 / TRUTH["m"]], [0], [0]], atol=1e-12)


def test_a_map_moves_as_scipy_says():
    truth = recorded_wheel(2.0)
    made = rx.equation_system(wheel(), WHEEL, rates=RATES)
    assert made.state_names == ("v", "d", "series_force")
    assert dict(made.states)["series_force"] == "N"
    assert made.input_names == ("F", "u")
    found = rx.simulate(made, truth.select("F", "u")).checked().record
    for name in made.state_names:
        # Between samples inputs are lines, not sines.
        size = float(np.max(np.abs(truth[name])))
        np.testing.assert_allclose(found[name], truth[name], atol=1e-3 * size)
    # The map goes on beyond its last points.
    assert float(np.max(truth["series_force"])) > MAP["F_5"]


@pytest.mark.slow
def test_validation_starts_a_spring_at_the_map():
    record = recorded_wheel(2.0)
    part = record.part(250, 1000).select("F", "u", "v", "d")
    made = rx.equation_system(wheel(), WHEEL, rates=RATES)
    held = rx.validation.validate_held_out(made, part)
    assert held.predicts
    assert dict(held.started_from)["series_force"] == "carried"
    assert float(held.signals["v"].fit) > 98
    rigid = rx.equation_system(Model(stages=wheel().stages), WHEEL, rates=RATES)
    assert float(rx.validation.validate_held_out(rigid, part).signals["v"].fit) < 98
    # The map at the velocity that was recorded_wheel, which differs by what the spring gives way.
    start = float(held.record["series_force"][0])
    across = float(part["v"][0] - part["u"][0])
    expected = np.interp(across, POINTS, list(MAP.values()))
    assert start == pytest.approx(expected, rel=1e-9)


def body(damper: rx.Term) -> rx.Equation:
    """The body of the machines with another damper."""
    inertia, _, *others = BODY.terms
    return rx.Equation(inertia, damper, *others, name="body", unit="N")


def test_what_cannot_be_asked():
    model = rx.staged(BODY)
    with pytest.raises(rx.ModelError, match=r"no equation has a coefficient 'b'.*m, c, k"):
        model.with_elements(rx.SeriesSpring("b"))
    with pytest.raises(rx.ModelError, match="HiddenMode"):
        model.with_elements("c")  # pyright: ignore[reportArgumentType]
    for damper, of, message in (
        (rx.Terms("f", rx.friction(), of="v"), "f_viscous", "roof functions"),
        (rx.Terms("c", rx.Polynomial((1, 3)), "v"), "c_1", "inverse of its law"),
    ):
        sprung = rx.staged(body(damper)).with_elements(rx.SeriesSpring(of))
        with pytest.raises(rx.ModelError, match=message):
            rx.equation_system(sprung, dict.fromkeys(sprung.parameter_names, 1.0), rates={"x": "v"})
    other = rx.Equation(
        rx.Term("n", "w", derivative=1), rx.Term("c", difference("w", "v")), name="other"
    )
    with pytest.raises(rx.ModelError, match="no one element"):
        rx.equation_system(
            rx.staged(BODY, other).with_elements(rx.SeriesSpring("c")),
            {**TRUTH, "n": 1.0},
            rates={"x": "v"},
        )
    sprung = model.with_elements(rx.SeriesSpring("c"))
    with pytest.raises(rx.ModelError, match="c, a spring in series, is zero"):
        rx.equation_system(sprung, {**TRUTH, "c": 0.0}, rates={"x": "v"})
