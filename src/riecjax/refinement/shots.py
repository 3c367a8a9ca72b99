"""Windows of a recording over which a model is simulated, and what was recorded in each.

How long they are decides what is fitted. Of one time step, the state being measured anew at every
sample, they make a fit of the equation error: nearly linear, and biased where the state is noisy.
Of the whole record they make single shooting, the output-error fit: efficient where the model is
right and noise is on the outputs, but what a wrong parameter does to the state adds up along the
window, exponentially where motion is unstable, and with it the curvature of the sum of squares.
Windows between the two (multiple shooting) bound that by their length, at the price of initial
states to estimate.
"""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int, Key

from riecjax.criteria.windows import RandomWindows
from riecjax.errors import DataError, ModelError
from riecjax.leaves import Leaf, is_concrete
from riecjax.records.record import Record, shared_length

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
