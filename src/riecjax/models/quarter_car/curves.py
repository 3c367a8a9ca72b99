"""Force curves of the source model: damper, suspension spring with bump stops, engine mount.

The paper draws them (Fig. 5) but its text does not give them. These families keep what the text
says; their constants are reconstructed, see `riecjax.models.quarter_car.reconstruction`.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

DAMPER_KNOTS = (0.0, 0.05, 0.15, 0.4, 1.0)
"""Velocities in m/s between which the damper's slope is interpolated, in either direction."""


class SplineDamper(eqx.Module):
    """Damper force over velocity, as a quadratic spline: its slope is linear between knots.

    Zero at rest; beyond the last knot the slope stays. Force and slope are continuous, so the
    damper's velocity x7, which divides by the slope, has a continuous derivative.

    **Fields:** `slope_at_rest` in N s/m; `compression` and `rebound` slopes at the further knots
    of `DAMPER_KNOTS`, for v < 0 and v > 0.
    """

    slope_at_rest: Float[Array, ""]
    compression: Float[Array, " knots"]
    rebound: Float[Array, " knots"]

    def _rises(self, velocity: Array) -> list[Array]:
        """Increase of the slope over each interval between knots, in the velocity's direction."""
        side = jnp.where(velocity > 0, 1, 0)
        slopes = [jnp.where(side, up, down) for down, up in zip(self.compression, self.rebound)]
        return [b - a for a, b in zip([self.slope_at_rest, *slopes], slopes)]

    def __call__(self, velocity: Array) -> Array:
        """Force in N at a velocity in m/s."""
        speed = jnp.abs(velocity)
        beyond = jnp.zeros_like(speed)
        for rise, a, b in zip(self._rises(velocity), DAMPER_KNOTS, DAMPER_KNOTS[1:]):
            share = jnp.clip((speed - a) / (b - a), 0.0, 1.0)
            beyond = beyond + rise * (0.5 * (b - a) * share**2 + jnp.maximum(speed - b, 0.0))
        # Not sign(v) F(|v|): that has no derivative at rest, and linearisation needs it there.
        return self.slope_at_rest * velocity + jnp.sign(velocity) * beyond

    def slope(self, velocity: Array) -> Array:
        """dF/dv in N s/m."""
        speed = jnp.abs(velocity)
        slope = self.slope_at_rest
        for rise, a, b in zip(self._rises(velocity), DAMPER_KNOTS, DAMPER_KNOTS[1:]):
            slope = slope + rise * jnp.clip((speed - a) / (b - a), 0.0, 1.0)
        return slope


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

    def _side(self, velocity: Array) -> tuple[Array, Array]:
        """c of the velocity's direction, and 1 / sqrt(1 + (v / v_knee)^2)."""
        rebound = velocity > 0
        rate = jnp.where(rebound, self.high_speed_rates[1], self.high_speed_rates[0])
        knee = jnp.where(rebound, self.knees[1], self.knees[0])
        return rate, jax.lax.rsqrt(1 + (velocity / knee) ** 2)

    def __call__(self, velocity: Array) -> Array:
        """Force in N at a velocity in m/s."""
        rate, bend = self._side(velocity)
        return velocity * (rate + (self.low_speed_rate - rate) * bend)

    def slope(self, velocity: Array) -> Array:
        """dF/dv in N s/m."""
        rate, bend = self._side(velocity)
        return rate + (self.low_speed_rate - rate) * bend**3


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

    def scaled(self, gain: Array | float) -> "HardeningMount":
        """The same curve times a gain, as the paper makes its Table 6 variants."""
        return HardeningMount(self.rate * gain, self.cubic * gain)


class LinearDamper(eqx.Module):
    """F(v) = c v, the damper of the linearised source model; `rate` c in N s/m."""

    rate: Float[Array, ""]

    def __call__(self, velocity: Array) -> Array:
        """Force in N at a velocity in m/s."""
        return self.rate * velocity

    def slope(self, velocity: Array) -> Array:
        """dF/dv in N s/m."""
        return jnp.broadcast_to(self.rate, jnp.shape(velocity))
