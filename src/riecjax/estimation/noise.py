"""How much of a recorded signal is noise, judged from one recording of it."""

import numpy as np
from jaxtyping import Array, Float

from riecjax.leaves import Leaf, namespace

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
