"""Steps that end where a velocity reverses, and a force that depends on its sign jumps.

Dry friction makes x' = f(x) jump where v = 0. A step across that falls to first order, in the
solution and above all in its derivatives: what differs by dv just before the reversal differs by
(f+ / f-) dv just behind it, f- and f+ being v' on the two sides. No derivative of a sign tells
that, nor do smaller steps. So the step is cut in two,

    x* = step(x, s h) by f-,    x(h) = step(x*, (1 - s) h) by f+,    v(x*) = 0,

each half seeing one side of the jump only: a velocity that is past zero counts as zero, of the sign
it had. s is a root of the cubic through v and v' at both ends of the whole step by f-, as exact as
that step, and a function of x: its derivative, that of one step of Newton's, is what makes the
factor f+ / f-.

Behind a reversal that f+ would undo at once the mass sticks: v stays 0, whatever it would have
depended on, until at the beginning of a step some side lets it go. So f+ / f- is never large.
Of several velocities the first to reverse cuts the step.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from riecjax.simulation.system import AbstractSystem, State

NEWTON_STEPS = 5
"""From the secant's root to that of a cubic which is nearly straight."""
FLAT = 1e-3
"""Slope at its root that a cubic is taken to have at the least, of what its ends are apart."""
Rises = Callable[["Regime", Array, float | Array], Array]
"""The state's derivative, or that times the step, at a share of it."""
Level = Callable[[float | Array], Float[Array, " inputs"]]
"""Inputs at a share of a step."""
Advance = Callable[[Callable[[Array, Array], Array], Array, Level, Array], Array]
"""One step of a method: of a derivative, from a state, along inputs, so long."""


class Regime(NamedTuple):
    """On which side of zero velocities are, and which of them stick there.

    **Fields:** `sides`, 1 above, -1 below, 0 where a state may be anywhere; `stuck`.
    """

    sides: State
    stuck: Bool[Array, " states"]

    def seen(self, state: State) -> State:
        """The state, velocities past zero taken for zero on their side."""
        held = self.sides * jnp.maximum(self.sides * state, jnp.finfo(state.dtype).tiny)
        return jnp.where(self.sides == 0, state, held)

    def derivative(self, system: AbstractSystem, state: Array, inputs: Array) -> Array:
        """The state's time derivative, that of a velocity which sticks being zero."""
        return jnp.where(self.stuck, 0.0, system.derivative(self.seen(state), inputs))


def cut_step(
    system: AbstractSystem, advance: Advance, state: State, level: Level, step: Float[Array, ""]
) -> State:
    """A step of a system, cut where the first of the velocities that matter reverses."""

    def rise(regime: Regime, state: Array, at: float | Array) -> Array:
        return step * regime.derivative(system, state, level(at))

    def move(regime: Regime, state: Array, at: float | Array, share: float | Array) -> Array:
        slope = partial(regime.derivative, system)
        return advance(slope, state, lambda node: level(at + node * share), share * step)

    before = _regime_of(rise, state, system)
    sides = before.sides
    whole = move(before, state, 0.0, 1.0)
    reversed_ = sides * whole < 0

    def cut() -> Array:
        rises = rise(before, state, 0.0), rise(before, whole, 1.0)
        shares = jnp.where(reversed_, _first_root((state, whole), rises, reversed_), 1.0)
        first = jnp.min(shares)
        turned = reversed_ & (shares <= first)
        middle = jnp.where(turned, 0.0, move(before, state, 0.0, first))
        behind = jnp.where(turned, -sides, sides)
        after = _sticking(rise, middle, behind, turned | before.stuck, first)
        return move(after, middle, first, 1 - first)

    return jax.lax.cond(jnp.any(reversed_), cut, lambda: whole)


def _regime_of(rise: Rises, state: State, system: AbstractSystem) -> Regime:
    """Of a state at the beginning of a step: the side on which velocities at rest leave, if any."""
    ours = np.array([name in system.reversing for name in system.state_names])
    resting = jnp.asarray(ours) & (state == 0)
    free = Regime(jnp.zeros_like(state), jnp.zeros(state.shape, bool))
    leaving = jnp.where(resting, rise(free, state, 0.0), state)
    return _sticking(rise, state, jnp.where(ours, jnp.sign(leaving), 0.0), resting, 0.0)


def regime_at(system: AbstractSystem, state: Array, inputs: Array) -> Regime:
    """The same of a system at a sample."""
    return _regime_of(lambda regime, at, _: regime.derivative(system, at, inputs), state, system)


def _sticking(
    rise: Rises, state: Array, sides: Array, resting: Bool[Array, " states"], at: float | Array
) -> Regime:
    """With the velocities at rest that their own side would push back."""
    risen = rise(Regime(sides, jnp.zeros(state.shape, bool)), state, at)
    return Regime(sides, resting & (sides * risen <= 0))


def _first_root(
    ends: tuple[Array, Array], rises: tuple[Array, Array], reversed_: Bool[Array, " states"]
) -> State:
    """Where, of a step, cubics through values of other signs at its ends are zero."""
    # Others get a line whose root is harmless.
    first, last = (jnp.where(reversed_, v, other) for v, other in zip(ends, (-0.5, 0.5)))
    begins, leaves = (jnp.where(reversed_, r, 1.0) for r in rises)
    square = 3 * (last - first) - 2 * begins - leaves
    cube = 2 * (first - last) + begins + leaves

    least = FLAT * jax.lax.stop_gradient(jnp.abs(first) + jnp.abs(last))

    def newton(share: Array) -> Array:
        at, value = jax.lax.stop_gradient(share), first
        value = first + at * (begins + at * (square + at * cube))
        slope = jax.lax.stop_gradient(begins + at * (2 * square + 3 * at * cube))
        # Where v only just touches zero, when it does depends on next to anything.
        steep = jnp.where(slope < 0, -1.0, 1.0) * jnp.maximum(jnp.abs(slope), least)
        return jnp.clip(at - value / steep, 0.0, 1.0)

    # A loop is compiled once, where steps written out would be fused into each other.
    share = jax.lax.stop_gradient(first / (first - last))
    share = jax.lax.fori_loop(
        0, NEWTON_STEPS, lambda _, at: jax.lax.stop_gradient(newton(at)), share
    )
    return newton(share)
