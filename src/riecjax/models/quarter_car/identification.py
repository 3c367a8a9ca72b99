"""The four-state identification model, eqs (21)-(22), as a system to simulate."""

from collections.abc import Mapping
from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from riecjax.equations.bases import RoofFunctions
from riecjax.simulation.system import AbstractSystem, Quantities

BREAK_POINTS = (-0.8, -0.3, 0.3, 0.8)
"""Suspension velocities v_i of the damper map in m/s (Table 2)."""


class QuarterCar(AbstractSystem):
    """Two masses, linear but for a damper map F_di = sum F_i R_i(x3 - x4), eqs (21)-(22).

    States and signs are those of the source model's `x1` to `x4`.

    **Fields:** `K_t`, `K_s` in N/m; `M_us`, `M_s` in kg; `F` damper forces in N at the break
    points; `roof` the damper map's functions.
    """

    K_t: Float[Array, ""]
    M_us: Float[Array, ""]
    M_s: Float[Array, ""]
    K_s: Float[Array, ""]
    F: Float[Array, " points"]
    roof: RoofFunctions

    states: ClassVar[Quantities] = (("x1", "m"), ("x2", "m"), ("x3", "m/s"), ("x4", "m/s"))
    inputs: ClassVar[Quantities] = (("v_r", "m/s"),)
    outputs: ClassVar[Quantities] = (("F_t", "N"),)

    @classmethod
    def from_parameters(cls, parameters: Mapping[str, Array]) -> "QuarterCar":
        """The model with these values of `K_t, M_us, M_s, K_s, F_1 ... F_4`."""
        forces = jnp.stack([jnp.asarray(parameters[f"F_{i}"]) for i in range(1, 5)])
        named = {name: jnp.asarray(parameters[name]) for name in ("K_t", "M_us", "M_s", "K_s")}
        return cls(**named, F=forces, roof=RoofFunctions(BREAK_POINTS))

    def derivative(
        self, state: Float[Array, " 4"], inputs: Float[Array, " 1"]
    ) -> Float[Array, " 4"]:
        """Eq. (21)."""
        x1, x2, x3, x4 = (state[i] for i in range(4))
        suspension = self.K_s * x2 + self.roof.interpolate(self.F, x3 - x4)
        return jnp.stack(
            [
                inputs[0] - x3,
                x3 - x4,
                (self.K_t * x1 - suspension) / self.M_us,
                suspension / self.M_s,
            ]
        )

    def output(self, state: Float[Array, " 4"], inputs: Float[Array, " 1"]) -> Mapping[str, Array]:
        """Tyre force F_t in N."""
        return {"F_t": self.K_t * state[0]}


def quarter_car_system(parameters: Mapping[str, Array]) -> QuarterCar:
    """The identification model with these parameters."""
    return QuarterCar.from_parameters(parameters)
