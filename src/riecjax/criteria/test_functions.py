"""Test functions: the weight that a window gives to the equation of motion inside it.

With a weight phi that vanishes at both ends of the window, integration by parts moves derivatives
from the motion to the weight:

    integral phi d^k s / dt^k dt = (-1)^k integral d^k phi / dt^k s dt

so that a position suffices where DOLS needs an acceleration. How many derivatives can be moved is
the weight's smoothness: one for the boxcar, two for the hat and for bumps.
"""

import dataclasses
from typing import ClassVar, Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from riecjax.criteria.all_windows import Moments, moments_in_blocks
from riecjax.criteria.chunks import Blocks
from riecjax.criteria.gains import difference_gain, mean_difference_gain, mean_over_lengths
from riecjax.criteria.laws import LagBins
from riecjax.criteria.quadrature import ORDERS, running_integral
from riecjax.criteria.windows import AllWindows, WindowSet
from riecjax.equations.columns import Columns
from riecjax.errors import ModelError, require
from riecjax.records.record import Record


class Integrals(NamedTuple):
    """Weighted integrals of every column of an equation over every window.

    **Fields:** `columns`, the target first; `whole`, False for windows that touch a missing or
    masked sample and hold no meaning, `None` where there are none.
    """

    columns: Float[Array, "columns windows"]
    whole: Bool[Array, " windows"] | None


class AbstractTestFunction(eqx.Module):
    """A weight on a window, and the integrals of an equation that it makes.

    A new one is one subclass, with a `name` and whatever raises `NotImplementedError` here.
    """

    name: ClassVar[str]
    """What `describe` and the command line call it."""

    @property
    def smoothness(self) -> int:
        """How many time derivatives it takes off the motion, by integration by parts."""
        raise NotImplementedError

    @property
    def length_multiple(self) -> int:
        """Window lengths are whole multiples of so many samples."""
        raise NotImplementedError

    @property
    def row_seconds(self) -> int:
        """Power of the second by which a row's unit differs from the equation's.

        1 where the weight has no unit; a weight in seconds has 2.
        """
        return 1

    @property
    def margin(self) -> int:
        """Samples beside a window that its integrals may look at."""
        return 0

    def integrals(
        self, columns: Columns, windows: WindowSet, held: Int[Array, ""] | int | None = None
    ) -> Integrals:
        """Integral of every column over every window.

        `held`: real samples of columns that are filled up, all by default.
        """
        raise NotImplementedError

    def lags(self, windows: AllWindows, record: Record) -> LagBins:
        """The law of window lengths on a record."""
        raise NotImplementedError

    def moments(self, columns: Columns, lags: LagBins, blocks: Blocks, reach: int) -> Moments:
        """Sums over all windows of the outer products of their rows, for blocks of starts.

        **Arguments:** `lags`, the law of lengths; with two axes, sums are kept for each of the
        first, along a leading axis. `reach`: no window is longer in samples.
        """
        raise NotImplementedError

    def window_count(self, windows: AllWindows, record: Record) -> float:
        """Number of all windows of a record without gaps, by the weights of their law."""
        raise NotImplementedError

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


