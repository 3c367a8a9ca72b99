"""Families of functions of one signal, each function with its own coefficient.

Laws with a width are each one function: dead zone, saturation, Stribeck's friction. They are linear
in their coefficient and not in the width, which is an array: sums for another width compile nothing
anew.
"""

from collections.abc import Sequence
from typing import ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Float

from riecjax import arrays as xp
from riecjax.arrays import Array
from riecjax.errors import ModelError, require
from riecjax.leaves import Leaf, as_leaf


class AbstractBasis(eqx.Module):
    """A family of functions of one variable."""

    is_continuous: ClassVar[bool] = False
    """Whether none of them jumps; a family that does not say so is tried."""

    @property
    def labels(self) -> tuple[str, ...]:
        """What is appended to a coefficient's name, one for each function."""
        raise NotImplementedError

    def __call__(self, x: Float[Array, " n"]) -> Float[Array, "functions n"]:
        """Every function at every sample."""
        raise NotImplementedError

    def interpolate(self, values: Float[Array, " functions"], x: Float[Array, " n"]) -> Array:
        """`sum values_i f_i(x)`, which some know without forming their functions."""
        return values @ self(x)

    def words(self, name: str, of: str) -> list[str]:
        """The summands of `sum_i name_i basis_i(of)` in words."""
        return [f"{name} {type(self).__name__.lower()}({of})"]

    @property
    def source(self) -> str | None:
        """As it is written after `import riecjax as rx`; `None` where that is not known."""
        return None


class RoofFunctions(AbstractBasis):
    """Piecewise linear roof functions R_i on break points, eq. (22) and Fig. 6.

    R_i is 1 at its break point, 0 at the others and linear between them, so that
    `sum F_i R_i(x)` interpolates the forces F_i linearly. Outside the break points the end
    segments are continued. Everywhere the functions sum to 1 and `sum v_i R_i(x) = x`.

    **Raises:** `ModelError` unless there are at least two break points in increasing order.
    """

    break_points: Float[Leaf, " points"] = eqx.field(converter=as_leaf)
    is_continuous: ClassVar[bool] = True

    def __check_init__(self):
        points = self.break_points
        if points.ndim != 1 or points.shape[0] < 2:
            raise ModelError("roof functions need at least two break points.")
        if xp.is_concrete(points) and not bool(np.all(np.diff(points) > 0)):
            raise ModelError(f"break points must increase; got {points.tolist()}.")

    @property
    def points(self) -> Float[Array, " points"]:
        """The break points, to compute with."""
        return xp.asarray(self.break_points, float)

    @property
    def labels(self) -> tuple[str, ...]:
        """`1`, `2`, ... in the order of the break points."""
        return tuple(str(i + 1) for i in range(self.break_points.shape[0]))

    def __call__(self, x: Float[Array, " n"]) -> Float[Array, "points n"]:
        """R_i(x) for every i."""
        # Each roof looks at x by itself: to look up the segment of x takes four times as long.
        points, x = self.points, x[None, :]
        one, inner = np.ones(1, points.dtype), points[1:-1]
        far = np.inf * one
        falls = ~(x < xp.concatenate([-far, inner, far])[:, None])
        ended = x >= xp.concatenate([inner, far, far])[:, None]
        begun = ~(x < xp.concatenate([-far, -far, inner])[:, None])
        start = xp.where(falls, points[:, None], xp.pad(points, (1, 0))[:-1, None])
        width = xp.concatenate([one, xp.diff(points), one])
        share = (x - start) / xp.where(falls, width[1:, None], width[:-1, None])
        return xp.where(falls, xp.where(ended, 0.0, 1 - share), xp.where(begun, share, 0.0))

    def words(self, name: str, of: str) -> list[str]:
        """`F R(v)`."""
        return [f"{name} R({of})"]

    def interpolate(self, values: Float[Array, " points"], x: Array) -> Array:
        """`sum values_i R_i(x)`, without forming the functions; x of any shape."""
        # The segment that x lies on (the nearest one outside), and its share along it.
        points = self.points
        last = points.shape[0] - 2
        # Comparing with the inner points vectorises where a binary search does not.
        inside = [(x >= points[i]).astype(np.int32) for i in range(1, last + 1)]
        below = sum(inside, start=np.zeros(np.shape(x), np.int32))
        low, high = (xp.take(points, below + i) for i in (0, 1))
        share = (x - low) / (high - low)
        return xp.take(values, below) * (1 - share) + xp.take(values, below + 1) * share


