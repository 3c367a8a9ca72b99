"""Smooth test functions, integrated by fast Fourier transform.

The row of the window that starts at sample t is a sum over samples of weight times signal,

    r[t] = h sum_k sum_i psi_k[i] s_k[t + i],    psi_k = (-1)^k d^k phi / dt^k

with s_k the part of a column that stands under k time derivatives. For all t at once it is a
correlation: the signals are transformed once, each window length's weights once, and one inverse
transform gives the rows at every start, O(N log N) for each column and length. Transforms of 2 N
samples, half of them zero, keep the ends of the record from wrapping around.

**Order.** By Euler and Maclaurin, a sum over samples differs from the integral by the odd
derivatives of the integrand g at the window's ends, times even powers of h:

    h sum_i g[i] - integral g dt = h^2 / 12 [g^(1)] - h^4 / 720 [g^(3)] + ...

The k-th derivative of (1 - tau^2)^p has a zero of multiplicity p - k at both ends, so the first
term that is left has order p - k + 1 where that is even, else p - k + 2: for an inertia (k = 2),
order 4 with p = 4.
"""

import math
from collections.abc import Callable
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.special
from jaxtyping import Array, Bool, Float, Int

from riecjax.criteria.all_windows import Moments
from riecjax.criteria.chunks import StartBlocks
from riecjax.criteria.gains import fourier_size
from riecjax.criteria.laws import LagBins, sum_over_lengths
from riecjax.criteria.length_bins import each_bin
from riecjax.criteria.noise_weights import NoiseWeights, noise_weights_of_lengths
from riecjax.criteria.quadrature import unpadded_mean
from riecjax.criteria.test_functions import AbstractTestFunction, Integrals, valid_windows
from riecjax.criteria.windows import AllWindows, WindowSet, half_periods
from riecjax.equations.columns import Columns
from riecjax.errors import ModelError
from riecjax.leaves import Leaf
from riecjax.records.record import Record


