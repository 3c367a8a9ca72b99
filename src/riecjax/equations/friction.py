"""Friction as a function of sliding velocity, linear in its coefficients."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from riecjax.equations.bases import AbstractBasis
from riecjax.errors import ModelError
from riecjax.leaves import Leaf, as_leaf, is_concrete


class Friction(AbstractBasis):
    """Viscous and Coulomb friction, alike or of their own in each direction, and Stribeck's.

    The functions of the velocity v, with the labels that are appended to a coefficient's name:

    - `viscous`: v, and `coulomb`: sign(v); or, if asymmetric, `viscous_pos`, `coulomb_pos` for
      v > 0 and `viscous_neg`, `coulomb_neg` for v < 0. Each has the sign of v, so all
      coefficients of a passive friction are positive.
    - `stribeck`: sign(v) exp(-(v / speed)^2), what is added near standstill.

    **Arguments:**

    - `asymmetric`: coefficients of their own in each direction.
    - `stribeck`: Stribeck speed in the velocity's unit, or `None` for none.
    - `smooth`: width over which sign(v) goes from -1 to 1, as tanh(v / smooth), in the
      velocity's unit; `None` for the sign itself.

    **Raises:** `ModelError` unless speeds are positive.
    """

    asymmetric: bool = eqx.field(static=True)
    stribeck: Leaf | None
    smooth: Leaf | None

    def __init__(
        self,
        *,
        asymmetric: bool = False,
        stribeck: float | Array | None = None,
        smooth: float | Array | None = None,
    ):
        self.asymmetric = asymmetric
        self.stribeck = None if stribeck is None else as_leaf(stribeck)
        self.smooth = None if smooth is None else as_leaf(smooth)
        for name, speed in (("Stribeck speed", self.stribeck), ("smoothing width", self.smooth)):
            if speed is not None and is_concrete(speed) and not float(speed) > 0:
                raise ModelError(f"the {name} must be positive; got {float(speed):g}.")

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the functions; see the class."""
        sliding = ("viscous", "coulomb")
        if self.asymmetric:
            sliding = ("viscous_pos", "coulomb_pos", "viscous_neg", "coulomb_neg")
        return sliding if self.stribeck is None else (*sliding, "stribeck")

    def __call__(self, x: Float[Array, " n"]) -> Float[Array, "functions n"]:
        """Every function at every velocity."""
        direction = jnp.sign(x) if self.smooth is None else jnp.tanh(x / self.smooth)
        if self.asymmetric:
            forward, backward = x > 0, x < 0
            functions = [
                jnp.where(forward, x, 0.0),
                jnp.where(forward, direction, 0.0),
                jnp.where(backward, x, 0.0),
                jnp.where(backward, direction, 0.0),
            ]
        else:
            functions = [x, direction]
        if self.stribeck is not None:
            functions.append(direction * jnp.exp(-((x / self.stribeck) ** 2)))
        return jnp.stack(functions)


def friction(
    *, asymmetric: bool = False, stribeck: float | None = None, smooth: float | None = None
) -> Friction:
    """A basis of friction functions; see [`Friction`][]."""
    return Friction(asymmetric=asymmetric, stribeck=stribeck, smooth=smooth)
