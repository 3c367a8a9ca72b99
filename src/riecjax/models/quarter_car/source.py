"""The seven-state source model, eqs (19)-(20), that stands in for the real vehicle.

The paper draws the force curves of damper, spring and mount (Fig. 5) but its text does not give
them. The families here keep what the text says; their constants are reconstructed, see
`riecjax.models.quarter_car.reconstruction`.
"""

from collections.abc import Callable, Mapping
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from riecjax.simulation import AbstractSystem

GRAVITY = 9.81

Curve = Callable[[Array], Array]
"""A force in N over a deflection in m or a velocity in m/s."""


class QuarterCarSource(AbstractSystem):
    """Quarter car with engine on its mount and a compliant damper, eqs (19)-(20).

    Displacements and velocities are positive downwards and zero at static load. `x1` is the tyre's
    extension (road minus wheel), `x2` wheel minus body, `x5` body minus engine; `x3`, `x4`, `x6`
    the velocities of wheel, body and engine; `x7` the velocity across the damper, whose compliance
    takes up the rest of `x3 - x4`.

    **Fields:** masses in kg, `tyre_stiffness` K_t and `damper_compliance` K_c in N/m,
    `mount_damping` B_m in N s/m; `damper`, `spring` and `mount` are the force curves F_d(x7),
    F_s(x2) and F_ms(x5).
    """

    wheel_mass: Float[Array, ""]
    body_mass: Float[Array, ""]
    engine_mass: Float[Array, ""]
    tyre_stiffness: Float[Array, ""]
    damper_compliance: Float[Array, ""]
    mount_damping: Float[Array, ""]
    damper: Curve
    spring: Curve
    mount: Curve

    states: ClassVar = (
        ("x1", "m"),
        ("x2", "m"),
        ("x3", "m/s"),
        ("x4", "m/s"),
        ("x5", "m"),
        ("x6", "m/s"),
        ("x7", "m/s"),
    )
    inputs: ClassVar = (("v_r", "m/s"),)
    outputs: ClassVar = (("F_t", "N"),)

    @property
    def lift_off_force(self) -> Float[Array, ""]:
        """W_t of eq. (20) in N: the static load, at which the tyre leaves the road."""
        return (self.engine_mass + self.body_mass + self.wheel_mass) * GRAVITY

    def tyre_force(self, extension: Array) -> Array:
        """F_t of eq. (20) in N."""
        return jnp.minimum(self.tyre_stiffness * extension, self.lift_off_force)

    def derivative(self, state: Array, inputs: Array) -> Array:
        """Eq. (19)."""
        x1, x2, x3, x4, x5, x6, x7 = (state[i] for i in range(7))
        damping, slope = jax.value_and_grad(self.damper)(x7)
        suspension = self.spring(x2) + damping
        mount = self.mount(x5) + self.mount_damping * (x4 - x6)
        return jnp.stack(
            [
                inputs[0] - x3,
                x3 - x4,
                (self.tyre_force(x1) - suspension) / self.wheel_mass,
                (suspension - mount) / self.body_mass,
                x4 - x6,
                mount / self.engine_mass,
                self.damper_compliance / slope * (x3 - x4 - x7),
            ]
        )

    def output(self, state: Array, inputs: Array) -> Mapping[str, Array]:
        """Tyre force F_t in N."""
        return {"F_t": self.tyre_force(state[0])}


class DigressiveDamper(eqx.Module):
    """Damper force over velocity, steep at low speed, flatter beyond a knee.

    F(v) = c v + (c0 - c) v / sqrt(1 + (v / v_knee)^2), with its own c and v_knee for each
    direction; smooth, zero at rest, slope c0 at rest.

    **Fields:**

    - `low_speed_rate`: c0 in N s/m.
    - `high_speed_rates`: c in N s/m for compression (v < 0) and rebound (v > 0).
    - `knees`: v_knee in m/s for compression and rebound.
    """

    low_speed_rate: Float[Array, ""]
    high_speed_rates: Float[Array, " 2"]
    knees: Float[Array, " 2"]

    def __call__(self, velocity: Array) -> Array:
        """Force in N at a velocity in m/s."""
        rebound = velocity > 0
        rate = jnp.where(rebound, self.high_speed_rates[1], self.high_speed_rates[0])
        knee = jnp.where(rebound, self.knees[1], self.knees[0])
        bend = jax.lax.rsqrt(1 + (velocity / knee) ** 2)
        return velocity * (rate + (self.low_speed_rate - rate) * bend)


class BumpStopSpring(eqx.Module):
    """Spring force over deflection: linear, and stiffer beyond a gap on either side.

    F(x) = k x + k_stop h(x), where h is the deflection beyond the gap.

    **Fields:**

    - `rate`: first-stage stiffness k in N/m.
    - `gaps`: free travel in m in compression (x < 0) and rebound (x > 0).
    - `stop_rates`: k_stop in N/m for compression and rebound.
    """

    rate: Float[Array, ""]
    gaps: Float[Array, " 2"]
    stop_rates: Float[Array, " 2"]

    def __call__(self, deflection: Array) -> Array:
        """Force in N at a deflection in m."""
        compression = jnp.maximum(-deflection - self.gaps[0], 0.0)
        rebound = jnp.maximum(deflection - self.gaps[1], 0.0)
        return (
            self.rate * deflection - self.stop_rates[0] * compression + self.stop_rates[1] * rebound
        )


class HardeningMount(eqx.Module):
    """Engine-mount spring force over deflection: F(x) = k x + k_3 x^3.

    **Fields:** `rate` k in N/m for small motion; `cubic` k_3 in N/m^3.
    """

    rate: Float[Array, ""]
    cubic: Float[Array, ""]

    def __call__(self, deflection: Array) -> Array:
        """Force in N at a deflection in m."""
        return deflection * (self.rate + self.cubic * deflection**2)
