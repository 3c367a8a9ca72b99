"""The state of a system as far as a recording tells it."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from riecjax.records.record import Record
from riecjax.simulation.system import AbstractSystem


def state_sources(system: AbstractSystem, record: Record) -> dict[str, str]:
    """Source of each state: `measured`, `differences` of its recorded integral, or `zero`."""
    integral = {velocity: state for state, velocity in system.velocity_of.items()}
    return {
        name: "measured"
        if name in record.arrays
        else "differences"
        if integral.get(name) in record.arrays
        else "zero"
        for name in system.state_names
    }


def measured_states(system: AbstractSystem, record: Record) -> Float[Array, "n states"]:
    """Each state at each sample; zero where nothing tells it."""
    integral = {velocity: state for state, velocity in system.velocity_of.items()}
    columns = []
    for name, source in state_sources(system, record).items():
        if source == "measured":
            columns.append(record[name])
        elif source == "differences":
            columns.append(_differences(record[integral[name]], record.time_step))
        else:
            columns.append(jnp.zeros(record.sample_count, record.time_step.dtype))
    return jnp.stack(columns, axis=-1)


def _differences(samples: Array, step: Array) -> Array:
    """Second-order differences, one-sided at the ends."""
    inner = samples[2:] - samples[:-2]
    first = -3 * samples[0] + 4 * samples[1] - samples[2]
    last = 3 * samples[-1] - 4 * samples[-2] + samples[-3]
    return jnp.concatenate([first[None], inner, last[None]]) / (2 * step)
