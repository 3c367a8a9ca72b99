"""Test functions: the weight that a window gives to the equation of motion inside it.

**Integration by parts.** A window from t0 to t0 + T weighs the equation with a function phi that is
zero outside it. As phi vanishes at both ends, derivatives move from the motion s to the weight:

    integral phi s^(k) dt = (-1)^k integral phi^(k) s dt

so that a recorded position suffices where DOLS needs an acceleration. How many derivatives move is
the weight's smoothness: one for the boxcar, two for the hat and for bumps. The derivatives that are
left when a weight's own are pulses need no integral at all:

    boxcar  phi = 1             phi'  = d(t - t0) - d(t - t0 - T)                  [s]    over T
    hat     phi = min(t, T - t) phi'' = d(t - t0) - 2 d(t - t0 - T/2) + d(t - t0 - T)

with d Dirac's pulse: an integrated boxcar of s' is the paper's Delta x = x(T) - x(0), and the hat
of s'' its "second integration" x(T) - 2 x(T/2) + x(0). The pulse by itself as a weight leaves the
equation at one sample, which is DOLS.

**Gain.** An error of frequency f = w / (2 pi) enters a window with the gain |H| = |integral phi
exp(i w t) dt|, eq. (13); see `gains`. Least squares sees the mean of |H|^2 over the windows.
"""

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Any, ClassVar, Literal

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from riecjax import arrays as xp
from riecjax.arrays import Array
from riecjax.criteria.all_windows import (
    ORDERS,
    Moments,
    Points,
    Primitives,
    Runs,
    moments_in_blocks,
    running_integral,
)
from riecjax.criteria.noise_moments import (
    NoiseWeights,
    boxcar_noise_weights,
    hat_noise_weights,
)
from riecjax.criteria.windows import (
    AllWindows,
    LagBins,
    StartBlocks,
    WindowSet,
    half_periods,
    sum_over_bins,
)
from riecjax.equations.noisy_columns import Columns
from riecjax.errors import ModelError
from riecjax.leaves import Leaf, PlainMethods
from riecjax.records.record import Record
from riecjax.records.signal import both

# Gains of windows: how much of each frequency one window, or a range of lengths, lets through.
#
# A window of length T passes an oscillation exp(i w t) with a gain |H|, the size of its weight's
# Fourier integral. For the boxcar, eq. (13),
#
#     |H| = |integral_0^T exp(i w t) dt| = |2 sin(w T / 2) / w|
#
# which is largest at T = 1 / (2 f) for a given f (eq. 26) and zero at multiples of T = 1 / f. The
# hat is the boxcar of T / 2 folded with itself, so its gain is the square of that one's. In the
# mean over lengths, eq. (14), no frequency is left unseen: with x = w T / (2 s) and s the order of
# the difference, |H| = (2 |sin x| / w)^s, and for T ~ U(alpha, beta)
#
#     mean |H|^q = (2 / w)^(s q) (P(x_beta) - P(x_alpha)) / (x_beta - x_alpha)
#
# where P is the integral of |sin|^(s q) from zero. The paper averages |H| (q = 1); least squares
# sees the mean of its square (q = 2).

NODES = 256
"""Window lengths in a mean by quadrature: two to a lobe of the gain where there are 128 lobes, and
so far out a smooth weight lets next to nothing through."""
SLOWEST = 5e-3
"""Periods to the longest window below which a motion is as good as constant."""

Frequencies = Float[np.ndarray, " frequencies"]
Lengths = Float[np.ndarray, " lengths"]
Gains = Float[np.ndarray, "frequencies lengths"]


