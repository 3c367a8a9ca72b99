"""The two-mass demonstration of Section 2: one mode that a one-mass model leaves out."""

from collections.abc import Mapping
from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from riecjax.equations.equation import Equation
from riecjax.equations.term import Term
from riecjax.simulation.system import AbstractSystem, Quantities


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

    def derivative(
        self, state: Float[Array, " 4"], inputs: Float[Array, " 1"]
    ) -> Float[Array, " 4"]:
        """Velocities and accelerations."""
        _, dz, d, dd = (state[i] for i in range(4))
        reduced = self.m1 * self.m2 / (self.m1 + self.m2)
        coupling = reduced * self.omega_n * (self.omega_n * d + 2 * self.zeta * dd)
        first = (inputs[0] + coupling) / self.m1
        return jnp.stack([dz, first, dd, -coupling / self.m2 - first])

    def output(self, state: Float[Array, " 4"], inputs: Float[Array, " 1"]) -> Mapping[str, Array]:
        """The equation error of the one-mass model with M = m1 + m2, eq. (6), in N.

        M z'' = F + error, so error = -m2 d'' with d measured from m1; eq. (6) counts it the
        other way round.
        """
        return {"error": -self.m2 * self.derivative(state, inputs)[3]}


def two_mass_system(parameters: Mapping[str, Array]) -> TwoMass:
    """The two masses with these parameters."""
    return TwoMass(**parameters)
