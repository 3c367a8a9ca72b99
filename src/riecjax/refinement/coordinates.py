"""Coordinates without bounds for parameters that have some, and priors."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from riecjax.errors import ModelError
from riecjax.leaves import Leaf, is_concrete

AT_BOUND = 1e-6
"""Distance from a bound, as a share of the parameter's scale, at which it is called reached."""

Bounds = tuple[float | None, float | None]


class Prior(NamedTuple):
    """What is known of a parameter beforehand: a normal law, in the parameter's unit."""

    mean: float
    std: float


class Coordinates(eqx.Module):
    """Smooth maps between parameters and coordinates that may take any value.

    A free parameter is its scale times its coordinate z. One that is bounded below is
    `lower + scale (sqrt(1 + z^2) - 1)`, above likewise, and between two bounds it is
    `middle + half (upper - lower) sin(z)`: a bound can be reached, with a slope of zero there
    (James and Roos, 1975, MINUIT).

    **Fields:** `scale` of each parameter; `lower` and `upper` bounds, infinite where there is none.
    """

    scale: Float[Array, " p"]
    lower: Leaf
    upper: Leaf

    def values(self, z: Float[Array, " p"]) -> Float[Array, " p"]:
        """Parameters in their units."""
        below, above = jnp.isfinite(self.lower), jnp.isfinite(self.upper)
        low, high = jnp.where(below, self.lower, 0.0), jnp.where(above, self.upper, 0.0)
        rise = self.scale * (jnp.sqrt(1 + z**2) - 1)
        between = (low + high) / 2 + (high - low) / 2 * jnp.sin(z)
        one_sided = jnp.where(below, low + rise, jnp.where(above, high - rise, self.scale * z))
        return jnp.where(below & above, between, one_sided)

    def inverse(self, values: Float[Array, " p"]) -> Float[Array, " p"]:
        """Coordinates of parameters strictly within their bounds."""
        below, above = jnp.isfinite(self.lower), jnp.isfinite(self.upper)
        low, high = jnp.where(below, self.lower, 0.0), jnp.where(above, self.upper, 0.0)
        both = below & above
        half = jnp.where(both, (high - low) / 2, 1.0)
        angle = jnp.arcsin(jnp.clip((values - (low + high) / 2) / half, -1.0, 1.0))
        distance = jnp.where(below, values - low, high - values) / self.scale
        distance = jnp.where(below ^ above, jnp.maximum(distance, 0.0), 1.0)
        root = jnp.sqrt((distance + 1) ** 2 - 1)
        return jnp.where(both, angle, jnp.where(below | above, root, values / self.scale))

    def at_bound(self, values: Float[Array, " p"]) -> Bool[Array, " p"]:
        """Which parameters sit on one of their bounds."""
        near = AT_BOUND * self.scale
        return (values - self.lower < near) | (self.upper - values < near)


class Laws(eqx.Module):
    """Bounds and priors of the free parameters.

    **Fields:** `lower` and `upper`, infinite where there is no bound; `prior_mean`, and
    `prior_weight`, one over the prior's standard deviation, 0 where there is no prior.
    """

    lower: Leaf
    upper: Leaf
    prior_mean: Leaf
    prior_weight: Leaf

    @classmethod
    def of(
        cls,
        names: Sequence[str],
        start: Mapping[str, Array],
        bounds: Mapping[str, Bounds],
        priors: Mapping[str, Prior],
    ) -> "Laws":
        """Checked.

        **Raises:** `ModelError` for a parameter that is not free, bounds in the wrong order or
        that the start does not lie between, a prior without a positive standard deviation.
        """
        for what, given in (("bounds are", bounds), ("a prior is", priors)):
            if unknown := [name for name in given if name not in names]:
                raise ModelError(f"{what} given for '{unknown[0]}'; free are: {', '.join(names)}.")
        ends = [bounds.get(name, (None, None)) for name in names]
        lower = np.array([-np.inf if low is None else low for low, _ in ends], float)
        upper = np.array([np.inf if high is None else high for _, high in ends], float)
        for name, low, high in zip(names, lower, upper):
            if not low < high:
                raise ModelError(f"the bounds of {name} are in the wrong order: {low} to {high}.")
            if is_concrete(start[name]) and not low < float(start[name]) < high:
                raise ModelError(
                    f"{name} starts at {float(start[name]):g}, which is not between its bounds "
                    f"{low:g} and {high:g}. Start strictly between them."
                )
        if wrong := [name for name, prior in priors.items() if not prior[1] > 0]:
            raise ModelError(f"the prior of {wrong[0]} needs a positive standard deviation.")
        laws = [priors.get(name, (0.0, np.inf)) for name in names]
        return cls(
            lower,
            upper,
            np.array([mean for mean, _ in laws], float),
            np.array([1 / std for _, std in laws], float),
        )

    def coordinates(self, scale: Float[Array, " p"]) -> Coordinates:
        """Coordinates of parameters of this size."""
        return Coordinates(scale, self.lower, self.upper)
