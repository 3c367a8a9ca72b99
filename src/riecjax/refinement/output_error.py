"""Output-error refinement: the model simulated over windows, and compared with the recording.

Windows of a recording over which a model is simulated, and what was recorded in each.

How long they are decides what is fitted. Of one time step, the state being measured anew at every
sample, they make a fit of the equation error: nearly linear, and biased where the state is noisy.
Of the whole record they make single shooting, the output-error fit: efficient where the model is
right and noise is on the outputs, but what a wrong parameter does to the state adds up along the
window, exponentially where motion is unstable, and with it the curvature of the sum of squares.
Windows between the two (multiple shooting) bound that by their length, at the price of initial
states to estimate.

What a recording holds in the windows over which a model is simulated, and how it is cut to them.

Recordings are filled up behind their end to lengths that others share, so that the next one, of
another length, is simulated by functions that are compiled already. What is simulated there is not
compared, and may diverge.

Output error over windows: the model simulated from initial states, compared with the recording.

The residual of a window is r = (y(theta, s) - measured) / sigma at every compared sample of every
channel, y simulated from the initial state s. Its derivatives are those of the simulation: along
each unit vector of (theta, s) the variational equation is stepped with the state, by forward
differentiation of the very steps. That is the exact derivative of what is computed, takes p + s
simulations beside the one, and keeps no step in memory for later. Reverse mode would take one pass
for each residual, of which there are thousands.

**Initial states projected out.** Let J = dr/dtheta, S = dr/ds, C = S^T S and B = J^T S of a window.
To first order the best initial state follows theta by ds/dtheta = -C^-1 B^T, and the residual does

    (J - S C^-1 B^T) dtheta.

That is a linear map of columns, [r J S] -> [-r, J - S C^-1 B^T], the same in every piece of the
window. Applied to the moments of pieces it gives scores of theta alone by blocks of time. Their sum
has the Schur complement A - B C^-1 B^T of `optimum` for its Gram matrix: a covariance of theta
that includes what is not known of initial states.

Huber's loss, which grows with a residual's square up to a threshold and straight on past it.

With the threshold c, rho(r) = r^2 / 2 up to c and c |r| - c^2 / 2 past it. What searches for least
squares makes it small as the square of f(r) = sign(r) sqrt(2 rho(r)), whose slope is continuous.
f f' is the score psi(r), r cut off at c, so the gradient is the loss's own; f'^2 > 0 past c keeps
steps defined, and is more than the curvature psi' = 0 there. A sandwich takes psi' instead, or its
standard errors were too small: by a fifth of a normal law at c = 1.345.
"""

import dataclasses
import math
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Literal, NamedTuple, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from diffrax import BacksolveAdjoint, RecursiveCheckpointAdjoint
from jaxtyping import Array, Bool, Float, Int, Key

from riecjax.compilation import kept_jit
from riecjax.criteria.criterion import SHORT_BLOCKS_OF_ROWS
from riecjax.errors import DataError, ModelError, require
from riecjax.estimation.parameters import ParameterTable
from riecjax.leaves import Leaf, held_still, is_concrete, is_number, namespace
from riecjax.linear_algebra import solve_scaled
from riecjax.records.noise_judgement import judged
from riecjax.records.record import Record, Signal, both, filled_up, shared_length
from riecjax.refinement.objective import (
    AbstractObjective,
    AbstractResiduals,
    ByFunction,
    Energies,
    Expansion,
    Initial,
    Theta,
    as_parametric_system,
)
from riecjax.simulation.intersample import Intersample, bends_of, require_intersample, smooth_inputs
from riecjax.simulation.linearisation import MOST_STEPS, spread_points, suitable_steps
from riecjax.simulation.method import AbstractMethod, FixedStep
from riecjax.simulation.system import AbstractSystem, measured_states, state_sources
from riecjax.summaries.normal_equations import NormalEquations, ShortBlocks, stack_normal_equations

SHORTEST = 2
"""Samples of a window below which it tells nothing."""


class Shots(eqx.Module):
    """Windows of one recording.

    **Fields:** `first` sample of each window; `length`, its number of samples; `longest`, how many
    are simulated, as many or more.
    """

    first: Int[Array, " windows"] | Int[np.ndarray, " windows"]
    length: Int[Array, " windows"] | Int[np.ndarray, " windows"]
    longest: int = eqx.field(static=True)

    @property
    def samples(self) -> Int[Array, "windows longest"]:
        """Index of each sample of each window; the last one again beyond its length."""
        steps = jnp.arange(self.longest)[None, :]
        return jnp.asarray(self.first)[:, None] + jnp.minimum(steps, self.length[:, None] - 1)


def within(length: Int[Leaf, " windows"], longest: int) -> Bool[Array, "windows longest"]:
    """Which of so many samples lie within the length of each window."""
    return jnp.arange(longest)[None, :] < jnp.asarray(length)[:, None]


