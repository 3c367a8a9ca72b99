"""Springs in series, simulated: against matrices and SciPy."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tests.machines import LAG_MODEL as MODEL
from tests.machines import LAG_TRUTH as TRUTH
from tests.machines import body_matrix

import riecjax as rx
from riecjax.equations.procedure import Procedure
from riecjax.equations.term import difference
from riecjax.refinement.objective import ByCoefficients
from riecjax.simulation.linearisation import linearise

POINTS = (-1.0, -0.3, 0.0, 0.3, 1.0)
MAP = {f"F_{i}": f for i, f in enumerate((-900.0, -500.0, 0.0, 400.0, 700.0), 1)}
WHEEL = {"M": 30.0, "K": 20e3, **MAP, "K_series": 300e3}
RATES = {"d": difference("v", "u")}


def wheel() -> Procedure:
    """A wheel below a body that moves by u: F = M v' + K d + map(v - u), d' = v - u."""
    equation = rx.Equation(
        rx.Term(1.0, "F"),
        -rx.Term("M", "v", derivative=1, unit="kg"),
        -rx.Term("K", "d", unit="N/m"),
        -rx.Terms("F", rx.roof(POINTS), of=difference("v", "u"), unit="N"),
        name="wheel",
        unit="N",
    )
    return rx.staged(equation).with_series_springs(rx.SeriesSpring("F_2"))


def push(t: np.ndarray) -> np.ndarray:
    return 1500 * np.sin(12 * t) + 900 * np.sin(31 * t + 1) + 500 * np.sin(70 * t)


def moved(t: np.ndarray) -> np.ndarray:
    return 0.2 * np.sin(7 * t)


def recorded(seconds: float, step: float = 0.002) -> rx.Record:
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
    model = rx.staged(equation).with_series_springs(rx.SeriesSpring("c"))
    made = rx.equation_system(model, TRUTH, rates={"x": "v"})
    assert made.state_names == ("v", "x", "series_force")
    expected = body_matrix(TRUTH["c"], series=TRUTH["K_series"])[np.ix_([1, 0, 2], [1, 0, 2])]
    state, inputs = linearise(made)
    np.testing.assert_allclose(state, expected, atol=1e-9)
    np.testing.assert_allclose(inputs, [[1 / TRUTH["m"]], [0], [0]], atol=1e-12)


def test_a_map_moves_as_scipy_says():
    truth = recorded(2.0)
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
    record = recorded(2.0)
    part = record.part(250, 1000).select("F", "u", "v", "d")
    made = rx.equation_system(wheel(), WHEEL, rates=RATES)
    held = rx.validation.validate_held_out(made, part)
    assert held.predicts
    assert dict(held.started_from)["series_force"] == "carried"
    assert float(held.signals["v"].fit) > 98
    rigid = rx.equation_system(Procedure(wheel().stages), WHEEL, rates=RATES)
    assert float(rx.validation.validate_held_out(rigid, part).signals["v"].fit) < 98
    # The map at the velocity that was recorded, which differs by what the spring gives way.
    start = float(held.record["series_force"][0])
    across = float(part["v"][0] - part["u"][0])
    expected = np.interp(across, POINTS, list(MAP.values()))
    assert start == pytest.approx(expected, rel=1e-9)


def test_what_cannot_be_simulated():
    with pytest.raises(rx.ModelError, match="c, a spring in series, is zero"):
        rx.equation_system(MODEL, {**TRUTH, "c": 0.0}, rates={"x": "v"})
    cubic = rx.Equation(
        rx.Term("m", "v", derivative=1), rx.Terms("c", rx.Polynomial((1, 3)), "v"), name="cubic"
    )
    model = rx.staged(cubic).with_series_springs(rx.SeriesSpring("c_1"))
    with pytest.raises(rx.ModelError, match="inverse of its law"):
        rx.equation_system(model, dict.fromkeys(model.parameters, 1.0))


@pytest.mark.slow
def test_refinement_finds_spring_and_map():
    record = recorded(2.0).select("F", "u", "v", "d")
    start = {"M": 24.0, "K": 24e3, "K_series": 1e6}
    start |= {name: 1.2 * force + 20 for name, force in MAP.items()}
    refined = rx.refine(
        lambda values: rx.equation_system(wheel(), values, rates=RATES),
        record,
        start,
        rx.OutputError(method=rx.FixedStep(8)),
    )
    assert bool(refined.converged)
    for name, value in WHEEL.items():
        np.testing.assert_allclose(refined.values[name], value, rtol=1e-3, atol=0.1, err_msg=name)


VALUES = {"m": 2.0, "c": 12.0, "k": 90.0, "K_series": 400.0}


def body(damper: rx.Term | rx.Terms) -> rx.Equation:
    """m v' + c v + k x = u, the position another state."""
    return rx.Equation(
        rx.Term("m", "v", derivative=1, unit="kg"),
        damper,
        rx.Term("k", "x", unit="N/m"),
        -rx.Term(1.0, "u"),
        name="body",
        unit="N",
    )


