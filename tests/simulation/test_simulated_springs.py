"""Springs in series, simulated: against matrices and SciPy."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tests.machines import BODY, body_matrix
from tests.machines import LAG_MODEL as MODEL
from tests.machines import LAG_TRUTH as TRUTH

import riecjax as rx
from riecjax.equations.procedure import Procedure
from riecjax.equations.term import difference
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


def body(damper: rx.Term | rx.Terms) -> rx.Equation:
    """The body of the machines with another damper."""
    inertia, _, *others = BODY.terms
    return rx.Equation(inertia, damper, *others, name="body", unit="N")


def test_what_cannot_be_asked():
    procedure = rx.staged(BODY)
    with pytest.raises(rx.ModelError, match=r"no equation has a coefficient 'b'.*m, c, k"):
        procedure.with_series_springs(rx.SeriesSpring("b"))
    with pytest.raises(rx.ModelError, match="SeriesSpring"):
        procedure.with_series_springs("c")  # pyright: ignore[reportArgumentType]
    for damper, of, message in (
        (rx.Terms("f", rx.friction(), of="v"), "f_viscous", "roof functions"),
        (rx.Terms("c", rx.Polynomial((1, 3)), "v"), "c_1", "inverse of its law"),
    ):
        sprung = rx.staged(body(damper)).with_series_springs(rx.SeriesSpring(of))
        with pytest.raises(rx.ModelError, match=message):
            rx.equation_system(sprung, dict.fromkeys(sprung.parameters, 1.0), rates={"x": "v"})
    other = rx.Equation(
        rx.Term("n", "w", derivative=1), rx.Term("c", difference("w", "v")), name="other"
    )
    with pytest.raises(rx.ModelError, match="no one element"):
        rx.equation_system(
            rx.staged(BODY, other).with_series_springs(rx.SeriesSpring("c")),
            {**TRUTH, "n": 1.0},
            rates={"x": "v"},
        )
    sprung = procedure.with_series_springs(rx.SeriesSpring("c"))
    with pytest.raises(rx.ModelError, match="c, a spring in series, is zero"):
        rx.equation_system(sprung, {**TRUTH, "c": 0.0}, rates={"x": "v"})
