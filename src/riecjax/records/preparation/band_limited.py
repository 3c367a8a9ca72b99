"""Interpolation of evenly spaced samples by a windowed sinc.

A signal that is band-limited to half its rate is x(t) = sum_n x[n] sinc(t - n), with t in samples.
Evaluating it at a slower rate needs a low-pass first, so that nothing folds; filtering and
evaluating are one sum,

    x(t) = sum_n h(t - n) x[n] / sum_n h(t - n),   h(u) = sinc(c u) w(u / L).

c is the cut-off as a share of half the samples' rate, and the window w cuts the sum off at L
samples to each side: Kaiser's, whose shape and length follow from the attenuation and the width of
the transition (SciPy's `kaiserord`). Dividing by the sum of the weights makes a constant pass
exactly. The cost is 2 L for each value, and weights are computed once for each distinct phase
t - floor(t).
"""

import math
from typing import NamedTuple

import numpy as np
import scipy.special

LARGEST_BLOCK = 2**22
"""Weights held at once."""
PHASE_DIGITS = 9
"""Of a position in samples; positions equal in these digits share their weights."""


class LowPass(NamedTuple):
    """A windowed-sinc low-pass, in terms of half the slower of two rates.

    **Fields:** `cutoff`, the middle of the transition, and `transition`, half its width, as
    shares of half the slower rate; `attenuation` in dB, of what lies above and of the ripple
    below.
    """

    cutoff: float
    transition: float
    attenuation: float

    def half_length(self, density: float) -> float:
        """Samples to each side that have a weight, at `density` samples per slower sample."""
        from scipy.signal import kaiserord  # takes half a second, which few records need

        taps, _ = kaiserord(self.attenuation, 2 * self.transition)
        return 0.5 * float(taps) * density

    def reach(self, density: float) -> int:
        """Whole samples that must be there on each side of a position."""
        return math.ceil(self.half_length(density))

    def weights(self, offsets: np.ndarray, density: float) -> np.ndarray:
        """Weight of samples that lie `offsets` samples away."""
        share = offsets / self.half_length(density)
        from scipy.signal import kaiser_beta

        beta = kaiser_beta(self.attenuation)
        window = scipy.special.i0(beta * np.sqrt(np.maximum(1 - share**2, 0.0)))
        return np.where(np.abs(share) < 1, np.sinc(self.cutoff / density * offsets) * window, 0.0)


INTERPOLATION = LowPass(cutoff=1.0, transition=0.1, attenuation=130.0)
"""To a faster rate: errors below 1e-6 of the amplitude up to 0.9 of half the samples' rate. Its
sinc is zero at all samples but one, so these pass unchanged. Reaches 44 samples to each side."""
ANTI_ALIAS = LowPass(cutoff=0.9, transition=0.1, attenuation=80.0)
"""To a slower rate: flat to 0.8 of half the new rate within 1e-4, and 80 dB down from half the new
rate on, so that nothing folds into the record. Reaches 26 new samples to each side."""


def band_limited(samples: np.ndarray, positions: np.ndarray, spacing: float) -> np.ndarray:
    """An evenly sampled signal at other places.

    **Arguments:**

    - `samples`: unit distance apart, shape `(n,)`.
    - `positions`: where to evaluate, in samples from the first one, shape `(m,)`.
    - `spacing`: usual distance of positions in samples; above 1 the signal is low-passed for it.

    **Returns:** values of shape `(m,)`, NaN where the weights would reach beyond the samples.
    """
    low_pass, density = _low_pass(spacing)
    reach = reach_beyond(spacing)
    positions = np.round(positions, PHASE_DIGITS)
    found = np.full(positions.size, np.nan)
    inside = np.flatnonzero((positions >= reach) & (positions <= samples.size - 1 - reach))
    if not inside.size:
        return found
    offsets = np.arange(-reach + 1, reach + 1)
    neighbours = np.lib.stride_tricks.sliding_window_view(samples, offsets.size)
    for block in np.array_split(inside, math.ceil(inside.size * offsets.size / LARGEST_BLOCK)):
        before = np.floor(positions[block]).astype(int)
        phases, which = np.unique(
            np.round(positions[block] - before, PHASE_DIGITS), return_inverse=True
        )
        weights = low_pass.weights(offsets - phases[:, None], density)
        weights /= weights.sum(axis=1, keepdims=True)
        found[block] = np.einsum("ij,ij->i", weights[which], neighbours[before - reach + 1])
    return found


def reach_beyond(spacing: float) -> int:
    """Samples that `band_limited` needs on each side of a position."""
    low_pass, density = _low_pass(spacing)
    return low_pass.reach(density)


def response(offsets: np.ndarray, spacing: float) -> np.ndarray:
    """What `band_limited` makes of one sample of 1, so many samples away from it."""
    low_pass, density = _low_pass(spacing)
    reach = low_pass.reach(density)
    whole = low_pass.weights(np.arange(-reach, reach + 1), density)
    return low_pass.weights(offsets, density) / whole.sum()


def _low_pass(spacing: float) -> tuple[LowPass, float]:
    return (ANTI_ALIAS, spacing) if spacing > 1 else (INTERPOLATION, 1.0)
