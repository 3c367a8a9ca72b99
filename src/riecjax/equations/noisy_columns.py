"""What noise on the signals does to an equation's columns: it shifts their mean and scatters them.

**Shift.** A column g(z) of noisy signals z = s + e has the mean g(s) + sigma^2 g''/2 + ..., which
no averaging removes: in a curved column it is ten times what the scatter adds to a Gram matrix.
With noise along one direction d of the signals, of unit variance,

    shift = (g(z + d) + g(z - d)) / 2 - g(z)

is that mean shift to fourth order in d, exactly so for cubics; and under a kink, where g'' is a
pulse, its area is the exact one, so that it is right on average over a spread of z. Columns are
corrected by it, g_c = g - shift.

**Scatter.** To first order a corrected column moves by g_c' with the noise, and its density of
noise products with another column h_c is, with the shifts of the two,

    q = g_c' h_c' - 2 shift_g shift_h

which is sigma^2 g' h' + sigma^4 g'' h'' / 2 in expectation: the second product takes off what noise
adds to the derivatives' own product. Derivatives of g_c come from JAX at z and z +- d.

**Jumps**, as of friction at a reversal, JAX does not see. What its derivatives leave of the rise
(g(z + d) - g(z - d)) / 2 is a pulse of height J / 2 over two d, whose area is that of the jump's
covariance with the noise; and what they leave of the shift, (J / 2) sign(z) there, is the jump's.
The corrected jump is sign(z) (J / 2) (1 + [|z| < d]), whose variance adds up to 7.05 d (J / 2)^2
over z: that of the pulse, 2 d, and 2.5 times that of the shift. `curved` shifts alone are taken
off twice.
"""

from collections.abc import Iterable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from riecjax.equations.columns import Columns, columns_of_terms
from riecjax.equations.equation import Equation
from riecjax.equations.expressions import Sampled, evaluate, read_expression
from riecjax.equations.term import AbstractTerm, Term, Terms
from riecjax.leaves import Leaf
from riecjax.records.noise import Noise
from riecjax.records.record import Record

Direction = dict[str, Leaf]
"""Signals that noise moves together, and by how much for one standard deviation of its source."""
STEPS = (0.0, 1.0, -1.0)
AT_JUMPS = ""
"""In place of a source's name: what scatters at jumps beyond first order."""
JUMPS = 2.5**0.5
"""Of a corrected jump's scatter, see the module."""


class Movement(eqx.Module):
    """How an equation's columns move, by the derivative still in front of them.

    **Fields:** `values`, of each order the moving rows, shape `(rows, n)`, or `(rows, 1)` where
    they move alike at all samples; `rows`, which these are, the target being 0.
    """

    values: dict[int, Float[Array, "rows samples"]]
    rows: dict[int, tuple[int, ...]] = eqx.field(static=True)

    def __init__(self, parts: "Iterable[_Part]", parameters: tuple[str, ...]):
        found: dict[int, dict[int, Array]] = {}
        for part in parts:
            names = part.term.parameters or (None,)
            for name, values in zip(names, part.values, strict=True):
                row = 0 if name is None else 1 + parameters.index(name)
                # Known terms change sides.
                values = -values if name is None else values
                rows = found.setdefault(part.order, {})
                rows[row] = rows[row] + values if row in rows else values
        self.rows = {order: tuple(sorted(rows)) for order, rows in found.items()}
        self.values = {
            order: jnp.stack(jnp.broadcast_arrays(*(rows[row] for row in self.rows[order])))
            for order, rows in found.items()
        }

    def scaled(self, by: Float[Array, " n"]) -> "Movement":
        """Times a factor at each sample."""
        values = {order: rows * by[None, :] for order, rows in self.values.items()}
        return eqx.tree_at(lambda m: m.values, self, values)

    def columns(self, like: Columns) -> Columns:
        """As columns, zero where nothing moves."""
        values = jnp.zeros_like(like.values)
        for order, rows in self.values.items():
            values = values.at[order, jnp.array(self.rows[order])].set(rows)
        return Columns(values, like.present, like.time_step, like.parameters)


class NoisyColumns(NamedTuple):
    """An equation's columns, and what noise on the signals does to them.

    **Fields:** `columns`, less the shift of their mean; `shift` itself, where columns are curved;
    `white`, how columns move with each source that is white in all signals of the equation;
    `coloured`, how they move with each signal that has other noise.
    """

    columns: Columns
    shift: Movement
    white: dict[str, Movement]
    coloured: dict[str, Movement]

    @property
    def moves(self) -> bool:
        """Whether anything is known of noise on what the columns are made of."""
        return bool(self.white or self.coloured)


def without_noise(columns: Columns) -> NoisyColumns:
    """Columns of which nothing is known."""
    return NoisyColumns(columns, Movement((), columns.parameters), {}, {})


class _Scatter(NamedTuple):
    """Derivative of corrected columns, and the shift of their mean by curvature and at jumps."""

    slope: Float[Array, "columns samples"]
    curved: Float[Array, "columns samples"]
    jump: Float[Array, "columns samples"]


class _Part(NamedTuple):
    """Values that a term adds to columns of one order."""

    term: AbstractTerm
    order: int
    values: Float[Array, "columns samples"]


