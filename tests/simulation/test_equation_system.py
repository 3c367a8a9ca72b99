"""Systems made from equations, against hand-written ones, SciPy, closed forms and differences."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from riecjax.equations.equation import Equation
from riecjax.equations.model import equation_system, simultaneous, staged
from riecjax.equations.term import Term
from riecjax.errors import ModelError
from riecjax.records.record import Record
from riecjax.simulation.method import FixedStep
from riecjax.simulation.simulate import simulate


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


def momentum(signals):
    return signals["m_dot"] * signals["v"]


def squared_acceleration(signals):
    return signals["ddy"] ** 2


def fails(signals):
    raise RuntimeError("no such thing")


def acceleration(*rest):
    return Equation(Term("m", "y", derivative=2), -Term(1.0, "u"), *rest, name="bad")


@pytest.mark.parametrize(
    ("model", "values", "message"),
    [
        (Equation(Term("k", "y"), -Term(1.0, "u")), {"k": 1.0}, "no derivative.*static"),
        (acceleration(), {"m": 0.0}, "coefficient of ddy is zero"),
        (acceleration(), {}, "no value is given for m"),
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