@functools.cache
def _nodes() -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights of Gauss and Legendre; finding them takes longer than using them."""
    return np.polynomial.legendre.leggauss(NODES)


Integrals = tuple[Float[Array, "columns windows"], Bool[Array, " windows"] | None]
"""Weighted integrals of every column of an equation over every window, the target first; and False
for windows that touch a missing or masked sample and hold no meaning, `None` where there are
none."""


class AbstractTestFunction(PlainMethods, eqx.Module):
    """A weight on a window, and the integrals of an equation that it makes.

    A new one is one subclass. A smooth weight takes a name and a formula: see
    [`AbstractSmoothTestFunction`][riecjax.criteria.AbstractSmoothTestFunction]. Any other gives a
    `name` and whatever raises `NotImplementedError` here.
    """

    name: ClassVar[str]
    """What `describe` and the command line call it."""
    smoothness: ClassVar[int]
    """How many time derivatives it takes off the motion, by integration by parts."""
    length_multiple: ClassVar[int] = 1
    """Window lengths are whole multiples of so many samples."""
    fewest_samples: ClassVar[int] = 4
    """Samples that the shortest window should span, or it is hardly an integral."""
    row_seconds: ClassVar[int] = 1
    """Power of the second by which a row's unit differs from the equation's: 1 where the weight has
    no unit, 2 for a weight in seconds."""

    @property
    def margin(self) -> int:
        """Samples beside a window that its integrals may look at."""
        return 0

    def lengths_of_band(self, band: tuple[float, float]) -> tuple[float, float]:
        """alpha and beta in seconds that suit a band in hertz: half its periods, eq. (26).

        **Raises:** `ModelError` unless 0 < low < high.
        """
        return half_periods(band)

    def edges(self, alpha: float, beta: float) -> Float[np.ndarray, " edges"] | None:
        """Edges in seconds of bins of lengths whose sums it asks to be kept apart, if any."""
        return None

    def integrals(self, columns: Columns, windows: WindowSet) -> Integrals:
        """Integral of every column over every window."""
        raise NotImplementedError

    def lags(self, windows: AllWindows, record: Record) -> LagBins:
        """The law of window lengths on a record, in multiples of `length_multiple` samples."""
        law = windows.lags(record, self.length_multiple)
        return LagBins(*(xp.asarray(lag)[None] for lag in law))

    def moments(self, columns: Columns, lags: LagBins, blocks: StartBlocks, reach: int) -> Moments:
        """Sums over all windows of the outer products of their rows, for blocks of starts.

        **Arguments:** `lags`, the law of lengths; one with two axes gives sums for each of the
        first, along a leading axis. `reach`: no window is longer, in samples.
        """
        raise NotImplementedError

    def noise_weights(
        self, columns: Columns, windows: LagBins | WindowSet, blocks: StartBlocks
    ) -> NoiseWeights | None:
        """How much white noise at each sample weighs in the moments, see `noise_weights`.

        `None` where no closed form is known.

        **Arguments:** `windows`, the law of all windows that start in the blocks, which in bins has
        weights for each of them; or windows drawn.
        """
        return None

    def gain(self, frequency: Frequencies, length: Lengths) -> Gains:
        """|H| of windows, eq. (13): size of the weighted integral of a unit oscillation.

        In seconds to the power `row_seconds`.

        **Arguments:** `frequency` in hertz, `length` of the whole window in seconds.
        """
        raise NotImplementedError

    def mean_gain(
        self, frequency: Frequencies, alpha: float, beta: float, power: Literal[1, 2] = 1
    ) -> Frequencies:
        """Mean of |H|^power over T ~ U(alpha, beta), eq. (14).

        `power=1` is what Fig. 3 draws; `power=2` is what least squares sees: times the density of
        an error, and integrated, it is the mean square of the windows' errors.

        **Arguments:** `frequency` in hertz; `alpha`, `beta` in seconds.
        """
        total = np.zeros_like(frequency)
        # One length at a time: at all of them spectra of long records would make a large table.
        for node, weight in zip(*_nodes()):
            length = 0.5 * (alpha + beta + node * (beta - alpha))
            total += 0.5 * weight * self.gain(frequency, np.array([length]))[:, 0] ** power
        return total

    def finest(self) -> "AbstractTestFunction":
        """The same weight with the most accurate integrals there are."""
        return self

    def describe(self) -> dict[str, object]:
        """Name and settings that are numbers, for tables and JSON."""
        fields = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        numbers = {name: value for name, value in fields.items() if isinstance(value, int | float)}
        return {"test_function": self.name, **numbers}


class Dirac(AbstractTestFunction):
    """The pulse at one sample: its row is the equation there, as DOLS takes it, eqs (2)-(4)."""

    name: ClassVar[str] = "dirac"
    smoothness: ClassVar[int] = 0
    row_seconds: ClassVar[int] = 0  # the pulse is per second, which the integral takes back

    def integrals(self, columns: Columns, windows: WindowSet) -> Integrals:
        """Every column at the start of every window."""
        valid = valid_windows(windows, columns.present)
        return xp.take(columns.values[0], windows.start, axis=1), valid


class _Differences(AbstractTestFunction):
    """Weights whose integrals are differences, of the order s, of s-fold running integrals.

    Windows are multiples of s samples, so that all points of a difference lie on samples, and rows
    have s seconds more than the equation: it is integrated s times. s is the `smoothness`.
    """

    quadrature: int = eqx.field(static=True, default=4)

    def __check_init__(self):
        if self.quadrature not in ORDERS:
            raise ModelError(
                f"the order of quadrature must be one of {ORDERS}; got {self.quadrature}."
            )

    def finest(self) -> "AbstractTestFunction":
        """The same weight with quadrature of the highest order."""
        return dataclasses.replace(self, quadrature=max(ORDERS))

    def gain(self, frequency: Frequencies, length: Lengths) -> Gains:
        """|H| of windows: of the boxcar T |sinc(f T)|, of the hat (T / 2)^2 sinc^2(f T / 2).

        The weight is s boxcars of length T / s, folded: the gain is the power s of the gain of one.
        """
        part = length[None, :] / self.smoothness
        return np.abs(part * np.sinc(frequency[:, None] * part)) ** self.smoothness

    def mean_gain(
        self, frequency: Frequencies, alpha: float, beta: float, power: Literal[1, 2] = 1
    ) -> Frequencies:
        """Mean of |2 sin(w T / (2 s)) / w|^(s power) over T ~ U(alpha, beta), in closed form."""
        exponent = self.smoothness * power
        # As good as at rest, and the difference of the primitives keeps its digits.
        omega = 2 * np.pi * np.maximum(frequency, SLOWEST / beta)
        low, high = (omega * length / (2 * self.smoothness) for length in (alpha, beta))

        def primitive(x: Frequencies) -> Frequencies:
            """Integral of |sin|^exponent from zero to x, for the exponents 1, 2 and 4."""
            if exponent == 1:
                return 2 * np.floor(x / np.pi) + 1 - np.cos(x % np.pi)
            if exponent == 2:
                return x / 2 - np.sin(2 * x) / 4
            return 3 * x / 8 - np.sin(2 * x) / 4 + np.sin(4 * x) / 32

        mean = (primitive(high) - primitive(low)) / (high - low)
        return (2 / omega) ** exponent * mean

    @property
    def margin(self) -> int:
        """Samples beside a window that its integrals may look at."""
        return self.quadrature

    def primitives(self, columns: Columns) -> Primitives:
        """Primitives of the target (first row) and of every named coefficient's column.

        A column is sum_k d^k/dt^k values[k], so that its s-fold integral is the sum over k of the
        (s - k)-fold integrals of values[k]: each joins after k of s integrations.
        """
        s, step, present = self.smoothness, columns.time_step, columns.present
        values, mean, slope = columns.values[0], xp.zeros(()), columns.values[0]
        for integrated in range(1, s + 1):
            slope = values * step
            average = xp.mean(slope, axis=1)
            # A later mean is integrated s - 1 times at most: the s-th difference of that vanishes.
            mean = average * step ** (s - 1) if integrated == 1 else mean
            values = columns.values[integrated]
            # A column that is all derivative has nothing to integrate.
            some = slice(None) if xp.is_traced(slope) else np.flatnonzero(slope.any(axis=1))
            whole = running_integral(slope[some] - average[some, None], self.quadrature, present)
            values = xp.with_entries(values, some, whole + values[some])
        return Primitives(values, mean, slope, present, s)

    def integrals(self, columns: Columns, windows: WindowSet) -> Integrals:
        """Integral of every column over every window.

        **Raises:** `ModelError` for windows that start between samples, unless the test function
        is the boxcar with trapezoidal quadrature.
        """
        on_samples = np.issubdtype(windows.start.dtype, np.integer)
        if not on_samples and (self.smoothness > 1 or self.quadrature > 2):
            raise ModelError(
                "windows between samples go with the boxcar and quadrature of order 2; draw them "
                "on samples (between_samples=False)."
            )
        values = self.primitives(columns).differences(*windows)
        return values, valid_windows(windows, columns.present)

    def moments(self, columns: Columns, lags: LagBins, blocks: StartBlocks, reach: int) -> Moments:
        """Sums over all windows of the outer products of their rows, for blocks of starts."""
        return moments_in_blocks(self.primitives(columns), lags, blocks, reach=reach)

    def noise_weights(
        self, columns: Columns, windows: LagBins | WindowSet, blocks: StartBlocks
    ) -> NoiseWeights | None:
        """In closed form for windows on samples, but for hats in 32-bit: running sums of squares
        are cubes of a chunk's length, beside which those of a window have no digit left."""
        if self.smoothness == 2 and columns.values.dtype == np.float32:
            return None
        if isinstance(windows, LagBins):
            n, present = columns.sample_count, columns.present
            valid = np.ones(n, bool) if present is None else present
            runs = Runs.of(valid, blocks.first, blocks.size * blocks.number)
            of_bin = functools.partial(Points.of_bin, runs=runs, pieces=self.smoothness)
            counted = sum_over_bins(windows, of_bin, beside=runs)
            # Their sums of sums are more than 32-bit integers hold.
            points = Points(*(number.astype(columns.values.dtype) for number in counted))
        elif not np.issubdtype(windows.start.dtype, np.integer):
            return None
        else:
            whole = valid_windows(windows, columns.present)
            one = np.ones(windows.start.shape) if whole is None else whole.astype(float)
            half = (windows.stop - windows.start) // 2
            places = windows.start, windows.start + half, windows.start + half, windows.stop
            each = zip((one, one, half * one, one), places)
            points = Points(*(xp.sum_by_block(*ends, columns.sample_count) for ends in each))
        weights = boxcar_noise_weights if self.smoothness == 1 else hat_noise_weights
        return weights(points, self.quadrature, columns.time_step)


