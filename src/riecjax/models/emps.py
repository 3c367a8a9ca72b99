"""EMPS: an electro-mechanical positioning axis with friction.

A. Janot, M. Gautier and M. Brunot, "Data Set and Reference Models of EMPS", Workshop on Nonlinear
System Identification Benchmarks, Eindhoven, 2019.
"""

import jax.numpy as jnp
from jaxtyping import Array

from riecjax.equations.equation import Equation
from riecjax.equations.expressions import constant, odd
from riecjax.equations.term import Term
from riecjax.records.record import Signals


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
    """M q'' + Fv q' + Fc sign(q') + offset = force."""
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
