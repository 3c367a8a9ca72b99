"""Windows of a recording over which a model is simulated, and what was recorded in each.

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
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key

from riecjax.compilation import kept_jit
from riecjax.criteria.criterion import SHORT_BLOCKS_OF_ROWS
from riecjax.criteria.windows import RandomWindows
from riecjax.errors import DataError, ModelError
from riecjax.leaves import Leaf, is_concrete
from riecjax.records.record import Record, filled_up, shared_length
from riecjax.simulation.intersample import bends_of
from riecjax.simulation.linearisation import spread_points
from riecjax.simulation.method import AbstractMethod
from riecjax.simulation.system import AbstractSystem, measured_states

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

    @property
    def inside(self) -> Array:
        """Which of these lie within the window's length."""
        return within(self.length, self.longest)


def within(length: Int[Leaf, " windows"], longest: int) -> Bool[Array, "windows longest"]:
    """Which of so many samples lie within the length of each window."""
    return jnp.arange(longest)[None, :] < jnp.asarray(length)[:, None]


class AbstractShooting(eqx.Module):
    """How a recording is cut into windows to simulate."""

    @property
    def needs_key(self) -> bool:
        """Whether windows are drawn at random."""
        return False

    @property
    def overlap(self) -> bool:
        """Whether windows may share samples."""
        return False

    def shots(
        self, record: Record, inputs: Sequence[str], key: Key[Array, ""] | None, *, joined: bool
    ) -> Shots:
        """The windows of one recording, unbroken in its inputs.

        With `joined`, a window begins on the sample at which its neighbour ends; a start that is
        estimated must not, for that sample would count twice.

        **Raises:** `DataError` if the record has no such window; `ModelError` where a length
        depends on a time step that is being traced.
        """
        raise NotImplementedError

    def describe(self) -> dict[str, object]:
        """Name and settings, for tables and JSON."""
        raise NotImplementedError


class WholeRecord(AbstractShooting):
    """Each unbroken stretch of a recording at once: single shooting, the output-error fit."""

    def shots(
        self,
        record: Record,
        inputs: Sequence[str],
        key: Key[Array, ""] | None = None,
        *,
        joined: bool = False,
    ) -> Shots:
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

    def shots(
        self,
        record: Record,
        inputs: Sequence[str],
        key: Key[Array, ""] | None = None,
        *,
        joined: bool = False,
    ) -> Shots:
        """Tiles of each unbroken stretch; the last of a stretch may be shorter."""
        if self.samples is not None:
            return _tiles(record, inputs, self.samples + 1, joined)
        steps = max(round(float(self.seconds or 0.0) / _seconds_of_a_sample(record)), 1)
        return _tiles(record, inputs, steps + 1, joined)

    def describe(self) -> dict[str, object]:
        """Name and length."""
        return {"windows": "tiles", "seconds": self.seconds, "samples": self.samples}


class RandomShots(AbstractShooting):
    """Windows of random start and length: randomised multiple shooting.

    **Arguments:** `windows`, as the integral criterion draws them, on samples.
    """

    windows: RandomWindows

    @property
    def needs_key(self) -> bool:
        """True."""
        return True

    @property
    def overlap(self) -> bool:
        """True."""
        return True

    def shots(
        self,
        record: Record,
        inputs: Sequence[str],
        key: Key[Array, ""] | None,
        *,
        joined: bool = False,
    ) -> Shots:
        """The drawn windows; those that a gap breaks are emptied but for one sample."""
        if key is None:
            raise ModelError("random windows need a key: key=jax.random.key(seed).")
        if self.windows.between_samples:
            raise ModelError("a simulation starts on a sample (between_samples=False).")
        self.windows.check(record.sample_count, record.time_step)
        step = _seconds_of_a_sample(record)
        longest = min(round(float(self.windows.beta) / step) + 1, record.sample_count)
        drawn = self.windows.draw(key, record.sample_count, record.time_step)
        length = drawn.stop - drawn.start + 1
        present = record.present(inputs)
        if present is not None:
            absent = jnp.concatenate([jnp.zeros(1, jnp.int32), jnp.cumsum(~present)])
            unbroken = absent[drawn.stop + 1] == absent[drawn.start]
            length = jnp.where(unbroken, length, 1)
        return Shots(drawn.start, length, longest)

    def describe(self) -> dict[str, object]:
        """Name and settings."""
        return {"shooting": "random", **self.windows.describe()}


def _seconds_of_a_sample(record: Record) -> float:
    if not is_concrete(record.time_step):
        raise ModelError(
            "the number of samples of a window must be known before tracing: give "
            "Tiles(samples=...) or keep the record's time step out of jit and vmap."
        )
    return float(record.time_step)


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
    - `initial`: initial state of each window as it was recorded, `(windows, states)`; `square`,
      mean square of each state over the record.
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
    square: Float[Array, " states"]
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
    batched = eqx.tree_at(
        lambda r: (r.levels, r.bends, r.measured, r.present, r.initial, r.position, r.length),
        jax.tree.map(lambda _: None, part),
        (0, 0, 0, 0, 0, 0, 0),
        is_leaf=lambda leaf: leaf is None,
    )
    return jax.vmap(function, in_axes=(0, batched))(initial, part)


