"""How long a block of time must be: stretches of a record whose errors may count as independent.

Windows overlap and equation errors are autocorrelated, so single rows are far from independent.
Normal equations are made for many short blocks of start times, which cost nothing, and added up to
blocks that are long enough once that length is known from the data.
"""

# Two lengths compete. The variance of a mean of n values, estimated from blocks of b, misses the
# covariances beyond b, a bias of -G / b with G = sum |k| R(k), and of n / b blocks it has a
# variance of about 2 g0^2 b / n, g0 = sum R(k) the spectral density at zero. The sum of squared
# bias and variance is least at `b = (G^2 / g0^2)^(1/3) n^(1/3)` (Politis and White, 2004; for
# blocks that overlap it is (3/2)^(1/3) times as long). The series is each block's influence on a
# parameter, so every parameter has its length and the longest is taken: too long a block costs
# degrees of freedom, which Student's t pays for, too short a one costs coverage that nothing shows.

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from riecjax.summaries.blocks import FEWEST_WINDOWS, ShortBlocks

ENOUGH_BLOCKS = 20
"""Blocks of all records that long blocks should leave."""
LONGEST_WINDOWS = 4
"""Longest windows to a block, where there is room: a quarter of it overlaps the next block."""
SILENT = 5
"""Insignificant autocovariances in a row that end the search: the root of log10 n, and 5 at least,
which is more for any n."""


def block_length(
    short: ShortBlocks, longest_window: Float[Array, ""], correlated: Float[Array, " p"]
) -> Float[Array, ""]:
    """Seconds to a block: the rule that intervals rest on.

    The longest that Politis and White's rule finds for any parameter (`correlated`, see
    [`politis_white`][]), and no less than four times the longest window, so that little of a
    block's windows reaches into the next. Where the records would be fewer than twenty such blocks
    it is shortened to that, but never below twice the longest window.
    """
    wanted = jnp.maximum(LONGEST_WINDOWS * longest_window, jnp.max(correlated))
    room = jnp.sum(short.durations) / ENOUGH_BLOCKS
    shortest = jnp.maximum(FEWEST_WINDOWS * longest_window, jnp.min(short.seconds))
    return jnp.maximum(jnp.minimum(wanted, room), shortest)


def politis_white(
    influence: Float[Array, "records blocks p"], short: ShortBlocks
) -> Float[Array, " p"]:
    """Length of blocks in seconds that gives the least error of a variance, for each parameter.

    Politis and White (2004), with the constant for blocks that do not overlap:
    `(G^2 / g0^2)^(1/3) N^(1/3)`, where g0 is the spectral density of the series at frequency zero
    and G = sum |k| R(k); autocovariances R count up to twice the lag from which on they are
    insignificant, with a flat-top taper (1 up to half of it, then falling to 0), whose bias is
    smaller than any power of that lag where Bartlett's is of its first.

    **Arguments:** `influence` of each short block on each estimate, zero where there is none.
    """
    records, room = influence.shape[:2]
    count = jnp.sum(short.number)
    # Arrays may be longer than what they hold, so that the number of lags is traced.
    room = min(int(np.ceil(np.sqrt(records * room))) + SILENT, room - 1)
    if room < SILENT + 1:
        return jnp.zeros(influence.shape[-1], influence.dtype)
    lags = jnp.ceil(jnp.sqrt(count)) + SILENT
    lags = jnp.minimum(lags, jnp.max(short.number) - 1).astype(int)
    covariances = _autocovariances(influence, room)
    positive = (covariances[0] > 0) & (lags > SILENT)
    scale = jnp.where(positive, covariances[0], 1.0)
    lag = jnp.arange(1, room + 1)[:, None]
    ratios = jnp.where(lag <= lags, covariances[1:] / scale[None, :], 0.0)
    significant = jnp.abs(ratios) >= 2 * jnp.sqrt(jnp.log10(count) / count)
    reach = 2 * _last_significant(significant & (lag <= lags), lags)
    taper = jnp.clip(2 * (1 - lag / reach[None, :]), 0.0, 1.0)
    slope = 2 * jnp.sum(taper * lag * ratios, axis=0)
    density = 1 + 2 * jnp.sum(taper * ratios, axis=0)
    blocks = jnp.abs(slope / jnp.maximum(density, 0.1)) ** (2 / 3) * count ** (1 / 3)
    return jnp.where(positive, blocks, 0.0) * jnp.mean(short.seconds)


def _autocovariances(series: Float[Array, "records n p"], most: int) -> Float[Array, "lags p"]:
    """Sums of products at lags 0 to `most`, of all records."""
    n = series.shape[1]
    padded = jnp.pad(series, ((0, 0), (0, most), (0, 0)))

    # Lag by lag: few enough, and XLA's Fourier transforms may lock up where several run at once.
    def at_lag(lag: Array) -> Float[Array, " p"]:
        later = jax.lax.dynamic_slice_in_dim(padded, lag, n, axis=1)
        return jnp.sum(series * later, axis=(0, 1))

    return jax.lax.map(at_lag, jnp.arange(most + 1))


def _last_significant(significant: Array, lags: Int[Array, ""]) -> Int[Array, " p"]:
    """The lag, 1 at least, after which `SILENT` in a row are insignificant; else the last one."""
    room = significant.shape[0]
    loud = jnp.pad(jnp.cumsum(significant, axis=0), ((1, 0), (0, 0)))
    starts = room - SILENT + 1
    quiet = loud[SILENT : SILENT + starts] == loud[:starts]
    quiet = quiet & (jnp.arange(starts)[:, None] <= lags - SILENT)
    last = jnp.max(jnp.where(significant, jnp.arange(1, room + 1)[:, None], 0), axis=0)
    found = jnp.where(jnp.any(quiet, axis=0), jnp.argmax(quiet, axis=0), last)
    return jnp.maximum(found, 1)
