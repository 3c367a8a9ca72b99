"""Is what a refined model leaves of the motion no more than sensors' white noise?

White noise of n samples has autocorrelations r_k of variance 1 / n_k, n_k the pairs that lie k
samples apart, so that (Ljung and Box, 1978; pairs that a gap parts are not counted)

    Q = (n + 2) / n sum_{k=1}^{20} n_k r_k^2

is chi-square with 20 degrees of freedom. It asks no noise level. A model that leaves out a mode
leaves that mode's ringing, which is far from white wherever it stands out of the noise.

**Initial states.** Where a window is short, its estimated initial state takes a part of the noise
with it: r = (1 - H) e, correlated though e is white. Its innovations are not: what each residual
adds to a regression on the slopes by the initial state over the residuals before it,

    z_i = (r_i - h_i d) / sqrt(1 + h_i P h_i'),

are uncorrelated if e is, and the same of r as of e, which differ by a multiple of the slopes. The
first few of a window determine d and are left out.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from riecjax import tails
from riecjax.estimation.estimate import Estimate
from riecjax.leaves import finite, told
from riecjax.records.record import Record, deviation
from riecjax.refinement.output_error import OutputResiduals, noise_levels

LAGS = 20
LEVEL = 0.01
"""Share of right models that are told to leave more than white noise."""
VANISHING = 1e-6
"""Residual as a share of its signal below which it is the arithmetic's, and no test is made."""
DIFFUSE = 1e6
"""Initial state that is allowed for before any residual was seen, in units of what moves one by its
size; a residual with a variance of as many units of its noise's rather determines that state."""
FEWEST_RESIDUALS = 3 * LAGS
MANY_SAMPLES = 2000
"""Samples of a window in which an initial state takes nothing that shows."""


class ChannelWhiteness(NamedTuple):
    """What the residuals of one channel look like.

    **Fields:**

    - `statistic`: Q / 20, the largest of all recordings, about 1 of white noise.
    - `chi_squared`: mean square in units of the sensor's noise, as the recording tells it; NaN
      where it tells of none.
    - `share`: root mean square as a share of the channel's deviation.
    """

    statistic: float
    chi_squared: float
    share: float


class Whiteness(NamedTuple):
    """What the residuals of a refinement by output error look like beside white noise.

    **Fields:** `channels` by name; `threshold`, value that the largest of their statistics exceeds
    with a probability of 1 %.
    """

    channels: Mapping[str, ChannelWhiteness]
    threshold: float

    @property
    def largest(self) -> float:
        """The largest statistic; NaN if there are too few residuals for any."""
        statistics = (channel.statistic for channel in self.channels.values())
        return max((value for value in statistics if value == value), default=float("nan"))

    @property
    def vanishing(self) -> bool:
        """Whether the model follows every channel to a millionth."""
        return all(channel.share < VANISHING for channel in self.channels.values())

    @property
    def white(self) -> bool:
        """Whether the residuals are as white as noise, or vanish."""
        return self.vanishing or self.largest <= self.threshold

    def entry(self) -> dict[str, Any]:
        """All of it, as plain data for JSON."""
        return {
            **told(self, "white", "vanishing", "largest", "threshold"),
            "channels": {name: finite(each._asdict()) for name, each in self.channels.items()},
        }


