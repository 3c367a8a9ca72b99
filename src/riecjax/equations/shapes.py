"""Laws with a width, each one function of one signal: dead zone, saturation, Stribeck's friction.

They are linear in their coefficient and not in the width, which is an array: sums for another width
compile nothing anew.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from riecjax.equations.bases import AbstractBasis
from riecjax.errors import ModelError
from riecjax.leaves import Leaf, as_leaf, is_concrete


class AbstractShape(AbstractBasis):
    """A function of one signal with a width in that signal's unit.

    **Raises:** `ModelError` unless the width is positive.
    """

    width: eqx.AbstractVar[Leaf]

    def __check_init__(self):
        if is_concrete(self.width) and not float(self.width) > 0:
            raise ModelError(f"a width must be positive; got {float(self.width):g}.")


class DeadZone(AbstractShape):
    """Nothing within +-width, and what is beyond it outside: play, a gap, a stop."""

    width: Leaf

    def __init__(self, width: float | Array):
        self.width = as_leaf(width)

    @property
    def labels(self) -> tuple[str, ...]:
        """What the coefficient is of: a stiffness."""
        return ("stiffness",)

    def __call__(self, x: Float[Array, " n"]) -> Float[Array, "1 n"]:
        """x - clip(x, -width, width)."""
        return (x - jnp.clip(x, -self.width, self.width))[None]


class Saturation(AbstractShape):
    """Linear within +-width, and constant outside."""

    width: Leaf

    def __init__(self, width: float | Array):
        self.width = as_leaf(width)

    @property
    def labels(self) -> tuple[str, ...]:
        """What the coefficient is of: the slope within the width."""
        return ("slope",)

    def __call__(self, x: Float[Array, " n"]) -> Float[Array, "1 n"]:
        """clip(x, -width, width)."""
        return jnp.clip(x, -self.width, self.width)[None]


class Stribeck(AbstractShape):
    """What dry friction is more near standstill: sign(v) exp(-(v / width)^2)."""

    width: Leaf

    def __init__(self, width: float | Array):
        self.width = as_leaf(width)

    @property
    def labels(self) -> tuple[str, ...]:
        """What the coefficient is of: a force."""
        return ("force",)

    def __call__(self, x: Float[Array, " n"]) -> Float[Array, "1 n"]:
        """sign(x) exp(-(x / width)^2)."""
        return (jnp.sign(x) * jnp.exp(-((x / self.width) ** 2)))[None]