class AbstractSmoothTestFunction(AbstractTestFunction):
    """A weight that is smooth over the window and vanishes with its slope at both ends.

    A new one is a name and a formula:

    ```python
    class Cosine(AbstractSmoothTestFunction):
        name = "cosine"

        def weight(self, tau, length):
            return jnp.cos(jnp.pi * tau / 2) ** 4
    ```

    Its derivatives are JAX's, its gain is found by quadrature. One window length after the other is
    worked through: `lengths` of them, 32 unless the class says otherwise, evenly spaced from alpha
    to beta; a random window takes the nearest one.

    **Raises:** `ModelError` for no length.
    """

    smoothness: ClassVar[int] = 2
    # The second derivative of a bump, summed over samples, takes off a parabola's to 4 % with 8
    # samples and to 0.8 % with 12.
    fewest_samples: ClassVar[int] = 12
    lengths = 32  # no annotation: that would put it before the fields of subclasses

    def __check_init__(self):
        if self.lengths < 1:
            raise ModelError(f"a {self.name} needs at least one window length; got {self.lengths}.")

    def weight(self, tau: Float[Array, " n"], length: Float[Array, ""]) -> Float[Array, " n"]:
        """phi at tau from -1 to 1 over a window that lasts `length` seconds."""
        raise NotImplementedError

    def lengths_of_band(self, band: tuple[float, float]) -> tuple[float, float]:
        """From half a period of the lowest frequency to two, in seconds.

        Two derivatives of the weight stand where one does of a boxcar, and most of the weight lies
        in the middle third: windows of half the period of the highest one would be all noise.
        """
        _, half = half_periods(band)
        return half, 4 * half

    def describe(self) -> dict[str, object]:
        """Name and number of window lengths."""
        return {**super().describe(), "lengths": self.lengths}

    def gain(
        self, frequency: Float[np.ndarray, " frequencies"], length: Float[np.ndarray, " lengths"]
    ) -> Float[np.ndarray, "frequencies lengths"]:
        """|H| of windows, by quadrature."""
        return fourier_size(self.weight, frequency, length)

    def integrals(
        self, columns: Columns, windows: WindowSet, unpadded: Int[Array, ""] | int | None = None
    ) -> Integrals:
        """Integral of every column of the equation over every window.

        **Raises:** `ModelError` for windows that start between samples.
        """
        if not jnp.issubdtype(windows.start.dtype, jnp.integer):
            raise ModelError(f"{self.name}s need windows on samples (between_samples=False).")
        everywhere = self._at_every_start(columns, unpadded)
        count = columns.sample_count if unpadded is None else unpadded
        windows, lengths = self.rounded(windows, count)

        def of_length(total: Array, length: Array) -> tuple[Array, None]:
            mine = (windows.stop - windows.start == length)[None, :]
            return jnp.where(mine, everywhere(length)[:, windows.start], total), None

        empty = jnp.zeros((columns.values.shape[1], windows.start.shape[0]), columns.values.dtype)
        total, _ = jax.lax.scan(of_length, empty, lengths)
        return Integrals(total, valid_windows(windows, columns.present))

    def lags(self, windows: AllWindows, record: Record) -> LagBins:
        """The law at `lengths` window lengths."""
        n = record.sample_count
        lengths = self._lengths(*windows.lags(n, record.time_step))
        return LagBins(lengths, lengths, windows.weights(n, record.time_step, lengths))

    def moments(self, columns: Columns, lags: LagBins, blocks: StartBlocks, reach: int) -> Moments:
        """Sums over all starts of the outer products of rows, at `lengths` window lengths."""
        everywhere = self._at_every_start(columns, blocks.unpadded)

        def rows_of_length(length: Leaf) -> tuple[Array, Array]:
            valid = self._whole(columns, length, blocks)
            return jnp.where(valid[None, :], everywhere(length), 0.0), valid

        def law_moments(law: LagBins) -> Moments:
            return moments_of_rows(rows_of_length, law.first, law.weight, blocks)

        return each_bin(law_moments, lags)

    def noise_weights(
        self, columns: Columns, windows: LagBins | WindowSet, blocks: StartBlocks
    ) -> NoiseWeights | None:
        """Of all windows, from the squares of each length's weights."""
        if not isinstance(windows, LagBins):
            return None
        start = jnp.arange(columns.sample_count)
        within = (start >= blocks.first) & (start < blocks.first + blocks.size * blocks.number)

        def of_length(length: Leaf, weight: Leaf) -> tuple[Array, Array]:
            at = jnp.where(within & self._whole(columns, length, blocks), weight, 0.0)
            return at, self._weights(length, columns)

        return noise_weights_of_lengths(of_length, (windows.first, windows.weight))

    def _whole(self, columns: Columns, length: Leaf, blocks: StartBlocks) -> Bool[Array, " n"]:
        """Where a window of this length may start: inside, with no sample missing."""
        start = jnp.arange(columns.sample_count)
        inside = start + length < blocks.unpadded
        window = WindowSet(start, jnp.minimum(start + length, columns.sample_count - 1))
        unbroken = valid_windows(window, columns.present)
        return inside if unbroken is None else inside & unbroken

    def _at_every_start(
        self, columns: Columns, unpadded: Int[Array, ""] | int | None
    ) -> Callable[[Leaf], Float[Array, "columns n"]]:
        """A function of window length: integrals of every column over the windows at each start."""
        # A constant has no derivative, while the sum of a weight's derivative is not quite zero.
        values = jnp.stack(
            [
                part if order == 0 else part - unpadded_mean(part, unpadded)[:, None]
                for order, part in enumerate(columns.values)
            ]
        )
        size = 2 * columns.sample_count
        spectrum = jnp.fft.rfft(values, size, axis=-1)

        def everywhere(length: Leaf) -> Float[Array, "columns n"]:
            weights = jnp.fft.rfft(self._weights(length, columns), size, axis=-1)
            product = jnp.sum(spectrum * jnp.conj(weights)[:, None, :], axis=0)
            return jnp.fft.irfft(product, size, axis=-1)[:, : columns.sample_count]

        return everywhere

    def _lengths(self, shortest: Int[Array, ""], longest: Int[Array, ""]) -> Int[Array, " lengths"]:
        spacing = (longest - shortest) / max(self.lengths - 1, 1)
        return jnp.round(shortest + spacing * jnp.arange(self.lengths)).astype(shortest.dtype)

    def rounded(
        self, windows: WindowSet, sample_count: Int[Array, ""] | int
    ) -> tuple[WindowSet, Int[Array, " lengths"]]:
        """The windows with the nearest of `lengths` lengths, and these lengths in samples."""
        drawn = windows.stop - windows.start
        shortest, longest = jnp.min(drawn), jnp.max(drawn)
        spacing = (longest - shortest) / max(self.lengths - 1, 1)
        lengths = self._lengths(shortest, longest)
        nearest = jnp.round((drawn - shortest) / jnp.where(spacing > 0, spacing, 1.0))
        length = lengths[jnp.clip(nearest.astype(jnp.int32), 0, self.lengths - 1)]
        start = jnp.minimum(windows.start, sample_count - 1 - length)
        return WindowSet(start, start + length), lengths

    def _weights(self, length: Int[Leaf, ""], columns: Columns) -> Float[Array, "1+s n"]:
        """h psi_k at the samples of a window of `length` samples, k from 0 to the smoothness s."""
        sample = jnp.arange(columns.sample_count)
        # By whole numbers: at the window's end |tau| is 1 but for rounding, and a compiler may
        # evaluate |tau| < 1 twice, once with fused multiply-adds, so that the masks differ.
        inside = (sample > 0) & (sample < length)
        tau = jnp.where(inside, 2 * sample / length - 1, 0.0)
        seconds = jnp.asarray(length * columns.time_step)
        one, slope = jnp.ones_like(tau), 2 / seconds  # slope: d tau / dt

        def phi(at: Array) -> Array:
            return self.weight(at, seconds)

        def along(function: Callable[[Array], Array]) -> Callable[[Array], Array]:
            return lambda at: jax.jvp(function, (at,), (one,))[1]

        rows, by_tau = [phi(tau)], phi
        for order in range(1, self.smoothness + 1):
            by_tau = along(by_tau)
            rows.append((-slope) ** order * by_tau(tau))
        return jnp.where(inside[None, :], jnp.stack(rows), 0.0) * columns.time_step


