"""The EMPS axis as its rig moves it: exactly through stops, under the rig's sampled controller.

Friction may change near rest (Stribeck): not linear in its parameters.
"""

import math
from collections.abc import Mapping
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

import riecjax as rx
from riecjax.models.emps import Axis
from riecjax.records.signals import Signals

KP, KV = 160.18, 243.45
"""Gains of the controller in 1/s and V s/m."""


class SlidingAxis(Axis):
    """An axis that knows where a force that is held takes it."""

    def advance(
        self, position: Array, velocity: Array, force: Array, seconds: Array
    ) -> tuple[Array, Array, Array]:
        """Motion under a constant force, exactly, stops and sticking included.

        Under a constant force the axis slides in one direction with linear friction, which has a
        closed form. It stops at most once; then it sticks if the force is within the Coulomb
        friction, and otherwise slides off with the force, never to stop again. So no step size and
        no smoothed sign come in, and nothing chatters about rest.

        **Returns:** position in m, velocity in m/s after `seconds`, and the acceleration in m/s^2
        at their start, 0 while sticking. Coulomb friction must not be negative.
        """
        drive = force - self.offset
        pulled = jnp.where(drive > self.Fc_pos, 1.0, jnp.where(drive < -self.Fc_neg, -1.0, 0.0))
        sliding = jnp.where(velocity == 0, pulled, jnp.sign(velocity))
        rate, acceleration = self._sliding(sliding, drive)
        # When v e^(-rate t) + acceleration (1 - e^(-rate t)) / rate vanishes.
        slowing = velocity * acceleration < 0
        ratio = jnp.where(slowing, -velocity / jnp.where(slowing, acceleration, 1.0), 0.0)
        stop = jnp.where(slowing, ratio * _log_ratio(rate * ratio), jnp.inf)
        stops = stop < seconds
        before = jnp.where(stops, stop, seconds)
        reached, left = _slide(position, velocity, rate, acceleration, before)
        rate_after, acceleration_after = self._sliding(pulled, drive)
        final, gained = _slide(
            reached, jnp.zeros_like(left), rate_after, acceleration_after, seconds - before
        )
        return (
            jnp.where(stops, final, reached),
            jnp.where(stops, gained, left),
            acceleration - rate * velocity,
        )

    def _sliding(self, direction: Array, drive: Array) -> tuple[Array, Array]:
        """Decay rate in 1/s and acceleration at rest while sliding; both 0 without a direction."""
        viscous = jnp.where(direction > 0, self.Fv_pos, self.Fv_neg)
        coulomb = jnp.where(direction > 0, self.Fc_pos, -self.Fc_neg)
        moving = direction != 0
        return (
            jnp.where(moving, viscous / self.M, 0.0),
            jnp.where(moving, (drive - coulomb) / self.M, 0.0),
        )


def _log_ratio(x: Array) -> Array:
    """log(1 + x) / x, also at 0."""
    small = jnp.abs(x) < 1e-4
    safe = jnp.where(small, 1.0, x)
    return jnp.where(small, 1 - x / 2 + x**2 / 3 - x**3 / 4, jnp.log1p(safe) / safe)


def _slide(
    position: Array, velocity: Array, rate: Array, acceleration: Array, seconds: Array
) -> tuple[Array, Array]:
    """x'' = acceleration - rate x', started at a position with a velocity."""
    x = rate * seconds
    # (1 - e^-x) / x and (e^-x - 1 + x) / x^2; the second one cancels at small x.
    small = jnp.abs(x) < 0.05
    safe = jnp.where(small, 1.0, x)
    once = jnp.where(small, _series(x, 1), -jnp.expm1(-safe) / safe)
    twice = jnp.where(small, _series(x, 2), (safe + jnp.expm1(-safe)) / safe**2)
    reached = position + seconds * (velocity * once + acceleration * seconds * twice)
    return reached, velocity * jnp.exp(-x) + acceleration * seconds * once


def _series(x: Array, start: int) -> Array:
    """Sum over k of (-x)^k / (k + start)!, to 1e-16 for |x| < 0.05."""
    total = jnp.zeros_like(x)
    for k in reversed(range(9)):
        total = total * -x + 1 / math.factorial(k + start)
    return total


@eqx.filter_jit
def sampled_control(
    axis: SlidingAxis, reference: rx.Record, *, gain: Array, start: Array, delay: int = 0
) -> dict[str, Array]:
    """The axis under its controller as the rig runs it: sampled, its force held between samples.

    At each sample of the reference position `qg` the controller reads the position and takes the
    velocity from it over two samples, (q_k - q_(k-2)) / 2 dt. The logged voltage is this law of
    the logged positions to 0.24 % (tested); a difference over one sample leaves 3 %. Between
    samples the motion is exact.

    **Arguments:** `gain` of the drive in N/V; `start`, the position at rest; `delay`: samples
    between reading the position and applying the force, 0 or 1. The rig's record is best described
    by 0, the published simulation by 1.

    **Returns:** `q`, `dq`, `ddq` and `force`, each from the sample on.
    """
    step = reference.time_step

    def sample(carry, goal):
        q, dq, last, before_last, waiting = carry
        commanded = gain * KV * (KP * (goal - q) - (q - before_last) / (2 * step))
        applied = waiting if delay else commanded
        moved, speed, acceleration = axis.advance(q, dq, applied, step)
        return (moved, speed, q, last, commanded), (q, dq, acceleration, applied)

    rest = jnp.zeros_like(start)
    _, found = jax.lax.scan(sample, (start, rest, start, start, rest), reference["qg"])
    return dict(zip(("q", "dq", "ddq", "force"), found))