def whiteness(refined: Estimate, records: list[Record]) -> Whiteness | None:
    """Tests what refined parameters and initial states leave (not under jit).

    **Returns:** `None` where no output error was made small, or a simulation was lost.
    """
    residuals, at = refined.search.residuals, (refined.theta, refined.search.initial_states)
    if not isinstance(residuals, OutputResiduals):
        return None
    simulated: Any = residuals.at(*at).simulated
    left = [part.left for part in simulated]
    masks = [np.asarray(part.present) for part in residuals.recorded]
    if not all(np.isfinite(part).all() for part in left):
        return None
    squares = sum(np.sum(one**2, axis=(0, 1)) for one in left)
    size = np.sqrt(squares / np.asarray(residuals.counts))
    series = left
    if any(
        len(part.length) > 1 and part.measured.shape[1] < MANY_SAMPLES
        for part in residuals.recorded
    ):
        weight = 1 / np.where(size > 0, size, 1.0)
        scaled = [(part.left * weight, part.by_initial * weight[:, None]) for part in simulated]
        series, masks = zip(*(innovations(*of, there) for of, there in zip(scaled, masks)))
    sigma, levels = np.asarray(residuals.sigma), np.asarray(noise_levels(records, residuals.labels))
    channels: dict[str, ChannelWhiteness] = {}
    for j, name in enumerate(residuals.labels):
        tests = []
        for values, present, part in zip(series, masks, residuals.recorded):
            # The values of all windows where they stand in the recording.
            values, present = values[..., j], present[..., j]
            place = np.asarray(part.position)[present]
            length = int(place.max(initial=0)) + 1
            in_time = np.full(length, np.nan)
            in_time[place] = values[present]
            tests.append(ljung_box(in_time))
        rms, level, spread = float(size[j] * sigma[j]), float(levels[j]), deviation(records, name)
        channels[name] = ChannelWhiteness(
            max((t for t in tests if t == t), default=float("nan")) / LAGS,
            (rms / level) ** 2 if level > 0 else float("nan"),
            rms / spread if spread > 0 else float("nan"),
        )
    tests = len(residuals.labels) * len(residuals.recorded)
    threshold = tails.chi_square(LEVEL / tests, LAGS) / LAGS
    return Whiteness(channels, threshold)


def ljung_box(series: Float[np.ndarray, " n"]) -> float:
    """Q over 20 lags of values that are NaN where they are missing; NaN of fewer than 60 values, or
    of values that do not vary."""
    present = ~np.isnan(series)
    count = np.count_nonzero(present)
    if count < FEWEST_RESIDUALS or not np.ptp(series[present]) > 0:
        return float("nan")
    centred = np.where(present, series - np.mean(series[present]), 0.0)
    apart = range(1, LAGS + 1)
    pairs = np.array([np.sum(present[k:] & present[:-k]) for k in apart])
    products = np.array([np.sum(centred[k:] * centred[:-k]) for k in apart])
    # Of lags at which there are no pairs the products are zero.
    squares = products**2 / np.maximum(pairs, 1) / (np.sum(centred**2) / count) ** 2
    return float((count + 2) / count * np.sum(squares))


def innovations(
    left: Float[np.ndarray, "w n c"],
    slopes: Float[np.ndarray, "w n c s"],
    present: Bool[np.ndarray, "w n c"],
) -> tuple[Float[np.ndarray, "w n c"], Bool[np.ndarray, "w n c"]]:
    """Residuals less what those before them in their window tell of the initial state; see above.

    **Returns:** these in units of their own deviation, and a mask without those that determine it.
    """
    windows, samples, channels, states = slopes.shape
    largest = np.max(np.abs(slopes), axis=(1, 2), initial=0.0)
    slopes = slopes / np.where(largest > 0, largest, 1.0)[:, None, None, :]
    found, kept = np.zeros_like(left), present.copy()
    spread = np.broadcast_to(DIFFUSE**2 * np.eye(states), (windows, states, states)).copy()
    state = np.zeros((windows, states))
    for i in range(samples):
        for j in range(channels):
            h, here = slopes[:, i, j], present[:, i, j]
            gain = np.einsum("wst,wt->ws", spread, h)
            variance = 1 + np.einsum("ws,ws->w", h, gain)
            error = left[:, i, j] - np.einsum("ws,ws->w", h, state)
            found[:, i, j] = error / np.sqrt(variance)
            kept[:, i, j] = here & (variance < DIFFUSE)
            gain = np.where(here, 1 / variance, 0.0)[:, None] * gain
            state = state + gain * error[:, None]
            spread = spread - gain[:, :, None] * np.einsum("wst,wt->ws", spread, h)[:, None, :]
    return found, kept
