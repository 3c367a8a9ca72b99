"""Common functions of the signals, for terms and masks.

Two of them that say the same compare equal, so that building an equation anew compiles nothing
anew, as a fresh `lambda` would.
"""

import functools
import operator
from dataclasses import dataclass

import jax.numpy as jnp
from jaxtyping import Array

from riecjax.records.record import Signals


def constant(signals: Signals) -> Array:
    """1 at every sample: `Term("offset", constant, unit="N")` is a constant force."""
    return jnp.ones(())


@dataclass(frozen=True)
class _Product:
    names: tuple[str, ...]

    def __call__(self, signals: Signals) -> Array:
        return functools.reduce(operator.mul, (signals[name] for name in self.names))


@dataclass(frozen=True)
class _Difference:
    first: str
    second: str

    def __call__(self, signals: Signals) -> Array:
        return signals[self.first] - signals[self.second]


@dataclass(frozen=True)
class _FasterThan:
    name: str
    threshold: float

    def __call__(self, signals: Signals) -> Array:
        return jnp.abs(signals[self.name]) > self.threshold


def product(*names: str) -> _Product:
    """The product of signals, such as `product("current", "flux")`."""
    return _Product(names)


def difference(first: str, second: str) -> _Difference:
    """One signal minus another, such as the velocity across a damper."""
    return _Difference(first, second)


def faster_than(name: str, threshold: float) -> _FasterThan:
    """A mask: True where the signal's magnitude is above a threshold, in the signal's unit.

    Near standstill the sign of a measured velocity is noise, and so is Coulomb friction
    computed from it.
    """
    return _FasterThan(name, threshold)