SUBSTEPS = 8
"""Parts of a sample over which the friction's level is taken as constant."""


def stribeck_rise(velocity: Array, excess: Array, width: Array) -> Array:
    """Friction above the Coulomb level, as a share of it: excess e^-(velocity / width)^2."""
    return excess * jnp.exp(-((velocity / width) ** 2))


class StribeckBalance(rx.refinement.AbstractBalance):
    """M q'' + friction(q') = force, with different friction in each direction.

    friction = Fv q' + Fc (1 + excess e^-(q'/vs)^2) tanh(q'/width), where the width over which it
    changes its sign is a parameter too: what the velocity's noise and the drive's play make of it.

    **Fields:** `M` in kg; `Fv_pos`, `Fv_neg` in N s/m; `Fc_pos`, `Fc_neg` in N; `excess` of static
    over Coulomb friction; `vs`, `width` in m/s.
    """

    M: Float[Array, ""]
    Fv_pos: Float[Array, ""]
    Fc_pos: Float[Array, ""]
    Fv_neg: Float[Array, ""]
    Fc_neg: Float[Array, ""]
    excess: Float[Array, ""]
    vs: Float[Array, ""]
    width: Float[Array, ""]

    name: ClassVar[str] = "emps-stribeck"
    unit: ClassVar[str] = "N"
    units: ClassVar[Mapping[str, str]] = {
        "M": "kg",
        "Fv_pos": "N s/m",
        "Fc_pos": "N",
        "Fv_neg": "N s/m",
        "Fc_neg": "N",
        "excess": "",
        "vs": "m/s",
        "width": "m/s",
    }

    def momentum(self, signals: Signals) -> Array:
        """M q'."""
        return self.M * signals["dq"]

    def force(self, signals: Signals) -> Array:
        """Friction less the drive's force."""
        v = signals["dq"]
        forward = v > 0
        viscous = jnp.where(forward, self.Fv_pos, self.Fv_neg)
        coulomb = jnp.where(forward, self.Fc_pos, self.Fc_neg)
        level = coulomb * (1 + stribeck_rise(v, self.excess, self.vs))
        return viscous * v + level * jnp.tanh(v / self.width) - signals["force"]


class SteppedAxis(SlidingAxis):
    """An axis whose friction's level changes with the speed, for the sampled control loop."""

    def at_speed(self, velocity: Array) -> SlidingAxis:
        """The axis with the level that it has at a velocity."""
        raise NotImplementedError

    def advance(
        self, position: Array, velocity: Array, force: Array, seconds: Array
    ) -> tuple[Array, Array, Array]:
        """Motion under a constant force, as of `SlidingAxis`, exact in each of `SUBSTEPS` parts.

        Within a part the friction keeps the level that it has at the part's first velocity, so
        that stops and sticking stay exact.
        """
        step = seconds / SUBSTEPS

        def part(_: Array, motion: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
            q, v, first = motion
            moved, speed, acceleration = self.at_speed(v).advance(q, v, force, step)
            return moved, speed, jnp.where(jnp.isnan(first), acceleration, first)

        begun = jnp.full_like(velocity, jnp.nan)
        return jax.lax.fori_loop(0, SUBSTEPS, part, (position, velocity, begun))

    def with_levels(self, positive: Array, negative: Array) -> SlidingAxis:
        """An axis with these Coulomb levels, and all else as here."""
        return SlidingAxis(self.M, self.Fv_pos, positive, self.Fv_neg, negative, self.offset)


class StribeckAxis(SteppedAxis):
    """An axis whose Coulomb friction is higher near rest.

    **Fields:** those of `Axis`, `excess` of static over Coulomb friction, and `vs` in m/s.
    """

    excess: Float[Array, ""]
    vs: Float[Array, ""]

    def at_speed(self, velocity: Array) -> SlidingAxis:
        """Both levels times 1 + excess e^-(v/vs)^2."""
        factor = 1 + stribeck_rise(velocity, self.excess, self.vs)
        return self.with_levels(factor * self.Fc_pos, factor * self.Fc_neg)


def stribeck_axis(parameters: Mapping[str, Array]) -> StribeckAxis:
    """The axis with a balance's parameters, but for the width, which exact sticking needs not."""
    fields = {name: value for name, value in parameters.items() if name != "width"}
    return StribeckAxis(**fields, offset=jnp.zeros(()))


def stribeck_balance(start: Mapping[str, Array | float]) -> StribeckBalance:
    """The balance with these values."""
    fields = {field: jnp.asarray(start[field]) for field in StribeckBalance.units}
    return StribeckBalance(**fields)


def without_rise(axis: Mapping[str, Array | float]) -> dict[str, Array | float]:
    """A start for the refinement: asymmetric friction, with a tenth more near rest."""
    return {**axis, "excess": 0.1, "vs": 0.02, "width": 1e-4}