class Bump(AbstractSmoothTestFunction):
    """The smooth weight (1 - tau^2)^p, with tau from -1 to 1 over the window.

    **Arguments:**

    - `p`: 3 or more, so that a second derivative of the weight is still continuous.
    - `lengths`: number of window lengths, evenly spaced from alpha to beta; a window takes the
      nearest one.

    **Raises:** `ModelError` for p < 3 or no length.
    """

    name: ClassVar[str] = "bump"
    p: int = eqx.field(static=True, default=4)
    lengths: int = eqx.field(static=True, default=32)  # pyright: ignore[reportIncompatibleVariableOverride]

    def __check_init__(self):
        if self.p < 3:
            raise ModelError(f"a bump needs p of 3 or more; got {self.p}.")

    def weight(self, tau: Float[Array, " n"], length: Float[Array, ""]) -> Float[Array, " n"]:
        """(1 - tau^2)^p."""
        return (1 - tau**2) ** self.p

    def describe(self) -> dict[str, object]:
        """Name, exponent and number of window lengths."""
        return {"test_function": self.name, "p": self.p, "lengths": self.lengths}

    def gain(
        self, frequency: Float[np.ndarray, " frequencies"], length: Float[np.ndarray, " lengths"]
    ) -> Float[np.ndarray, "frequencies lengths"]:
        """|H| of windows by Poisson's integral for Bessel's functions, with z = w T / 2.

        integral_{-1}^{1} (1 - tau^2)^p exp(i z tau) dtau
        = sqrt(pi) p! (2 / z)^(p + 1/2) J_{p + 1/2}(z).
        """
        z = np.pi * (frequency[:, None] * length[None, :])
        order, front = self.p + 0.5, math.sqrt(math.pi) * math.gamma(self.p + 1)
        swings = np.maximum(z, 1e-3)
        transform = front * (2 / swings) ** order * scipy.special.jv(order, swings)
        # Below a thousandth of a radian the transform is what it is at rest, to 1e-7.
        transform = np.where(z > 1e-3, transform, front / math.gamma(self.p + 1.5))
        return 0.5 * length[None, :] * np.abs(transform)


