"""Error criteria: which residuals of an equation of motion are made small.

With a window from t0 to t0 + T and a test function phi on it, the residual of an equation of motion
sum_j theta_j a_j(t) = y(t) is its weighted integral, eq. (17) of the paper for the boxcar phi = 1:

    epsilon = integral phi (y - sum_j theta_j a_j) dt

which is linear in theta: a row of a regression, target first. Least squares over the rows of many
windows is RIEC; over the samples themselves, phi being a pulse, it is DOLS.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import ClassVar, Self

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float, Int, Key

from riecjax import arrays as xp
from riecjax.arrays import Array
from riecjax.criteria.test_functions import AbstractTestFunction, Boxcar, Dirac
from riecjax.criteria.windows import (
    AbstractWindows,
    AllWindows,
    LagBins,
    RandomWindows,
    WindowSet,
)
from riecjax.equations.equation import Equation
from riecjax.equations.noisy_columns import Columns, NoisyColumns, noisy_columns, sampled_columns
from riecjax.errors import ModelError, require
from riecjax.leaves import Leaf
from riecjax.records.record import Record
from riecjax.records.signal import Noise

SHORT_BLOCKS_OF_ROWS = 512
"""Short blocks of start times to a record where single rows are put into them."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Rows:
    """Regression rows: target (first) and regressors of every residual of a criterion.

    **Fields:**

    - `columns`: shape `(1 + parameters, rows)`; the first holds the target.
    - `position`: where in the record each row starts, in samples.
    - `parameters`: names of the regressors.
    - `valid`: False for rows that touch a missing or masked sample; their columns are zero. `None`
      where there are none.
    """

    columns: Float[Array, "columns rows"]
    position: Int[Array, " rows"] | Float[Array, " rows"]
    parameters: tuple[str, ...] = dataclasses.field(metadata={"static": True})
    valid: Bool[Array, " rows"] | None = None

    @property
    def target(self) -> Float[Array, " rows"]:
        """Left-hand side y."""
        return self.columns[0]

    @property
    def regressors(self) -> Float[Array, "rows parameters"]:
        """Regressor matrix A."""
        return self.columns[1:].T

    def fix(self, known: Mapping[str, Array]) -> "Rows":
        """The rows left when these parameters take these values: their columns join the target."""
        own = dict(zip(self.parameters, self.columns[1:]))
        given = [known[name] * column for name, column in own.items() if name in known]
        unknown = {name: column for name, column in own.items() if name not in known}
        columns = xp.stack([self.target - sum(given), *unknown.values()])
        return Rows(columns, self.position, tuple(unknown), self.valid)

    def count(self) -> Float[Array, ""]:
        """Number of valid rows."""
        if self.valid is None:
            return np.asarray(self.columns.shape[1], self.columns.dtype)
        return self.valid.sum(dtype=self.columns.dtype)


