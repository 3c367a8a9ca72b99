"""Families of functions of one signal, each function with its own coefficient.

Laws with a width, each one function of one signal: dead zone, saturation, Stribeck's friction.

They are linear in their coefficient and not in the width, which is an array: sums for another width
compile nothing anew.
"""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from riecjax.errors import ModelError
from riecjax.leaves import Leaf, as_leaf, is_concrete


class AbstractBasis(eqx.Module):
    """A family of functions of one variable."""

    @property
    def labels(self) -> tuple[str, ...]:
        """What is appended to a coefficient's name, one for each function."""
        raise NotImplementedError

    def __call__(self, x: Float[Array, " n"]) -> Float[Array, "functions n"]:
        """Every function at every sample."""
        raise NotImplementedError


class RoofFunctions(AbstractBasis):
    """Piecewise linear roof functions R_i on break points, eq. (22) and Fig. 6.

    R_i is 1 at its break point, 0 at the others and linear between them, so that
    `sum F_i R_i(x)` interpolates the forces F_i linearly. Outside the break points the end
    segments are continued. Everywhere the functions sum to 1 and `sum v_i R_i(x) = x`.

    **Raises:** `ModelError` unless there are at least two break points in increasing order.
    """

    break_points: Float[Array, " points"]

    def __init__(self, break_points: Sequence[float] | ArrayLike | Array):
        self.break_points = jnp.asarray(break_points, jnp.result_type(float))

    def __check_init__(self):
        points = self.break_points
        if points.ndim != 1 or points.shape[0] < 2:
            raise ModelError("roof functions need at least two break points.")
        if is_concrete(points) and not bool(np.all(np.diff(points) > 0)):
            raise ModelError(f"break points must increase; got {points.tolist()}.")

    @property
    def labels(self) -> tuple[str, ...]:
        """`1`, `2`, ... in the order of the break points."""
        return tuple(str(i + 1) for i in range(self.break_points.shape[0]))

    def _segment(self, x: Array) -> tuple[Array, Array]:
        """The segment that x lies on (the nearest one outside) and its share along it."""
        points = self.break_points
        last = points.shape[0] - 2
        # Comparing with the inner points vectorises where a binary search does not.
        inside = [(x >= points[i]).astype(jnp.int32) for i in range(1, last + 1)]
        below = sum(inside, start=jnp.zeros(jnp.shape(x), jnp.int32))
        share = (x - points[below]) / (points[below + 1] - points[below])
        return below, share

    def __call__(self, x: Float[Array, " n"]) -> Float[Array, "points n"]:
        """R_i(x) for every i."""
        # Each roof looks at x by itself: to look up the segment of x takes four times as long.
        points, widths, x = self.break_points, jnp.diff(self.break_points), x[None, :]
        one, inner = jnp.ones(1, points.dtype), points[1:-1]
        far = jnp.inf * one
        falls = ~(x < jnp.concatenate([-far, inner, far])[:, None])
        ended = x >= jnp.concatenate([inner, far, far])[:, None]
        begun = ~(x < jnp.concatenate([-far, -far, inner])[:, None])
        start = jnp.where(falls, points[:, None], jnp.pad(points, (1, 0))[:-1, None])
        width = jnp.concatenate([one, widths, one])
        share = (x - start) / jnp.where(falls, width[1:, None], width[:-1, None])
        return jnp.where(falls, jnp.where(ended, 0.0, 1 - share), jnp.where(begun, share, 0.0))

    def interpolate(self, values: Float[Array, " points"], x: Array) -> Array:
        """`sum values_i R_i(x)`, without forming the functions; x of any shape."""
        below, share = self._segment(x)
        return values[below] * (1 - share) + values[below + 1] * share


class Polynomial(AbstractBasis):
    """Powers x^p of a signal for the given exponents."""

    exponents: tuple[int, ...] = eqx.field(static=True, converter=tuple)

    @property
    def labels(self) -> tuple[str, ...]:
        """The exponents."""
        return tuple(str(p) for p in self.exponents)

    def __call__(self, x: Float[Array, " n"]) -> Float[Array, "exponents n"]:
        """x^p for every exponent p."""
        return jnp.stack([x**p for p in self.exponents])


def roof(break_points: Sequence[float]) -> RoofFunctions:
    """Roof functions on these break points; see [`RoofFunctions`][]."""
    return RoofFunctions(break_points)


class Friction(AbstractBasis):
    """Viscous and Coulomb friction, shared by both directions or separate, and Stribeck's.

    The functions of the velocity v, with the labels that are appended to a coefficient's name:

    - `viscous`: v, and `coulomb`: sign(v); or, if asymmetric, `viscous_pos`, `coulomb_pos` for
      v > 0 and `viscous_neg`, `coulomb_neg` for v < 0. Each has the sign of v, so all
      coefficients of a passive friction are positive.
    - `stribeck`: sign(v) exp(-(v / speed)^2), what is added near standstill.

    **Arguments:**

    - `asymmetric`: separate coefficients for each direction.
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
