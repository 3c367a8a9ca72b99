"""Section 2 of the paper: the error of a one-mass model beside white noise of its size (Fig. 2).

Both have zero mean and one size at any instant. Integrated, white noise walks off like its root of
time; the impulse of the mechanical error stays below 2 m2 v_max (eq. 8), however long.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from riecjax.models.two_mass import TwoMass
from riecjax.records.record import Record
from riecjax.simulation.method import FixedStep
from riecjax.simulation.simulate import simulate

FIRST_MASS, SECOND_MASS = 10.0, 1.0
"""kg, published."""
NATURAL_FREQUENCY, DAMPING_RATIO = 100.0, 0.5
"""rad/s and 1, published."""
DURATION, RATE = 20.0, 1000.0
"""s and Hz; the text gives neither. The rate is 60 times the natural frequency."""


class Demonstration(eqx.Module):
    """One realisation of Fig. 2, or many along a leading axis.

    **Fields:** `noise` white and of the same r.m.s. as `error`, the equation error, both in N;
    `noise_integral` and `error_integral` in N s; `bound`, 2 m2 v_max in N s.
    """

    noise: Float[Array, " n"]
    error: Float[Array, " n"]
    noise_integral: Float[Array, " n"]
    error_integral: Float[Array, " n"]
    bound: Float[Array, ""]


def demonstrate(key: Key[Array, ""]) -> Demonstration:
    """Drive the two masses by a white Gaussian force, and integrate; vmap over keys for many."""
    force_key, noise_key = jax.random.split(key)
    count = round(DURATION * RATE)
    masses = TwoMass(
        *(
            jnp.asarray(value)
            for value in (FIRST_MASS, SECOND_MASS, NATURAL_FREQUENCY, DAMPING_RATIO)
        )
    )
    force = jax.random.normal(force_key, (count,))
    run = simulate(masses, Record({"F": force}, 1 / RATE), method=FixedStep(1)).record
    error = run["error"]
    # A force of 1 N r.m.s. is as good as any: the model is linear.
    size = jnp.sqrt(jnp.mean(error**2))
    noise = jax.random.normal(noise_key, (count,))
    noise = noise * size / jnp.sqrt(jnp.mean(noise**2))
    largest = jnp.maximum(jnp.max(jnp.abs(run["dz"])), jnp.max(jnp.abs(run["dz"] + run["dd"])))
    return Demonstration(noise, error, _running(noise), _running(error), 2 * SECOND_MASS * largest)


def _running(values: Float[Array, " n"]) -> Float[Array, " n"]:
    """Integral from the start to each sample, by trapezoids."""
    steps = 0.5 * (values[1:] + values[:-1]) / RATE
    return jnp.concatenate([jnp.zeros(1), jnp.cumsum(steps)])
