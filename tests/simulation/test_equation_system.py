"""Systems made from equations, against hand-written ones, SciPy, closed forms and differences."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from nightly import by_day, nightly
from riecjax.equations.equation import Equation
from riecjax.equations.procedure import simultaneous, staged
from riecjax.equations.term import RoofFunctions, Term, Terms
from riecjax.errors import ModelError
from riecjax.models.emps import (
    emps_asymmetric_equation,
    emps_asymmetric_system,
    emps_equation,
    emps_system,
)
from riecjax.models.oscillators import (
    drag_oscillator_equation,
    drag_oscillator_system,
    duffing_equation,
    duffing_system,
)
from riecjax.models.quarter_car.identification import (
    quarter_car_by_body,
    quarter_car_by_wheel,
    quarter_car_system,
)
from riecjax.records.record import Record
from riecjax.simulation.equation_system import equation_system
from riecjax.simulation.method import FixedStep
from riecjax.simulation.simulate import simulate

OSCILLATORS = {
    "duffing": (
        duffing_equation,
        duffing_system,
        {"m": 2.0, "d": 0.7, "k1": 30.0, "k2": -40.0, "k3": 900.0},
        {"y": 0.1, "dy": -0.2},
    ),
    "drag-oscillator": (
        drag_oscillator_equation,
        drag_oscillator_system,
        {"m": 1.5, "r": 0.8, "r2": 0.5, "k": 20.0},
        {"x": 0.1, "dx": 1.0},
    ),
    "emps": (
        emps_equation,
        emps_system,
        {"M": 95.0, "Fv": 200.0, "Fc": 20.0, "offset": -3.0},
        {"dq": 0.1},
    ),
    "emps-asymmetric": (
        emps_asymmetric_equation,
        emps_asymmetric_system,
        {"M": 95.0, "Fv_pos": 160.0, "Fc_pos": 20.0, "Fv_neg": 240.0, "Fc_neg": 21.0},
        {"dq": 0.1},
    ),
}


def arrays(values: dict[str, float]) -> dict[str, jax.Array]:
    return {name: jnp.asarray(value) for name, value in values.items()}


def drive(name: str, count: int = 400, step: float = 0.01) -> Record:
    time = np.arange(count) * step
    return Record({name: 30 * np.sin(5 * time) + 20 * np.cos(11.3 * time)}, step)


@pytest.mark.parametrize("case", by_day(OSCILLATORS, "duffing", "emps"))
def test_simulates_as_the_hand_written_system_does(case):
    equation, system, values, start = OSCILLATORS[case]
    by_hand = system(arrays(values))
    # The order of the coefficients' values is the user's.
    made = equation_system(equation(), dict(reversed(values.items())))
    assert made.state_names == by_hand.state_names
    assert made.input_names == by_hand.input_names
    inputs = drive(by_hand.input_names[0])
    expected = simulate(by_hand, inputs, initial_state=start).checked().record
    found = simulate(made, inputs, initial_state=start).checked().record
    assert set(found.arrays) == set(expected.arrays)
    for name in expected.arrays:
        # Coulomb friction at rest amplifies rounding: a step may end on either side of zero.
        scale = float(jnp.max(jnp.abs(expected[name])))
        np.testing.assert_allclose(found[name], expected[name], atol=1e-12 * scale, err_msg=name)


def spring_force(signals):
    stretch = signals["b"] - signals["a"]
    return stretch + 5 * stretch**3


def inertia_coupling(signals):
    """d/dt of it is a' + 0.2 b' cos(b): the velocities couple through position."""
    return signals["a"] + 0.2 * jnp.sin(signals["b"])


def coupled():
    """Two masses on a hardening spring; a belt couples their inertias."""
    first = Equation(
        Term("m1", "a", derivative=2, measured=("va", "acc_a"), unit="kg"),
        Term("J", inertia_coupling, derivative=2),
        Term("c", "va"),
        -Term("k", spring_force),
        -Term(1.0, "u"),
        name="first",
    )
    second = Equation(
        Term("m2", "b", derivative=2, unit="kg"),
        Term("c", "b", derivative=1),
        Term("J2", "a", derivative=2),
        Term("k", spring_force),
        -Term(2.0, "w"),
        name="second",
    )
    return simultaneous(first, second)


VALUES = {"m1": 1.0, "m2": 2.0, "J": 0.4, "J2": 0.3, "c": 0.5, "k": 40.0}


def mass_matrix(b):
    return np.array([[1.4, 0.4 * 0.2 * np.cos(b)], [0.3, 2.0]])


def test_two_coupled_masses_move_as_scipy_says():
    system = equation_system(coupled(), VALUES)
    assert system.state_names == ("a", "va", "b", "db")
    assert system.input_names == ("u", "w")
    time = np.arange(201) * 0.01
    inputs = {"u": 3 * time, "w": 2.0 - time}  # linear in time, so exact between samples

    def right_hand_side(t, x):
        a, va, b, vb = x
        spring = 40.0 * ((b - a) + 5 * (b - a) ** 3)
        # d2/dt2 of 0.2 sin b is 0.2 cos b b'' - 0.2 sin b b'^2.
        force = [
            3 * t + spring - 0.5 * va + 0.4 * 0.2 * np.sin(b) * vb**2,
            2 * (2.0 - t) - spring - 0.5 * vb,
        ]
        acc = np.linalg.solve(mass_matrix(b), force)
        return [va, acc[0], vb, acc[1]]

    start = {"a": 0.3, "b": -0.4, "va": 1.0}
    exact = solve_ivp(
        right_hand_side,
        (0, 2),
        [0.3, 1.0, -0.4, 0.0],
        method="DOP853",
        t_eval=time,
        rtol=1e-11,
        atol=1e-12,
    ).y
    found = simulate(system, Record(inputs, 0.01), initial_state=start, method=FixedStep(16)).record
    for row, name in zip(exact, system.state_names):
        np.testing.assert_allclose(found[name], row, atol=1e-7, err_msg=name)
    acceleration = [right_hand_side(t, x)[1] for t, x in zip(time, exact.T)]
    np.testing.assert_allclose(found["acc_a"], acceleration, atol=1e-5)


CALLS: list[int] = []


def counted(signals):
    CALLS.append(1)
    return signals["y"] ** 3


def test_new_values_do_not_compile_anew():
    equation = Equation(
        Term("m", "y", derivative=2), Term("k3", counted), -Term(1.0, "u"), name="counted"
    )
    compiled = eqx.filter_jit(lambda system, u: simulate(system, u).record["y"])
    systems = [equation_system(equation, {"m": m, "k3": k}) for m, k in ((1, 2), (3, 4.5))]
    compiled(systems[0], drive("u", 20))
    traced = len(CALLS)
    compiled(systems[1], drive("u", 20))
    assert len(CALLS) == traced


def velocity(signals):
    return signals["v"]


def test_first_order_friction_equation_slides_to_a_stop_in_closed_form():
    equation = Equation(
        Term("M", "v", derivative=1, unit="kg"),
        Terms("F", RoofFunctions([-2.0, -1.0, 1.0, 2.0]), of=velocity, unit="N"),
        -Term(1.0, "force"),
        name="slider",
    )
    # Forces at the break points make F = 3 v between -1 and 1.
    values = {"M": 2.0, "F_1": -4.0, "F_2": -3.0, "F_3": 3.0, "F_4": 4.0}
    system = equation_system(equation, values)
    assert (system.state_names, system.input_names) == (("v",), ("force",))
    record = simulate(
        system, Record({"force": np.zeros(100)}, 0.02), initial_state={"v": 0.9}
    ).record
    np.testing.assert_allclose(record["v"], 0.9 * np.exp(-1.5 * np.asarray(record.time)), rtol=1e-9)


QUARTER_CAR = {
    "K_t": 180e3,
    "M_us": 45.0,
    "M_s": 300.0,
    "K_s": 20e3,
    "F_1": -900.0,
    "F_2": -500.0,
    "F_3": 700.0,
    "F_4": 1300.0,
}


def across_tyre(signals):
    return signals["v_r"] - signals["x3"]


def across_suspension(signals):
    return signals["x3"] - signals["x4"]


@pytest.mark.parametrize("procedure", [quarter_car_by_body, *nightly([quarter_car_by_wheel])])
def test_quarter_car_procedure_with_kinematics_is_the_hand_written_system(procedure):
    """Its tyre equation has no derivative: it determines the tyre force."""
    rates = {"x1": across_tyre, "x2": across_suspension}
    made = equation_system(procedure(), QUARTER_CAR, rates=rates)
    by_hand = quarter_car_system(arrays(QUARTER_CAR))
    assert made.state_names == ("x3", "x4", "x1", "x2")
    assert made.input_names == ("v_r",)
    inputs = Record({"v_r": 0.5 * np.sin(np.arange(300) * 0.3)}, 0.005)
    found, expected = (simulate(system, inputs).checked().record for system in (made, by_hand))
    assert set(found.arrays) == set(expected.arrays)
    for name in expected.arrays:
        scale = float(jnp.max(jnp.abs(expected[name])))
        np.testing.assert_allclose(found[name], expected[name], atol=1e-10 * scale, err_msg=name)


def momentum(signals):
    return signals["m_dot"] * signals["v"]


def squared_acceleration(signals):
    return signals["ddy"] ** 2


def fails(signals):
    raise RuntimeError("no such thing")


def sums(signals):
    return jnp.sum(signals["y"])


def acceleration(*rest):
    return Equation(Term("m", "y", derivative=2), -Term(1.0, "u"), *rest, name="bad")


@pytest.mark.parametrize(
    ("model", "values", "message"),
    [
        (Equation(Term("k", "y"), -Term(1.0, "u")), {"k": 1.0}, "no derivative.*static"),
        (acceleration(), {"m": 0.0}, "coefficient of ddy is zero"),
        (acceleration(), {}, "no value is given for m"),
        (acceleration(), {"m": [1.0, 2.0]}, "one number"),
        (acceleration(Term("m", "z", derivative=2)), {"m": 1.0}, "1 equation.* 2 unknown"),
        (acceleration(Term("k", squared_acceleration)), {"m": 1.0, "k": 1.0}, "linearly"),
        (
            acceleration(Term("k", momentum, derivative=1)),
            {"m": 1.0, "k": 1.0},
            r"derivatives of m_dot, v.* write Term\('NAME', 'm_dot', derivative=2, measured=\(",
        ),
        (
            Equation(Term("J", momentum, derivative=1), -Term(1.0, "u")),
            {"J": 1.0},
            r"derivative of the expression momentum \(of .*--derive NAME=FORMULA",
        ),
        (
            acceleration(Term("k", fails)),
            {"m": 1.0, "k": 1.0},
            "fails failed at line .*: RuntimeError",
        ),
        (acceleration(Term("k", sums)), {"m": 1.0, "k": 1.0}, "one number for each sample"),
        (
            acceleration(Term("m", "ddy", derivative=1)),
            {"m": 1.0},
            "order 3",
        ),
        (staged(acceleration(), acceleration()), {"m": 1.0}, r"2 equation\(s\) for 1"),
        (
            simultaneous(
                Equation(Term("m", "a", derivative=1), Term("m", "b", derivative=1), name="a"),
                Equation(Term("n", "a", derivative=1), Term("n", "b", derivative=1), name="b"),
            ),
            {"m": 1.0, "n": 3.0},
            "not independent",
        ),
        (
            staged(acceleration(), Equation(Term("k", "y"), Term("c", "z"), name="static")),
            {"m": 1.0, "k": 1.0, "c": 1.0},
            "static holds no leading derivative",
        ),
    ],
)
def test_what_cannot_be_simulated_is_said_in_one_line(model, values, message):
    with pytest.raises(ModelError, match=message) as caught:
        equation_system(model, values)
    assert "\n" not in str(caught.value)
