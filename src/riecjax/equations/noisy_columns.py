"""An equation's columns, sampled: what every criterion integrates, compares or adds up.

What noise on the signals does to an equation's columns: it shifts their mean and scatters them.

**Shift.** A column g(z) of noisy signals z = s + e has the mean g(s) + sigma^2 g''/2 + ..., which
no averaging removes: in a curved column it is ten times what the scatter adds to a Gram matrix.
Let e be normal along one direction of the signals, and let K_b g be the mean of g at z +- b sigma.
In powers of D = sigma^2 d^2/dz^2 / 2 the mean over e is exp(D) g, and K_b - 1 = b^2 D + b^4 D^2 / 6
+ ..., so that

    L = c_1 (K_b1 - 1) + c_2 (K_b2 - 1),    c_1 b_1^2 + c_2 b_2^2 = 1,   c_1 b_1^4 + c_2 b_2^4 = -3

is 1 - exp(-D) to second order. The corrected column g_c = g - L g therefore has the mean g(s):
exactly for polynomials of fifth degree, and where g has a kink or a jump on average over a spread
of z, since L takes only values of g.

**Scatter.** The Gram matrix of columns is of products g h, and these are functions of z as well. So
g h - L(g h) has the mean g(s) h(s), and what noise adds to the product of two corrected columns is,
with the half difference a_b and the bend s_b = K_b g - g of either,

    q = g_c h_c - (g h - L(g h)) = L g L h + sum_b c_b (a_b a_b' + s_b s_b')

which is sigma^2 g' h' to first order. Two samples whose noise is correlated share only the first
order, r r' with the rise r = c_1 b_1 a_1 + c_2 b_2 a_2, sigma g' to third order. So columns move by
r with each source, and what is left at one sample is a sum of three squares,

    q - r r' = c_1 c_2 (b_2 a_1 - b_1 a_2)^2 + c_1 (1 + c_1) (s_1 + t s_2)^2
               + c_2 (1 + c_2 / (1 + c_1)) s_2^2,    t = c_2 / (1 + c_1)

(squares for products of two columns), all of them zero where a column is straight.
"""

import dataclasses
import itertools
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float

from riecjax import arrays as xp
from riecjax.arrays import Array
from riecjax.equations.equation import Equation
from riecjax.equations.expressions import combined, evaluate, read_expression
from riecjax.equations.term import AbstractTerm, samples_of
from riecjax.leaves import Leaf
from riecjax.records.record import Record
from riecjax.records.signal import Noise, Signal

_Part = tuple[AbstractTerm, int, Float[Array, "columns samples"]]
"""A term, and values that it adds to columns of one order."""


def _rows(parts: Iterable[_Part], parameters: tuple[str, ...]) -> dict[int, dict[int, Array]]:
    """The sums of each coefficient's columns, by order and row; the first takes known terms."""
    found: dict[int, dict[int, Array]] = {}
    for term, order, columns in parts:
        for name, values in zip(term.parameters or (None,), columns, strict=True):
            row = 0 if name is None else 1 + parameters.index(name)
            # The terms sum to zero, so the known ones change sides and are regressed on the rest.
            values = -values if name is None else values
            rows = found.setdefault(order, {})
            rows[row] = rows[row] + values if row in rows else values
    return found


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Columns:
    """Samples of the target and of every regressor, by the derivative still in front of them.

    The column of a coefficient is `sum_k d^k/dt^k values[k]`: what a test function of smoothness s
    takes off the motion stays in front, k = 0 to s, and every higher derivative was recorded.

    **Fields:**

    - `values`: the target first, shape `(1 + s, 1 + p, n)`.
    - `present`: where every column has its sample and the equation is to be trusted; `None`
      where that is everywhere.
    - `time_step`: seconds between samples.
    - `parameters`: names of the p regressors.
    """

    values: Float[Array, "orders columns n"]
    present: Bool[Array, " n"] | None
    time_step: Float[Array, ""]
    parameters: tuple[str, ...] = dataclasses.field(metadata={"static": True})

    @property
    def sample_count(self) -> int:
        """Number of samples n."""
        return self.values.shape[-1]

    @property
    def smoothness(self) -> int:
        """Derivatives that a test function has to take off: s."""
        return self.values.shape[0] - 1

    def __sub__(self, other: "Columns") -> "Columns":
        """Column by column, such as those of a disturbed record less those of a clean one."""
        return Columns(self.values - other.values, self.present, self.time_step, self.parameters)