class GradedBump(Bump):
    """A bump that takes more derivatives off, over lengths in equal ratios.

    What hidden modes ask for: an equation with one holds two derivatives more, and its windows must
    be long enough for the noise and short enough for the mode, neither of which is known before.

    **Arguments:** `p` and `lengths` as for [`Bump`][]; `derivatives` that it takes off.

    **Raises:** `ModelError` unless p is larger than the derivatives by 2, or for no length.
    """

    name: ClassVar[str] = "graded_bump"
    # Third derivatives of (1 - tau^2)^8 are off by less than 0.1 % over 20 samples.
    fewest_samples: ClassVar[int] = 20
    p: int = eqx.field(static=True, default=8)
    lengths: int = eqx.field(static=True, default=6)
    derivatives: int = eqx.field(static=True, default=3)

    @property
    def smoothness(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        """How many time derivatives it takes off."""
        return self.derivatives

    def __check_init__(self):
        if self.p < self.derivatives + 2:
            raise ModelError(
                f"a bump that takes {self.derivatives} derivatives off needs p of "
                f"{self.derivatives + 2} or more; got {self.p}."
            )

    def describe(self) -> dict[str, object]:
        """Name, exponent, number of window lengths and derivatives."""
        return {**super().describe(), "derivatives": self.derivatives}

    def _lengths(self, shortest: Int[Array, ""], longest: Int[Array, ""]) -> Int[Array, " lengths"]:
        share = jnp.arange(self.lengths) / max(self.lengths - 1, 1)
        lengths = shortest * (longest / shortest) ** share
        return jnp.round(lengths).astype(jnp.asarray(shortest).dtype)

    def rounded(
        self, windows: WindowSet, sample_count: Int[Array, ""] | int
    ) -> tuple[WindowSet, Int[Array, " lengths"]]:
        """The windows with the nearest of `lengths` lengths, and these lengths in samples."""
        drawn = windows.stop - windows.start
        lengths = self._lengths(jnp.min(drawn), jnp.max(drawn))
        length = lengths[jnp.argmin(jnp.abs(drawn[:, None] - lengths[None, :]), axis=1)]
        start = jnp.minimum(windows.start, sample_count - 1 - length)
        return WindowSet(start, start + length), lengths

    def edges(self, alpha: float, beta: float) -> Float[np.ndarray, " lengths+1"]:
        """Edges in seconds of bins that hold one length each, see the base class."""
        lengths = np.geomspace(alpha, beta, self.lengths)
        return np.concatenate([[alpha], np.sqrt(lengths[1:] * lengths[:-1]), [beta]])


def moments_of_rows(
    rows_of_length: Callable[[Int[Leaf, ""]], tuple[Float[Array, "columns n"], Array]],
    lengths: Int[Leaf, " lengths"],
    weights: Float[Leaf, " lengths"],
    blocks: StartBlocks,
) -> Moments:
    """Moments of rows that start at every sample, summed over some window lengths.

    **Arguments:** `rows_of_length` gives rows at every start, zero where there is no valid window,
    and where there is one; `weights` of the lengths, of which those of weight zero take no time.
    """
    columns = jax.eval_shape(rows_of_length, jnp.asarray(lengths)[0])[0]
    count, room = blocks.number, columns.shape[1]
    # Blocks of a known size are a reshape; of a traced one, a mask for each block.
    size = blocks.size
    place = (jnp.arange(room) - blocks.first) // size

    def in_blocks(values: Float[Array, "columns n"]) -> Float[Array, "columns count size"]:
        if not isinstance(size, int):
            return jnp.where(
                (place[None, :] == jnp.arange(count)[:, None])[None], values[:, None, :], 0.0
            )
        # Room behind, so that no slice would begin earlier than asked for.
        padded = jnp.pad(values, ((0, 0), (0, count * size)))
        part = jax.lax.dynamic_slice_in_dim(padded, blocks.first, count * size, axis=1)
        return part.reshape(values.shape[0], count, size)

    def of_length(length: Leaf, weight: Leaf) -> tuple[Array, Array]:
        rows, valid = rows_of_length(length)
        parts = in_blocks(rows)
        number = jnp.sum(in_blocks(valid[None].astype(rows.dtype))[0], axis=1)
        moments = jnp.einsum("ibs,jbs->bij", parts, parts)
        return jnp.asarray(weight) * moments, jnp.asarray(weight) * number

    empty = jnp.zeros((count, columns.shape[0], columns.shape[0]), columns.dtype)
    none = (empty, jnp.zeros(count, columns.dtype))
    return sum_over_lengths(of_length, (lengths, weights), none)