class Polynomial(AbstractBasis):
    """Powers x^p of a signal for the given exponents.

    **Raises:** `ModelError` unless these are different whole numbers from 0 on.
    """

    exponents: tuple[int, ...] = eqx.field(static=True)
    is_continuous: ClassVar[bool] = True

    def __init__(self, exponents: Sequence[int]):
        kinds = (tuple, list, range)
        require("what a polynomial has for exponents", exponents, kinds, "rx.Polynomial((1, 3))")
        self.exponents = tuple(exponents)
        whole = all(isinstance(p, int | np.integer) and p >= 0 for p in self.exponents)
        if not whole or not 0 < len(self.exponents) == len({*self.exponents}):
            raise ModelError(
                f"a polynomial's exponents must be different whole numbers from 0 on; got "
                f"{self.exponents}."
            )

    @property
    def labels(self) -> tuple[str, ...]:
        """The exponents."""
        return tuple(str(p) for p in self.exponents)

    def __call__(self, x: Float[Array, " n"]) -> Float[Array, "exponents n"]:
        """x^p for every exponent p."""
        return xp.stack([x**p for p in self.exponents])

    def words(self, name: str, of: str) -> list[str]:
        """`c_1 x` and `c_3 x^3`."""
        base = of if of.isidentifier() else f"({of})"
        powers = {0: "", 1: f" {base}"}
        return [f"{name}_{p}{powers.get(p, f' {base}^{p}')}" for p in self.exponents]


def roof(break_points: Sequence[float]) -> RoofFunctions:
    """Roof functions on these break points; see [`RoofFunctions`][]."""
    return RoofFunctions(break_points)


def _leaf_or_none(value: float | Array | None) -> Leaf | None:
    return None if value is None else as_leaf(value)


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

    **Raises:** `ModelError` unless the speed is positive.
    """

    asymmetric: bool = eqx.field(static=True, kw_only=True, default=False)
    stribeck: Leaf | None = eqx.field(converter=_leaf_or_none, kw_only=True, default=None)

    def __check_init__(self):
        _require_positive("the Stribeck speed", self.stribeck)

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the functions; see the class."""
        sides = ("_pos", "_neg") if self.asymmetric else ("",)
        sliding = (f"{kind}{side}" for side in sides for kind in ("viscous", "coulomb"))
        return (*sliding, *(("stribeck",) if self.stribeck is not None else ()))

    def __call__(self, x: Float[Array, " n"]) -> Float[Array, "functions n"]:
        """Every function at every velocity."""
        direction = xp.sign(x)
        sides = (x > 0, x < 0) if self.asymmetric else (True,)
        functions = [xp.where(side, of, 0.0) for side in sides for of in (x, direction)]
        if self.stribeck is not None:
            functions += [*Stribeck(self.stribeck)(x)]
        return xp.stack(functions)


def friction(*, asymmetric: bool = False, stribeck: float | None = None) -> Friction:
    """A basis of friction functions; see [`Friction`][]."""
    return Friction(asymmetric=asymmetric, stribeck=stribeck)


class AbstractShape(AbstractBasis):
    """A function of one signal with a width in that signal's unit.

    **Raises:** `ModelError` unless the width is positive.
    """

    width: Leaf = eqx.field(converter=as_leaf)
    label: ClassVar[str]
    """What the coefficient is of."""

    def __check_init__(self):
        _require_positive("a width", self.width)

    @property
    def labels(self) -> tuple[str, ...]:
        """What the coefficient is of."""
        return (self.label,)

    def words(self, name: str, of: str) -> list[str]:
        """`stop_stiffness deadzone(x; 0.1)`."""
        at = f"; {float(self.width):.4g}" if xp.is_concrete(self.width) else ""
        return [f"{name}_{self.label} {type(self).__name__.lower()}({of}{at})"]

    @property
    def source(self) -> str:
        """`rx.equations.DeadZone(0.1)`."""
        return f"rx.equations.{type(self).__name__}({float(np.asarray(self.width))!r})"


def beyond(x: Array, half: Leaf) -> Array:
    """What of x is beyond a half width on either side: x - clip(x, -half, half)."""
    return x - xp.clip(x, -half, half)


class DeadZone(AbstractShape):
    """Nothing within +-width, and what is beyond it outside: play, a gap, a stop."""

    label = "stiffness"

    def __call__(self, x: Float[Array, " n"]) -> Float[Array, "1 n"]:
        """x - clip(x, -width, width)."""
        return beyond(x, self.width)[None]


class Saturation(AbstractShape):
    """Linear within +-width, and constant outside."""

    label = "slope"

    def __call__(self, x: Float[Array, " n"]) -> Float[Array, "1 n"]:
        """clip(x, -width, width)."""
        return xp.clip(x, -self.width, self.width)[None]


class Stribeck(AbstractShape):
    """What dry friction is more near standstill: sign(v) exp(-(v / width)^2)."""

    label = "force"

    def __call__(self, x: Float[Array, " n"]) -> Float[Array, "1 n"]:
        """sign(x) exp(-(x / width)^2)."""
        return (xp.sign(x) * xp.exp(-((x / self.width) ** 2)))[None]


def _require_positive(what: str, size: Leaf | None) -> None:
    if size is not None and xp.is_concrete(size) and not float(size) > 0:
        raise ModelError(f"{what} must be positive; got {float(size):g}.")