class Boxcar(_Differences):
    """Weight 1 inside the window, 0 outside: RIEC as published.

    Integrates the equation once. A term with a derivative becomes a difference between the ends
    of the window, the paper's Delta x, so that velocities stand where DOLS needs
    accelerations.

    **Arguments:** `quadrature`: order in the time step, 2 (trapezoids), 4, 6 or 8.

    **Raises:** `ModelError` for another order.
    """

    name: ClassVar[str] = "boxcar"
    smoothness: ClassVar[int] = 1


class Hat(_Differences):
    """A triangle over the window, of slope 1 to its middle and -1 from there.

    Integrates the equation twice, the paper's "second integration": over a window [0, 2 L] a
    second derivative becomes x(2 L) - 2 x(L) + x(0), so a recorded position suffices.

    **Arguments:** `quadrature`: order in the time step, 2 (trapezoids), 4, 6 or 8.

    **Raises:** `ModelError` for another order.
    """

    name: ClassVar[str] = "hat"
    smoothness: ClassVar[int] = 2
    length_multiple: ClassVar[int] = 2
    row_seconds: ClassVar[int] = 2


def valid_windows(
    windows: WindowSet, present: Bool[Array, " n"] | None
) -> Bool[Array, " windows"] | None:
    """Which windows hold no missing sample; `None` where nothing is missing."""
    if present is None:
        return None
    absent = xp.pad(xp.cumsum(~present), (1, 0))
    first = xp.floor(windows.start).astype(np.int32)
    last = xp.ceil(windows.stop).astype(np.int32)
    return xp.take(absent, last + 1) == xp.take(absent, first)


