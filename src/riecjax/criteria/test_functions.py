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
from typing import ClassVar, Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from riecjax.criteria.all_windows import Moments, moments_in_blocks
from riecjax.criteria.chunks import StartBlocks
from riecjax.criteria.gains import difference_gain, mean_difference_gain, mean_over_lengths
from riecjax.criteria.laws import LagBins
from riecjax.criteria.noise_weights import (
    NoiseWeights,
    Points,
    boxcar_noise_weights,
    hat_noise_weights,
    points_of_windows,
)
from riecjax.criteria.quadrature import ORDERS, Primitives, running_integral, unpadded_mean
from riecjax.criteria.windows import AllWindows, WindowSet, half_periods
from riecjax.equations.columns import Columns
from riecjax.errors import ModelError, require
from riecjax.records.record import Record


class Integrals(NamedTuple):
    """Weighted integrals of every column of an equation over every window.

    **Fields:** `columns`, the target first; `valid`, False for windows that touch a missing or
    masked sample and hold no meaning, `None` where there are none.
    """

    columns: Float[Array, "columns windows"]
    valid: Bool[Array, " windows"] | None


class AbstractTestFunction(eqx.Module):
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

    def integrals(
        self, columns: Columns, windows: WindowSet, unpadded: Int[Array, ""] | int | None = None
    ) -> Integrals:
        """Integral of every column over every window.

        `unpadded`: samples before any padding of the columns, all by default.
        """
        raise NotImplementedError

    def lags(self, windows: AllWindows, record: Record) -> LagBins:
        """The law of window lengths on a record, in multiples of `length_multiple` samples."""
        return windows.bins(record.sample_count, record.time_step, self.length_multiple)

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

        **Arguments:** `windows`, the law of all windows that start in the blocks, or windows drawn.
        """
        return None

    def window_count(self, windows: AllWindows, record: Record) -> float:
        """Number of all windows of a record without gaps, by the weights of their law.

        A lag of k samples has n - k starts; a bin's lags have n - k on average at its middle.
        """
        first, last, weight = self.lags(windows, record)
        # In real numbers: windows may be more than 32-bit integers hold.
        first, last = (np.asarray(edge, float) for edge in (first, last))
        starts = record.sample_count - self.length_multiple * (first + last) / 2
        return float(np.sum(np.asarray(weight, float) * (last - first + 1) * starts))

    def gain(
        self, frequency: Float[np.ndarray, " frequencies"], length: Float[np.ndarray, " lengths"]
    ) -> Float[np.ndarray, "frequencies lengths"]:
        """|H| of windows, eq. (13): size of the weighted integral of a unit oscillation.

        In seconds to the power `row_seconds`.

        **Arguments:** `frequency` in hertz, `length` of the whole window in seconds.
        """
        raise NotImplementedError

    def mean_gain(
        self,
        frequency: Float[np.ndarray, " frequencies"],
        alpha: float,
        beta: float,
        power: Literal[1, 2] = 1,
    ) -> Float[np.ndarray, " frequencies"]:
        """Mean of |H|^power over T ~ U(alpha, beta), eq. (14); see [`expected_gain`][]."""
        return mean_over_lengths(self.gain, frequency, (alpha, beta), power)

    def finest(self) -> "AbstractTestFunction":
        """The same weight with the most accurate integrals there are."""
        return self

    def describe(self) -> dict[str, object]:
        """Name and settings, for tables and JSON."""
        return {"test_function": self.name}


class Dirac(AbstractTestFunction):
    """The pulse at one sample: its row is the equation there, as DOLS takes it, eqs (2)-(4)."""

    name: ClassVar[str] = "dirac"
    smoothness: ClassVar[int] = 0
    row_seconds: ClassVar[int] = 0  # the pulse is per second, which the integral takes back

    def integrals(
        self, columns: Columns, windows: WindowSet, unpadded: Int[Array, ""] | int | None = None
    ) -> Integrals:
        """Every column at the start of every window, where the sample is not padding."""
        valid = valid_windows(windows, columns.present)
        if unpadded is not None:
            inside = windows.start < unpadded
            valid = inside if valid is None else valid & inside
        return Integrals(columns.values[0][:, windows.start], valid)


class _Differences(AbstractTestFunction):
    """Weights whose integrals are differences, of the order s, of s-fold running integrals.

    Windows are multiples of s samples, so that all points of a difference lie on samples, and rows
    have s seconds more than the equation: it is integrated s times. s is the `smoothness`.
    """

    quadrature: eqx.AbstractVar[int]

    def __check_init__(self):
        if self.quadrature not in ORDERS:
            raise ModelError(
                f"the order of quadrature must be one of {ORDERS}; got {self.quadrature}."
            )

    def finest(self) -> "AbstractTestFunction":
        """The same weight with quadrature of the highest order."""
        return dataclasses.replace(self, quadrature=max(ORDERS))

    def describe(self) -> dict[str, object]:
        """Name and order of quadrature."""
        return {**super().describe(), "quadrature": self.quadrature}

    def gain(
        self, frequency: Float[np.ndarray, " frequencies"], length: Float[np.ndarray, " lengths"]
    ) -> Float[np.ndarray, "frequencies lengths"]:
        """|H| of windows: of the boxcar T |sinc(f T)|, of the hat (T / 2)^2 sinc^2(f T / 2)."""
        return difference_gain(frequency, length, self.smoothness)

    def mean_gain(
        self,
        frequency: Float[np.ndarray, " frequencies"],
        alpha: float,
        beta: float,
        power: Literal[1, 2] = 1,
    ) -> Float[np.ndarray, " frequencies"]:
        """Mean of |H|^power over T ~ U(alpha, beta), in closed form."""
        return mean_difference_gain(frequency, (alpha, beta), self.smoothness, power)

    @property
    def margin(self) -> int:
        """Samples beside a window that its integrals may look at."""
        return self.quadrature

    def primitives(
        self, columns: Columns, unpadded: Int[Array, ""] | int | None = None
    ) -> Primitives:
        """Primitives of the target (first row) and of every named coefficient's column.

        A column is sum_k d^k/dt^k values[k], so that its s-fold integral is the sum over k of the
        (s - k)-fold integrals of values[k]: each joins after k of s integrations.
        """
        s, step, present = self.smoothness, columns.time_step, columns.present
        values = columns.values[0]
        mean, bend = jnp.zeros_like(values[:, 0]), jnp.zeros_like(values[:, 1:])
        for integrated in range(1, s + 1):
            values = values * step
            average = unpadded_mean(values, unpadded)
            # A later mean is integrated s - 1 times at most: the s-th difference of that vanishes.
            mean = average * step ** (s - 1) if integrated == 1 else mean
            bend = jnp.diff(values, axis=1)
            values = running_integral(values - average[:, None], self.quadrature, present, unpadded)
            values = values + columns.values[integrated]
        return Primitives(values, mean, bend, present, s)

    def integrals(
        self, columns: Columns, windows: WindowSet, unpadded: Int[Array, ""] | int | None = None
    ) -> Integrals:
        """Integral of every column over every window.

        **Raises:** `ModelError` for windows that start between samples, unless the test function
        is the boxcar with trapezoidal quadrature.
        """
        on_samples = jnp.issubdtype(windows.start.dtype, jnp.integer)
        if not on_samples and (self.smoothness > 1 or self.quadrature > 2):
            raise ModelError(
                "windows between samples go with the boxcar and quadrature of order 2; draw them "
                "on samples (between_samples=False)."
            )
        values = self.primitives(columns, unpadded).differences(*windows)
        return Integrals(values, valid_windows(windows, columns.present))

    def moments(self, columns: Columns, lags: LagBins, blocks: StartBlocks, reach: int) -> Moments:
        """Sums over all windows of the outer products of their rows, for blocks of starts."""
        primitives = self.primitives(columns, blocks.unpadded)
        return moments_in_blocks(primitives, lags, blocks, reach=reach)

    def noise_weights(
        self, columns: Columns, windows: LagBins | WindowSet, blocks: StartBlocks
    ) -> NoiseWeights | None:
        """In closed form for windows on samples, but for hats in 32-bit: running sums of squares
        are cubes of a chunk's length, beside which those of a window have no digit left."""
        if self.smoothness == 2 and columns.values.dtype == jnp.float32:
            return None
        points = self._points(columns, windows, blocks)
        weights = boxcar_noise_weights if self.smoothness == 1 else hat_noise_weights
        return None if points is None else weights(points, self.quadrature, columns.time_step)

    def _points(
        self, columns: Columns, windows: LagBins | WindowSet, blocks: StartBlocks
    ) -> Points | None:
        present, n = columns.present, columns.sample_count
        if isinstance(windows, LagBins):
            return points_of_windows(present, n, windows, blocks, self.smoothness)
        if not jnp.issubdtype(windows.start.dtype, jnp.integer):
            return None
        whole = valid_windows(windows, present)
        one = jnp.ones(windows.start.shape) if whole is None else whole.astype(float)
        half = (windows.stop - windows.start) // 2
        middle = windows.start + half

        def at(place: Array, weight: Array) -> Array:
            return jnp.zeros(n, one.dtype).at[place].add(weight)

        return Points(
            at(windows.start, one), at(middle, one), at(middle, half * one), at(windows.stop, one)
        )


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
    quadrature: int = eqx.field(static=True, default=4)


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
    quadrature: int = eqx.field(static=True, default=4)


