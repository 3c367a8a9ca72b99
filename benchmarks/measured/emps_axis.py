"""The EMPS axis as its rig moves it, under the rig's sampled controller.

Friction may change near rest (Stribeck): not linear in its parameters.
"""

from collections.abc import Mapping
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

import riecjax as rx
from riecjax.records.record import Signals

KP, KV = 160.18, 243.45
"""Gains of the controller in 1/s and V s/m."""
RISE = {"excess": 0.1, "vs": 0.02, "width": 1e-4}
"""A start for the refinement: a tenth more friction near rest."""


@eqx.filter_jit
def sampled_control(
    axis: rx.simulation.AbstractSystem,
    reference: rx.Record,
    *,
    gain: Array,
    start: Array,
    delay: int = 0,
) -> dict[str, Array]:
    """The axis under its controller as the rig runs it: sampled, its force held between samples.

    At each sample of the reference position `qg` the controller reads the position and takes the
    velocity from it over two samples, (q_k - q_(k-2)) / 2 dt. The logged voltage is this law of
    the logged positions to 0.24 % (tested); a difference over one sample leaves 3 %.

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
        held = rx.Record({"force": jnp.stack([applied, applied])}, step)
        ahead = rx.simulate(
            axis, held, method=rx.FixedStep(4), initial_state={"q": q, "dq": dq}
        ).record
        moved = (ahead["q"][1], ahead["dq"][1], q, last, commanded)
        return moved, (q, dq, ahead["ddq"][0], applied)

    rest = jnp.zeros_like(start)
    _, found = jax.lax.scan(sample, (start, rest, start, start, rest), reference["qg"])
    return dict(zip(("q", "dq", "ddq", "force"), found))


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
        level = coulomb * (1 + self.excess * jnp.exp(-((v / self.vs) ** 2)))
        return viscous * v + level * jnp.tanh(v / self.width) - signals["force"]


class StribeckAxis(rx.simulation.AbstractSystem):
    """A mass driven by a force, whose Coulomb friction is higher near rest, and may differ between
    the directions; fields as of `StribeckBalance`."""

    M: Float[Array, ""]
    Fv_pos: Float[Array, ""]
    Fc_pos: Float[Array, ""]
    Fv_neg: Float[Array, ""]
    Fc_neg: Float[Array, ""]
    excess: Float[Array, ""]
    vs: Float[Array, ""]
    states: ClassVar = (("q", "m"), ("dq", "m/s"))
    inputs: ClassVar = (("force", "N"),)

    @property
    def reversing(self) -> tuple[str, ...]:  # pyright: ignore
        """The velocity, with whose sign the friction changes."""
        return ("dq",)

    def derivative(self, state: Array, inputs: Array) -> Array:
        """Velocity and acceleration."""
        v = state[1]
        factor = 1 + self.excess * jnp.exp(-((v / self.vs) ** 2))
        ahead, back = self.Fv_pos * v + factor * self.Fc_pos, self.Fv_neg * v - factor * self.Fc_neg
        friction = jnp.where(v > 0, ahead, jnp.where(v < 0, back, 0.0))
        return jnp.stack([v, (inputs[0] - friction) / self.M])


def stribeck_axis(parameters: Mapping[str, Array]) -> StribeckAxis:
    """The axis with a balance's parameters, but for the width, which exact sticking needs not."""
    fields = {name: value for name, value in parameters.items() if name != "width"}
    return StribeckAxis(**fields)


def stribeck_balance(start: Mapping[str, Array | float]) -> StribeckBalance:
    """The balance with these values."""
    fields = {field: jnp.asarray(start[field]) for field in StribeckBalance.units}
    return StribeckBalance(**fields)
