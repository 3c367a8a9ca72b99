"""The smooth test function (1 - tau^2)^p, integrated by fast Fourier transform."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from riecjax.criteria.all_windows import Moments, moments_of_rows
from riecjax.criteria.chunks import in_chunks
from riecjax.criteria.test_functions import AbstractTestFunction, Integrals, whole
from riecjax.criteria.windows import AllWindows, WindowSet
from riecjax.equations.equation import Equation
from riecjax.equations.term import sum_columns
from riecjax.errors import ModelError
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
        """Name and settings."""
        return {"test_function": "bump", "p": self.p}

    def integrals(self, equation: Equation, record: Record, windows: WindowSet) -> Integrals:
        """Integral of every column of the equation over every window.

        **Raises:** `ModelError` for windows that start between samples.
        """
        if not jnp.issubdtype(windows.start.dtype, jnp.integer):
            raise ModelError("bumps need windows on samples (between_samples=False).")
        everywhere, present = self._at_every_start(equation, record)
        windows, lengths = self.rounded(windows, record.sample_count)

        def of_length(total: Array, length: Array) -> tuple[Array, None]:
            mine = (windows.stop - windows.start == length)[None, :]
            return jnp.where(mine, everywhere(length)[:, windows.start], total), None

        columns = 1 + len(equation.parameters)
        empty = jnp.zeros((columns, windows.start.shape[0]), record.time_step.dtype)
        total, _ = jax.lax.scan(of_length, empty, lengths)
        return Integrals(total, whole(windows, present))

    def moments(self, equation: Equation, record: Record, windows: AllWindows) -> Moments:
        """Sums over all starts of the outer products of rows, at `lengths` window lengths."""
        n = record.sample_count
        block, reach = windows.block(n), windows.reach(n)
        lengths = self._lengths(*windows.lags(n, record.time_step))
        weights = windows.weights(n, record.time_step, lengths)

        def of_chunk(part: Record, first: Int[Array, ""] | int, count: int) -> Moments:
            everywhere, present = self._at_every_start(equation, part)
            start = jnp.arange(part.sample_count)

            def rows_of_length(length: Array) -> tuple[Array, Array]:
                inside = start + length < part.sample_count
                window = WindowSet(start, jnp.minimum(start + length, part.sample_count - 1))
                unbroken = whole(window, present)
                held = inside if unbroken is None else inside & unbroken
                return jnp.where(held[None, :], everywhere(length), 0.0), held

            return moments_of_rows(
                rows_of_length, lengths, weights, first=first, count=count, block=block
            )

        return in_chunks(record, of_chunk, block=block, reach=reach, margin=0)

    def window_count(self, windows: AllWindows, record: Record) -> float:
        """Starts of every length, as far as windows end in the record."""
        n = record.sample_count
        lengths = self._lengths(*windows.lags(n, record.time_step))
        weights = np.asarray(windows.weights(n, record.time_step, lengths), float)
        return float(np.sum(weights * (n - np.asarray(lengths, float))))

    def _at_every_start(
        self, equation: Equation, record: Record
    ) -> tuple[Callable[[Array], Float[Array, "columns n"]], Bool[Array, " n"] | None]:
        """A function of window length: integrals of every column over the windows at each start."""
        columns, present = self._columns(equation, record)
        size = 2 * record.sample_count
        spectrum = jnp.fft.rfft(columns, size, axis=-1)

        def everywhere(length: Array) -> Float[Array, "columns n"]:
            weights = jnp.fft.rfft(self.weights(length, record), size, axis=-1)
            # Summed over the order of derivative: correlation of each column with its weight.
            product = jnp.sum(spectrum * jnp.conj(weights)[:, None, :], axis=0)
            return jnp.fft.irfft(product, size, axis=-1)[:, : record.sample_count]

        return everywhere, present

    def _lengths(self, shortest: Int[Array, ""], longest: Int[Array, ""]) -> Int[Array, " lengths"]:
        spacing = (longest - shortest) / max(self.lengths - 1, 1)
        return jnp.round(shortest + spacing * jnp.arange(self.lengths)).astype(shortest.dtype)

    def rounded(
        self, windows: WindowSet, sample_count: int
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

    def weights(self, length: Int[Array, ""], record: Record) -> Float[Array, "3 n"]:
        """(-1)^k d^k phi / dt^k dt at the samples of a window of `length` samples, k = 0, 1, 2."""
        sample = jnp.arange(record.sample_count)
        # By whole numbers: at the window's end |tau| is 1 but for rounding, and a compiler may
        # evaluate |tau| < 1 twice, once with fused multiply-adds, so that the masks differ.
        inside = (sample > 0) & (sample < length)
        tau = jnp.where(inside, 2 * sample / length - 1, 0.0)
        slope = 2 / (length * record.time_step)
        u, p = 1 - tau**2, self.p
        first = -2 * p * tau * u ** (p - 1)
        second = 4 * p * (p - 1) * tau**2 * u ** (p - 2) - 2 * p * u ** (p - 1)
        weights = jnp.stack([u**p, -slope * first, slope**2 * second])
        return jnp.where(inside[None, :], weights, 0.0) * record.time_step

    def _columns(
        self, equation: Equation, record: Record
    ) -> tuple[Float[Array, "3 columns n"], Bool[Array, " n"] | None]:
        """Samples of every column, by the order of the derivative in front of them."""
        read = [term.samples(record, 0) for term in equation.terms]
        by_order = []
        for order in range(3):
            blocks = [
                _without_mean(sampled.values, order)
                if term.derivative == order
                else jnp.zeros_like(sampled.values)
                for term, sampled in zip(equation.terms, read)
            ]
            by_order.append(sum_columns(zip(equation.terms, blocks), equation.parameters))
        return jnp.stack(by_order), equation.present(record, read)


def _without_mean(values: Float[Array, "columns n"], derivative: int) -> Array:
    """A constant has no derivative, while the sum of a weight's derivative is not quite zero."""
    return values if derivative == 0 else values - jnp.mean(values, axis=1, keepdims=True)
