"""Coordinates without bounds for parameters that have some, and priors.

A search that knows no bounds is given coordinates z in which there are none. With scale c,

    free                theta = c z                         d theta / dz = c
    above l             theta = l + c log(1 + e^z)          c (1 - e^(-(theta - l) / c))
    below u             theta = u - c log(1 + e^z)          -c (1 - e^(-(u - theta) / c))
    between l and u     theta = l + (u - l) / (1 + e^-z)    (theta - l) (u - theta) / (u - l)

Towards a bound the slope falls with the distance d from it. A Gauss-Newton step of theta by -x is
one of z by -x over the slope, the longer the nearer the bound: where data push against a bound, d
falls by a constant factor or faster at each step, and a few steps reach it. A map with a turning
point (a sine) has slope zero on the bound itself and turns back beyond it, so that it would be
reached and left in turn.

No finite z lies on a bound. z = -16 leaves d = c e^-16, 1e-7 of the scale: there the bound counts
as reached, and the coordinate is held (see `optimum.Problem`). Float32 has no more digits to tell a
parameter from its bound.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from riecjax.errors import ModelError
from riecjax.leaves import Leaf, is_concrete, is_number

AT_BOUND = 1e-6
"""Distance from a bound, as a share of the parameter's scale, at which it is called reached."""
FARTHEST = 16.0
"""Coordinate at which a bound is that near: further out its slope would be nothing."""

Bounds = tuple[float | None, float | None]


class Prior(NamedTuple):
    """What is known of a parameter beforehand: a normal distribution, in its unit."""

    mean: float
    std: float


class Coordinates(eqx.Module):
    """Smooth maps between parameters and coordinates that may take any value; see the module.

    **Fields:** `scale` of each parameter; `lower` and `upper` bounds, infinite where there is none.
    """

    scale: Float[Array, " p"]
    lower: Leaf
    upper: Leaf

    def _kinds(self) -> tuple[Array, Array, Array, Array]:
        """Which have a lower and an upper bound, and these, 0 for none."""
        below, above = jnp.isfinite(self.lower), jnp.isfinite(self.upper)
        return below, above, jnp.where(below, self.lower, 0.0), jnp.where(above, self.upper, 0.0)

    def values(self, z: Float[Array, " p"]) -> Float[Array, " p"]:
        """Parameters in their units."""
        below, above, low, high = self._kinds()
        rise = self.scale * jax.nn.softplus(z)
        between = low + (high - low) * jax.nn.sigmoid(z)
        one_sided = jnp.where(below, low + rise, jnp.where(above, high - rise, self.scale * z))
        return jnp.where(below & above, between, one_sided)

    def inverse(self, values: Float[Array, " p"]) -> Float[Array, " p"]:
        """Coordinates of parameters strictly within their bounds."""
        below, above, low, high = self._kinds()
        both = below & above
        share = jnp.where(both, (values - low) / jnp.where(both, high - low, 1.0), 0.5)
        share = jnp.clip(share, jnp.finfo(share.dtype).tiny, 1 - jnp.finfo(share.dtype).epsneg)
        distance = jnp.where(below, values - low, high - values) / self.scale
        distance = jnp.where(below ^ above, distance, 1.0)
        distance = jnp.maximum(distance, jnp.finfo(share.dtype).tiny)
        # z = log(e^d - 1) = d + log(1 - e^-d), which neither overflows nor cancels.
        root = distance + jnp.log(-jnp.expm1(-distance))
        bounded = jnp.where(both, jnp.log(share) - jnp.log1p(-share), root)
        free = values / self.scale
        return jnp.where(below | above, jnp.clip(bounded, -FARTHEST, None), free)

    def limits(self) -> tuple[Float[Array, " p"], Float[Array, " p"]]:
        """Lowest and highest coordinates that need ever be tried."""
        below, above, _, _ = self._kinds()
        lowest = jnp.where(below | above, -FARTHEST, -jnp.inf)
        return lowest, jnp.where(below & above, FARTHEST, jnp.inf)

    def at_bound(self, values: Float[Array, " p"]) -> Bool[Array, " p"]:
        """Which parameters sit on one of their bounds."""
        below, above, low, high = self._kinds()
        near = AT_BOUND * jnp.where(below & above, high - low, self.scale)
        return (values - self.lower < near) | (self.upper - values < near)


class Constraints(eqx.Module):
    """Bounds and priors of the free parameters.

    **Fields:** `lower` and `upper`, infinite where there is no bound; `prior_mean`, and
    `prior_weight`, one over the prior's standard deviation, 0 where there is no prior;
    `has_priors`, whether there is any.
    """

    lower: Leaf
    upper: Leaf
    prior_mean: Leaf
    prior_weight: Leaf
    has_priors: bool = eqx.field(static=True)

    @classmethod
    def of(
        cls,
        names: Sequence[str],
        start: Mapping[str, Leaf],
        bounds: Mapping[str, Bounds],
        priors: Mapping[str, Prior],
    ) -> "Constraints":
        """Checked.

        **Raises:** `ModelError` for a parameter that is not free, what is no pair of numbers,
        bounds in the wrong order or that the start does not lie between, a prior without a finite
        mean and a positive standard deviation.
        """
        for what, given in (("bounds are", bounds), ("a prior is", priors)):
            if unknown := [name for name in given if name not in names]:
                raise ModelError(f"{what} given for '{unknown[0]}'; free are: {', '.join(names)}.")
        for name, given in bounds.items():
            if not is_pair(given, or_none=True):
                raise ModelError(
                    f"the bounds of {name} are {given!r}. Write (lower, upper), None where there "
                    f"is none."
                )
        ends = [bounds.get(name, (None, None)) for name in names]
        lower = np.array([-np.inf if low is None else low for low, _ in ends], float)
        upper = np.array([np.inf if high is None else high for _, high in ends], float)
        for name, low, high in zip(names, lower, upper):
            if not low < high:
                raise ModelError(
                    f"the bounds of {name} are equal or in the wrong order: {low:g} to {high:g}."
                )
            if is_concrete(start[name]) and not low < float(start[name]) < high:
                raise ModelError(
                    f"{name} starts at {float(start[name]):g}, which is not between its bounds "
                    f"{low:g} and {high:g}. Widen them, or start strictly between them."
                )
        for name, prior in priors.items():
            if not (is_pair(prior) and np.isfinite(float(prior[0]))):
                raise ModelError(
                    f"the prior of {name} is {prior!r}. Write (mean, standard deviation), a finite "
                    f"mean."
                )
        if wrong := [name for name, prior in priors.items() if not prior[1] > 0]:
            raise ModelError(f"the prior of {wrong[0]} needs a positive standard deviation.")
        normal = [priors.get(name, (0.0, np.inf)) for name in names]
        return cls(
            lower,
            upper,
            np.array([mean for mean, _ in normal], float),
            np.array([1 / std for _, std in normal], float),
            bool(priors),
        )

    def coordinates(self, scale: Float[Array, " p"]) -> Coordinates:
        """Coordinates of parameters of this size."""
        return Coordinates(scale, self.lower, self.upper)


def is_pair(given: Any, or_none: bool = False) -> bool:
    """Whether this is two numbers, or `None` in place of one if that is allowed."""
    if not isinstance(given, Sequence | np.ndarray | jax.Array) or len(given) != 2:
        return False
    return all(is_number(end) or (or_none and end is None) for end in given)
