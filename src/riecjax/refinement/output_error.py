"""Output-error refinement: the model simulated over windows, and compared with the recording.

**Windows.** How long they are decides what is fitted. Of one time step, the state being measured
anew at every sample, they make a fit of the equation error: nearly linear, and biased where the
state is noisy. Of the whole record they make single shooting, the output-error fit: efficient where
the model is right and noise is on the outputs, but what a wrong parameter does to the state adds up
along the window, exponentially where motion is unstable, and with it the curvature of the sum of
squares. Windows between the two (multiple shooting) bound that by their length, at the price of
initial states to estimate.

Windows are filled up behind their end, with its inputs, to lengths that others share, so that the
next recording, of another length, is simulated by what is compiled already. What is simulated there
is not compared, and may diverge.

**Residuals.** Of a window they are r = (y(theta, s) - measured) / sigma at every compared sample of
every channel, y simulated from the initial state s. Their derivatives are those of the simulation:
along each unit vector of (theta, s) the variational equation is stepped with the state, by forward
differentiation of the very steps. That is the exact derivative of what is computed, takes p + s
simulations beside the one, and keeps no step in memory for later. Reverse mode would take one pass
for each residual, of which there are thousands.

**Huber's loss** grows with a residual's square up to a threshold and straight on past it. With the
threshold c, rho(r) = r^2 / 2 up to c and c |r| - c^2 / 2 past it. What searches for least squares
makes it small as the square of f(r) = sign(r) sqrt(2 rho(r)), whose slope is continuous. f f' is
the score psi(r), r cut off at c, so the gradient is the loss's own; f'^2 > 0 past c keeps steps
defined, and is more than the curvature psi' = 0 there. A sandwich takes psi' instead, or its
standard errors were too small: by a fifth of a normal law at c = 1.345.
"""

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from diffrax import BacksolveAdjoint, RecursiveCheckpointAdjoint
from jaxtyping import Float, Int, Key

from riecjax import arrays as xp
from riecjax.arrays import Array
from riecjax.criteria.criterion import SHORT_BLOCKS_OF_ROWS
from riecjax.errors import DataError, ModelError, require
from riecjax.estimation.parameters import ParameterTable
from riecjax.leaves import Leaf, is_number
from riecjax.records.noise_judgement import judged
from riecjax.records.record import Record, shared_length
from riecjax.refinement.objective import (
    AbstractObjective,
    AbstractResiduals,
    ByFunction,
    Energies,
    Expansion,
    Initial,
    Simulated,
    Theta,
    as_parametric_system,
    without_initial,
)
from riecjax.simulation.intersample import Intersample, bends_of, require_intersample, smooth_inputs
from riecjax.simulation.linearisation import (
    FEWEST_SAMPLES,
    MOST_STEPS,
    suitable_steps,
)
from riecjax.simulation.method import AbstractMethod, FixedStep
from riecjax.simulation.simulate import signals_of
from riecjax.simulation.system import (
    AbstractSystem,
    compared_signals,
    input_levels,
    measured_states,
)
from riecjax.summaries.normal_equations import NormalEquations, ShortBlocks, stack_normal_equations

SHORTEST = 2
"""Samples of a window below which it tells nothing."""


class WholeRecord(eqx.Module):
    """Each unbroken stretch of a recording at once: single shooting, the output-error fit."""

    def longest(self, record: Record) -> int:
        """How many samples a window has at most.

        **Raises:** `ModelError` where that depends on a time step that is being traced.
        """
        return record.sample_count

    def describe(self) -> dict[str, object]:
        """Name and settings, for tables and JSON."""
        return {"windows": "whole record"}

    def shots(
        self, record: Record, inputs: Sequence[str], *, joined: bool = False
    ) -> tuple[Int[np.ndarray, "windows longest"], Int[np.ndarray, " windows"]]:
        """The windows of one recording, unbroken in its inputs; the last of a stretch may be
        shorter.

        **Returns:** index of each sample of each window, the last one again beyond its length; and
        these lengths.

        With `joined`, a window begins on the sample at which its neighbour ends; a start that is
        estimated must not, for that sample would count twice.

        **Raises:** `DataError` if the record has no such window.
        """
        longest, count = self.longest(record), record.sample_count
        if xp.is_concrete(record):
            stretches = [(part.start, part.stop) for part in record.segments(inputs)]
        elif record.present(inputs) is None:
            stretches = [(0, count)]
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
                f"no unbroken stretch of {SHORTEST} samples is left in which {', '.join(inputs)} "
                f"are recorded."
            )
        starts, lengths = np.array(first, np.int32).T
        simulated = int(lengths.max())
        # Whole stretches are of any lengths, and are simulated over one that others share.
        steps = np.arange(simulated if longest < count else shared_length(simulated))
        return starts[:, None] + np.minimum(steps[None, :], lengths[:, None] - 1), lengths


