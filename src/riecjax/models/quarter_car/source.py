"""The seven-state source model, eqs (19)-(20), that stands in for the real vehicle."""

from collections.abc import Mapping
from typing import ClassVar, Protocol

import jax.numpy as jnp
from jaxtyping import Array, Float

from riecjax.simulation.system import AbstractSystem, Quantities

GRAVITY = 9.81


class Curve(Protocol):
    """A force in N over a deflection in m or a velocity in m/s."""

    def __call__(self, x: Array, /) -> Array:
        """The force at x."""
        ...


class DamperCurve(Curve, Protocol):
    """A damper's force over velocity, with its slope, by which x7 is governed."""

    def slope(self, velocity: Array, /) -> Array:
        """dF/dv in N s/m."""
        ...


class QuarterCarSource(AbstractSystem):
    """Quarter car with engine on its mount and a compliant damper, eqs (19)-(20).

    Displacements and velocities are positive downwards and zero at static load. `x1` is the tyre's
    extension (road minus wheel), `x2` wheel minus body, `x5` body minus engine; `x3`, `x4`, `x6`
    the velocities of wheel, body and engine; `x7` the velocity across the damper, whose compliance
    takes up the rest of `x3 - x4`.

    **Fields:** masses in kg, `tyre_stiffness` K_t and `damper_compliance` K_c in N/m,
    `mount_damping` B_m in N s/m; `damper`, `spring` and `mount` are the force curves F_d(x7),
    F_s(x2) and F_ms(x5), the first with a method `slope`.
    """

    wheel_mass: Float[Array, ""]
    body_mass: Float[Array, ""]
    engine_mass: Float[Array, ""]
    tyre_stiffness: Float[Array, ""]
    damper_compliance: Float[Array, ""]
    mount_damping: Float[Array, ""]
    damper: DamperCurve
    spring: Curve
    mount: Curve

    states: ClassVar[Quantities] = (
        ("x1", "m"),
        ("x2", "m"),
        ("x3", "m/s"),
        ("x4", "m/s"),
        ("x5", "m"),
        ("x6", "m/s"),
        ("x7", "m/s"),
    )
    inputs: ClassVar[Quantities] = (("v_r", "m/s"),)
    outputs: ClassVar[Quantities] = (("F_t", "N"),)

    @property
    def lift_off_force(self) -> Float[Array, ""]:
        """W_t of eq. (20) in N: the static load, at which the tyre leaves the road."""
        return (self.engine_mass + self.body_mass + self.wheel_mass) * GRAVITY

    def tyre_force(self, extension: Array) -> Array:
        """F_t of eq. (20) in N."""
        return jnp.minimum(self.tyre_stiffness * extension, self.lift_off_force)

    def derivative(
        self, state: Float[Array, " 7"], inputs: Float[Array, " 1"]
    ) -> Float[Array, " 7"]:
        """Eq. (19)."""
        x1, x2, x3, x4, x5, x6, x7 = (state[i] for i in range(7))
        suspension = self.spring(x2) + self.damper(x7)
        mount = self.mount(x5) + self.mount_damping * (x4 - x6)
        relaxation = self.damper_compliance / self.damper.slope(x7)
        return jnp.stack(
            [
                inputs[0] - x3,
                x3 - x4,
                (self.tyre_force(x1) - suspension) / self.wheel_mass,
                (suspension - mount) / self.body_mass,
                x4 - x6,
                mount / self.engine_mass,
                relaxation * (x3 - x4 - x7),
            ]
        )

    def output(self, state: Float[Array, " 7"], inputs: Float[Array, " 1"]) -> Mapping[str, Array]:
        """Tyre force F_t in N."""
        return {"F_t": self.tyre_force(state[0])}


def contact_share(tyre_extension: Array, source: QuarterCarSource) -> Array:
    """Share of the samples at which the tyre touches the road."""
    lift_off = source.lift_off_force / source.tyre_stiffness
    return jnp.mean(tyre_extension <= lift_off, axis=-1, dtype=tyre_extension.dtype)
