"""Springs in series with dampers, against SciPy and the law that they have to obey."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import riecjax as rx
from riecjax.equations.expressions import difference
from riecjax.models.model import as_model
from riecjax.refinement import ByFunction
from riecjax.simulation.linearisation import linearise

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


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_maxwell_element_moves_as_newton_and_hooke_say(sign):
    equation = rx.Equation(*(-t if sign < 0 else t for t in LINEAR.terms), name="body", unit="N")
    procedure = rx.staged(equation).with_series_springs(rx.SeriesSpring("c"))
    assert procedure.parameters == ("m", "c", "k", "K_series")
    assert procedure.units["K_series"] == "N/m"
    made = rx.equation_system(procedure, VALUES, rates={"x": "v"})
    assert made.state_names == ("v", "x", "series_force")
    assert dict(made.states)["series_force"] == "N"
    m, c, k, series = VALUES.values()
    expected = [[0, -k / m, -1 / m], [1, 0, 0], [series, 0, -series / c]]
    np.testing.assert_allclose(linearise(made)[0], expected, rtol=1e-12)


def test_a_map_is_inverted():
    """Of a map that rises by 40 N s/m inside 0.1 m/s and by 10 outside, the inner velocity."""
    points, forces = (-1.0, -0.1, 0.1, 1.0), np.array([-13.0, -4.0, 4.0, 13.0])
    equation = body(rx.Terms("F", rx.roof(points), of="v", unit="N"))
    procedure = rx.staged(equation).with_series_springs(rx.SeriesSpring("F_2"))
    values = {"m": 2.0, "k": 90.0, "K_series": 400.0}
    values |= {f"F_{i}": force for i, force in enumerate(forces, 1)}
    made = rx.equation_system(procedure, values, rates={"x": "v"})
    time = np.arange(401) * 0.005

    def push(t):
        return 30 * np.sin(6 * t)

    def inner(force):
        return np.sign(force) * (abs(force) / 40 if abs(force) < 4 else 0.1 + (abs(force) - 4) / 10)

    def rates(t, state):
        v, x, f = state
        return [(push(t) - 90 * x - f) / 2, v, 400 * (v - inner(f))]

    truth = solve_ivp(rates, (0, 2), [0, 0, 0], t_eval=time, rtol=1e-9, atol=1e-10, max_step=1e-3).y
    found = rx.simulate(made, rx.Record({"u": push(time)}, 0.005), method=rx.FixedStep(8)).record
    np.testing.assert_allclose(found["v"], truth[0], atol=2e-3 * np.max(np.abs(truth[0])))
    np.testing.assert_allclose(
        found["series_force"], truth[2], atol=2e-3 * np.max(np.abs(truth[2]))
    )
    assert np.max(np.abs(truth[2])) > 8  # far on the outer pieces


def test_a_map_that_falls_is_simulated_by_one_that_hardly_rises():
    equation = body(rx.Terms("F", rx.roof((-1.0, 0.0, 1.0)), of="v", unit="N"))
    procedure = rx.staged(equation).with_series_springs(rx.SeriesSpring("F_1"))
    values = {"m": 2.0, "k": 90.0, "K_series": 400.0, "F_1": -9.0, "F_2": -9.5, "F_3": 9.0}
    made = rx.equation_system(procedure, values, rates={"x": "v"})
    record = rx.Record({"u": np.sin(np.arange(200) * 0.05)}, 0.005)
    assert np.all(np.isfinite(rx.simulate(made, record).checked().record["v"]))


def test_a_stiff_spring_is_none():
    plain = rx.equation_system(LINEAR, VALUES, rates={"x": "v"})
    stiff = rx.equation_system(
        rx.staged(LINEAR).with_series_springs(rx.SeriesSpring("c")),
        {**VALUES, "K_series": 1e5},
        rates={"x": "v"},
    )
    record = rx.Record({"u": np.sin(np.arange(200) * 0.05)}, 0.005)
    fine = rx.FixedStep(40)
    one, other = (rx.simulate(s, record, method=fine).record["v"] for s in (plain, stiff))
    np.testing.assert_allclose(one, other, atol=1e-3 * np.max(np.abs(one)))


def test_two_springs_have_names_of_their_own():
    second = rx.Equation(*LINEAR.terms, rx.Term("d", "w", unit="N s/m"), name="both")
    procedure = rx.staged(second).with_series_springs(rx.SeriesSpring("c"), rx.SeriesSpring("d"))
    assert procedure.parameters == ("m", "c", "k", "d", "K_series", "K_series_2")
    made = rx.equation_system(procedure, {**VALUES, "d": 3.0, "K_series_2": 50.0}, rates={"x": "v"})
    assert made.state_names == ("v", "x", "series_force", "series_2_force")
    assert made.input_names == ("u", "w")


def test_spring_and_mode_together():
    procedure = rx.staged(LINEAR).with_modes(rx.HiddenMode("v"))
    procedure = procedure.with_series_springs(rx.SeriesSpring("c"))
    values = {**VALUES, "M_mode": 0.5, "K_mode": 60.0, "B_mode": 0.8}
    made = rx.equation_system(procedure, values, rates={"x": "v"})
    assert made.state_names == ("v", "x", "mode_deflection", "mode_velocity", "series_force")
    assert {q.name for q in as_model(procedure).parameters} == set(values)


def test_refinement_finds_the_spring():
    procedure = rx.staged(LINEAR).with_series_springs(rx.SeriesSpring("c"))

    def build(values):
        return rx.equation_system(procedure, values, rates={"x": "v"})

    push = 40 * np.random.default_rng(0).normal(size=400)
    made = rx.simulate(build(VALUES), rx.Record({"u": push}, 0.01)).record.select("u", "x", "v")
    start = {"m": 2.2, "c": 10.0, "k": 80.0, "K_series": 2000.0}
    refined = rx.refine(ByFunction(build), made, start, rx.OutputError(intersample="lines"))
    for name, value in VALUES.items():
        np.testing.assert_allclose(refined.values[name], value, rtol=1e-3)


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


def test_the_quarter_car_with_its_spring_is_simulated_by_its_equations():
    model = rx.find_model("quarter-car").with_series_springs(rx.SeriesSpring("F_1"))
    assert model.parameters[-1].name == "K_series"
    assert model.parameters[-1].unit == "N/m"
    values = {q.name: jnp.asarray(1.0) for q in model.parameters}
    values |= {f"F_{i}": jnp.asarray(v) for i, v in enumerate((-8.0, -3.0, 3.0, 8.0), 1)}
    record = rx.Record({name: np.zeros(9) for name in ("v_r", "x1", "x2")}, 0.1)
    made = model.identified_system(values, record)
    assert "series_force" in made.state_names
    with pytest.raises(rx.ModelError, match="no springs in series"):
        model.build_system({})