def noisy_columns(equation: Equation, record: Record, smoothness: int) -> NoisyColumns:
    """The columns of an equation as of [`sampled_columns`][], less what noise adds to their mean.

    **Raises:** `DataError` for a missing signal or derivative.
    """
    terms = list(equation.terms)
    above = [max(term.derivative - smoothness, 0) for term in terms]
    orders = [min(term.derivative, smoothness) for term in terms]
    sampled = [term.samples(record, order) for term, order in zip(terms, above)]
    directions = noise_directions(record.noise, equation.terms_read(record, smoothness))
    moves: dict[tuple[str, str], list[_Part]] = {key: [] for key in directions}
    shifts, jumps, clean = [], [], []
    for term, order, higher, found in zip(terms, orders, above, sampled):
        moved, shift = _term_noise(term, record, higher, directions)
        for key, values in moved.items():
            moves[key].append(_Part(term, order, values))
        values = found.values
        if shift is not None:
            curved, jump = shift
            shifts.append(_Part(term, order, curved))
            jumps.append(_Part(term, order, JUMPS * jump))
            values = values - curved - jump
        clean.append(Sampled(values, found.present))
    names = equation.parameters
    columns = columns_of_terms(equation, record, smoothness, clean)
    movements = {key: Movement(parts, names) for key, parts in moves.items() if parts}
    white = {name: m for (kind, name), m in movements.items() if kind == "white"}
    if jumps:
        white[AT_JUMPS] = Movement(jumps, names)
    return NoisyColumns(
        columns,
        Movement(shifts, names),
        white,
        {name: m for (kind, name), m in movements.items() if kind == "coloured"},
    )


def is_white(noise: Noise, source: str, read: Iterable[str]) -> bool:
    """Whether a source acts within the sample alone on each of these signals."""
    kernels = (noise.kernels.get(name, {}).get(source) for name in read)
    return all(taps is None or taps.shape[-1] == 1 for taps in kernels)


def noise_directions(noise: Noise, read: Iterable[str]) -> dict[tuple[str, str], Direction]:
    """Along which signals move together: ("white", source) or ("coloured", signal)."""
    found: dict[tuple[str, str], Direction] = {}
    variances: Direction = {}
    for name in sorted(read):
        for source, taps in noise.kernels.get(name, {}).items():
            if is_white(noise, source, read):
                found.setdefault(("white", source), {})[name] = taps[..., 0]
            else:
                variances[name] = variances.get(name, np.zeros(())) + jnp.sum(taps**2, axis=-1)
    for name, variance in variances.items():
        found[("coloured", name)] = {name: jnp.sqrt(variance)}
    return found


def _term_noise(
    term: AbstractTerm, record: Record, order: int, directions: dict[tuple[str, str], Direction]
) -> tuple[dict[tuple[str, str], Array], tuple[Array, Array] | None]:
    """How a term's columns move along each direction, and by how much their mean is shifted, by
    curvature and at jumps."""
    signals = record.signals
    expression = term.expression(record, order)
    read_expression(expression, signals)
    touching = {
        key: {name: size for name, size in direction.items() if name in signals.read}
        for key, direction in directions.items()
    }
    touching = {key: direction for key, direction in touching.items() if direction}
    if isinstance(term, Terms):
        return _basis_noise(term, record, touching)
    if isinstance(term, Term) and isinstance(expression, str):
        number = jnp.asarray(term.number)
        moved = {k: (number * d[expression]).reshape(1, 1) for k, d in touching.items()}
        return moved, None
    moved, curved, jump = {}, jnp.zeros(()), jnp.zeros(())
    for key, direction in touching.items():

        def along(step: Array, direction: Direction = direction) -> Array:
            return term.samples(_moved(record, direction, step), order).values

        found = _scatter_and_shift(along, jnp.ones(()))
        moved[key] = found.slope
        curved, jump = curved + found.curved, jump + found.jump
    return moved, (curved, jump) if touching else None


def _basis_noise(
    term: Terms, record: Record, touching: dict[tuple[str, str], Direction]
) -> tuple[dict[tuple[str, str], Array], tuple[Array, Array] | None]:
    """Of functions of one argument, whose noise is that of all directions together."""
    if not touching:
        return {}, None

    def argument(direction: Direction, step: Array) -> Array:
        return evaluate(term.of, _moved(record, direction, step))[0]

    zero = jnp.zeros(())
    one = jnp.ones(())
    at = argument({}, zero)
    slopes = {
        key: jax.jvp(lambda h, d=direction: argument(d, h), (zero,), (one,))[1]
        for key, direction in touching.items()
    }
    spread = jnp.sqrt(sum(slope**2 for slope in slopes.values()))
    size = jnp.where(spread > 0, spread, 1.0)

    def along(step: Array) -> Array:
        return jnp.asarray(term.sign) * term.basis(at + step * spread)

    found = _scatter_and_shift(along, one)
    moved = {key: found.slope * (own / size)[None, :] for key, own in slopes.items()}
    return moved, (found.curved, found.jump)


def _scatter_and_shift(along, one: Array) -> "_Scatter":
    """What noise along a direction does to functions g."""
    steps = jnp.asarray(STEPS, one.dtype)
    values, slopes = jax.vmap(lambda step: jax.jvp(along, (step,), (one,)))(steps)
    risen = 0.5 * (values[1] - values[2]) - (4 * slopes[0] + slopes[1] + slopes[2]) / 6
    curved = 0.25 * (slopes[1] - slopes[2])
    jump = 0.5 * (values[1] + values[2]) - values[0] - curved
    return _Scatter(2 * slopes[0] - 0.5 * (slopes[1] + slopes[2]) + risen, curved, jump)


def _moved(record: Record, direction: Direction, step: Array) -> Record:
    moved = {name: record.arrays[name] + step * size for name, size in direction.items()}
    return record.with_signals(moved, missing=record.missing)