class AbstractShooting(eqx.Module):
    """How a recording is cut into windows to simulate."""

    @abstractmethod
    def shots(self, record: Record, inputs: Sequence[str], *, joined: bool = False) -> Shots:
        """The windows of one recording, unbroken in its inputs.

        With `joined`, a window begins on the sample at which its neighbour ends; a start that is
        estimated must not, for that sample would count twice.

        **Raises:** `DataError` if the record has no such window; `ModelError` where a length
        depends on a time step that is being traced.
        """

    @abstractmethod
    def describe(self) -> dict[str, object]:
        """Name and settings, for tables and JSON."""


class WholeRecord(AbstractShooting):
    """Each unbroken stretch of a recording at once: single shooting, the output-error fit."""

    def shots(self, record: Record, inputs: Sequence[str], *, joined: bool = False) -> Shots:
        """One window for each unbroken stretch."""
        cut = _tiles(record, inputs, record.sample_count, joined)
        return dataclasses.replace(cut, longest=shared_length(cut.longest))

    def describe(self) -> dict[str, object]:
        """Name."""
        return {"windows": "whole record"}


class Tiles(AbstractShooting):
    """Windows of one length side by side: multiple shooting.

    Of one time step they make a fit of the equation error, of the whole record an output-error
    fit.

    **Arguments:** `seconds` of a window, or `samples` from its start to its end.

    **Raises:** `ModelError` unless one of the two is given, and positive.
    """

    seconds: float | None = eqx.field(static=True, default=None)
    samples: int | None = eqx.field(static=True, default=None)

    def __check_init__(self):
        if (self.seconds is None) == (self.samples is None):
            raise ModelError("tiles need a length in seconds or in samples, one of the two.")
        if (self.seconds is not None and self.seconds <= 0) or (
            self.samples is not None and self.samples < 1
        ):
            raise ModelError("tiles need a positive length.")

    def shots(self, record: Record, inputs: Sequence[str], *, joined: bool = False) -> Shots:
        """Tiles of each unbroken stretch; the last of a stretch may be shorter."""
        if self.samples is not None:
            return _tiles(record, inputs, self.samples + 1, joined)
        if not is_concrete(record.time_step):
            raise ModelError(
                "the number of samples of a window must be known before tracing: give "
                "Tiles(samples=...) or keep the record's time step out of jit and vmap."
            )
        steps = max(round(float(self.seconds or 0.0) / float(record.time_step)), 1)
        return _tiles(record, inputs, steps + 1, joined)

    def describe(self) -> dict[str, object]:
        """Name and length."""
        return {"windows": "tiles", "seconds": self.seconds, "samples": self.samples}


def _tiles(record: Record, inputs: Sequence[str], longest: int, joined: bool) -> Shots:
    """Windows of up to `longest` samples, from the last sample of the one before, or after it."""
    longest = min(longest, record.sample_count)
    if is_concrete(record):
        stretches = [(part.start, part.stop) for part in record.segments(inputs)]
    elif record.present(inputs) is None:
        stretches = [(0, record.sample_count)]
    else:
        raise ModelError("a record with gaps cannot be traced here: cut it at its gaps first.")
    first = [
        (start, min(longest, stop - start))
        for begin, stop in stretches
        for start in range(begin, stop - 1, longest - joined)
        if stop - start >= SHORTEST
    ]
    if not first:
        raise DataError(
            f"no unbroken stretch of {SHORTEST} samples is left in which {', '.join(inputs)} are "
            f"recorded."
        )
    starts, lengths = np.array(first, np.int32).T
    return Shots(starts, lengths, int(lengths.max()))


class Recorded(eqx.Module):
    """What is simulated and compared of one recording.

    **Fields:**

    - `levels`: inputs in each window, shape `(windows, longest, inputs)`; `bends`, their curvature
      by time steps, zero or `None` where they are straight lines between samples.
    - `measured`: the channels at every sample that is compared, `(windows, compared, channels)`.
    - `present`: which of these count.
    - `initial`: initial state of each window as it was recorded, `(windows, states)`.
    - `position`: sample at which each compared one stands in the record, `(windows, compared)`.
    - `length` of each window in samples, `(windows,)`.
    - `time_step` in seconds; `sample_count` of the record.
    - `short_blocks` of time that hold it, of `short` samples; `every`, of how many samples one is
      compared; `piece`, how many of these make a piece of time.
    """

    levels: Float[Array, "windows longest inputs"]
    bends: Float[Array, "windows longest inputs"] | None
    measured: Float[Array, "windows compared channels"]
    present: Array
    initial: Float[Array, "windows states"]
    position: Int[Array, "windows compared"]
    length: Int[Array, " windows"]
    time_step: Float[Array, ""]
    sample_count: Int[Array, ""]
    short: int = eqx.field(static=True)
    short_blocks: int = eqx.field(static=True)
    every: int = eqx.field(static=True)
    piece: int = eqx.field(static=True)

    @property
    def windows(self) -> int:
        """Number of windows."""
        return self.initial.shape[0]

    def trajectory(
        self, method: AbstractMethod, system: AbstractSystem, initial: Float[Array, " states"]
    ) -> tuple[Float[Array, "longest states"], Bool[Array, ""]]:
        """Along the inputs of one window: of a recording that is mapped over its windows.

        **Returns:** states, and whether the solution was kept to the window's end. What is
        simulated behind it counts for nothing.
        """
        # A method of one's own need not know of bends that are not asked for.
        bends = () if self.bends is None else (self.bends,)
        states, _, reached = method.trajectory(system, self.levels, self.time_step, initial, *bends)
        return states, reached >= self.length


