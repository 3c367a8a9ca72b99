"""Huber's loss, which grows with a residual's square up to a threshold and straight on past it.

With the threshold c, rho(r) = r^2 / 2 up to c and c |r| - c^2 / 2 past it. What searches for least
squares makes it small as the square of f(r) = sign(r) sqrt(2 rho(r)), whose slope is continuous.
f f' is the score psi(r), r cut off at c, so the gradient is the loss's own; f'^2 > 0 past c keeps
steps defined, and is more than the curvature psi' = 0 there. A sandwich takes psi' instead, or its
standard errors were too small: by a fifth of a normal law at c = 1.345.
"""

from collections.abc import Callable
from typing import TypeAlias

import jax.numpy as jnp
from jaxtyping import Array, Float

THRESHOLD = 1.345
"""Standard deviations of the noise: 95 % as precise as squares where all of it is normal."""
LEAST_NOISE = 1e-3
"""Share of a channel's standard deviation that its noise is taken for at the least."""

Threshold: TypeAlias = Float[Array, "1 channels"] | None
"""Past which a channel's loss is straight, in units of its residuals; `None` where nowhere."""
Columns: TypeAlias = Callable[[Array, Array, Threshold], tuple[Array, Array]]
"""Of residuals and their slopes, two sets of columns whose products are moments from the diagonal
up: energies, scores and curvatures."""


def as_square(
    residual: Float[Array, "*n channels"], threshold: Threshold
) -> Float[Array, "*n channels"]:
    """f(r), half the square of which is the loss."""
    if threshold is None:
        return residual
    past = jnp.maximum(jnp.abs(residual), threshold)
    bent = jnp.sign(residual) * jnp.sqrt(threshold * (2 * past - threshold))
    return jnp.where(jnp.abs(residual) <= threshold, residual, bent)


def for_search(
    level: Float[Array, "*n channels"],
    slopes: Float[Array, "*n channels columns"],
    threshold: Threshold,
) -> tuple[Array, Array]:
    """f and its slopes."""
    square = as_square(level, threshold)
    if threshold is not None:
        bent = jnp.clip(level, -threshold, threshold) / jnp.where(square == 0, 1.0, square)
        slopes = slopes * jnp.where(square == 0, 1.0, bent)[..., None]
    columns = jnp.concatenate([square[..., None], slopes], axis=-1)
    return columns, columns


def for_scatter(
    level: Float[Array, "*n channels"],
    slopes: Float[Array, "*n channels columns"],
    threshold: Threshold,
) -> tuple[Array, Array]:
    """f^2, psi times slopes, and slopes times each other up to the threshold."""
    assert threshold is not None
    score = jnp.clip(level, -threshold, threshold)
    energy = as_square(level, threshold) ** 2 / jnp.where(score == 0, 1.0, score)
    inside = slopes * (jnp.abs(level) <= threshold)[..., None]
    left = jnp.concatenate([score[..., None], inside], axis=-1)
    return left, jnp.concatenate([energy[..., None], slopes], axis=-1)
