"""Error criteria: which residuals of an equation of motion are made small.

With a window from t0 to t0 + T and a test function phi on it, the residual of an equation of motion
sum_j theta_j a_j(t) = y(t) is its weighted integral, eq. (17) of the paper for the boxcar phi = 1:

    epsilon = integral phi (y - sum_j theta_j a_j) dt

which is linear in theta: a row of a regression, target first. Least squares over the rows of many
windows is RIEC; over the samples themselves, phi being a pulse, it is DOLS.
"""

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key

from riecjax.criteria.laws import AbstractLaw, LagBins
from riecjax.criteria.noise_moments import NoiseWeights, noise_moments
from riecjax.criteria.test_functions import AbstractTestFunction, Boxcar, Dirac
from riecjax.criteria.windows import (
    AbstractWindows,
    AllWindows,
    Count,
    RandomWindows,
    StartBlocks,
    WindowSet,
)
from riecjax.equations.equation import Equation
from riecjax.equations.noisy_columns import (
    Columns,
    NoisyColumns,
    noisy_columns,
    sampled_columns,
)
from riecjax.errors import DataError, ModelError, require
from riecjax.leaves import Leaf, is_concrete
from riecjax.records.record import Record
from riecjax.records.signal import Noise

SHORT_BLOCKS_OF_ROWS = 512
"""Short blocks of start times to a record where single rows are put into them."""