def valid_windows(
    windows: WindowSet, present: Bool[Array, " n"] | None
) -> Bool[Array, " windows"] | None:
    """Which windows hold no missing sample; `None` where nothing is missing."""
    if present is None:
        return None
    absent = jnp.pad(jnp.cumsum(~present), (1, 0))
    first = jnp.floor(windows.start).astype(jnp.int32)
    last = jnp.ceil(windows.stop).astype(jnp.int32)
    return absent[last + 1] == absent[first]


def expected_gain(
    frequency: Float[np.ndarray, " frequencies"],
    alpha: float,
    beta: float,
    test_function: AbstractTestFunction,
    *,
    power: Literal[1, 2] = 1,
) -> Float[np.ndarray, " frequencies"]:
    """Mean of |H|^power over T ~ U(alpha, beta), eq. (14), of the test function's `gain`.

    `power=1` is what Fig. 3 draws; `power=2` is what least squares sees: times the density of an
    error, and integrated, it is the mean square of the windows' errors.

    **Arguments:** `frequency` in hertz; `alpha`, `beta` in seconds.

    **Raises:** `ModelError` for what is no test function.
    """
    require("the test function", test_function, AbstractTestFunction, "rx.Hat(), an object")
    return test_function.mean_gain(frequency, alpha, beta, power)
