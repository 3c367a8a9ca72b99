"""One signal: its samples, which of them are present, its unit, and what is known of its noise.

What linear operations make of signals is arithmetic: a sum is present where all its signals are,
and its noise is the sum of theirs, source by source.
"""

import dataclasses
import numbers
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool, Float
from numpy.typing import ArrayLike

from riecjax.leaves import Leaf, namespace
from riecjax.records.noise import SignalNoise


def _array(values: Any) -> Any:
    return values if values is None or isinstance(values, jax.Array) else np.asarray(values)


class Signal(eqx.Module):
    """Samples of one signal, as a [`Record`][riecjax.Record] holds them.

    A sample that is missing (a NaN in the file, a pause of the logger) holds the last value before
    it, so that every array is finite.

    **Fields:**

    - `values`: the samples, shape `(n,)`; of a batch, with its axes in front.
    - `present`: a mask, False where a sample is missing; `None` where none is.
    - `unit`: its unit, empty where it is not known.
    - `noise`: what is known of its noise; `None` where nothing is.
    """

    # NumPy's numbers and arrays leave arithmetic with signals to these.
    __array_ufunc__ = None

    values: Float[Leaf, "*batch n"]
    present: Bool[Leaf, "... n"] | None
    unit: str = eqx.field(static=True)
    noise: SignalNoise | None

    def __init__(
        self,
        values: ArrayLike | Array,
        present: ArrayLike | Array | None = None,
        unit: str = "",
        noise: SignalNoise | None = None,
    ):
        self.values, self.present = _array(values), _array(present)
        self.unit, self.noise = unit, noise

    @classmethod
    def of(
        cls, samples: ArrayLike | Array, unit: str = "", noise: SignalNoise | None = None
    ) -> "Signal":
        """A signal of samples that are NaN where they are missing."""
        samples = _array(samples)
        xp = namespace(samples)
        present = ~xp.isnan(samples)
        if xp is np and present.all():
            return cls(samples, None, unit, noise)
        return cls(_held(samples, present), present, unit, noise)

    @property
    def with_nan(self) -> Float[np.ndarray, "*batch n"]:
        """The samples, NaN where they are missing."""
        values = np.array(self.values, float)
        if self.present is not None:
            values[~np.asarray(self.present)] = np.nan
        return values

    def with_samples(self, samples: ArrayLike | Array) -> "Signal":
        """Other samples, NaN where they are missing, of the same unit and noise."""
        return Signal.of(samples, self.unit, self.noise)

    def through_taps(self, taps: Float[np.ndarray, " taps"]) -> SignalNoise | None:
        """What is known of its noise behind a filter of an odd number of taps, the middle one for
        the same sample."""
        return None if self.noise is None else self.noise.convolved(taps)

    def __mul__(self, factor: Any) -> "Signal":
        noise = None if self.noise is None else factor * self.noise
        return dataclasses.replace(self, values=factor * self._array, noise=noise)

    __rmul__ = __mul__

    def __neg__(self) -> "Signal":
        return -1.0 * self

    def __add__(self, other: Any) -> "Signal":
        if not isinstance(other, Signal):
            if isinstance(other, numbers.Number) and other == 0:  # where `sum` begins
                return self
            total = _held(self._array + _array(other), self.present)
            return dataclasses.replace(self, values=total)
        # Nothing known of one, nothing known of the sum.
        noise = None
        if self.noise is not None and other.noise is not None:
            noise = self.noise + other.noise
        unit = self.unit if self.unit == other.unit else ""
        total, present = self._array + other._array, both(self.present, other.present)
        return Signal(_held(total, present), present, unit, noise)

    __radd__ = __add__

    def __sub__(self, other: Any) -> "Signal":
        return self + -1.0 * other

    @property
    def _array(self) -> Any:
        """The samples for arithmetic: JAX would compile it for each length."""
        return namespace(self.values).asarray(self.values)


def both(one: Leaf | None, other: Leaf | None) -> Leaf | None:
    """Where both masks are True; `None` is everywhere."""
    if one is None or other is None:
        return other if one is None else one
    return namespace(one, other).logical_and(one, other)


def _held(values: Any, present: Any) -> Any:
    """Samples that are not present replaced by the last before them, at the start by the first
    after, else by 0."""
    if present is None:
        return values
    xp = namespace(values, present)
    places = xp.where(present, xp.arange(values.shape[-1]), -1)
    last = (
        np.maximum.accumulate(places, axis=-1)
        if xp is np
        else jax.lax.cummax(places, axis=places.ndim - 1)
    )
    first = xp.argmax(present, axis=-1)[..., None]
    held = xp.take_along_axis(values, xp.where(last < 0, first, last), axis=-1)
    return xp.where(xp.any(present, axis=-1)[..., None], held, 0.0)
