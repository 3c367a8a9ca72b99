"""One-degree-of-freedom models: Duffing oscillator, oscillator with drag, pendulum."""

from collections.abc import Mapping
from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from riecjax.equations.equation import Equation
from riecjax.equations.term import Term
from riecjax.records.record import Signals
from riecjax.simulation.system import AbstractSystem, Quantities


def _square(signals: Signals) -> Array:
    return signals["y"] ** 2


def _cube(signals: Signals) -> Array:
    return signals["y"] ** 3


def _drag(signals: Signals) -> Array:
    return signals["dx"] * jnp.abs(signals["dx"])


def _sine(signals: Signals) -> Array:
    return jnp.sin(signals["theta"])


def duffing_equation() -> Equation:
    """m y'' + d y' + k1 y + k2 y^2 + k3 y^3 = u."""
    return Equation(
        Term("m", "y", derivative=2, measured=("dy", "ddy"), unit="kg"),
        Term("d", "y", derivative=1, measured=("dy",), unit="N s/m"),
        Term("k1", "y", unit="N/m"),
        Term("k2", _square, unit="N/m^2"),
        Term("k3", _cube, unit="N/m^3"),
        -Term(1.0, "u"),
        name="duffing",
        unit="N",
    )


def drag_oscillator_equation() -> Equation:
    """m x'' + r x' + r2 x'|x'| + k x = u."""
    return Equation(
        Term("m", "x", derivative=2, measured=("dx", "ddx"), unit="kg"),
        Term("r", "x", derivative=1, measured=("dx",), unit="N s/m"),
        Term("r2", _drag, unit="N s^2/m^2"),
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


class Duffing(AbstractSystem):
    """m y'' + d y' + k1 y + k2 y^2 + k3 y^3 = u; fields are these parameters, in SI units."""

    m: Float[Array, ""]
    d: Float[Array, ""]
    k1: Float[Array, ""]
    k2: Float[Array, ""]
    k3: Float[Array, ""]

    states: ClassVar[Quantities] = (("y", "m"), ("dy", "m/s"))
    inputs: ClassVar[Quantities] = (("u", "N"),)

    def derivative(self, state: Array, inputs: Array) -> Array:
        """Velocity and acceleration."""
        y, dy = state[0], state[1]
        spring = y * (self.k1 + y * (self.k2 + y * self.k3))
        return jnp.stack([dy, (inputs[0] - self.d * dy - spring) / self.m])


class DragOscillator(AbstractSystem):
    """m x'' + r x' + r2 x'|x'| + k x = u; fields are these parameters, in SI units."""

    m: Float[Array, ""]
    r: Float[Array, ""]
    r2: Float[Array, ""]
    k: Float[Array, ""]

    states: ClassVar[Quantities] = (("x", "m"), ("dx", "m/s"))
    inputs: ClassVar[Quantities] = (("u", "N"),)

    def derivative(self, state: Array, inputs: Array) -> Array:
        """Velocity and acceleration."""
        x, dx = state[0], state[1]
        force = inputs[0] - (self.r + self.r2 * jnp.abs(dx)) * dx - self.k * x
        return jnp.stack([dx, force / self.m])


class Pendulum(AbstractSystem):
    """theta'' = p1 sin(theta) - p2 theta' + torque; theta is zero upright and pi hanging.

    The input `torque` is per inertia, in 1/s^2; a free swing has none.
    """

    p1: Float[Array, ""]
    p2: Float[Array, ""]

    states: ClassVar[Quantities] = (("theta", "rad"), ("dtheta", "rad/s"))
    inputs: ClassVar[Quantities] = (("torque", "1/s^2"),)

    def derivative(self, state: Array, inputs: Array) -> Array:
        """Angular velocity and acceleration."""
        theta, dtheta = state[0], state[1]
        return jnp.stack([dtheta, self.p1 * jnp.sin(theta) - self.p2 * dtheta + inputs[0]])


def duffing_system(parameters: Mapping[str, Array]) -> Duffing:
    """Duffing oscillator with these parameters."""
    return Duffing(**parameters)


def drag_oscillator_system(parameters: Mapping[str, Array]) -> DragOscillator:
    """Oscillator with drag and these parameters."""
    return DragOscillator(**parameters)


def pendulum_system(parameters: Mapping[str, Array]) -> Pendulum:
    """Pendulum with these parameters."""
    return Pendulum(**parameters)


def two_mass_equation() -> Equation:
    """M z'' = F, eq. (5) without its error: M stands for m1 + m2."""
    return Equation(
        Term("M", "z", derivative=2, measured=("dz", "ddz"), unit="kg"),
        -Term(1.0, "F", unit="N"),
        name="two-mass",
        unit="N",
    )


class TwoMass(AbstractSystem):
    """Mass m1 under a force F, with m2 on a linear spring and damper (Fig. 1).

    `z` is the displacement of m1, where the sensor sits, and `d` that of m2 relative to it. The
    text gives omega_n and zeta of their coupling; they are taken as those of the free relative
    motion, d'' + 2 zeta omega_n d' + omega_n^2 d = -F / m1.

    **Fields:** `m1`, `m2` in kg; `omega_n` in rad/s; `zeta`.
    """

    m1: Float[Array, ""]
    m2: Float[Array, ""]
    omega_n: Float[Array, ""]
    zeta: Float[Array, ""]

    states: ClassVar[Quantities] = (("z", "m"), ("dz", "m/s"), ("d", "m"), ("dd", "m/s"))
    inputs: ClassVar[Quantities] = (("F", "N"),)
    outputs: ClassVar[Quantities] = (("error", "N"),)

    def derivative(self, state: Array, inputs: Array) -> Array:
        """Velocities and accelerations."""
        _, dz, d, dd = (state[i] for i in range(4))
        reduced = self.m1 * self.m2 / (self.m1 + self.m2)
        coupling = reduced * self.omega_n * (self.omega_n * d + 2 * self.zeta * dd)
        first = (inputs[0] + coupling) / self.m1
        return jnp.stack([dz, first, dd, -coupling / self.m2 - first])

    def output(self, state: Array, inputs: Array) -> Mapping[str, Array]:
        """The equation error of the one-mass model with M = m1 + m2, eq. (6), in N.

        M z'' = F + error, so error = -m2 d'' with d measured from m1; eq. (6) counts it the
        other way round.
        """
        return {"error": -self.m2 * self.derivative(state, inputs)[3]}


def two_mass_system(parameters: Mapping[str, Array]) -> TwoMass:
    """The two masses with these parameters."""
    return TwoMass(**parameters)