# Smooth test functions, integrated by fast Fourier transform.
#
# The row of the window that starts at sample t is a sum over samples of weight times signal,
#
#     r[t] = h sum_k sum_i psi_k[i] s_k[t + i],    psi_k = (-1)^k d^k phi / dt^k
#
# with s_k the part of a column that stands under k time derivatives. For all t at once it is a
# correlation: the signals are transformed once, each window length's weights once, and one inverse
# transform gives the rows at every start, O(N log N) for each column and length. What wraps around
# are rows of windows that reach beyond the record, which are left out.
#
# **Order.** By Euler and Maclaurin, a sum over samples differs from the integral by the odd
# derivatives of the integrand g at the window's ends, times even powers of h:
#
#     h sum_i g[i] - integral g dt = h^2 / 12 [g^(1)] - h^4 / 720 [g^(3)] + ...
#
# The k-th derivative of (1 - tau^2)^p has a zero of multiplicity p - k at both ends, so the first
# term that is left has order p - k + 1 where that is even, else p - k + 2: for an inertia (k = 2),
# order 4 with p = 4.


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
        """Name and settings that are numbers, the number of window lengths among them."""
        return {**super().describe(), "lengths": self.lengths}

    def gain(self, frequency: Frequencies, length: Lengths) -> Gains:
        """|H| of windows, by Gauss and Legendre.

        |H| = T / 2 |integral_{-1}^{1} phi exp(i z tau) dtau| with z = w T / 2. n nodes integrate
        polynomials of degree 2 n - 1, and exp(i z tau) is one of degree little more than z but for
        rounding, so n nodes serve up to z = n. What a smooth weight lets through beyond is taken to
        be zero.
        """
        nodes, weights = _nodes()
        found = np.zeros((frequency.size, length.size))
        for place, seconds in enumerate(length):
            phi = weights * self.by_tau(nodes, seconds, 0)[0]
            z = np.pi * frequency * seconds
            seen = z < NODES
            phase = np.outer(z[seen], nodes)
            size = np.hypot(np.cos(phase) @ phi, np.sin(phase) @ phi)
            found[seen, place] = 0.5 * seconds * size
        return found

    def integrals(self, columns: Columns, windows: WindowSet) -> Integrals:
        """Integral of every column of the equation over every window.

        **Raises:** `ModelError` for windows that start between samples.
        """
        if not np.issubdtype(windows.start.dtype, np.integer):
            raise ModelError(f"{self.name}s need windows on samples (between_samples=False).")
        everywhere = self._at_every_start(columns)
        windows, lengths = self.rounded(windows, columns.sample_count)

        def of_length(length: Array) -> Array:
            mine = (windows.stop - windows.start == length)[None, :]
            return xp.where(mine, xp.take(everywhere(length), windows.start, axis=1), 0.0)

        beside = (columns, windows)
        # A length that is there twice counts once.
        before = np.tri(self.lengths, k=-1, dtype=bool) & (lengths[:, None] == lengths[None, :])
        each = LagBins(lengths, lengths - before.any(axis=1))
        total = sum_over_bins(each, lambda bin_: of_length(bin_.first), beside=beside)
        return total, valid_windows(windows, columns.present)

    def lags(self, windows: AllWindows, record: Record) -> LagBins:
        """`lengths` window lengths, which count alike."""
        lengths = self._lengths(*map(xp.asarray, windows.lags(record)))
        return LagBins(lengths, lengths)

    def moments(self, columns: Columns, lags: LagBins, blocks: StartBlocks, reach: int) -> Moments:
        """Sums over all starts of the outer products of rows, at `lengths` window lengths."""
        everywhere = self._at_every_start(columns)

        def of_length(bin_: LagBins) -> Moments:
            valid = self._whole(columns, bin_.first, blocks)[None, :]
            rows = xp.where(valid, everywhere(bin_.first), 0.0)
            there = valid.astype(rows.dtype)
            return blocks.products(rows, rows), blocks.products(there, there)[:, 0, 0]

        return sum_over_bins(lags, of_length, beside=columns)

    def noise_weights(
        self, columns: Columns, windows: LagBins | WindowSet, blocks: StartBlocks
    ) -> NoiseWeights | None:
        """Of all windows: W_kl[u] is the sum over lengths and t of w_k[u - t] w_l[u - t], as often
        as windows of a length start at t, by Fourier transform."""
        if not isinstance(windows, LagBins):
            return None
        orders, n = self.smoothness + 1, columns.sample_count
        one, other = np.triu_indices(orders)
        place = np.zeros((orders, orders), int)
        place[one, other] = place[other, one] = np.arange(one.size)
        # No window reaches beyond the samples, so that nothing wraps around.
        size, dtype = xp.fft_size(n), columns.values.dtype

        def of_length(bin_: LagBins) -> Array:
            starts = self._whole(columns, bin_.first, blocks).astype(dtype)
            inside = self._weights(bin_.first, n, columns.time_step.astype(dtype))
            spectrum = xp.fft.rfft(inside[one] * inside[other], size, axis=-1)
            spectrum = xp.fft.rfft(starts, size)[None] * spectrum
            return xp.fft.irfft(spectrum, size, axis=-1)[:, :n]

        return sum_over_bins(windows, of_length, lambda weights: weights[place], beside=columns)

    def _whole(self, columns: Columns, length: Leaf, blocks: StartBlocks) -> Bool[Array, " n"]:
        """Where a window of this length may start: in a block, with no sample missing."""
        n = columns.sample_count
        start = np.arange(n)
        within = (start >= blocks.first) & (start < blocks.first + blocks.size * blocks.number)
        window = WindowSet(start, xp.minimum(start + length, n - 1))
        unbroken = valid_windows(window, columns.present)
        valid: Any = both(unbroken, within & (start + length < n))
        return valid

    def _at_every_start(self, columns: Columns) -> Callable[[Leaf], Float[Array, "columns n"]]:
        """A function of window length: integrals of every column over the windows at each start."""
        # A constant has no derivative, while the sum of a weight's derivative is not quite zero.
        derived = columns.values[1:] - columns.values[1:].mean(axis=-1, keepdims=True)
        values = xp.concatenate([columns.values[:1], derived])
        n, step = columns.sample_count, columns.time_step.astype(values.dtype)
        size = xp.fft_size(n)
        spectrum = xp.fft.rfft(values, size, axis=-1)

        def everywhere(length: Leaf) -> Float[Array, "columns n"]:
            # Classes with arrays of their own cannot be looked up.
            if xp.are_traced(length, step) or jax.tree.leaves(self):
                weights = xp.fft.rfft(self._weights(length, n, step), size, axis=-1)
            else:
                weights = _spectrum(self, int(length), n, float(step))
            product = (spectrum * xp.conj(weights)[:, None, :]).sum(axis=0)
            return xp.fft.irfft(product, size, axis=-1)[:, :n]

        return everywhere

    def _lengths(self, shortest: Int[Array, ""], longest: Int[Array, ""]) -> Int[Array, " lengths"]:
        spacing = (longest - shortest) / max(self.lengths - 1, 1)
        return xp.round(shortest + spacing * np.arange(self.lengths)).astype(shortest.dtype)

    def rounded(
        self, windows: WindowSet, sample_count: int
    ) -> tuple[WindowSet, Int[Array, " lengths"]]:
        """The windows with the nearest of `lengths` lengths, and these lengths in samples."""
        drawn = windows.stop - windows.start
        lengths = self._lengths(drawn.min(), drawn.max())
        length = xp.take(lengths, self._nearest(drawn, lengths))
        start = xp.minimum(windows.start, sample_count - 1 - length)
        return WindowSet(start, start + length), lengths

    def _nearest(
        self, drawn: Int[Array, " windows"], lengths: Int[Array, " lengths"]
    ) -> Int[Array, " windows"]:
        # One division, of whole numbers: a tie is broken alike however it is compiled, while XLA
        # makes of the division by a constant the product by its rounded reciprocal.
        room = xp.maximum(lengths[-1] - lengths[0], 1.0)
        nearest = xp.round((drawn - lengths[0]) * float(self.lengths - 1) / room)
        return xp.clip(nearest.astype(np.int32), 0, self.lengths - 1)

    def _weights(self, length: Int[Leaf, ""], count: int, step: Leaf) -> Float[Array, "1+s n"]:
        """h psi_k at the samples of a window of `length` samples, k from 0 to the smoothness s; at
        so many samples where the length is traced, else at no more than the window has."""
        if not xp.are_traced(length, step):
            count = min(int(length) + 1, count)
        sample = np.arange(count)
        # By whole numbers: at the window's end |tau| is 1 but for rounding, and a compiler may
        # evaluate |tau| < 1 twice, once with fused multiply-adds, so that the masks differ.
        inside = (sample > 0) & (sample < length)
        tau = xp.where(inside, 2 * sample / length - 1, 0.0).astype(step.dtype)
        seconds = length * step
        along = self.by_tau(tau, seconds, self.smoothness)
        rows = [(-2 / seconds) ** order * of for order, of in enumerate(along)]  # d tau / dt
        return xp.where(inside[None, :], xp.stack(rows), 0.0) * step

    def by_tau(
        self, tau: Float[Array, " n"], length: Float[Array, ""], most: int
    ) -> list[Float[Array, " n"]]:
        """phi and its derivatives by tau up to `most`, at tau from -1 to 1: JAX's, unless a class
        knows better."""

        def phi(at: Array) -> Array:
            return self.weight(at, length)

        def along(function: Callable[[Array], Array]) -> Callable[[Array], Array]:
            return lambda at: jax.jvp(function, (at,), (jax.numpy.ones_like(at),))[1]

        def every(at: Array) -> list[Array]:
            found: list[Callable[[Array], Array]] = [phi]
            for _ in range(most):
                found.append(along(found[-1]))
            return [of(at) for of in found]

        if xp.are_traced(tau, length):
            return every(tau)
        # A function of JAX's is compiled for each size: for few of them.
        filled = np.pad(tau, (0, 2 ** math.ceil(math.log2(tau.size)) - tau.size))
        return [of[: tau.size] for of in xp.in_double(every, filled)]