class Rows(eqx.Module):
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
    parameters: tuple[str, ...] = eqx.field(static=True)
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
        columns = jnp.stack([self.target - sum(given), *unknown.values()])
        return Rows(columns, self.position, tuple(unknown), self.valid)

    def count(self) -> Float[Array, ""]:
        """Number of valid rows."""
        if self.valid is None:
            return jnp.asarray(self.columns.shape[1], self.columns.dtype)
        return jnp.sum(self.valid, dtype=self.columns.dtype)


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
        """Samples to one of the short blocks of start times that have moments of their own."""
        # At least two blocks, or nothing could be said of scatter.
        return min(-(-record.sample_count // SHORT_BLOCKS_OF_ROWS), -(-record.sample_count // 2))

    def check(self, record: Record) -> None:
        """Raise `DataError` if the record is too short for this criterion (not under jit)."""

    def row_count(self, record: Record) -> float | None:
        """Rows of an equation on this record before any is left out, if that is known."""
        raise NotImplementedError

    def between(self, alpha: float | Array, beta: float | Array) -> "AbstractCriterion":
        """The same with windows of other lengths.

        **Raises:** `ModelError` of a criterion without windows.
        """
        raise ModelError("this criterion has no windows whose lengths could be others.")

    def finest(self) -> "AbstractCriterion":
        """The same with the most accurate integrals there are; itself if it has these."""
        return self

    def fitted(self, records: Sequence[Record]) -> "AbstractCriterion":
        """This criterion with what it takes from the records before tracing."""
        return self

    def draw(
        self, record: Record, key: Key[Array, ""] | None, unpadded: Count | None = None
    ) -> WindowSet:
        """Where rows are taken: the windows of a key, or each sample as one.

        `unpadded`: samples before any padding of the record, all by default.
        """
        raise NotImplementedError

    def rows_of(self, columns: Columns, drawn: WindowSet, unpadded: Count | None = None) -> Rows:
        """One row of these columns for each window."""
        values, valid = self.test_function.integrals(columns, drawn, unpadded)
        if valid is not None:
            values = jnp.where(valid[None, :], values, 0.0)
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
        """The law of window lengths on a record.

        **Raises:** `ModelError` of a criterion without windows.
        """
        raise ModelError("this criterion has no windows, and so no law of their lengths.")

    corrects_noise: ClassVar[bool] = True
    """Whether what sensor noise adds to the moments is to be taken off."""

    def noisy_columns(self, equation: Equation, record: Record) -> NoisyColumns:
        """An equation's columns, and what the record's noise does to them."""
        if self.corrects_noise:
            return noisy_columns(equation, record, self.smoothness)
        columns = sampled_columns(equation, record, self.smoothness)
        return NoisyColumns(columns, {}, {}, (), Noise())

    def noise_of(
        self,
        noisy: NoisyColumns,
        windows: LagBins | WindowSet,
        blocks: StartBlocks,
        products: Callable[[Columns], Array],
    ) -> tuple[Array, Array] | None:
        """What noise adds to `products` of rows over windows, and what each of its sources adds
        to those of all blocks; `None` without any.

        **Arguments:** `windows`, the law of all that start in the blocks, or those drawn.
        """
        if not (noisy.white or noisy.coloured):
            return None

        def weights_of(law: LagBins | WindowSet) -> NoiseWeights | None:
            return self.test_function.noise_weights(noisy.columns, law, blocks)

        return noise_moments(noisy, windows, blocks, weights_of, products)

    def describe(self) -> dict[str, object]:
        """Name and settings, for tables and JSON."""
        raise NotImplementedError


class DOLS(AbstractCriterion):
    """Direct ordinary least squares, eqs (2)-(4): the equation at every sample.

    Terms with a derivative need that derivative as a recorded signal. As published: what sensor
    noise adds stays in.
    """

    corrects_noise: ClassVar[bool] = False

    def __init__(self):
        """There is nothing to set."""

    @property
    def windows(self) -> None:  # pyright: ignore[reportIncompatibleVariableOverride]
        """None: rows are single samples."""
        return None

    @property
    def test_function(self) -> AbstractTestFunction:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The pulse."""
        return Dirac()

    def row_count(self, record: Record) -> float | None:
        """One for each sample."""
        return record.sample_count

    def draw(
        self, record: Record, key: Key[Array, ""] | None = None, unpadded: Count | None = None
    ) -> WindowSet:
        """Each sample."""
        at = jnp.arange(record.sample_count)
        return WindowSet(at, at)

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

    def between(self, alpha: float | Array, beta: float | Array) -> "RIEC":
        """The same with windows of other lengths."""
        return dataclasses.replace(self, windows=self.windows.between(alpha, beta))

    def finest(self) -> "RIEC":
        """The same with the test function's finest quadrature; windows between samples have one."""
        finer = self.test_function.finest()
        same = finer == self.test_function or self.windows.drawn.between_samples
        return self if same else RIEC(self.windows, finer)

    def block_samples(self, record: Record) -> int:
        """Of all windows, as many starts as they are summed over at once."""
        if self.all_windows is None:
            return super().block_samples(record)
        return self.all_windows.block(record.sample_count)

    @property
    def every(self) -> "RIEC":
        """This criterion with all windows, which random ones converge to."""
        return dataclasses.replace(self, windows=self.windows.every)

    def fitted(self, records: Sequence[Record]) -> "RIEC":
        """This criterion with what it takes from the records before tracing."""
        return dataclasses.replace(self, windows=self.windows.fitted(records))

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
            # In real numbers: windows may be more than 32-bit integers hold. A lag of k samples has
            # n - k starts; a bin's lags have n - k on average at its middle.
            first, last, weight = (np.asarray(leaf, float) for leaf in self.law(record))
            starts = record.sample_count - self.test_function.length_multiple * (first + last) / 2
            return float(np.sum(weight * (last - first + 1) * starts))

    def draw(
        self, record: Record, key: Key[Array, ""] | None, unpadded: Count | None = None
    ) -> WindowSet:
        """The windows of a key. Of all windows, without one, a fixed random sample."""
        return self.windows.drawn.draw(
            jax.random.key(0) if key is None else key,
            record.sample_count if unpadded is None else unpadded,
            record.time_step,
            self.test_function.length_multiple,
        )

    def law(self, record: Record) -> LagBins:
        """The law of window lengths on a record."""
        return self.test_function.lags(self.windows.every, record)

    def describe(self) -> dict[str, object]:
        """Name and settings."""
        because = {"because": self.why} if self.why else {}
        windows, weight = self.windows.describe(), self.test_function.describe()
        return {"name": "riec", **windows, **weight, **because}


# A criterion as plain data, for files, and back.
#
# Each part is its class's name and its fields, parts within parts. A file names classes and never
# imports them: what is read is looked for among the subclasses that the running program has
# defined, so that a new test function needs nothing here, and a file can run no code.

FAMILIES = (AbstractCriterion, AbstractWindows, AbstractLaw, AbstractTestFunction)
"""What a criterion is made of."""
RESERVED = ("class", "from")
"""Keys beside the fields' names: keywords of Python, and so no names of fields."""


def to_plain_data(part: eqx.Module) -> dict[str, Any]:
    """A part of a criterion as nested dictionaries of what JSON has words for.

    `{"class": name, "from": module, field: value, ...}`, where an array is `{dtype: list}`.

    **Raises:** `ModelError` for what is code rather than numbers.
    """
    kind = type(part)
    fields = {
        field.name: _plain(getattr(part, field.name), f"the {field.name} of {kind.__name__}")
        for field in dataclasses.fields(part)
    }
    return {"class": kind.__name__, "from": kind.__module__} | fields


def _plain(value: Any, name: str) -> Any:
    if isinstance(value, FAMILIES):
        return to_plain_data(value)
    if isinstance(value, tuple | list):
        return [_plain(each, name) for each in value]
    if isinstance(value, np.ndarray | jax.Array) and value.dtype.kind in "fiub":
        return {str(value.dtype): np.asarray(value).tolist()}
    plain = value.item() if isinstance(value, np.generic) else value
    if plain is None or isinstance(plain, bool | int | float | str):
        return plain
    raise ModelError(f"{name} is code, which no file can hold: give numbers in its place.")


def criterion_from_plain_data(document: dict[str, Any]) -> AbstractCriterion:
    """The criterion that [`to_plain_data`][riecjax.criteria.criterion.to_plain_data] described.

    **Raises:** `DataError` for a class that is not defined here, or one with other fields.
    """
    found = _read(document)
    if not isinstance(found, AbstractCriterion):
        raise DataError("what it calls a criterion is none.")
    return found


def _read(value: Any) -> Any:
    if isinstance(value, list):
        return tuple(_read(each) for each in value)
    if not isinstance(value, dict):
        return value
    if "class" in value:
        name, module = value["class"], value["from"]
        fields = {name: _read(each) for name, each in value.items() if name not in RESERVED}
        # The class of this name, as it was defined last; of several modules', that of `module`.
        found = {kind.__module__: kind for kind in _subclasses(*FAMILIES) if kind.__name__ == name}
        if module not in found and len(found) != 1:
            raise DataError(
                f"it was made with {name} of '{module}', a class that is not defined here: import "
                f"the module that defines it first."
            )
        try:
            return (found.get(module) or next(iter(found.values())))(**fields)
        except (TypeError, ModelError):
            raise DataError(
                f"its {name} has other settings than the one of this name here."
            ) from None
    ((dtype, values),) = value.items()
    array = np.array(values, dtype)
    # Constructors take any NumPy array to 64-bit; JAX's pass unchanged.
    return array if array.dtype == np.float64 else jnp.asarray(array)


def _subclasses(*kinds: type) -> Iterator[type]:
    for kind in kinds:
        below = kind.__subclasses__()
        yield from below
        yield from _subclasses(*below)
