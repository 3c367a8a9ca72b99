"""One signal: its samples, which of them are present, its unit, and what is known of its noise.

What linear operations make of signals is arithmetic: a sum is present where all its signals are,
and its noise is the sum of theirs, source by source.
"""

import dataclasses
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Bool, Float
from numpy.typing import ArrayLike

from riecjax.leaves import Leaf, namespace
from riecjax.records.noise import SignalNoise


# A record has hundreds of them, which JAX takes apart faster than Equinox's modules.
@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Signal:
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
    present: Bool[Leaf, "... n"] | None = None
    unit: str = dataclasses.field(default="", metadata={"static": True})
    noise: SignalNoise | None = None

    @classmethod
    def of(
        cls, samples: ArrayLike | Array, unit: str = "", noise: SignalNoise | None = None
    ) -> "Signal":
        """A signal of samples that are NaN where they are missing."""
        xp = namespace(samples)
        values = xp.asarray(samples)
        present = ~xp.isnan(values)
        if xp is np and present.all():
            return cls(values, None, unit, noise)
        return cls(_held(values, present), present, unit, noise)

    @property
    def with_nan(self) -> Any:
        """The samples, shape `(n,)`, NaN where they are missing; of NumPy unless traced."""
        xp = namespace(self.values, self.present)
        values = xp.array(self.values, float)
        return values if self.present is None else xp.where(self.present, values, np.nan)

    def __mul__(self, factor: Any) -> "Signal":
        noise = self.noise and factor * self.noise
        return dataclasses.replace(self, values=factor * self._array, noise=noise)

    __rmul__ = __mul__

    def __neg__(self) -> "Signal":
        return -1.0 * self

    def __add__(self, other: Any) -> "Signal":
        if not isinstance(other, Signal):
            return dataclasses.replace(self, values=_held(self._array + other, self.present))
        # Nothing known of one, nothing known of the sum.
        noise = self.noise and other.noise and self.noise + other.noise
        unit = self.unit if self.unit == other.unit else ""
        total, present = self._array + other._array, both(self.present, other.present)
        return Signal(_held(total, present), present, unit, noise)

    __radd__ = __add__

    def __sub__(self, other: Any) -> "Signal":
        return self + -1.0 * other

    def __rsub__(self, other: Any) -> "Signal":
        return -self + other

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