Along = tuple[Leaf, Leaf]
"""States and inputs at points along a recording."""


class Compared(NamedTuple):
    """What of the windows is compared, and how they begin.

    **Fields:** `channels` and `every`, of how many samples one, as of [`OutputError`][]; `given`,
    values of initial states; `joined` as of `AbstractShooting.shots`, and `overlap`; which inputs
    are `smooth`, `None` to keep no bends.
    """

    channels: tuple[str, ...]
    given: dict[str, Any]
    every: int
    joined: bool
    overlap: bool
    smooth: tuple[bool, ...] | None


def cut_records(
    system: AbstractSystem, records: Sequence[Record], shots: Sequence[Shots], compared: Compared
) -> tuple[list[Recorded], list[Along]]:
    """What each recording holds in its windows; states and inputs at points spread over them."""
    counts = [jnp.asarray(record.sample_count) for record in records]
    if is_concrete(records):
        records = [_filled(record) for record in records]
    return _cut(system, records, counts, shots, compared)


def _filled(record: Record) -> Record:
    """A record of a length that others share, with no sample behind its end."""
    filled = filled_up(record, shared_length(record.sample_count))
    behind = np.arange(filled.sample_count) >= record.sample_count
    missing = {name: filled.missing.get(name, False) | behind for name in filled.arrays}
    return Record(filled.arrays, filled.time_step, missing=missing)


@kept_jit
def _cut(
    system: AbstractSystem,
    records: Sequence[Record],
    counts: Sequence[Int[Array, ""]],
    shots: Sequence[Shots],
    compared: Compared,
) -> tuple[list[Recorded], list[Along]]:
    """The same of records that hold so many samples, and are filled up behind."""
    recorded, along = [], []
    for record, count, cut in zip(records, counts, shots):
        states = measured_states(system, record)
        recorded.append(_recorded(system, record, states, count, cut, compared))
        samples = cut.samples.reshape(-1)
        samples = samples[spread_points(samples.shape[0])]
        along.append((states[samples], _levels(system, record, samples)))
    return recorded, along


def _levels(system: AbstractSystem, record: Record, samples: Array) -> Float[Array, "*n inputs"]:
    inputs = [record[name][samples] for name in system.input_names]
    none = jnp.zeros((*samples.shape, 0), record.time_step.dtype)
    return jnp.stack(inputs, axis=-1) if inputs else none


def _bends(
    system: AbstractSystem, record: Record, samples: Array, smooth: tuple[bool, ...]
) -> Float[Array, "windows longest inputs"]:
    """Of the whole record: a window's neighbours tell what its inputs do at its ends."""
    everywhere = _levels(system, record, jnp.arange(record.sample_count))
    return bends_of(everywhere, record.present(system.input_names), smooth)[samples]


def _recorded(
    system: AbstractSystem,
    record: Record,
    states: Float[Array, "n states"],
    sample_count: Int[Array, ""],
    shots: Shots,
    compared: Compared,
) -> Recorded:
    channels, given, every, joined, overlap, smooth = compared
    position = shots.samples[:, ::every]
    held = jnp.arange(record.sample_count) < sample_count
    initial = states[shots.first]
    for name, value in given.items():
        place = system.state_names.index(name)
        initial = initial.at[:, place].set(jnp.asarray(value, initial.dtype))
    # An initial state that is taken from the record leaves no error there.
    counts = shots.inside[:, ::every] & (shots.length > 1)[:, None]
    counts = counts.at[:, 0].set(counts[:, 0] & (not joined))
    masks = (record.present((name,)) for name in channels)
    everywhere = jnp.ones(record.sample_count, bool)
    present = [(everywhere if mask is None else mask)[position] for mask in masks]
    # A window that overlaps others is one piece, by where it begins.
    count = position.shape[1]
    # As many as where the record is filled up, which under jit it is not.
    shared = shared_length(record.sample_count)
    short = -(-shared // SHORT_BLOCKS_OF_ROWS)
    return Recorded(
        _levels(system, record, shots.samples),
        None if smooth is None else _bends(system, record, shots.samples, smooth),
        jnp.stack([record[name][position] for name in channels], axis=-1),
        jnp.stack(present, axis=-1) & counts[:, :, None],
        initial,
        jnp.sum(jnp.where(held[:, None], states, 0.0) ** 2, axis=0) / sample_count,
        position,
        jnp.asarray(shots.length),
        record.time_step,
        sample_count,
        short,
        max(-(-shared // short), 2),
        every,
        count if overlap else min(max(short // every, 1), count),
    )
