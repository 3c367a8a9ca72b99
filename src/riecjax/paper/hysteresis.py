"""What the damper's compliance does to its force, and to identified damper maps (Fig. 13)."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from riecjax.criteria.criterion import DOLS
from riecjax.models.quarter_car.source import QuarterCarSource
from riecjax.paper.published import TABLE_2
from riecjax.paper.reproduction import road_keys, training_noise
from riecjax.paper.variations import by_body
from riecjax.records.record import Record
from riecjax.simulation.inputs import low_passed
from riecjax.simulation.method import FixedStep
from riecjax.simulation.simulate import simulate

BANDWIDTHS = (6.0, 15.0, 30.0)
"""Hz: low, from where DOLS drifts, and high."""
STIFFER = 4.0
"""Factor on K_c that makes the damper follow the suspension more closely."""
METHOD = FixedStep(12)
"""A stiffer damper needs shorter steps: K_c over its least slope is 3500 per second."""


class Hysteresis(eqx.Module):
    """One road at each of `BANDWIDTHS`, with the source's own compliance and a stiffer one.

    **Fields:** `velocity` of the suspension in m/s and `force` of the damper in N, of the source's
    own compliance; `width`, r.m.s. of the force's distance from the damper's curve at this
    velocity, over its r.m.s.; `by_dols`, what DOLS identifies (variant B_id).
    """

    velocity: Float[Array, "bandwidths n"]
    force: Float[Array, "bandwidths n"]
    width: Float[Array, "compliances bandwidths"]
    by_dols: Float[Array, "compliances bandwidths parameters"]


def hysteresis(key: Key[Array, ""], source: QuarterCarSource) -> Hysteresis:
    """Simulate and identify on one random road; vmap over keys for many."""
    keys, step = road_keys(key), 1 / TABLE_2.rate
    noise = training_noise(keys.training)

    def at(compliance: Array, bandwidth: Array) -> Hysteresis:
        model = eqx.tree_at(lambda s: s.damper_compliance, source, compliance)
        driven = Record({"v_r": low_passed(noise, step, bandwidth)}, step)
        record = simulate(model, driven, method=METHOD).record
        relative = record["x3"] - record["x4"]
        force = source.damper(record["x7"])
        off = force - source.damper(relative)
        width = jnp.sqrt(jnp.mean(off**2) / jnp.mean(force**2))
        return Hysteresis(relative, force, width, by_body(record, DOLS()))

    compliances = jnp.asarray(source.damper_compliance) * jnp.array([1.0, STIFFER])
    over_bandwidths = jax.vmap(at, in_axes=(None, 0))
    found = jax.vmap(over_bandwidths, in_axes=(0, None))(compliances, jnp.array(BANDWIDTHS))
    return Hysteresis(found.velocity[0], found.force[0], found.width, found.by_dols)