def over_windows(function: Callable[[Any, Recorded], Any], initial: Array, part: Recorded) -> Any:
    """A function of each window's initial state and recording."""
    axes = jax.tree.map(lambda leaf: 0 if jnp.ndim(leaf) else None, part)
    return jax.vmap(function, in_axes=(0, axes))(initial, part)


Along = tuple[Leaf, Leaf]
"""States and inputs at points along a recording."""
States = Float[Array, "windows longest states"]


class Compared(NamedTuple):
    """What of the windows is compared, and how they begin.

    **Fields:** `channels` and `every`, of how many samples one, as of [`OutputError`][]; `given`,
    values of initial states; `joined` as of `AbstractShooting.shots`; which inputs are `smooth`,
    `None` to keep no bends.
    """

    channels: tuple[str, ...]
    given: dict[str, Any]
    every: int
    joined: bool
    smooth: tuple[bool, ...] | None


def _filled(record: Record) -> Record:
    """A record of a length that others share, with no sample behind its end."""
    filled = filled_up(record, shared_length(record.sample_count))
    behind = np.arange(filled.sample_count) >= record.sample_count
    signals = {n: Signal(s.values, both(s.present, ~behind)) for n, s in filled.by_name.items()}
    return Record(signals, filled.time_step)


@kept_jit
def _cut(
    system: AbstractSystem,
    record: Record,
    sample_count: Int[Array, ""],
    shots: Shots,
    compared: Compared,
) -> tuple[Recorded, Along, Float[Array, " states"]]:
    """What a recording holds in its windows; states and inputs at points spread over them; and the
    mean square of each state.

    **Arguments:** `sample_count` of the recording; what lies behind only fills it up.
    """
    channels, given, every, joined, smooth = compared
    states, n = measured_states(system, record), record.sample_count
    inputs = jnp.zeros((n, 0), record.time_step.dtype)
    if system.input_names:
        inputs = jnp.stack([record[name] for name in system.input_names], axis=-1)
    samples = shots.samples.reshape(-1)
    samples = samples[spread_points(samples.shape[0])]
    position = shots.samples[:, ::every]
    initial = states[shots.first]
    for name, value in given.items():
        place = system.state_names.index(name)
        initial = initial.at[:, place].set(jnp.asarray(value, initial.dtype))
    # An initial state that is taken from the record leaves no error there.
    inside = within(shots.length, shots.longest)[:, ::every]
    inside = inside.at[:, 0].set(inside[:, 0] & (not joined))
    masks = (record.present((name,)) for name in channels)
    present = [inside if mask is None else inside & mask[position] for mask in masks]
    # As many as where the record is filled up, which under jit it is not.
    shared = shared_length(n)
    short = -(-shared // SHORT_BLOCKS_OF_ROWS)
    bends = None
    if smooth is not None:
        # Of the whole record: a window's neighbours tell what its inputs do at its ends.
        bends = bends_of(inputs, record.present(system.input_names), smooth)[shots.samples]
    held = jnp.arange(n) < sample_count
    squares = jnp.sum(jnp.where(held[:, None], states, 0.0) ** 2, axis=0) / sample_count
    recorded = Recorded(
        inputs[shots.samples],
        bends,
        jnp.stack([record[name][position] for name in channels], axis=-1),
        jnp.stack(present, axis=-1),
        initial,
        position,
        jnp.asarray(shots.length),
        record.time_step,
        sample_count,
        short,
        max(-(-shared // short), 2),
        every,
        min(max(short // every, 1), position.shape[1]),
    )
    return recorded, (states[samples], inputs[samples]), squares


THRESHOLD = 1.345
"""Standard deviations of the noise: 95 % as precise as squares where all of it is normal."""
LEAST_NOISE = 1e-3
"""Share of a channel's standard deviation that its noise is taken for at the least."""

Threshold: TypeAlias = Float[Array, "1 channels"] | None
"""Past which a channel's loss is straight, in units of its residuals; `None` where nowhere."""


def as_square(
    residual: Float[Array, "*n channels"], threshold: Threshold
) -> Float[Array, "*n channels"]:
    """f(r), half the square of which is the loss."""
    if threshold is None:
        return residual
    past = jnp.maximum(jnp.abs(residual), threshold)
    bent = jnp.sign(residual) * jnp.sqrt(threshold * (2 * past - threshold))
    return jnp.where(jnp.abs(residual) <= threshold, residual, bent)


def loss_columns(
    level: Float[Array, "*n channels"],
    slopes: Float[Array, "*n channels columns"],
    threshold: Threshold,
    curved: bool,
) -> tuple[Array, Array]:
    """Of residuals and their slopes, two sets of columns whose products are moments from the
    diagonal up: f^2, psi times slopes, and slopes times each other and f'^2, or psi' if `curved`.
    """
    if threshold is None:
        columns = jnp.concatenate([level[..., None], slopes], axis=-1)
        return columns, columns
    score, energy = jnp.clip(level, -threshold, threshold), as_square(level, threshold) ** 2
    inside = jnp.abs(level) <= threshold
    weight = inside if curved else jnp.where(inside, 1.0, score**2 / jnp.where(inside, 1.0, energy))
    left = jnp.concatenate([score[..., None], weight[..., None] * slopes], axis=-1)
    energy = energy / jnp.where(score == 0, 1.0, score)
    return left, jnp.concatenate([energy[..., None], slopes], axis=-1)


RIDGE = 1e-10
"""What keeps an initial state that no residual depends on from a division by zero; relative."""
PROFILED = 1e-6
"""Share of the sum of squares that better initial states would still take off: as good as none."""
MOST_TRIALS = 8
"""Initial states that are tried for each window."""


class OutputResiduals(AbstractResiduals):
    """Simulated minus recorded channels, in units of `sigma`, over all windows of all records.

    `labels` are the channels; `estimated`, the places of the states whose initial values are
    estimated; `threshold` of Huber's loss by channel, in units of sigma, `None` for squares.
    `longest_window` is 0: no residual counts twice.
    """

    system: ByFunction
    recorded: list[Recorded]
    table: ParameterTable
    start: Theta
    sigma: Float[Array, " channels"]
    initial: Initial
    scale: Float[Array, " s"]
    longest_window: Float[Array, ""]
    method: Any
    threshold: Float[Array, "1 channels"] | None
    labels: tuple[str, ...] = eqx.field(static=True)
    units: tuple[str, ...] = eqx.field(static=True)
    initial_state_names: tuple[str, ...] = eqx.field(static=True)
    estimated: tuple[int, ...] = eqx.field(static=True)
    most_steps: int = eqx.field(static=True)

    @property
    def work(self) -> int:
        """Steps x states x tangents of an expansion, which a search takes about twelve of.

        Every step of every simulation is taken with a tangent for each parameter and initial state.
        """
        fixed = self.method if isinstance(self.method, FixedStep) else FixedStep()
        samples = sum(math.prod(part.levels.shape[:2]) for part in self.recorded)
        tangents = 1 + len(self.table.free) + len(self.estimated)
        states = self.recorded[0].initial.shape[1]
        return samples * fixed.steps_per_sample * states * tangents

    def energy(self, theta: Theta, initial: Initial) -> Energies:
        """Of each channel, in units of sigma, profiled over initial states by Gauss and Newton,
        while that makes the sum smaller."""
        zero = jnp.zeros(len(self.labels), theta.dtype)
        if not self.estimated:
            squares = self._by_window(
                lambda at, window, index: jnp.sum(
                    as_square(self._error(theta, at, window, index), self.threshold) ** 2, axis=0
                ),
                initial,
            )
            return sum((jnp.sum(each, axis=0) for each in squares), start=zero)
        table = self.table.holding({**self.table.known, **dict(zip(self.table.free, theta))})
        held, initial = held_still((dataclasses.replace(self, table=table), initial))
        none = jnp.zeros(0, initial.dtype)

        # Initial states to try, the least energy so far, trials left, and whether to go on.
        def tried(state: tuple[Array, Energies, Array, Array]) -> tuple[Array, ...]:
            trial, least, trials, _ = state
            at = held.expansion(none, trial)
            moments = at.moments()
            better = jnp.sum(at.energy) < jnp.sum(least)
            energy = jnp.where(better, at.energy, least)
            gradient = moments[:, 1:, :1]
            step = -jax.vmap(lambda g, r: solve_scaled(g, r, RIDGE))(moments[:, 1:, 1:], gradient)
            going = better & (-jnp.sum(gradient * step) > PROFILED * jnp.sum(energy))
            return trial + step[:, :, 0], energy, trials - 1, going & (trials > 0)

        first: Any = (initial, zero + jnp.inf, jnp.asarray(MOST_TRIALS), jnp.asarray(True))
        return jax.lax.while_loop(lambda state: state[3], tried, first)[1]

    def expansion(self, theta: Theta, initial: Initial) -> Expansion:
        """Of each window of each record, in pieces of time."""
        return self._expansion(theta, initial, False)

    def curved(self, theta: Theta, initial: Initial, expansion: Expansion) -> Expansion:
        """With the curvature of Huber's loss itself, none past its threshold."""
        return expansion if self.threshold is None else self._expansion(theta, initial, True)

    def _expansion(self, theta: Theta, initial: Initial, curved: bool) -> Expansion:

        def of_window(initial: Array, window: Recorded, index: int) -> tuple[Array, Array]:
            # Residuals, and their derivatives by parameters and initial states.
            p = theta.shape[0]
            unknown = jnp.concatenate([theta, initial])

            def along(direction: Array) -> tuple[Array, Array]:
                return jax.jvp(
                    lambda u: self._error(u[:p], u[p:], window, index), (unknown,), (direction,)
                )

            directions = jnp.eye(unknown.shape[0], dtype=unknown.dtype)
            level, slopes = jax.vmap(along, out_axes=(None, 2))(directions)
            left, right = loss_columns(level, slopes, self.threshold, curved)
            cut, other = _in_pieces(left, window.piece), _in_pieces(right, window.piece)
            moments = jnp.einsum("prci,prcj->pij", cut, cut if left is right else other)
            if left is not right:
                moments = jnp.triu(moments) + jnp.swapaxes(jnp.triu(moments, 1), 1, 2)
            return moments, jnp.sum(left[..., 0] * right[..., 0], axis=0)

        pieces, squares = zip(*self._by_window(of_window, initial))
        zero = jnp.zeros(len(self.labels), theta.dtype)
        return Expansion(list(pieces), sum((jnp.sum(s, axis=0) for s in squares), start=zero))

    @kept_jit
    def values(
        self, theta: Theta, initial: Initial
    ) -> list[Float[Array, "windows compared channels"]]:
        """Simulated minus recorded in units of sigma; 0 where nothing is compared."""
        return self._by_window(partial(self._error, theta), initial)

    @kept_jit
    def slopes_by_initial(
        self, theta: Theta, initial: Initial
    ) -> list[Float[Array, "windows compared channels s"]]:
        """Derivatives of `values` by the initial states of their window."""
        return self._by_window(jax.jacfwd(partial(self._error, theta)), initial)

    def _by_window(self, of: Callable[[Array, Recorded, int], Any], initial: Initial) -> list[Any]:
        """What is made of each window's initial state, the window and its record's number."""
        edges = np.cumsum([part.windows for part in self.recorded])[:-1]
        parts = enumerate(zip(self.recorded, jnp.split(initial, edges)))
        return [
            over_windows(lambda at, window, i=i: of(at, window, i), own, part)
            for i, (part, own) in parts
        ]

    def rms(self, energy: Energies) -> Energies:
        """Of simulated minus recorded."""
        return self.sigma * jnp.sqrt(energy / _counts(self.recorded))

    def independent_rows(self) -> Float[Array, ""]:
        """All that are compared."""
        return jnp.asarray(sum(jnp.sum(part.present) for part in self.recorded), float)

    def blocks(self, expansion: Expansion) -> tuple[NormalEquations, ShortBlocks]:
        """By blocks of time."""
        p = len(self.table.free)
        parts, numbers, seconds = [], [], []
        for part, pieces in zip(self.recorded, expansion.pieces):
            samples, most = part.short, part.short_blocks
            number = jnp.clip(-(-part.sample_count // samples), 2, most)
            moments = jax.vmap(lambda m: _without_initial(m, p))(pieces)
            position = part.position[:, :: part.piece]
            index = jnp.minimum(position // samples, number - 1).reshape(-1)
            held = jax.vmap(partial(_in_pieces, length=part.piece))(part.present).sum(axis=(2, 3))
            flat, held = moments.reshape(-1, *moments.shape[2:]), held.reshape(-1)
            flat, held = (jax.ops.segment_sum(v, index, num_segments=most) for v in (flat, held))
            parts.append(NormalEquations(flat, held.astype(flat.dtype), self.table.free))
            numbers.append(number)
            seconds.append(samples * part.time_step)
        return stack_normal_equations(parts), ShortBlocks(jnp.stack(numbers), jnp.stack(seconds))

    def _error(
        self, theta: Theta, initial: Float[Array, " s"], window: Recorded, index: int
    ) -> Float[Array, "compared channels"]:
        """Of one window of record number `index`."""
        system = self.system.build(self.table.values_at(theta, index))
        first = window.initial.at[np.array(self.estimated, int)].set(initial)
        states, kept = window.trajectory(self.method, system, first)
        states, levels = states[:: window.every], window.levels[:: window.every]
        # A state goes before an output of its name, and that before a state's derivative.
        made, names = {}, system.state_names
        outputs = {name for name, _ in system.outputs} - {*names}
        if {*self.labels} - outputs - {*names}:
            rates = jax.vmap(system.derivative)(states, levels)
            made |= {f"d{name}": rates[:, i] for i, name in enumerate(names)}
        if outputs & {*self.labels}:
            made |= jax.vmap(system.output)(states, levels)
        made |= {name: states[:, i] for i, name in enumerate(names)}
        simulated = jnp.stack([made[name] for name in self.labels], axis=-1)
        # What a lost simulation shows after its loss must not pass for an answer.
        simulated = jnp.where(kept, simulated, jnp.inf)
        return jnp.where(window.present, (simulated - window.measured) / self.sigma[None, :], 0.0)


def _in_pieces(values: Array, length: int) -> Array:
    """The first axis cut into pieces of a length, the last one filled up with zeros."""
    count = -(-values.shape[0] // length)
    pad = [(0, count * length - values.shape[0])] + [(0, 0)] * (values.ndim - 1)
    return jnp.pad(values, pad).reshape(count, length, *values.shape[1:])


def _without_initial(
    pieces: Float[Array, "pieces columns columns"], p: int
) -> Float[Array, "pieces 1+p 1+p"]:
    """Moments of minus the residual and of its derivatives while initial states follow."""
    mix = jnp.eye(1 + p, dtype=pieces.dtype).at[0, 0].set(-1.0)
    if pieces.shape[-1] > 1 + p:
        whole = jnp.sum(pieces, axis=0)
        following = solve_scaled(whole[1 + p :, 1 + p :], whole[1 + p :, 1 : 1 + p], ridge=RIDGE)
        mix = jnp.concatenate([mix, jnp.pad(-following, [(0, 0), (1, 0)])])
    return jnp.einsum("ia,pij,jb->pab", mix, pieces, mix)


class OutputError(AbstractObjective):
    """Simulated minus recorded signals, over windows from one sample to the whole record.

    Over one time step this is a fit of the equation error, over windows multiple shooting, over the
    whole record the output-error fit: one code. Short windows forgive a poor start and what the
    model leaves out; long ones tell most where the model is right and the sensors are noisy.

    **Arguments:**

    - `shooting`: [`WholeRecord`][] or [`Tiles`][].
    - `channels`: signals to compare: states, their derivatives `d<state>`, outputs. By default the
      recorded states, or if there are none, every output that the record holds; but not what was
      computed from others that are compared, such as a velocity differentiated from a position.
    - `sigma`: standard deviation of each channel's error, in its unit, by which it is weighed; by
      default the channel's own standard deviation, so that relative errors count alike.
    - `initial_states` of each window. `"estimated"`, with the recorded one for a first
      guess; `"measured"`, taken from the record where it holds the state and estimated where not;
      or values by name of those states that are known at the start, the others estimated.
    - `method`: as for [`simulate`][]. By default Runge-Kutta with steps that resolve the model's
      fastest motion along the recording (see [`suitable_steps`][]), made shorter for as long as
      halving them at the optimum changes the answer, up to 64 between samples; 8 under jit.
    - `intersample`: what inputs are between samples. `"smooth"` wherever they neither jump nor
      turn a corner, or straight `"lines"`, as of a command that is known to be, or of what
      [`simulate`][] made; of all inputs, or by name: `{"F": "lines"}`.
    - `loss`: `"squares"`, or `"huber"`, which grows with the square up to 1.345 standard deviations
      of a channel's noise and straight on past it, so that what no noise explains pulls less. The
      noise is what the records say of it, or their samples do; `rms` then is that of residuals
      whose squares are the loss.
    - `every`: compare one of so many samples. Of a record that was upsampled, the others would tell
      the same again.
    """

    shooting: AbstractShooting = eqx.field(default_factory=WholeRecord)
    channels: tuple[str, ...] | None = eqx.field(static=True, default=None)
    sigma: Mapping[str, float | Array] | None = None
    initial_states: Literal["estimated", "measured"] | Mapping[str, float | Array] = "estimated"
    method: AbstractMethod | None = None
    every: int = eqx.field(static=True, default=1)
    intersample: Intersample = "smooth"
    loss: Literal["squares", "huber"] = eqx.field(static=True, default="squares")

    def __check_init__(self):
        write = "rx.OutputError(rx.refinement.Tiles(0.5)), or without windows rx.OutputError()"
        require("what OutputError simulates over", self.shooting, AbstractShooting, write)
        require("the method", self.method or FixedStep(), AbstractMethod, "method=rx.FixedStep(8)")
        write = "initial_states='estimated', 'measured' or values by name such as {'x': 0.0}"
        require("initial states", self.initial_states, (str, Mapping), write)
        channels = self.channels if self.channels is None else f"('{self.channels}',)"
        write = f"channels={channels}: a tuple of names"
        require("channels", self.channels or (), (tuple, list), write)
        words, given = ("estimated", "measured"), self.initial_states
        if isinstance(given, str) and given not in words:
            raise ModelError(
                f"initial_states are 'estimated', 'measured' or values by name; got '{given}'."
            )
        require_intersample(self.intersample)
        if self.loss not in ("squares", "huber"):
            raise ModelError(f"the loss is 'squares' or 'huber'; got {self.loss!r}.")
        if self.every < 1:
            raise ModelError(f"every must be 1 or more; got {self.every}.")
        adjoint = getattr(self.method, "adjoint", None)
        if isinstance(adjoint, RecursiveCheckpointAdjoint | BacksolveAdjoint):
            raise ModelError(
                f"refinement forms its Jacobians forward, which {type(adjoint).__name__} cannot: "
                f"leave Adaptive its ForwardMode, or give it diffrax.DirectAdjoint() to "
                f"differentiate the result in reverse."
            )

    def models(self, model: Any, record: Record) -> tuple[ByFunction]:
        """The system to simulate."""
        return (as_parametric_system(model, record),)

    def over(
        self,
        models: Sequence[ByFunction],
        records: list[Record],
        table: ParameterTable,
        start: Theta,
        keys: list[Key[Array, ""] | None],
    ) -> OutputResiduals:
        """Over the windows of all records."""
        (model,) = models
        system: AbstractSystem = model.build(table.values_at(start, 0))
        channels = _channels(system, records, self.channels)
        for record in records:
            for name in system.input_names:
                _ = record.signals[name]
        for name, value in (self.sigma or {}).items():
            if name not in channels:
                raise ModelError(
                    f"sigma is given for '{name}', which is not compared; compared are: "
                    f"{', '.join(channels)}."
                )
            if not is_number(value) or (is_concrete(value) and not 0 < float(value) < np.inf):
                raise ModelError(
                    f"sigma of {name} is {value!r}: a standard deviation is a positive number, in "
                    f"the unit of {name}."
                )
        sources = [state_sources(system, record) for record in records]
        given = self.initial_states if isinstance(self.initial_states, Mapping) else {}
        system.require_states(given)
        fixed = {*given}
        if self.initial_states == "measured":
            names = system.state_names
            fixed = {name for name in names if all(s[name] == "measured" for s in sources)}
        # Places of the states whose initial values are estimated.
        estimated = tuple(i for i, name in enumerate(system.state_names) if name not in fixed)
        smooth = smooth_inputs(self.intersample, system.input_names)
        # By a method that is chosen here, lines are bent by zero: what is compiled serves both.
        bent = smooth if any(smooth) or (smooth and self.method is None) else None
        compared = Compared(channels, dict(given), self.every, not estimated, bent)
        parts = []
        for record in records:
            # A missing sample of an input breaks the motion; of a free motion, one of any signal.
            unbroken = system.input_names or tuple(record.arrays)
            shots = self.shooting.shots(record, unbroken, joined=compared.joined)
            longer = _filled(record) if is_concrete(records) else record
            count = jnp.asarray(record.sample_count)
            parts.append(_cut(system, longer, count, shots, compared))
        recorded, along, squares = map(list, zip(*parts))
        told = not any("zero" in by_state.values() for by_state in sources)
        method, simulated = _method(system, recorded, along, told, self.method)
        units = dict(system.states) | dict(system.outputs)
        motion = None if simulated is None else (tuple(sources[0].values()), simulated)
        given_sigma = dict(self.sigma or {})
        sigma, deviation, scale = _scales(
            recorded, given_sigma, channels, estimated, squares[0], motion
        )
        threshold = None
        if self.loss == "huber":
            noise = noise_levels(records, channels)
            threshold = THRESHOLD * (jnp.maximum(noise, LEAST_NOISE * deviation) / sigma)[None, :]
        return OutputResiduals(
            system=model,
            recorded=recorded,
            table=table,
            start=start,
            sigma=sigma,
            initial=jnp.concatenate(
                [part.initial[:, np.array(estimated, int)] for part in recorded]
            ),
            scale=scale,
            longest_window=jnp.zeros_like(scale, shape=()),
            method=method,
            threshold=threshold,
            labels=channels,
            units=tuple(units.get(name, "") for name in channels),
            initial_state_names=tuple(system.state_names[i] for i in estimated),
            estimated=estimated,
            most_steps=MOST_STEPS if self.method is None else 0,
        )

    def describe(self) -> dict[str, object]:
        """Name and settings."""
        initial = self.initial_states if isinstance(self.initial_states, str) else "partly known"
        loss: dict[str, object] = {} if self.loss == "squares" else {"loss": self.loss}
        shooting = self.shooting.describe()
        return {"refine": "output-error", **shooting, "starts": initial, **loss}


def _channels(
    system: AbstractSystem, records: Sequence[Record], asked: tuple[str, ...] | None
) -> tuple[str, ...]:
    available = system.simulated_names
    if asked is not None:
        if unknown := [name for name in asked if name not in available]:
            raise ModelError(
                f"the simulation has no signal '{unknown[0]}' to compare; it has: "
                f"{', '.join(available)}."
            )
        for record in records:
            for name in asked:
                _ = record.signals[name]
        return asked
    held = [name for name in available if all(name in record.arrays for record in records)]
    chosen = [name for name in system.state_names if name in held] or held
    if not chosen:
        raise DataError(
            f"the records hold nothing that is simulated, so there is nothing to compare; needed "
            f"is one of: {', '.join(available)}."
        )
    computed = [_computed(record, chosen) for record in records]
    return tuple(name for name in chosen if not all(name in of for of in computed))


def _computed(record: Record, names: Sequence[str]) -> set[str]:
    """Signals that were made of others among these: their noise is the others', sample by sample.

    They tell nothing new, and compared as if they did would have noise that hangs together in time.
    """
    sources = {name: record.noise.sensors(name) for name in names}
    sensed = {n for n in names if n in sources[n]}
    return {n for n in names if n not in sensed and sources[n] and sources[n] <= sensed}


def _method(
    system: AbstractSystem,
    recorded: Sequence[Recorded],
    along: Sequence[Along],
    told: bool,
    asked: AbstractMethod | None,
) -> tuple[AbstractMethod, States | None]:
    """The method that was asked for, or steps for the fastest motion of all recordings, which are
    `told` all states, or not.

    **Returns:** the method; the first recording's motion, simulated, if it has states that no
    recording tells.
    """
    free = asked is None and is_concrete(system, recorded)
    steps = _steps(system, recorded, along) if free else 1
    method = FixedStep(steps) if free else asked or FixedStep()
    if told:
        return method, None
    simulated, kept = _trajectories(system, recorded, method)
    while free and steps < MOST_STEPS and not all(kept):
        steps = min(4 * steps, MOST_STEPS)
        simulated, kept = _trajectories(system, recorded, FixedStep(steps))
    if not free or not all(kept):
        return method, simulated[0]
    along = []
    for states, part in zip(simulated, recorded):
        # Of the samples within all windows: what lies behind may run away.
        places = np.nonzero(np.asarray(within(part.length, states.shape[1])))
        at = tuple(place[spread_points(place.size)] for place in places)
        along.append((np.asarray(states)[at], np.asarray(part.levels)[at]))
    return FixedStep(max(steps, _steps(system, recorded, along))), simulated[0]


def _steps(system: AbstractSystem, recorded: Sequence[Recorded], along: Sequence[Along]) -> int:
    return max(
        suitable_steps(system, states, levels, float(part.time_step))
        for part, (states, levels) in zip(recorded, along)
    )


@kept_jit
def _trajectories(
    system: AbstractSystem, recorded: Sequence[Recorded], method: AbstractMethod
) -> tuple[list[States], list[Bool[Array, ""]]]:
    """Of each window of each recording, and whether all kept their solution."""
    runs = [
        over_windows(lambda first, own: own.trajectory(method, system, first), part.initial, part)
        for part in recorded
    ]
    return [states for states, _ in runs], [jnp.all(kept) for _, kept in runs]


@kept_jit
def _scales(
    recorded: Sequence[Recorded],
    sigma: dict[str, Any],
    channels: tuple[str, ...],
    estimated: tuple[int, ...],
    squares: Float[Array, " states"],
    simulated: tuple[tuple[str, ...], States] | None,
) -> tuple[Float[Array, " channels"], Float[Array, " channels"], Float[Array, " s"]]:
    """What channels are weighed by, their standard deviations, and the size of estimated states.

    **Arguments:** `squares` of the states over the first recording, and that motion as simulated
    with the source of each state.
    """

    def mean(of: Callable[[Array], Array]) -> Array:
        held = (jnp.where(part.present, of(part.measured), 0.0) for part in recorded)
        return sum(jnp.sum(values, axis=(0, 1)) for values in held) / _counts(recorded)

    # Of each channel over all that is compared.
    centre = mean(lambda measured: measured)
    variance = mean(lambda measured: (measured - centre[None, None, :]) ** 2)
    deviation = jnp.where(variance > 0, jnp.sqrt(jnp.where(variance > 0, variance, 1.0)), 1.0)
    chosen = [sigma.get(name, deviation[i]) for i, name in enumerate(channels)]
    weights = jnp.stack([jnp.asarray(each, deviation.dtype) for each in chosen])
    # Root mean square of each state: recorded, else simulated; 1 of one that rests.
    if simulated is not None:
        sources, states = simulated
        inside = within(recorded[0].length, states.shape[1])
        motion = jnp.sum(jnp.where(inside[..., None], states, 0.0) ** 2, axis=(0, 1))
        told = np.array([source != "zero" for source in sources])
        squares = jnp.where(told, squares, motion / jnp.sum(recorded[0].length))
    usable = jnp.isfinite(squares) & (squares > 0)
    scale = jnp.sqrt(jnp.where(usable, jnp.where(usable, squares, 1.0), 1.0))
    return weights, deviation, scale[np.array(estimated, int)]


def _counts(recorded: Sequence[Recorded]) -> Float[Array, " channels"]:
    """Of each channel, how many samples are compared, 1 at the least."""
    counts = [jnp.sum(part.present, axis=(0, 1)) for part in recorded]
    return jnp.maximum(sum(counts), 1)


def noise_levels(records: Sequence[Record], channels: Sequence[str]) -> Float[Leaf, " channels"]:
    """Standard deviation of each channel's noise over all records, as they or their samples tell
    it."""
    known = [judged(record, "auto", *channels).noise for record in records]
    levels = [[noise.std(name) for name in channels] for noise in known]
    xp = namespace(levels)
    return xp.sqrt(xp.mean(xp.square(xp.asarray(levels, float)), axis=0))
