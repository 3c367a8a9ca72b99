"""How much of a recorded signal is noise, judged from one recording of it."""

import numpy as np
from jaxtyping import Array, Float

from riecjax.leaves import Leaf, namespace

DIFFERENCE_ORDER = 6


def noise_level(samples: Float[Array, " n"] | Float[np.ndarray, " n"]) -> Float[Leaf, ""]:
    """Standard deviation of the white noise on a smooth signal.

    From the median of its differences of sixth order, which steps and spikes do not reach. Content
    near half the sampling rate counts as noise.
    """
    if samples.shape[0] <= DIFFERENCE_ORDER:
        return np.zeros(())
    xp = namespace(samples)
    differences = xp.diff(samples, n=DIFFERENCE_ORDER)
    gain = np.sqrt(np.sum(np.poly([1.0] * DIFFERENCE_ORDER) ** 2))
    return xp.median(xp.abs(differences)) / (0.6745 * gain)
