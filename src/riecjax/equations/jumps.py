"""Signals at whose zero a function jumps, as dry friction does at a velocity's."""

import functools
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from riecjax.equations.expressions import Expression
from riecjax.records.signals import Signals

ASIDE, JUMP = 1e-9, 1e-4
"""A velocity to either side of zero, and the share of itself that a function jumps by there."""

Basis = Callable[[Array], Array]


def reversing_states(
    functions: Sequence[tuple[Expression, Basis | None]],
    states: Sequence[str],
    signals: Sequence[str],
) -> tuple[str, ...]:
    """States at whose zero a function jumps, as dry friction does of a velocity.

    **Arguments:** expressions, and what bases make of them, of `signals`, the states among these.
    """
    found: set[str] = set()
    for of, basis in functions:
        if basis is not None:
            found |= _jumping(of, basis, tuple(states), tuple(signals))
        elif not isinstance(of, str):
            found |= _jumping_alone(of, tuple(states), tuple(signals))
    return tuple(state for state in states if state in found)


@functools.lru_cache
def _jumping_alone(of: Expression, states: tuple[str, ...], signals: tuple[str, ...]) -> set[str]:
    return _jumping(of, None, states, signals)


def _jumping(
    of: Expression, basis: Basis | None, states: tuple[str, ...], signals: tuple[str, ...]
) -> set[str]:
    """The states at whose zero one function jumps (none of a function that is not concrete)."""
    # Four samples for each state: next to its zero and well away, on both sides.
    places = np.array([ASIDE, -ASIDE, 1.0, -1.0])
    levels = np.random.default_rng(0).uniform(0.2, 0.9, (len(signals), 1))
    at = dict(zip(signals, np.repeat(levels, len(states) * places.size, axis=1)))
    for i, state in enumerate(states):
        at[state][i * places.size : (i + 1) * places.size] = places
    try:
        with jax.ensure_compile_time_eval():
            probed = Signals({name: jnp.asarray(value) for name, value in at.items()})
            samples = jnp.asarray(probed[of] if isinstance(of, str) else of(probed))
            values = np.asarray(samples if basis is None else basis(samples))
    except Exception:  # whatever is wrong with a user's function is said where it is used
        return set()
    if not values.shape or values.shape[-1] != len(states) * places.size:
        return set()
    above, below, far, other = np.moveaxis(values.reshape(-1, len(states), places.size), -1, 0)
    jumps = np.abs(above - below) > JUMP * np.maximum(np.abs(far), np.abs(other))
    return {state for state, jump in zip(states, np.atleast_1d(jumps.any(axis=0))) if jump}
