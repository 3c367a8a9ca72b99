"""The smooth test function (1 - tau^2)^p, integrated by fast Fourier transform."""

from collections.abc import Callable
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from riecjax.criteria.all_windows import Moments, moments_of_rows
from riecjax.criteria.chunks import Blocks
from riecjax.criteria.gains import bump_gain
from riecjax.criteria.laws import LagBins
from riecjax.criteria.length_bins import each_bin
from riecjax.criteria.test_functions import AbstractTestFunction, Integrals, real_mean, whole
from riecjax.criteria.windows import AllWindows, WindowSet
from riecjax.equations.columns import Columns
from riecjax.errors import ModelError
from riecjax.leaves import Leaf
from riecjax.records.record import Record


class Bump(AbstractTestFunction):
    """The smooth weight (1 - tau^2)^p, with tau from -1 to 1 over the window.

    Integrals are sums over the samples of weight times signal, for every start at once by fast
    Fourier transform, one window length after the other. The k-th derivative of the weight has a
    zero of multiplicity p - k at both ends, so by Euler and Maclaurin the sums converge with
    order p - k + 1 where that is even, else p - k + 2: for an inertia (k = 2), order 4 with p = 4.

    **Arguments:**

    - `p`: 3 or more, so that a second derivative of the weight is still continuous.
    - `lengths`: number of window lengths, evenly spaced from alpha to beta; a window takes the
      nearest one.

    **Raises:** `ModelError` for p < 3 or no length.
    """

    name: ClassVar[str] = "bump"
    p: int = eqx.field(static=True, default=4)
    lengths: int = eqx.field(static=True, default=32)

    def __check_init__(self):
        if self.p < 3:
            raise ModelError(f"a bump needs p of 3 or more; got {self.p}.")
        if self.lengths < 1:
            raise ModelError(f"a bump needs at least one window length; got {self.lengths}.")

    @property
    def smoothness(self) -> int:
        """2: as many as an equation of motion has."""
        return 2

    @property
    def length_multiple(self) -> int:
        """1: any whole number of samples."""
        return 1

    def describe(self) -> dict[str, object]:
        """Name, exponent and number of window lengths."""
        return {**super().describe(), "p": self.p, "lengths": self.lengths}

    def gain(
        self, frequency: Float[np.ndarray, " frequencies"], length: Float[np.ndarray, " lengths"]
    ) -> Float[np.ndarray, "frequencies lengths"]:
        """|H| of windows in seconds, by Bessel's function of the order p + 1/2."""
        return bump_gain(frequency, length, self.p)

    def integrals(
        self, columns: Columns, windows: WindowSet, held: Int[Array, ""] | int | None = None
    ) -> Integrals:
        """Integral of every column of the equation over every window.

        **Raises:** `ModelError` for windows that start between samples.
        """
        if not jnp.issubdtype(windows.start.dtype, jnp.integer):
            raise ModelError("bumps need windows on samples (between_samples=False).")
        everywhere = self._at_every_start(columns, held)
        windows, lengths = self.rounded(windows, columns.sample_count if held is None else held)

        def of_length(total: Array, length: Array) -> tuple[Array, None]:
            mine = (windows.stop - windows.start == length)[None, :]
            return jnp.where(mine, everywhere(length)[:, windows.start], total), None

        empty = jnp.zeros((columns.values.shape[1], windows.start.shape[0]), columns.values.dtype)
        total, _ = jax.lax.scan(of_length, empty, lengths)
        return Integrals(total, whole(windows, columns.present))

    def lags(self, windows: AllWindows, record: Record) -> LagBins:
        """The law at `lengths` window lengths."""
        n = record.sample_count
        lengths = self._lengths(*windows.lags(n, record.time_step))
        return LagBins(lengths, lengths, windows.weights(n, record.time_step, lengths))

    def moments(self, columns: Columns, lags: LagBins, blocks: Blocks, reach: int) -> Moments:
        """Sums over all starts of the outer products of rows, at `lengths` window lengths."""
        everywhere = self._at_every_start(columns, blocks.held)
        start = jnp.arange(columns.sample_count)

        def rows_of_length(length: Leaf) -> tuple[Array, Array]:
            inside = start + length < blocks.held
            window = WindowSet(start, jnp.minimum(start + length, columns.sample_count - 1))
            unbroken = whole(window, columns.present)
            held = inside if unbroken is None else inside & unbroken
            return jnp.where(held[None, :], everywhere(length), 0.0), held

        def of_lags(own: LagBins) -> Moments:
            return moments_of_rows(
                rows_of_length, own.first, own.weight, blocks, skip_empty=lags.first.ndim == 2
            )

        return each_bin(of_lags, lags._replace(edges=None))

    def window_count(self, windows: AllWindows, record: Record) -> float:
        """Starts of every length, as far as windows end in the record."""
        lags = self.lags(windows, record)
        starts = record.sample_count - np.asarray(lags.first, float)
        return float(np.sum(np.asarray(lags.weight, float) * starts))

    def _at_every_start(
        self, columns: Columns, held: Int[Array, ""] | int | None
    ) -> Callable[[Leaf], Float[Array, "columns n"]]:
        """A function of window length: integrals of every column over the windows at each start."""
        # A constant has no derivative, while the sum of a weight's derivative is not quite zero.
        values = jnp.stack(
            [
                of_order if order == 0 else of_order - real_mean(of_order, held)[:, None]
                for order, of_order in enumerate(columns.values)
            ]
        )
        size = 2 * columns.sample_count
        spectrum = jnp.fft.rfft(values, size, axis=-1)

        def everywhere(length: Leaf) -> Float[Array, "columns n"]:
            weights = jnp.fft.rfft(self.weights(length, columns), size, axis=-1)
            # Summed over the order of derivative: correlation of each column with its weight.
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

    def weights(self, length: Int[Leaf, ""], columns: Columns) -> Float[Array, "3 n"]:
        """(-1)^k d^k phi / dt^k dt at the samples of a window of `length` samples, k = 0, 1, 2."""
        sample = jnp.arange(columns.sample_count)
        # By whole numbers: at the window's end |tau| is 1 but for rounding, and a compiler may
        # evaluate |tau| < 1 twice, once with fused multiply-adds, so that the masks differ.
        inside = (sample > 0) & (sample < length)
        tau = jnp.where(inside, 2 * sample / length - 1, 0.0)
        slope = 2 / (length * columns.time_step)
        u, p = 1 - tau**2, self.p
        first = -2 * p * tau * u ** (p - 1)
        second = 4 * p * (p - 1) * tau**2 * u ** (p - 2) - 2 * p * u ** (p - 1)
        weights = jnp.stack([u**p, -slope * first, slope**2 * second])
        return jnp.where(inside[None, :], weights, 0.0) * columns.time_step
