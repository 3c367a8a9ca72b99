"""How much of a recorded signal is noise, judged from one recording of it."""

import numpy as np
from jaxtyping import Array, Float

from riecjax.leaves import Leaf, namespace
from riecjax.records.record import Record

DIFFERENCE_ORDER = 6
STRETCHES = 16
"""Stretches of a long signal that are looked at."""
STRETCH = 2**10
"""Samples to each of them."""


def noise_level(samples: Float[Array, " n"] | Float[np.ndarray, " n"]) -> Float[Leaf, ""]:
    """Standard deviation of the white noise on a smooth signal.

    From the median of its differences of sixth order, which steps and spikes do not reach. Content
    near half the sampling rate counts as noise. Of a long signal it looks at stretches, evenly
    spread.
    """
    n = samples.shape[0]
    if n <= DIFFERENCE_ORDER:
        return np.zeros(())
    xp = namespace(samples)
    if n > STRETCHES * STRETCH:
        starts = np.linspace(0, n - STRETCH, STRETCHES).astype(int)
        samples = samples[starts[:, None] + np.arange(STRETCH)]
    differences = xp.diff(samples, n=DIFFERENCE_ORDER)
    gain = np.sqrt(np.sum(np.poly([1.0] * DIFFERENCE_ORDER) ** 2))
    return xp.median(xp.abs(differences)) / (0.6745 * gain)


def with_noise(record: Record, seed: int) -> Record:
    """The record with as much white noise again on every signal as it seems to have."""
    rng = np.random.default_rng(seed)
    disturbed = {}
    for name, signal in record.arrays.items():
        values = np.asarray(signal)
        disturbed[name] = values + noise_level(values) * rng.standard_normal(values.shape)
    return record.with_signals(disturbed, missing=record.missing)