class AbstractCriterion(eqx.Module):
    """Turns an equation and a record into regression rows, or at once into their moments.

    **Fields:** `windows` that its rows are integrals over, `None` if they are single samples;
    `test_function` inside them.
    """

    windows: eqx.AbstractVar[AbstractWindows | None]
    test_function: eqx.AbstractVar[AbstractTestFunction]

    @property
    def needs_key(self) -> bool:
        """Whether rows are drawn at random."""
        return isinstance(self.windows, RandomWindows)

    @property
    def all_windows(self) -> AllWindows | None:
        """The windows, where all are summed at once; `None` where there are single rows."""
        return self.windows if isinstance(self.windows, AllWindows) else None

    @property
    def smoothness(self) -> int:
        """How many time derivatives the test function takes off the motion."""
        return self.test_function.smoothness

    def row_unit(self, unit: str) -> str:
        """Unit of the rows of an equation with this unit, such as "N s"; none if that has none."""
        power = self.test_function.row_seconds
        seconds = {0: "", 1: " s"}.get(power, f" s^{power}")
        return f"{unit}{seconds}" if unit else ""

    @property
    def block_length(self) -> Leaf:
        """Seconds after which two rows share no data: their errors are not locked together."""
        return np.zeros(()) if self.windows is None else self.windows.beta

    def block_samples(self, record: Record) -> int:
        """Samples to one of the short blocks of start times that have moments of their own.

        Of all windows, as many starts as they are summed over at once.
        """
        n = record.sample_count
        if self.all_windows is not None:
            return self.all_windows.block(n)
        # At least two blocks, or nothing could be said of scatter.
        return min(-(-n // SHORT_BLOCKS_OF_ROWS), -(-n // 2))

    def check(self, record: Record) -> None:
        """Raise `DataError` if the record is too short for this criterion (not under jit)."""
        if self.windows is not None:
            self.windows.check(record, self.test_function.length_multiple)

    def row_count(self, record: Record) -> float | None:
        """Rows of an equation on this record before any is left out, if that is known: not where
        all windows, or the record, are traced."""
        if self.windows is None:
            return record.sample_count
        if isinstance(self.windows, RandomWindows):
            return self.windows.count
        if not xp.is_concrete(self.windows, record.time_step):
            return None
        # In real numbers: windows may be more than 32-bit integers hold. A lag of k samples has
        # n - k starts; a bin's lags have n - k on average at its middle.
        first, last = (np.asarray(leaf, float) for leaf in self.law(record))
        starts = record.sample_count - self.test_function.length_multiple * (first + last) / 2
        return float(np.sum((last - first + 1) * starts))

    def between(self, alpha: float | Array, beta: float | Array) -> Self:
        """The same with windows of other lengths.

        **Raises:** `ModelError` of a criterion without windows.
        """
        if self.windows is None:
            raise ModelError("this criterion has no windows whose lengths could be others.")
        return dataclasses.replace(self, windows=self.windows.between(alpha, beta))

    def finest(self) -> Self:
        """The same with the test function's finest quadrature, itself if it has that; windows
        between samples have one."""
        finer, windows = self.test_function.finest(), self.windows
        if finer == self.test_function or windows is None or windows.drawn.between_samples:
            return self
        return dataclasses.replace(self, test_function=finer)

    def fitted(self, records: Sequence[Record]) -> Self:
        """This criterion with what it takes from the records before tracing."""
        if self.windows is None:
            return self
        return dataclasses.replace(self, windows=self.windows.fitted(records))

    def draw(self, record: Record, key: Key[Array, ""] | None) -> WindowSet:
        """Where rows are taken: each sample as a window, or the windows of a key; of all windows,
        without one, a fixed random sample."""
        if self.windows is None:
            at = np.arange(record.sample_count)
            return WindowSet(at, at)
        key = jax.random.key(0) if key is None else key
        return self.windows.drawn.draw(key, record, self.test_function.length_multiple)

    def rows_of(self, columns: Columns, drawn: WindowSet) -> Rows:
        """One row of these columns for each window."""
        values, valid = self.test_function.integrals(columns, drawn)
        if valid is not None:
            values = xp.where(valid[None, :], values, 0.0)
        return Rows(values, drawn.start, columns.parameters, valid)

    def rows(self, equation: Equation, record: Record, key: Key[Array, ""] | None = None) -> Rows:
        """The rows of this criterion; see the classes. The same key draws the same windows for
        every equation.

        **Raises:** `DataError` for a missing signal or derivative, `ModelError` without a key.
        """
        if key is None and self.needs_key:
            raise ModelError("random windows need a key: key=jax.random.key(seed).")
        drawn = self.draw(record, key)
        return self.rows_of(sampled_columns(equation, record, self.smoothness), drawn)

    def law(self, record: Record) -> LagBins:
        """The law of window lengths on a record, of a criterion that has windows."""
        assert self.windows is not None
        return self.test_function.lags(self.windows.every, record)

    def noisy_columns(self, equation: Equation, record: Record) -> NoisyColumns:
        """An equation's columns, and what the record's noise does to them."""
        return noisy_columns(equation, record, self.smoothness)

    def describe(self) -> dict[str, object]:
        """Name and settings, for tables and JSON."""
        raise NotImplementedError


class DOLS(AbstractCriterion):
    """Direct ordinary least squares, eqs (2)-(4): the equation at every sample.

    Terms with a derivative need that derivative as a recorded signal. As published: what sensor
    noise adds stays in.
    """

    windows: ClassVar[None] = None  # pyright: ignore
    test_function: ClassVar[Dirac] = Dirac()  # pyright: ignore

    def noisy_columns(self, equation: Equation, record: Record) -> NoisyColumns:
        """An equation's columns, as if there was no noise."""
        return noisy_columns(equation, record, self.smoothness, Noise())

    def describe(self) -> dict[str, object]:
        """Name and settings."""
        return {"name": "dols"}


class RIEC(AbstractCriterion):
    """The randomized integral error criterion, eq. (17).

    One row for each window: the equation of motion, weighted by a test function and integrated.
    Windows that touch a missing or masked sample are left out.

    **Arguments:** `windows`, `RandomWindows(alpha, beta, count)` as in the paper, or
    `AllWindows(alpha, beta)`, which is what those converge to; `test_function`, such as `Boxcar()`
    (the default; RIEC as published with `Boxcar(2)`, trapezoids), `Hat()` or `Bump(p)`. Alpha and
    beta are lengths of the whole window, for each of them. `why` in words, where it was chosen to
    suit a recording.
    """

    windows: RandomWindows | AllWindows  # pyright: ignore[reportIncompatibleVariableOverride]
    test_function: AbstractTestFunction
    why: str = eqx.field(static=True, default="")

    def __init__(
        self,
        windows: RandomWindows | AllWindows,
        test_function: AbstractTestFunction | None = None,
        why: str = "",
    ):
        self.windows = windows  # pyright: ignore[reportIncompatibleVariableOverride]
        self.why = why
        between = getattr(windows, "between_samples", False)
        self.test_function = test_function or (Boxcar(2) if between else Boxcar())

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
        """All windows as long as suits a band, lowest and highest frequency in hertz.

        Half its periods for the boxcar and the hat, longer for a bump.

        **Raises:** `ModelError` unless 0 < low < high.
        """
        Boxcar().lengths_of_band(band)  # refuses what is no band
        weight = test_function or Boxcar()
        require("the test function", weight, AbstractTestFunction, "rx.Hat(), an object")
        return cls(AllWindows(*weight.lengths_of_band(band)), weight)

    @property
    def every(self) -> "RIEC":
        """This criterion with all windows, which random ones converge to."""
        return dataclasses.replace(self, windows=self.windows.every)

    def describe(self) -> dict[str, object]:
        """Name and settings."""
        because = {"because": self.why} if self.why else {}
        windows, weight = self.windows.describe(), self.test_function.describe()
        return {"name": "riec", **windows, **weight, **because}


PARTS = (AbstractCriterion, AbstractWindows, AbstractTestFunction)
"""What a criterion is made of."""