class Tiles(WholeRecord):
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
        length = self.samples if self.seconds is None else self.seconds
        if length is not None and length <= 0:
            raise ModelError("tiles need a positive length.")

    def longest(self, record: Record) -> int:
        """One sample more than there are steps."""
        if self.samples is not None:
            return self.samples + 1
        if not xp.is_concrete(record.time_step):
            raise ModelError(
                "the number of samples of a window must be known before tracing: give "
                "Tiles(samples=...) or keep the record's time step out of jit and vmap."
            )
        return max(round(float(self.seconds or 0.0) / float(record.time_step)), 1) + 1

    def describe(self) -> dict[str, object]:
        """Name and length."""
        return {"windows": "tiles", "seconds": self.seconds, "samples": self.samples}


class Recorded(eqx.Module):
    """What is simulated and compared of one recording.

    **Fields:**

    - `levels`: inputs in each window, shape `(windows, longest, inputs)`; `bends`, their curvature
      by time steps, zero or `None` where they are straight lines between samples.
    - `measured`: the channels at every sample, `(windows, longest, channels)`.
    - `present`: which of these count.
    - `initial`: initial state of each window as it was recorded, `(windows, states)`.
    - `position`: sample at which each one stands in the record, `(windows, longest)`.
    - `length` of each window in samples, `(windows,)`.
    - `time_step` in seconds; `sample_count` of the record.
    - `short_blocks` of time that hold it, of `short` samples; `piece`, samples of a piece of time.
    """

    levels: Float[Array, "windows longest inputs"]
    bends: Float[Array, "windows longest inputs"] | None
    measured: Float[Array, "windows longest channels"]
    present: Array
    initial: Float[Array, "windows states"]
    position: Int[Array, "windows longest"]
    length: Int[Array, " windows"]
    time_step: Float[Array, ""]
    sample_count: Int[Array, ""]
    short: int = eqx.field(static=True)
    short_blocks: int = eqx.field(static=True)
    piece: int = eqx.field(static=True)


THRESHOLD = 1.345
"""Standard deviations of the noise: 95 % as precise as squares where all of it is normal."""
LEAST_NOISE = 1e-3
"""Share of a channel's standard deviation that its noise is taken for at the least."""

LONGER = 8
"""Times by which segments grow, from those that any start predicts to the whole record: each length
is compiled anew, and a start that is right to a radian over one is so over the next once fitted."""

Threshold: TypeAlias = Float[Array, "1 channels"] | None
"""Past which a channel's loss is straight, in units of its residuals; `None` where nowhere."""


def loss_columns(
    level: Float[Array, "*n channels"],
    slopes: Float[Array, "*n channels columns"],
    threshold: Threshold,
    curved: Any,
) -> tuple[Array, Array]:
    """Of residuals and their slopes, two sets of columns whose products are moments from the
    diagonal up: f^2, psi times slopes, and slopes times each other and f'^2, or psi' if `curved`.
    """
    if threshold is None:
        columns = jnp.concatenate([level[..., None], slopes], axis=-1)
        return columns, columns
    score, size = jnp.clip(level, -threshold, threshold), jnp.abs(level)
    inside = size <= threshold
    energy = jnp.where(inside, size**2, threshold * (2 * size - threshold))
    beyond = jnp.where(curved, 0.0, score**2 / jnp.where(inside, 1.0, energy))
    weight = jnp.where(inside, 1.0, beyond)
    left = jnp.concatenate([score[..., None], weight[..., None] * slopes], axis=-1)
    energy = energy / jnp.where(score == 0, 1.0, score)
    return left, jnp.concatenate([energy[..., None], slopes], axis=-1)