def sampled_columns(equation: Equation, record: Record, smoothness: int) -> Columns:
    """The columns of an equation, of whose derivatives a criterion takes `smoothness` off.

    **Raises:** `DataError` for a missing signal or derivative, `ModelError` for a class of terms
    that fails or makes another shape.
    """
    return noisy_columns(equation, record, smoothness, Noise()).columns


Key = tuple[str, str]
Direction = dict[str, Leaf]
"""Signals that noise moves together, and by how much for one standard deviation of its source."""
STEPS = (1.5, 3.0)
"""b_1 and b_2, standard deviations by which a column's arguments are moved to either side."""


SHARES: tuple[float, float] = tuple(
    np.linalg.solve([np.power(STEPS, 2), np.power(STEPS, 4)], [1.0, -3.0]).tolist()
)
"""c_1 and c_2."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Movement:
    """How an equation's columns move, by the derivative still in front of them.

    **Fields:** `values`, of each order the moving rows, shape `(rows, n)`, or `(rows, 1)` where
    they move alike at all samples; `rows`, which these are, the target being 0.
    """

    values: dict[int, Float[Array, "rows samples"]]
    rows: dict[int, tuple[int, ...]] = dataclasses.field(metadata={"static": True})

    @classmethod
    def of(cls, parts: Iterable[_Part], parameters: tuple[str, ...]) -> "Movement":
        """What the movements of several terms add up to."""
        found = _rows(parts, parameters)
        moving = {order: tuple(sorted(rows)) for order, rows in found.items()}
        values = {
            order: xp.stack(xp.broadcast_arrays(*(rows[row] for row in moving[order])))
            for order, rows in found.items()
        }
        return cls(values, moving)

    def times(self, noise: Float[Array, " n"], like: Columns) -> Float[Array, "orders columns n"]:
        """Values of columns that move by this much at each sample, zero where nothing moves."""
        values = xp.zeros_like(like.values)
        for order, rows in self.values.items():
            values = xp.with_entries(
                values, (order, np.array(self.rows[order])), rows * noise[None, :]
            )
        return values


class NoisyColumns(NamedTuple):
    """An equation's columns, and what noise on the signals does to them.

    **Fields:** `columns`, less the shift of their mean; `white`, how columns move with each source
    that is white in all signals of the equation; `coloured`, how they move with each signal that
    has other noise; `curved`, what they scatter at one sample beyond that: squares, and how often;
    `noise` of the signals.
    """

    columns: Columns
    white: dict[str, Movement]
    coloured: dict[str, Movement]
    curved: tuple[tuple[float, Movement], ...]
    noise: Noise


class _Curved(NamedTuple):
    """Of a function along a direction: the shift of its mean, its rise, and squares beyond that."""

    shift: Float[Array, "columns samples"]
    rise: Float[Array, "columns samples"]
    squares: tuple[tuple[float, Float[Array, "columns samples"]], ...]


def noisy_columns(
    equation: Equation, record: Record, smoothness: int, noise: Noise | None = None
) -> NoisyColumns:
    """The columns of an equation as of [`sampled_columns`][], less what noise adds to their mean.

    **Arguments:** `noise`, by default the record's.

    **Raises:** as that does.
    """
    noise = record.noise if noise is None else noise
    # Along which signals move together: ("white", source) or ("coloured", signal).
    read = equation.signals_read(record, smoothness, masked=False) if noise.kernels else set()
    directions: dict[Key, Direction] = {}
    variances: Direction = {}
    for name in sorted(read):
        for source, taps in noise.kernels.get(name, {}).items():
            if is_white(noise, source, read):
                directions.setdefault(("white", source), {})[name] = taps[..., 0]
            else:
                variances[name] = variances.get(name, np.zeros(())) + xp.sum(taps**2, axis=-1)
    for name, variance in variances.items():
        directions[("coloured", name)] = {name: xp.sqrt(variance)}
    moves: dict[Key, list[_Part]] = {key: [] for key in directions}
    bends: dict[tuple[Key, ...], list[tuple[_Part, ...]]] = {}
    clean, weights = [], []
    for term in equation.terms:
        above, order = max(term.derivative - smoothness, 0), min(term.derivative, smoothness)
        sampled = samples_of(term, record, above)
        rises, curved = _term_noise(term, record, above, sampled.values, directions)
        for key, rise in rises.items():
            moves[key].append((term, order, rise))
        for keys, of in curved.items():
            sampled = combined(lambda values, shift=of.shift: values - shift, sampled)
            weights, squares = zip(*of.squares)
            bends.setdefault(keys, []).append(tuple((term, order, v) for v in squares))
        clean.append(sampled)
    names = equation.parameters

    # Shapes would be made anew with the function, which takes longer than all that it does.
    def sums(*each: Array) -> Array:
        orders = (min(term.derivative, smoothness) for term in equation.terms)
        rows = _rows(zip(equation.terms, orders, each), names)
        zero = xp.zeros_like(next(iter(next(iter(rows.values())).values())))
        places = itertools.product(range(smoothness + 1), range(1 + len(names)))
        every = xp.stack([rows.get(order, {}).get(row, zero) for order, row in places])
        return every.reshape(smoothness + 1, -1, zero.size)

    samples: Any = combined(sums, *clean)
    if equation.where is not None:
        # Present only where the equation is to be trusted.
        mask = evaluate(equation.where, record)
        holds = Signal(mask.values, mask.values.astype(bool))
        samples = combined(lambda values, *_: values, samples, mask, holds)
    movements = {key: Movement.of(parts, names) for key, parts in moves.items() if parts}
    return NoisyColumns(
        Columns(samples.values, samples.present, record.time_step, names),
        {name: m for (kind, name), m in movements.items() if kind == "white"},
        {name: m for (kind, name), m in movements.items() if kind == "coloured"},
        tuple(
            (weight, Movement.of(parts, names))
            for of_terms in bends.values()
            for weight, parts in zip(weights, zip(*of_terms))
        ),
        noise,
    )


def is_white(noise: Noise, source: str, read: Iterable[str]) -> bool:
    """Whether a source acts within the sample alone on each of these signals."""
    kernels = (noise.kernels.get(name, {}).get(source) for name in read)
    return all(taps is None or taps.shape[-1] == 1 for taps in kernels)


def _term_noise(
    term: AbstractTerm,
    record: Record,
    order: int,
    values: Float[Array, "columns samples"],
    directions: dict[Key, Direction],
) -> tuple[dict[Key, Array], dict[tuple[Key, ...], _Curved]]:
    """How a term's columns of these values move along each direction, and what bends in them along
    which."""
    if not directions:
        return {}, {}
    signals = record.signals
    expression = term.expression(record, order)
    read_expression(expression, signals)
    touching = {
        key: {name: size for name, size in direction.items() if name in signals.read}
        for key, direction in directions.items()
    }
    touching = {key: direction for key, direction in touching.items() if direction}
    if not touching:
        return {}, {}
    if term.basis is not None:
        # Functions of one argument, whose noise is that of all directions together.
        def argument(direction: Direction, step: float) -> Array:
            return evaluate(term.of, _moved(record, direction, step)).values

        # Half the difference of one standard deviation to either side: the slope of all but cubics.
        slopes = {
            key: 0.5 * (argument(direction, 1.0) - argument(direction, -1.0))
            for key, direction in touching.items()
        }
        at = argument({}, 0.0)
        spread = xp.sqrt(sum(slope**2 for slope in slopes.values()))
        size = xp.where(spread > 0, spread, 1.0)
        factor = term.factor
        found = _curved(
            values, lambda step: factor * xp.in_double(term.functions, at + step * spread)
        )
        rises = {key: found.rise * (own / size)[None, :] for key, own in slopes.items()}
        return rises, {tuple(touching): found}
    if term.is_linear and isinstance(expression, str):
        factor = term.factor
        return {k: (factor * d[expression]).reshape(1, 1) for k, d in touching.items()}, {}
    found = {
        (key,): _curved(
            values,
            lambda step, d=d: samples_of(term, _moved(record, d, step), order).values,
        )
        for key, d in touching.items()
    }
    return {key: of.rise for (key,), of in found.items()}, found


def _curved(
    values: Float[Array, "columns samples"],
    along: Callable[[float], Float[Array, "columns samples"]],
) -> _Curved:
    """What noise of unit size along a direction does to functions of these values."""
    (one, two), (first, second) = STEPS, SHARES
    pairs = [(along(step), along(-step)) for step in STEPS]
    apart = [0.5 * (above - below) for above, below in pairs]
    bends = [0.5 * (above + below) - values for above, below in pairs]
    mixed = second / (1 + first)
    return _Curved(
        first * bends[0] + second * bends[1],
        first * one * apart[0] + second * two * apart[1],
        (
            (first * second, two * apart[0] - one * apart[1]),
            (first * (1 + first), bends[0] + mixed * bends[1]),
            (second * (1 + mixed), bends[1]),
        ),
    )


def _moved(record: Record, direction: Direction, step: float) -> Record:
    signals = {name: record.signal(name) for name in direction}
    return record.with_signals(
        {
            name: dataclasses.replace(signal, values=signal.values + step * direction[name])
            for name, signal in signals.items()
        }
    )
