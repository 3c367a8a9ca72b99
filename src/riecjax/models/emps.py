"""EMPS: an electro-mechanical positioning axis with friction.

A. Janot, M. Gautier and M. Brunot, "Data Set and Reference Models of EMPS", Workshop on Nonlinear
System Identification Benchmarks, Eindhoven, 2019.
"""

from collections.abc import Mapping
from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from riecjax.equations.equation import Equation
from riecjax.equations.term import Term
from riecjax.records.record import Signals
from riecjax.simulation.system import AbstractSystem, Quantities


def _direction(signals: Signals) -> Array:
    return jnp.sign(signals["dq"])


def _one(signals: Signals) -> Array:
    return jnp.ones_like(signals["dq"])


def _forward_speed(signals: Signals) -> Array:
    return jnp.maximum(signals["dq"], 0.0)


def _backward_speed(signals: Signals) -> Array:
    return jnp.minimum(signals["dq"], 0.0)


def _forward(signals: Signals) -> Array:
    return jnp.where(signals["dq"] > 0, 1.0, 0.0)


def _backward(signals: Signals) -> Array:
    return jnp.where(signals["dq"] < 0, -1.0, 0.0)


def _inertia() -> Term:
    return Term("M", "q", derivative=2, measured=("dq", "ddq"), unit="kg")


def emps_equation() -> Equation:
    """M q'' + Fv q' + Fc sign(q') + offset = force."""
    return Equation(
        _inertia(),
        Term("Fv", "q", derivative=1, measured=("dq",), unit="N s/m"),
        Term("Fc", _direction, unit="N"),
        Term("offset", _one, unit="N"),
        -Term(1.0, "force"),
        name="emps",
        unit="N",
    )


def emps_asymmetric_equation() -> Equation:
    """M q'' + friction = force, with different viscous and Coulomb friction in each direction."""
    return Equation(
        _inertia(),
        Term("Fv_pos", _forward_speed, unit="N s/m"),
        Term("Fc_pos", _forward, unit="N"),
        Term("Fv_neg", _backward_speed, unit="N s/m"),
        Term("Fc_neg", _backward, unit="N"),
        -Term(1.0, "force"),
        name="emps-asymmetric",
        unit="N",
    )


class Axis(AbstractSystem):
    """A mass with friction that may differ between the directions, driven by a force.

    **Fields:** `M` in kg; `Fv_pos`, `Fv_neg` in N s/m; `Fc_pos`, `Fc_neg`, `offset` in N.
    """

    M: Float[Array, ""]
    Fv_pos: Float[Array, ""]
    Fc_pos: Float[Array, ""]
    Fv_neg: Float[Array, ""]
    Fc_neg: Float[Array, ""]
    offset: Float[Array, ""]

    states: ClassVar[Quantities] = (("q", "m"), ("dq", "m/s"))
    inputs: ClassVar[Quantities] = (("force", "N"),)

    @property
    def reversing(self) -> tuple[str, ...]:
        """The velocity, with whose sign the friction changes."""
        return ("dq",)

    def derivative(self, state: Array, inputs: Array) -> Array:
        """Velocity and acceleration."""
        velocity = state[1]
        forward = self.Fv_pos * velocity + self.Fc_pos
        backward = self.Fv_neg * velocity - self.Fc_neg
        friction = jnp.where(velocity > 0, forward, jnp.where(velocity < 0, backward, 0.0))
        return jnp.stack([velocity, (inputs[0] - self.offset - friction) / self.M])


def emps_system(parameters: Mapping[str, Array]) -> Axis:
    """The axis with symmetric friction."""
    p = parameters
    return Axis(p["M"], p["Fv"], p["Fc"], p["Fv"], p["Fc"], p["offset"])


def emps_asymmetric_system(parameters: Mapping[str, Array]) -> Axis:
    """The axis with asymmetric friction."""
    return Axis(**parameters, offset=jnp.zeros(()))