class OutputResiduals(AbstractResiduals):
    """Simulated minus recorded channels, in units of `sigma`, over all windows of all records.

    `labels` are the channels; `estimated`, the places of the states whose initial values are
    estimated; `threshold` of Huber's loss by channel, in units of sigma, `None` for squares.
    """

    system: ByFunction
    recorded: list[Recorded]
    sigma: Float[Array, " channels"]
    threshold: Threshold
    estimated: tuple[int, ...] = eqx.field(static=True)

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

    def expansion(self, theta: Theta, initial: Initial) -> Expansion:
        """Of each window of each record, in pieces of time."""

        def of_window(initial: Array, window: Recorded, index: int) -> tuple[Any, ...]:
            # Residuals, and their derivatives by parameters and initial states.
            p = theta.shape[0]
            unknown = jnp.concatenate([theta, initial])

            def along(direction: Array) -> tuple[Array, Array]:
                def error(u: Array) -> Array:
                    return self._error(u[:p], u[p:], window, index)

                return jax.jvp(error, (unknown,), (direction,))

            directions = jnp.eye(unknown.shape[0], dtype=unknown.dtype)
            level, slopes = jax.vmap(along, out_axes=(None, 2))(directions)
            left, right = loss_columns(level, slopes, self.threshold, self.curved)
            cut, other = _in_pieces(left, window.piece), _in_pieces(right, window.piece)
            moments = jnp.einsum("prci,prcj->pij", cut, cut if left is right else other)
            if left is not right:
                moments = jnp.triu(moments) + jnp.swapaxes(jnp.triu(moments, 1), 1, 2)
            energy = jnp.sum(left[..., 0] * right[..., 0], axis=0)
            return moments, energy, Simulated(level, slopes[..., p:])

        edges = np.cumsum([len(part.length) for part in self.recorded])[:-1]
        of_records = []
        for index, (part, own) in enumerate(zip(self.recorded, jnp.split(initial, edges))):
            axes = jax.tree.map(lambda leaf: 0 if jnp.ndim(leaf) else None, part)
            of_one = functools.partial(of_window, index=index)
            of_records.append(jax.vmap(of_one, in_axes=(0, axes))(own, part))
        pieces, squares, simulated = zip(*of_records)
        zero = jnp.zeros(len(self.labels), theta.dtype)
        energy = sum((jnp.sum(s, axis=0) for s in squares), start=zero)
        return Expansion(list(pieces), energy, simulated)

    def rms(self, energy: Energies) -> Energies:
        """Of simulated minus recorded."""
        return self.sigma * xp.sqrt(energy / self.counts)

    @property
    def counts(self) -> Float[Array, " channels"]:
        """Of each channel, how many samples are compared, 1 at the least."""
        return _counts(self.recorded)

    def independent_rows(self) -> Float[Array, ""]:
        """All that are compared."""
        return xp.asarray(sum(xp.sum(part.present) for part in self.recorded), float)

    def blocks(self, expansion: Expansion) -> tuple[NormalEquations, ShortBlocks]:
        """By blocks of time."""
        p = len(self.table.free)
        parts, numbers, seconds = [], [], []
        for part, pieces in zip(self.recorded, expansion.pieces):
            samples, most = part.short, part.short_blocks
            number = xp.clip(-(-part.sample_count // samples), 2, most)
            moments = without_initial(pieces, p)
            position = part.position[:, :: part.piece]
            index = xp.minimum(position // samples, number - 1).reshape(-1)
            held = xp.stack([_in_pieces(one, part.piece).sum(axis=(1, 2)) for one in part.present])
            flat, held = moments.reshape(-1, *moments.shape[2:]), held.reshape(-1)
            flat, held = (xp.sum_by_block(v, index, most) for v in (flat, held))
            parts.append(NormalEquations(flat, held.astype(flat.dtype), self.table.free))
            numbers.append(number)
            seconds.append(samples * part.time_step)
        return stack_normal_equations(parts), ShortBlocks(xp.stack(numbers), xp.stack(seconds))

    def _error(
        self, theta: Theta, initial: Float[Array, " s"], window: Recorded, index: int
    ) -> Float[Array, "longest channels"]:
        """Of one window of record number `index`."""
        system = self.system.build(self.table.values_at(theta, index))
        first = window.initial.at[np.array(self.estimated, int)].set(initial)
        # A method of one's own need not know of bends that are not asked for.
        bends = () if window.bends is None else (window.bends,)
        driven = system, window.levels, window.time_step
        states, _, reached = self.method.trajectory(*driven, first, *bends)
        made = signals_of(system, states, window.levels, self.labels)
        simulated = jnp.stack(list(made.values()), axis=-1)
        # What a lost simulation shows after its loss must not pass for an answer; what is simulated
        # behind the window's end counts for nothing.
        simulated = jnp.where(reached >= window.length, simulated, jnp.inf)
        scaled = (simulated - window.measured) / self.sigma[None, :]
        return jnp.where(window.present, scaled, 0.0)


def _in_pieces(values: Array, length: int) -> Array:
    """The first axis cut into pieces of a length, the last one filled up with zeros."""
    count = -(-values.shape[0] // length)
    pad = [(0, count * length - values.shape[0])] + [(0, 0)] * (values.ndim - 1)
    return xp.pad(values, pad).reshape(count, length, *values.shape[1:])


class OutputError(AbstractObjective):
    """Simulated minus recorded signals, over windows from one sample to the whole record.

    Over one time step this is a fit of the equation error, over windows multiple shooting, over the
    whole record the output-error fit: one code. Short windows forgive a poor start and what the
    model leaves out; long ones tell most where the model is right and the sensors are noisy.

    **Arguments:**

    - `shooting`: [`WholeRecord`][] or [`Tiles`][]. Where the search over whole records is lost,
      they are reached by way of ever longer tiles, as far as these leave no more than noise: a
      motion that nothing predicts for long, as a hardening spring's may be, is fitted over the
      longest that do.
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
    """

    shooting: WholeRecord = eqx.field(default_factory=WholeRecord)
    channels: tuple[str, ...] | None = eqx.field(static=True, default=None)
    sigma: Mapping[str, float | Array] | None = None
    initial_states: Literal["estimated", "measured"] | Mapping[str, float | Array] = "estimated"
    method: AbstractMethod | None = None
    intersample: Intersample = "smooth"
    loss: Literal["squares", "huber"] = eqx.field(static=True, default="squares")

    def __check_init__(self):
        write = "rx.OutputError(rx.refinement.Tiles(0.5)), or without windows rx.OutputError()"
        require("what OutputError simulates over", self.shooting, WholeRecord, write)
        require("the method", self.method or FixedStep(), AbstractMethod, "method=rx.FixedStep(8)")
        write = "initial_states='estimated', 'measured' or values by name such as {'x': 0.0}"
        require("initial states", self.initial_states, (str, Mapping), write)
        write = f"channels=('{self.channels}',): a tuple of names"
        require("channels", self.channels or (), (tuple, list), write)
        words, given = ("estimated", "measured"), self.initial_states
        if isinstance(given, str) and given not in words:
            raise ModelError(
                f"initial_states are 'estimated', 'measured' or values by name; got '{given}'."
            )
        require_intersample(self.intersample)
        if self.loss not in ("squares", "huber"):
            raise ModelError(f"the loss is 'squares' or 'huber'; got {self.loss!r}.")
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
        channels = compared_signals(system, records, self.channels)
        if self.channels is None:
            computed = [_computed(record, channels) for record in records]
            channels = tuple(n for n in channels if not all(n in each for each in computed))
        for name, value in (self.sigma or {}).items():
            if name not in channels:
                raise ModelError(
                    f"sigma is given for '{name}', which is not compared; compared are: "
                    f"{', '.join(channels)}."
                )
            if not is_number(value) or (xp.is_concrete(value) and not 0 < float(value) < np.inf):
                raise ModelError(
                    f"sigma of {name} is {value!r}: a standard deviation is a positive number, in "
                    f"the unit of {name}."
                )
        system.require_states(self._given)
        fixed = {*self._given}
        if self.initial_states == "measured":
            recorded_in = [record.arrays for record in records]
            fixed = {n for n in system.state_names if all(n in arrays for arrays in recorded_in)}
        # Places of the states whose initial values are estimated.
        estimated = tuple(i for i, name in enumerate(system.state_names) if name not in fixed)
        recorded = [self._recorded(system, record, channels, not estimated) for record in records]
        units = dict(system.states) | dict(system.outputs)
        sigma, deviation = _scales(recorded, dict(self.sigma or {}), channels)
        places = np.array(estimated, int)
        threshold = None
        if self.loss == "huber":
            noise = noise_levels(records, channels)
            threshold = THRESHOLD * (xp.maximum(noise, LEAST_NOISE * deviation) / sigma)[None, :]
        residuals = OutputResiduals(
            system=model,
            recorded=recorded,
            table=table,
            start=start,
            sigma=sigma,
            initial=xp.concatenate([part.initial[:, places] for part in recorded]),
            method=self.method or FixedStep(),
            threshold=threshold,
            curved=None if threshold is None else np.asarray(False),
            labels=channels,
            units=tuple(units.get(name, "") for name in channels),
            initial_state_names=tuple(system.state_names[i] for i in estimated),
            estimated=estimated,
            most_steps=MOST_STEPS if self.method is None else 0,
        )
        if self.method is not None or not xp.is_concrete(residuals):
            return residuals
        steps = max(
            suitable_steps(
                system,
                measured_states(system, record),
                input_levels(system, record),
                float(record.time_step),
            )
            for record in records
        )
        return dataclasses.replace(residuals, method=FixedStep(steps))

    @property
    def _given(self) -> Mapping[str, float | Array]:
        """Values of initial states that are known."""
        return self.initial_states if isinstance(self.initial_states, Mapping) else {}

    def _recorded(
        self, system: AbstractSystem, record: Record, channels: tuple[str, ...], joined: bool
    ) -> Recorded:
        """What a recording holds in its windows, `joined` as of its `shots`."""
        # A missing sample of an input breaks the motion; of a free motion, one of any signal.
        unbroken = system.input_names or tuple(record.arrays)
        windows, lengths = self.shooting.shots(record, unbroken, joined=joined)
        n, inputs = record.sample_count, input_levels(system, record)
        initial = measured_states(system, record, self._given)[windows[:, 0]]
        # An initial state that is taken from the record leaves no error there.
        inside = np.arange(windows.shape[1])[None, :] < lengths[:, None]
        inside[:, 0] &= not joined
        masks = (record.present((name,)) for name in channels)
        present = [inside if mask is None else inside & mask[windows] for mask in masks]
        # As many for all lengths that share what is compiled.
        shared = shared_length(n)
        short = -(-shared // SHORT_BLOCKS_OF_ROWS)
        smooth, bends = smooth_inputs(self.intersample, system.input_names), None
        # By a method that is chosen here, lines are bent by zero: what is compiled serves both.
        if any(smooth) or (smooth and self.method is None):
            # Of the whole record: a window's neighbours tell what its inputs do at its ends.
            bends = bends_of(inputs, record.present(system.input_names), smooth)[windows]
        return Recorded(
            inputs[windows],
            bends,
            xp.stack([record[name][windows] for name in channels], axis=-1),
            xp.stack(present, axis=-1),
            initial,
            windows,
            lengths,
            record.time_step,
            np.asarray(n),
            short,
            max(-(-shared // short), 2),
            min(short, windows.shape[1]),
        )

    def by_segments(self, record: Record) -> "list[OutputError]":
        """Over tiles from few samples on, each time `LONGER` as long, and whole records; none where
        it is not over whole records from estimated states."""
        if isinstance(self.shooting, Tiles) or self.initial_states != "estimated":
            return []
        samples, tiles = record.sample_count // LONGER, []
        while samples >= FEWEST_SAMPLES:
            tiles.append(dataclasses.replace(self, shooting=Tiles(samples=samples)))
            samples //= LONGER
        return [*tiles[::-1], self] if tiles else []

    def describe(self) -> dict[str, object]:
        """Name and settings."""
        initial = self.initial_states if isinstance(self.initial_states, str) else "partly known"
        loss: dict[str, object] = {} if self.loss == "squares" else {"loss": self.loss}
        shooting = self.shooting.describe()
        return {"refine": "output-error", **shooting, "starts": initial, **loss}


def _computed(record: Record, names: Sequence[str]) -> set[str]:
    """Signals that were made of others among these: their noise is the others', sample by sample.

    They tell nothing new, and compared as if they did would have noise that hangs together in time.
    """
    sources = {name: record.noise.sensors(name) for name in names}
    sensed = {n for n in names if n in sources[n]}
    return {n for n in names if n not in sensed and sources[n] and sources[n] <= sensed}


def _scales(
    recorded: Sequence[Recorded],
    sigma: dict[str, Any],
    channels: tuple[str, ...],
) -> tuple[Float[Array, " channels"], Float[Array, " channels"]]:
    """What channels are weighed by, and their standard deviations."""

    def mean(of: Callable[[Array], Array]) -> Array:
        held = (xp.where(part.present, of(part.measured), 0.0) for part in recorded)
        return sum(xp.sum(values, axis=(0, 1)) for values in held) / _counts(recorded)

    # Of each channel over all that is compared.
    centre = mean(lambda measured: measured)
    variance = mean(lambda measured: (measured - centre[None, None, :]) ** 2)
    deviation = xp.where(variance > 0, xp.sqrt(xp.where(variance > 0, variance, 1.0)), 1.0)
    chosen = [sigma.get(name, deviation[i]) for i, name in enumerate(channels)]
    weights = xp.stack([xp.asarray(each, deviation.dtype) for each in chosen])
    return weights, deviation


def _counts(recorded: Sequence[Recorded]) -> Float[Array, " channels"]:
    """Of each channel, how many samples are compared, 1 at the least."""
    counts = [xp.sum(part.present, axis=(0, 1)) for part in recorded]
    return xp.maximum(sum(counts), 1)


def noise_levels(records: Sequence[Record], channels: Sequence[str]) -> Float[Leaf, " channels"]:
    """Standard deviation of each channel's noise over all records, as they or their samples tell
    it."""
    known = [judged(record, "auto", *channels).noise for record in records]
    levels = [[noise.std(name) for name in channels] for noise in known]
    return xp.sqrt(xp.mean(xp.square(xp.asarray(levels, float)), axis=0))
