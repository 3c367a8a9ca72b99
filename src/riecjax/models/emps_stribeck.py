"""EMPS with friction that changes near rest (Stribeck): not linear in its parameters."""

from collections.abc import Mapping
from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from riecjax.models.emps import Axis
from riecjax.records.signals import Signals
from riecjax.refinement.balance import AbstractBalance

SUBSTEPS = 8
"""Parts of a sample over which the friction's level is taken as constant."""


def stribeck_rise(velocity: Array, excess: Array, width: Array) -> Array:
    """Friction above the Coulomb level, as a share of it: excess e^-(velocity / width)^2."""
    return excess * jnp.exp(-((velocity / width) ** 2))


class StribeckBalance(AbstractBalance):
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


class SteppedAxis(Axis):
    """An axis whose friction's level changes with the speed, for the sampled control loop."""

    def at_speed(self, velocity: Array) -> Axis:
        """The axis with the level that it has at a velocity."""
        raise NotImplementedError

    def advance(
        self, position: Array, velocity: Array, force: Array, seconds: Array
    ) -> tuple[Array, Array, Array]:
        """Motion under a constant force, as of `Axis`, exact in each of `SUBSTEPS` parts.

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

    def with_levels(self, positive: Array, negative: Array) -> Axis:
        """An axis with these Coulomb levels, and all else as here."""
        return Axis(self.M, self.Fv_pos, positive, self.Fv_neg, negative, self.offset)


class StribeckAxis(SteppedAxis):
    """An axis whose Coulomb friction is higher near rest.

    **Fields:** those of `Axis`, `excess` of static over Coulomb friction, and `vs` in m/s.
    """

    excess: Float[Array, ""]
    vs: Float[Array, ""]

    def at_speed(self, velocity: Array) -> Axis:
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
