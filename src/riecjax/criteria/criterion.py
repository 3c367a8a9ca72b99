"""Error criteria: which residuals of an equation of motion are made small."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int, Key

from riecjax.criteria.all_windows import Moments
from riecjax.criteria.chunks import Blocks, in_chunks
from riecjax.criteria.laws import LagBins
from riecjax.criteria.rows import Rows
from riecjax.criteria.test_functions import AbstractTestFunction, Boxcar
from riecjax.criteria.windows import (
    AbstractWindows,
    AllWindows,
    RandomWindows,
    WindowSet,
    half_periods,
)
from riecjax.equations.columns import Columns, sampled_columns
from riecjax.equations.equation import Equation
from riecjax.equations.term import both_present
from riecjax.errors import ModelError, require
from riecjax.leaves import Leaf, is_concrete, namespace
from riecjax.records.record import Record

Held = Int[Array, ""] | int | None
"""How many samples are a record's own where it is filled up behind them; `None` for all."""


SHORT_BLOCKS_OF_ROWS = 512
"""Short blocks of start times to a record where single rows are put into them."""


class AbstractCriterion(eqx.Module):
    """Turns an equation and a record into regression rows, or at once into their moments."""

    @property
    def needs_key(self) -> bool:
        """Whether rows are drawn at random."""
        raise NotImplementedError

    @property
    def smoothness(self) -> int:
        """How many time derivatives the weight takes off the motion, by integration by parts."""
        raise NotImplementedError

    @property
    def row_seconds(self) -> int:
        """Power of the second by which a row's unit differs from the equation's."""
        raise NotImplementedError

    def row_unit(self, unit: str) -> str:
        """Unit of the rows of an equation with this unit, such as "N s"; none if that has none."""
        seconds = {0: "", 1: " s"}.get(self.row_seconds, f" s^{self.row_seconds}")
        return f"{unit}{seconds}" if unit else ""

    @property
    def block_length(self) -> Leaf:
        """Seconds after which two rows share no data: their errors are not locked together."""
        raise NotImplementedError

    @property
    def typical_length(self) -> Leaf:
        """Seconds that a typical window lasts, 0 for a criterion without windows."""
        raise NotImplementedError

    @property
    def in_windows(self) -> AbstractWindows | None:
        """The windows that its rows are integrals over; `None` if they are single samples."""
        return None

    @property
    def weight(self) -> AbstractTestFunction | None:
        """The test function of these windows."""
        return None

    @property
    def in_closed_form(self) -> bool:
        """Whether all rows are summed at once: there are `moments`, and no single ones."""
        return False

    def in_chunks(self, record: Record) -> bool:
        """Whether a record is so long that it is worked through in chunks."""
        return False

    def block_samples(self, record: Record) -> int:
        """Samples to one of the short blocks of start times that moments are kept for."""
        n = record.sample_count
        # At least two blocks, or nothing could be said of scatter.
        return min(max(-(-n // SHORT_BLOCKS_OF_ROWS), 1), -(-n // 2))

    def check(self, record: Record) -> None:
        """Raise `DataError` if the record is too short for this criterion (not under jit)."""
        raise NotImplementedError

    def row_count(self, record: Record) -> float | None:
        """Rows of an equation on this record before any is left out, if that is known."""
        raise NotImplementedError

    @property
    def margin(self) -> int:
        """Samples beside a window that its integrals may look at."""
        return 0

    @property
    def lag_samples(self) -> int:
        """Window lengths are whole multiples of so many samples."""
        return 1

    def between(self, alpha: float | Array, beta: float | Array) -> "AbstractCriterion":
        """The same with windows of other lengths.

        **Raises:** `ModelError` of a criterion without windows.
        """
        raise ModelError("this criterion has no windows whose lengths could be others.")

    def finest(self) -> "AbstractCriterion":
        """The same with the most accurate integrals there are; itself if it has these."""
        return self

    def fitted(self, records: Sequence[Record]) -> "AbstractCriterion":
        """This criterion with what it can find out of the records before tracing."""
        return self

    def draw(self, record: Record, key: Key[Array, ""] | None, held: Held = None) -> WindowSet:
        """Where rows are taken: the windows of a key, or each sample as one.

        `held`: real samples of a record that is filled up, all by default.
        """
        raise NotImplementedError

    def rows_of(self, columns: Columns, drawn: WindowSet, held: Held = None) -> Rows:
        """One row of these columns for each window."""
        raise NotImplementedError

    def rows(self, equation: Equation, record: Record, key: Key[Array, ""] | None = None) -> Rows:
        """The rows of this criterion; see the classes. The same key draws the same windows for
        every equation.

        **Raises:** `DataError` for a missing signal or derivative, `ModelError` without a key.
        """
        if key is None and self.needs_key:
            raise ModelError("random windows need a key: key=jax.random.key(seed).")
        drawn = self.draw(record, key)
        return self.rows_of(sampled_columns(equation, record, self.smoothness), drawn)

    def moments(self, equation: Equation, record: Record) -> Moments:
        """Sums over all rows of their outer products, for blocks of `block_samples` starts.

        **Raises:** `ModelError` unless they come in closed form.
        """
        raise ModelError("this criterion has rows, not moments of all of them.")

    def law(self, record: Record) -> LagBins:
        """The law of window lengths on a record.

        **Raises:** `ModelError` unless moments come in closed form.
        """
        raise ModelError("this criterion has rows, not moments of all of them.")

    def moments_of(self, columns: Columns, lags: LagBins, blocks: Blocks, reach: int) -> Moments:
        """The same of columns and for window lengths that are told, no longer than `reach` samples.

        **Raises:** `ModelError` unless they come in closed form.
        """
        raise ModelError("this criterion has rows, not moments of all of them.")

    def describe(self) -> dict[str, object]:
        """Name and settings, for tables and JSON."""
        raise NotImplementedError


class DOLS(AbstractCriterion):
    """Direct ordinary least squares, eqs (2)-(4): the equation at every sample.

    Terms with a derivative need that derivative as a recorded signal.
    """

    @property
    def needs_key(self) -> bool:
        """False: every sample is used."""
        return False

    @property
    def smoothness(self) -> int:
        """0: no weight, every derivative is read."""
        return 0

    @property
    def row_seconds(self) -> int:
        """0: rows are the equation itself."""
        return 0

    @property
    def block_length(self) -> np.ndarray:
        """Zero: rows share no data."""
        return np.zeros(())

    @property
    def typical_length(self) -> np.ndarray:
        """Zero: each sample counts."""
        return np.zeros(())

    def check(self, record: Record) -> None:
        """Nothing to check: a record has samples."""

    def row_count(self, record: Record) -> float | None:
        """One for each sample."""
        return record.sample_count

    def draw(
        self, record: Record, key: Key[Array, ""] | None = None, held: Held = None
    ) -> WindowSet:
        """Each sample."""
        at = jnp.arange(record.sample_count)
        return WindowSet(at, at)

    def rows_of(self, columns: Columns, drawn: WindowSet, held: Held = None) -> Rows:
        """One row for each sample that is present and not masked."""
        kept = columns.present
        if held is not None:
            kept = both_present(kept, drawn.stop < held)
        return Rows.of(columns.values[0], drawn.start, columns.parameters, kept)

    def describe(self) -> dict[str, object]:
        """Name and settings."""
        return {"name": "dols"}


class RIEC(AbstractCriterion):
    """The randomized integral error criterion, eq. (17).

    One row for each window: the equation of motion, weighted by a test function and integrated.
    Windows that touch a missing or masked sample are left out.

    **Arguments:** `windows`, `RandomWindows(alpha, beta, count)` as in the paper, or
    `AllWindows(alpha, beta)`, which is what those converge to; `test_function`, such
    as `Boxcar()` (RIEC as published), `Hat()` or `Bump(p)`. Alpha and beta are lengths of the
    whole window, for each of them.
    """

    windows: RandomWindows | AllWindows
    test_function: AbstractTestFunction = eqx.field(default_factory=Boxcar)

    def __check_init__(self):
        require(
            "what RIEC takes its windows from",
            self.windows,
            (RandomWindows, AllWindows),
            "rx.RIEC(rx.AllWindows(0.05, 0.5)), with the shortest and the longest window in "
            "seconds, or rx.RIEC(rx.RandomWindows(0.05, 0.5, 8000))",
        )
        require(
            "the test function", self.test_function, AbstractTestFunction, "rx.Hat(), an object"
        )

    @classmethod
    def of_band(
        cls, band: tuple[float, float], test_function: AbstractTestFunction | None = None
    ) -> "RIEC":
        """All windows of half the periods of a band, lowest and highest frequency in hertz.

        **Raises:** `ModelError` unless 0 < low < high.
        """
        return cls(AllWindows(*half_periods(band)), test_function or Boxcar())

    @property
    def needs_key(self) -> bool:
        """Whether windows are drawn at random."""
        return self.windows.needs_key

    @property
    def smoothness(self) -> int:
        """The test function's."""
        return self.test_function.smoothness

    @property
    def row_seconds(self) -> int:
        """The test function's."""
        return self.test_function.row_seconds

    @property
    def block_length(self) -> Leaf:
        """beta: windows that start further apart do not overlap."""
        return self.windows.beta

    @property
    def typical_length(self) -> Leaf:
        """Geometric mean of alpha and beta."""
        alpha, beta = self.windows.alpha, self.windows.beta
        return namespace(alpha, beta).sqrt(alpha * beta)

    @property
    def in_windows(self) -> AbstractWindows:
        """Those."""
        return self.windows

    @property
    def weight(self) -> AbstractTestFunction:
        """The test function."""
        return self.test_function

    @property
    def in_closed_form(self) -> bool:
        """Whether all windows are summed."""
        return not self.windows.needs_key

    @property
    def margin(self) -> int:
        """The test function's."""
        return self.test_function.margin

    @property
    def lag_samples(self) -> int:
        """The test function's."""
        return self.test_function.length_multiple

    def between(self, alpha: float | Array, beta: float | Array) -> "RIEC":
        """The same with windows of other lengths."""
        return RIEC(self.windows.between(alpha, beta), self.test_function)

    def finest(self) -> "RIEC":
        """The same with the test function's finest quadrature; windows between samples have one."""
        finer = self.test_function.finest()
        same = finer == self.test_function or self.windows.drawn.between_samples
        return self if same else RIEC(self.windows, finer)

    def in_chunks(self, record: Record) -> bool:
        """Whether all windows are summed, chunk by chunk of a long record."""
        return self.windows.in_chunks(record)

    def block_samples(self, record: Record) -> int:
        """Of all windows, as many starts as they are summed over at once."""
        if self.in_closed_form:
            return self.windows.every.block(record.sample_count)
        return super().block_samples(record)

    @property
    def every(self) -> "RIEC":
        """This criterion with all windows, which random ones converge to."""
        return RIEC(self.windows.every, self.test_function)

    def fitted(self, records: Sequence[Record]) -> "RIEC":
        """This criterion with what it can find out of the records before tracing."""
        return RIEC(self.windows.fitted(records), self.test_function)

    def check(self, record: Record) -> None:
        """The record must be longer than the longest window."""
        self.windows.check(
            record.sample_count, record.time_step, self.test_function.length_multiple
        )

    def row_count(self, record: Record) -> float | None:
        """One for each window, if that is known (not where windows or the record are traced)."""
        if self.needs_key:
            return self.windows.drawn.count
        if not is_concrete(self.windows, record.time_step):
            return None
        # Inside a jitted function, JAX would trace arithmetic on known numbers too.
        with jax.ensure_compile_time_eval():
            return self.test_function.window_count(self.windows.every, record)

    def draw(self, record: Record, key: Key[Array, ""] | None, held: Held = None) -> WindowSet:
        """The windows of a key. Of all windows, without one, a fixed random sample."""
        return self.windows.drawn.draw(
            jax.random.key(0) if key is None else key,
            record.sample_count if held is None else held,
            record.time_step,
            self.test_function.length_multiple,
        )

    def rows_of(self, columns: Columns, drawn: WindowSet, held: Held = None) -> Rows:
        """One row for each window that touches no missing or masked sample."""
        values, kept = self.test_function.integrals(columns, drawn, held)
        return Rows.of(values, drawn.start, columns.parameters, kept)

    def moments(self, equation: Equation, record: Record) -> Moments:
        """Sums over all windows of the outer products of rows, for blocks of starts.

        **Raises:** `DataError` for a missing signal; `ModelError` for random windows.
        """
        if self.needs_key:
            raise ModelError("random windows have rows, not moments of all of them.")
        windows, n = self.windows.every, record.sample_count
        lags, reach = self.law(record), windows.reach(n)

        def of_chunk(part: Record, blocks: Blocks) -> Moments:
            columns = sampled_columns(equation, part, self.smoothness)
            return self.moments_of(columns, lags, blocks, reach)

        block = windows.block(n)
        return in_chunks(record, of_chunk, block=block, reach=reach, margin=self.margin)

    def law(self, record: Record) -> LagBins:
        """The law of window lengths on a record."""
        return self.test_function.lags(self.windows.every, record)

    def moments_of(self, columns: Columns, lags: LagBins, blocks: Blocks, reach: int) -> Moments:
        """The same of columns and for window lengths that are told, no longer than `reach` samples.

        Of lags with two axes the sums of each of the first are kept apart, along a leading axis.
        """
        return self.test_function.moments(columns, lags, blocks, reach)

    def describe(self) -> dict[str, object]:
        """Name and settings."""
        return {"name": "riec", **self.windows.describe(), **self.test_function.describe()}
