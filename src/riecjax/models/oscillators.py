"""One-degree-of-freedom models: oscillators, a pendulum, an axis with friction, two masses."""

from collections.abc import Mapping

import jax.numpy as jnp
from jaxtyping import Array

from riecjax.equations.equation import Equation
from riecjax.equations.equation_system import EquationSystem
from riecjax.equations.expressions import constant, even, odd
from riecjax.equations.model import equation_system, simultaneous
from riecjax.equations.term import Term
from riecjax.records.record import Signals


def _sine(signals: Signals) -> Array:
    return jnp.sin(signals["theta"])


def duffing_equation() -> Equation:
    """m y'' + d y' + k1 y + k2 y^2 + k3 y^3 = u."""
    return Equation(
        Term("m", "y", derivative=2, measured=("dy", "ddy"), unit="kg"),
        Term("d", "y", derivative=1, measured=("dy",), unit="N s/m"),
        Term("k1", "y", unit="N/m"),
        Term("k2", even("y", 2), unit="N/m^2"),
        Term("k3", odd("y", 3), unit="N/m^3"),
        -Term(1.0, "u"),
        name="duffing",
        unit="N",
    )


def drag_oscillator_equation() -> Equation:
    """m x'' + r x' + r2 x'|x'| + k x = u."""
    return Equation(
        Term("m", "x", derivative=2, measured=("dx", "ddx"), unit="kg"),
        Term("r", "x", derivative=1, measured=("dx",), unit="N s/m"),
        Term("r2", odd("dx", 2), unit="N s^2/m^2"),
        Term("k", "x", unit="N/m"),
        -Term(1.0, "u"),
        name="drag-oscillator",
        unit="N",
    )


def pendulum_equation() -> Equation:
    """theta'' = p1 sin(theta) - p2 theta', theta zero upright: p1 = m g a / J, p2 = k / J."""
    return Equation(
        Term(1.0, "theta", derivative=2, measured=("dtheta", "ddtheta")),
        -Term("p1", _sine, unit="1/s^2"),
        Term("p2", "theta", derivative=1, measured=("dtheta",), unit="1/s"),
        name="pendulum",
        unit="rad/s^2",
    )


def pendulum_system(parameters: Mapping[str, Array]) -> EquationSystem:
    """The pendulum under a torque over its inertia, which a free swing has none of."""
    swinging = pendulum_equation()
    driven = swinging.of_terms(*swinging.terms, -Term(1.0, "torque"))
    units = {"theta": "rad", "dtheta": "rad/s", "torque": "1/s^2"}
    return equation_system(driven, parameters, units=units)


def _forward_speed(signals: Signals) -> Array:
    return jnp.maximum(signals["dq"], 0.0)


def _backward_speed(signals: Signals) -> Array:
    return jnp.minimum(signals["dq"], 0.0)


def _forward(signals: Signals) -> Array:
    return jnp.where(signals["dq"] > 0, 1.0, 0.0)


def _backward(signals: Signals) -> Array:
    return jnp.where(signals["dq"] < 0, -1.0, 0.0)


INERTIA = Term("M", "q", derivative=2, measured=("dq", "ddq"), unit="kg")


def emps_equation() -> Equation:
    """M q'' + Fv q' + Fc sign(q') + offset = force: EMPS, an electro-mechanical positioning axis.

    A. Janot, M. Gautier and M. Brunot, "Data Set and Reference Models of EMPS", Workshop on
    Nonlinear System Identification Benchmarks, Eindhoven, 2019.
    """
    return Equation(
        INERTIA,
        Term("Fv", "q", derivative=1, measured=("dq",), unit="N s/m"),
        Term("Fc", odd("dq", 0), unit="N"),
        Term("offset", constant, unit="N"),
        -Term(1.0, "force"),
        name="emps",
        unit="N",
    )


def emps_asymmetric_equation() -> Equation:
    """M q'' + friction = force, with different viscous and Coulomb friction in each direction."""
    return Equation(
        INERTIA,
        Term("Fv_pos", _forward_speed, unit="N s/m"),
        Term("Fc_pos", _forward, unit="N"),
        Term("Fv_neg", _backward_speed, unit="N s/m"),
        Term("Fc_neg", _backward, unit="N"),
        -Term(1.0, "force"),
        name="emps-asymmetric",
        unit="N",
    )


def two_mass_equation() -> Equation:
    """M z'' = F, eq. (5) without its error: M stands for m1 + m2."""
    return Equation(
        Term("M", "z", derivative=2, measured=("dz", "ddz"), unit="kg"),
        -Term(1.0, "F", unit="N"),
        name="two-mass",
        unit="N",
    )


def two_mass_system(parameters: Mapping[str, Array]) -> EquationSystem:
    """Mass m1 under a force F, with m2 on a linear spring and damper (Fig. 1).

    `z` is the displacement of m1, where the sensor sits, and `d` that of m2 relative to it. The
    text gives omega_n and zeta of their coupling; they are taken as those of the free relative
    motion, d'' + 2 zeta omega_n d' + omega_n^2 d = -F / m1.

    `error` is the equation error of the one-mass model with M = m1 + m2, eq. (6), in N:
    M z'' = F + error, so error = -m2 d'' with d measured from m1; eq. (6) counts it the other way
    round.
    """
    m1, m2, omega_n, zeta = (parameters[name] for name in ("m1", "m2", "omega_n", "zeta"))
    reduced, share = m1 * m2 / (m1 + m2), m2 / m1
    stiffness, damping = reduced * omega_n**2, 2 * reduced * omega_n * zeta
    coupling = Term("K", "d"), Term("B", "d", derivative=1)
    first = Term("m1", "z", derivative=2), *(-term for term in coupling), -Term(1.0, "F")
    second = Term("m2", "z", derivative=2), Term("m2", "d", derivative=2), *coupling
    scaled = Term("K", "d", sign=-1 - share), Term("B", "d", derivative=1, sign=-1 - share)
    error = Term(1.0, "error"), *scaled, -Term(share, "F")
    return equation_system(
        simultaneous(*(Equation(*terms) for terms in (first, second, error))),
        {"m1": m1, "m2": m2, "K": stiffness, "B": damping},
        units={"z": "m", "dz": "m/s", "d": "m", "dd": "m/s", "F": "N", "error": "N"},
    )
