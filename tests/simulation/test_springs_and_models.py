"""Springs in series with dampers, against SciPy and the law that they have to obey."""

import jax.numpy as jnp
import numpy as np
import pytest

import riecjax as rx
from riecjax.equations.expressions import difference
from riecjax.refinement.parametric import ByCoefficients
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