@functools.lru_cache(maxsize=64)  # of one chunk after the other, and of noise sent through each
def _spectrum(
    weight: AbstractSmoothTestFunction, length: int, count: int, step: float
) -> np.ndarray:
    """Fourier transform of h psi_k of windows of so many samples, among `count` samples."""
    rows = weight._weights(np.asarray(length), count, np.asarray(step))
    return np.fft.rfft(rows, xp.fft_size(count), axis=-1)


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

    def by_tau(
        self, tau: Float[Array, " n"], length: Float[Array, ""], most: int
    ) -> list[Float[Array, " n"]]:
        """(1 - tau^2)^(p - k) times a polynomial q_k for the k-th derivative, which differentiates
        to q_(k+1) = (1 - tau^2) q_k' - 2 (p - k) tau q_k."""
        rest, found, coefficients = 1 - tau**2, [], np.ones(1)
        for order in range(most + 1):
            of = functools.reduce(lambda sum_, c: sum_ * tau + c, coefficients.tolist(), 0.0 * tau)
            found.append(rest ** (self.p - order) * of)
            coefficients = np.polyadd(
                np.polymul(np.polyder(coefficients), [-1.0, 0.0, 1.0]),
                np.polymul([-2.0 * (self.p - order), 0.0], coefficients),
            )
        return found


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

    def _lengths(self, shortest: Int[Array, ""], longest: Int[Array, ""]) -> Int[Array, " lengths"]:
        share = np.arange(self.lengths) / max(self.lengths - 1, 1)
        lengths = shortest * (longest / shortest) ** share
        return xp.round(lengths).astype(xp.asarray(shortest).dtype)

    def _nearest(
        self, drawn: Int[Array, " windows"], lengths: Int[Array, " lengths"]
    ) -> Int[Array, " windows"]:
        return xp.argmin(xp.abs(drawn[:, None] - lengths[None, :]), axis=1)

    def edges(self, alpha: float, beta: float) -> Float[np.ndarray, " lengths+1"]:
        """Edges in seconds of bins that hold one length each, see the base class."""
        lengths = np.geomspace(alpha, beta, self.lengths)
        return np.concatenate([[alpha], np.sqrt(lengths[1:] * lengths[:-1]), [beta]])


TEST_FUNCTIONS: dict[str, type[AbstractTestFunction]] = {
    kind.name: kind for kind in (Boxcar, Hat, Bump)
}
"""Those that a user can ask for by name. The command line offers those that `settings/kinds.py`
lists too, which reads no class before it must."""