class Primitives(eqx.Module):
    """For each column of an equation, the function whose differences are its integrals.

    The s-th difference over a window, s = 1 for the boxcar and 2 for the hat, of the s-th
    running integral of a column. Each is kept as the polynomial of its mean plus what is left. Of
    a signal with an offset the running integral grows with the record, and the difference of
    large numbers would lose in 32-bit what the polynomial keeps exactly.

    **Fields:**

    - `values`: what is left, at the samples, shape `(columns, n)`.
    - `mean`: mean of each integrand times the time step to the power s, shape `(columns,)`.
    - `bend`: increase of the column's slope from each sample to the next, per sample. Between
      samples an integrand is a straight line, so its primitive is a parabola with this bend.
    - `present`: where every column has its sample and the equation is to be trusted.
    - `difference`: s.
    """

    values: Float[Array, "columns n"]
    mean: Float[Array, " columns"]
    bend: Float[Array, "columns n-1"]
    present: Bool[Array, " n"] | None
    difference: int = eqx.field(static=True)

    def integrals(self, windows: WindowSet) -> Integrals:
        """Integral of every column over every window."""
        start, stop = windows
        step = (stop - start) / self.difference
        polynomial = self.mean[:, None] * (step**self.difference)[None, :]
        ends = self._at(stop) + (-1) ** self.difference * self._at(start)
        middle = 2 * self._at((start + stop) // 2) if self.difference == 2 else 0.0
        return Integrals(ends - middle + polynomial, whole(windows, self.present))

    def _at(
        self, position: Int[Array, " windows"] | Float[Array, " windows"]
    ) -> Float[Array, "columns windows"]:
        if jnp.issubdtype(position.dtype, jnp.integer):
            # A window's columns lie side by side then: one line of cache instead of one for each.
            return self.values.T[position].T
        below = jnp.clip(position.astype(jnp.int32), 0, self.values.shape[1] - 2)
        share = (position - below)[None, :]
        left, right = self.values[:, below], self.values[:, below + 1]
        return left + share * (right - left) - 0.5 * share * (1 - share) * self.bend[:, below]


class _Differences(AbstractTestFunction):
    """Weights whose integrals are differences of running integrals."""

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

    @property
    def length_multiple(self) -> int:
        """As the order of the difference, so that all its points lie on samples."""
        return self.smoothness

    @property
    def row_seconds(self) -> int:
        """As often as the equation is integrated."""
        return self.smoothness

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

    def primitives(self, columns: Columns, held: Int[Array, ""] | int | None = None) -> Primitives:
        """Primitives of the target (first row) and of every named coefficient's column."""
        s, step, present = self.smoothness, columns.time_step, columns.present
        # A term with a derivative joins the others when they have been integrated as often.
        values = columns.values[0]
        mean, bend = jnp.zeros_like(values[:, 0]), jnp.zeros_like(values[:, 1:])
        for integrated in range(1, s + 1):
            values = values * step
            average = real_mean(values, held)
            # The mean of a later integrand belongs to a polynomial whose differences vanish.
            mean = average * step ** (s - 1) if integrated == 1 else mean
            bend = jnp.diff(values, axis=1)
            values = running_integral(values - average[:, None], self.quadrature, present, held)
            values = values + columns.values[integrated]
        return Primitives(values, mean, bend, present, s)

    def integrals(
        self, columns: Columns, windows: WindowSet, held: Int[Array, ""] | int | None = None
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
        return self.primitives(columns, held).integrals(windows)

    def lags(self, windows: AllWindows, record: Record) -> LagBins:
        """The law of window lengths on a record, in multiples of samples."""
        return windows.bins(record.sample_count, record.time_step, self.length_multiple)

    def moments(self, columns: Columns, lags: LagBins, blocks: Blocks, reach: int) -> Moments:
        """Sums over all windows of the outer products of their rows, for blocks of starts."""
        found = self.primitives(columns, blocks.held)
        return moments_in_blocks(
            found.values,
            found.mean,
            found.present,
            lags,
            blocks.first,
            blocks.size,
            blocks.held,
            order=self.smoothness,
            count=blocks.number,
            reach=reach,
        )

    def window_count(self, windows: AllWindows, record: Record) -> float:
        """Starts times lengths, as far as windows end in the record."""
        n, multiple = record.sample_count, self.length_multiple
        first, last, weight, _ = self.lags(windows, record)
        # In real numbers: windows may be more than 32-bit integers hold.
        first, last = (np.asarray(edge, float) for edge in (first, last))
        starts = n - multiple * (first + last) / 2
        return float(np.sum(np.asarray(weight, float) * (last - first + 1) * starts))


def real_mean(
    values: Float[Array, "columns n"], held: Int[Array, ""] | int | None
) -> Float[Array, " columns"]:
    """Mean of the first `held` samples, of all by default."""
    if held is None or (isinstance(held, int) and held == values.shape[1]):
        return jnp.mean(values, axis=1)
    inside = jnp.arange(values.shape[1]) < held
    return jnp.sum(jnp.where(inside[None, :], values, 0.0), axis=1) / held


class Boxcar(_Differences):
    """Weight 1 inside the window, 0 outside: RIEC as published.

    Integrates the equation once. A term with a derivative becomes a difference between the ends
    of the window, the paper's Delta x, so that velocities stand where DOLS needs
    accelerations.

    **Arguments:** `quadrature`: order in the time step, 2 (trapezoids), 4, 6 or 8.

    **Raises:** `ModelError` for another order.
    """

    name: ClassVar[str] = "boxcar"
    quadrature: int = eqx.field(static=True, default=2)

    @property
    def smoothness(self) -> int:
        """1: the boxcar's first derivative is a pulse at either end."""
        return 1


class Hat(_Differences):
    """A triangle over the window, of slope 1 to its middle and -1 from there.

    Integrates the equation twice, the paper's "second integration": over a window [0, 2 L] a
    second derivative becomes x(2 L) - 2 x(L) + x(0), so a recorded position suffices.

    **Arguments:** `quadrature`: order in the time step, 2 (trapezoids), 4, 6 or 8.

    **Raises:** `ModelError` for another order.
    """

    name: ClassVar[str] = "hat"
    quadrature: int = eqx.field(static=True, default=2)

    @property
    def smoothness(self) -> int:
        """2: the hat's second derivative is a pulse at either end and one in the middle."""
        return 2


def whole(windows: WindowSet, present: Bool[Array, " n"] | None) -> Bool[Array, " windows"] | None:
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
