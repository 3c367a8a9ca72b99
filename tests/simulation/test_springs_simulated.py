"""Force elements with a spring in series, against matrices written by hand and SciPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tests.machines import LAG_MODEL as MODEL
from tests.machines import LAG_TRUTH as TRUTH
from tests.machines import body_matrix

import riecjax as rx
from riecjax.equations.expressions import difference
from riecjax.equations.procedure import Procedure
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


def test_a_mode_and_a_spring_are_simulated_together():
    mode = {"M_mode": 6.0, "K_mode": 21000.0, "B_mode": 120.0}
    model = MODEL.with_modes(rx.HiddenMode("v"))
    made = rx.equation_system(model, {**TRUTH, **mode}, rates={"x": "v"})
    assert made.state_names == ("v", "x", "mode_deflection", "mode_velocity", "series_force")
    heavy, stiff, loss = mode.values()
    found = np.sort_complex(np.linalg.eigvals(np.asarray(linearise(made)[0])))
    expected = np.sort_complex(
        np.linalg.eigvals(body_matrix(TRUTH["c"], (heavy, stiff, loss), TRUTH["K_series"]))
    )
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_slope_by_a_force_of_the_map_is_that_of_a_difference():
    record = recorded(0.5).select("F", "u")

    def last(force):
        system = rx.equation_system(wheel(), {**WHEEL, "F_4": force}, rates=RATES)
        return rx.simulate(system, record).record["v"][-1]

    slope = jax.jacfwd(last)(jnp.asarray(400.0))
    rise = (last(400.1) - last(399.9)) / 0.2
    assert abs(float(rise)) > 1e-6
    np.testing.assert_allclose(slope, rise, rtol=1e-4)


def test_a_map_that_falls_is_simulated_with_a_least_slope():
    falling = {**WHEEL, "F_4": -100.0, "F_5": -100.0}
    record = recorded(0.5).select("F", "u")
    run = rx.simulate(rx.equation_system(wheel(), falling, rates=RATES), record)
    assert bool(run.successful)
    assert np.all(np.isfinite(np.asarray(run.record["v"])))


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