LINEAR = body(rx.Term("c", "v", unit="N s/m"))


def test_what_cannot_be_asked():
    procedure = rx.staged(LINEAR)
    with pytest.raises(rx.ModelError, match=r"no equation has a coefficient 'b'.*m, c, k"):
        procedure.with_series_springs(rx.SeriesSpring("b"))
    with pytest.raises(rx.ModelError, match="SeriesSpring"):
        procedure.with_series_springs("c")  # pyright: ignore[reportArgumentType]
    friction = rx.staged(body(rx.Terms("f", rx.friction(), of="v")))
    with pytest.raises(rx.ModelError, match="roof functions"):
        rx.equation_system(
            friction.with_series_springs(rx.SeriesSpring("f_viscous")),
            {"m": 1.0, "k": 1.0, "f_viscous": 1.0, "f_coulomb": 1.0, "K_series": 9.0},
            rates={"x": "v"},
        )
    other = rx.Equation(
        rx.Term("n", "w", derivative=1), rx.Term("c", difference("w", "v")), name="other"
    )
    with pytest.raises(rx.ModelError, match="no one element"):
        rx.equation_system(
            rx.staged(LINEAR, other).with_series_springs(rx.SeriesSpring("c")),
            {**VALUES, "n": 1.0},
            rates={"x": "v"},
        )
    sprung = procedure.with_series_springs(rx.SeriesSpring("c"))
    with pytest.raises(rx.ModelError, match="c, a spring in series, is zero"):
        rx.equation_system(sprung, {**VALUES, "c": 0.0}, rates={"x": "v"})


def test_the_quarter_car_with_spring_and_mode_moves_over_a_road_as_its_matrix_says():
    """With a linear damper, as eq. (19) with one: states x3, x4, x1, x2, d, w, f."""
    k_t, m_u, m_s, k_s, c, series = 178e3, 25.0, 200.0, 20e3, 1500.0, 500e3
    mass, k, b = 100.0, 300e3, 4000.0
    values = {"K_t": k_t, "M_us": m_u, "M_s": m_s, "K_s": k_s, "K_series": series}
    values |= {f"F_{i}": c * v for i, v in enumerate((-0.8, -0.3, 0.3, 0.8), 1)}
    values |= {"M_mode": mass, "K_mode": k, "B_mode": b}
    model = rx.find_model("quarter-car").with_modes(rx.HiddenMode("x4"))
    model = model.with_series_springs(rx.SeriesSpring("F_1"))
    road = rx.Record({"v_r": np.zeros(9)}, 0.005)
    numbers = {name: jnp.asarray(value) for name, value in values.items()}
    made = model.identified_system(numbers, road)
    expected = {
        "x3": {"x1": k_t / m_u, "x2": -k_s / m_u, "series_force": -1 / m_u},
        "x4": {
            "x2": k_s / m_s,
            "series_force": 1 / m_s,
            "mode_deflection": -k / m_s,
            "x4": -b / m_s,
            "mode_velocity": b / m_s,
        },
        "x1": {"x3": -1.0},
        "x2": {"x3": 1.0, "x4": -1.0},
        "mode_deflection": {"x4": 1.0, "mode_velocity": -1.0},
        "mode_velocity": {"mode_deflection": k / mass, "x4": b / mass, "mode_velocity": -b / mass},
        "series_force": {"x3": series, "x4": -series, "series_force": -series / c},
    }
    assert set(made.state_names) == set(expected)
    state, inputs = linearise(made)
    matrix = [[expected[row].get(n, 0.0) for n in made.state_names] for row in made.state_names]
    np.testing.assert_allclose(state, matrix, rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(inputs[:, 0], [float(n == "x1") for n in made.state_names])
    every = model.parametric_system(road)
    assert isinstance(every, ByCoefficients)
    assert every.build(numbers).state_names == made.state_names
