"""What is known of parameters beforehand, and whether the recordings bear it out."""

from collections.abc import Mapping
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from riecjax.estimation.estimate import AbstractEstimate, Estimate
from riecjax.findings import Finding
from riecjax.refinement.coordinates import Bounds, Prior, is_pair

STRANGE = 3.0
"""Standard deviations past which a prior contradicts the data: one time in 370 by chance."""
INSIDE = 0.1
"""Share of the way between bounds, or of the way to the only one, by which a start stands off."""


class Beforehand(NamedTuple):
    """What is known of parameters before a refinement, by name."""

    bounds: Mapping[str, Bounds] | None = None
    priors: Mapping[str, Prior] | None = None


def against_priors(estimate: Estimate, priors: Mapping[str, Prior]) -> list[Finding]:
    """Priors from which what the data tell without them lies further than chance explains."""
    errors = dict(zip(estimate.parameters, np.asarray(estimate.standard_errors)))
    found = []
    for name in priors.keys() & errors.keys():
        (mean, std), value, error = priors[name], float(estimate[name]), float(errors[name])
        if abs(value - mean) > STRANGE * np.hypot(std, error):
            found.append(
                Finding(
                    "prior_disagrees",
                    f"the prior of {name}, {mean:.4g} +- {std:.2g}, and the estimate without it, "
                    f"{value:.4g} +- {error:.2g}, contradict each other: what was answered lies "
                    f"between two values of which one is wrong.",
                    parameters=(name,),
                    doubt=1.0,
                )
            )
    return found


def outside_bounds(answer: AbstractEstimate, bounds: Mapping[str, Bounds]) -> list[Finding]:
    """Values of a linear estimate, which knows of no bounds, that lie outside of them."""
    found = []
    for name, value, nearest in _strays(answer, bounds):
        low, high = _bounds_of(name, bounds)
        said = f"below {low:g}" if value < low else f"above {high:g}"
        found.append(
            Finding(
                "outside_bound",
                f"{name} is {value:.4g}, {said}, its bound: bounds apply to refined values, and "
                f"these are linear estimates. Ask for refinement (--refine output-error), hold "
                f"{name} at a value (--set), or check the bound.",
                parameters=(name,),
                doubt=abs(value - nearest) / max(abs(value), 1e-300),
            )
        )
    return found


def within(start: AbstractEstimate, bounds: Mapping[str, Bounds]) -> AbstractEstimate:
    """A start between the bounds, which a search approaches and never crosses."""
    moved = {}
    for name, value, nearest in _strays(start, bounds):
        low, high = _bounds_of(name, bounds)
        way = high - low if np.isfinite(high - low) else max(abs(value - nearest), abs(nearest))
        moved[name] = nearest + INSIDE * way * (1 if nearest == low else -1)
    theta = [moved.get(n, value) for n, value in zip(start.parameters, start.theta)]
    return eqx.tree_at(lambda one: one.theta, start, jnp.stack(theta)) if moved else start


def _strays(
    estimate: AbstractEstimate, bounds: Mapping[str, Bounds]
) -> list[tuple[str, float, float]]:
    """Parameters out of bounds, with value and nearest bound."""
    found = []
    for name in estimate.parameters:
        low, high = _bounds_of(name, bounds)
        value = float(estimate[name])
        if low < high and not low < value < high:
            found.append((name, value, low if value <= low else high))
    return found


def _bounds_of(name: str, bounds: Mapping[str, Bounds]) -> tuple[float, float]:
    # What is given for `m` holds for `m[2]` too; what makes no sense is refused by the search.
    given = bounds.get(name, bounds.get(name.partition("[")[0], (None, None)))
    low, high = given if is_pair(given, or_none=True) else (None, None)
    return (-np.inf if low is None else float(low)), (np.inf if high is None else float(high))
