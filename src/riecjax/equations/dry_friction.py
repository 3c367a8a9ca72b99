"""Equations of bodies with dry friction, where these move alone.

While a body sticks, friction is whatever balances the other forces and no function of the velocity
v, and next to standstill the sign of a recorded v is noise. Times a weight h(v) that vanishes at
rest the equation is true throughout, and its acceleration is a time derivative still:

    h(v) (m v' + sum_i c_i g_i) = 0,    h(v) v' = d/dt H(v),    H(v) = int_0^v h(u) du.

So no window is lost, those across a rest included, and every test function goes on to take the
derivative off. With r = v / width,

    h = r^2 / (1 + r^2),    H = v - width arctan(r).

h sign(v) has a slope everywhere, unlike sign(v): at a width of several standard deviations of the
noise on v, the correction for curved columns (`noisy_columns`) leaves next to nothing. A wrong sign
in the middle of a rest counts h, a correct one far from it counts 1.

Signals at whose zero a function jumps, as dry friction does at a velocity's.
"""

import functools
import operator
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from riecjax.equations.equation import Equation
from riecjax.equations.expressions import Expression, combined, evaluate, product
from riecjax.equations.term import AbstractTerm
from riecjax.leaves import Leaf, is_concrete, is_under_trace
from riecjax.records.faults.sampled_signal import Rest, rest_of
from riecjax.records.record import Record, Signals
from riecjax.records.signal import Signal

if TYPE_CHECKING:
    from riecjax.equations.model import Model

FAR = 1e6
"""Widths beyond which a weight is 1."""


class InMotion(AbstractTerm):
    """A term times the weight of a velocity; `accelerates` where it is a derivative of that."""

    term: AbstractTerm
    velocity: str = eqx.field(static=True)
    width: Leaf

    @property
    def parameters(self) -> tuple[str, ...]:
        """Those of the term."""
        return self.term.parameters

    @property
    def units(self) -> dict[str, str]:
        """Those of the term."""
        return self.term.units

    def expression(self, record: Record, order: int) -> Expression:
        """What reads all that the samples are made of."""
        # Whether this is of the velocity alone, and not of what the term is of.
        if self.term.derivative and not order:
            return self.velocity
        of = self.term.expression(record, self.term.derivative if order else 0)
        return product(self.velocity, of)

    def samples(self, record: Record, order: int) -> Signal:
        """Samples of the weighted term; see the base class."""
        velocity = evaluate(self.velocity, record)
        ratio = combined(lambda v: jnp.clip(v / self.width, -FAR, FAR), velocity)
        weight = combined(lambda r: r**2 / (1 + r**2), ratio)
        if order or not self.term.derivative:
            samples = self.term.samples(record, self.term.derivative if order else 0)
            return combined(lambda values, weight: values * weight[None], samples, weight)
        if self.derivative:
            of = combined(lambda v, r: v - self.width * jnp.arctan(r), velocity, ratio)
        else:
            of = combined(operator.mul, velocity, weight)
        return combined(lambda values: (jnp.asarray(self.term.factor) * values)[None], of)

    def __neg__(self) -> "InMotion":
        return eqx.tree_at(lambda own: own.term, self, -self.term)


def in_motion(model: "Model", record: Record) -> "Model":
    """The model with equations weighted where a velocity with dry friction rests.

    The same unless rests are to be masked, and under trace; and of hidden elements.
    """
    rests = {} if model.at_rest == "keep" or model.has_hidden else rests_of(model, record)

    def weighted(equation: Equation) -> Equation:
        velocities = reversing_states(equation.terms, sorted(rests), sorted(record.arrays))
        if len(velocities) != 1:
            return equation
        velocity, width = velocities[0], np.asarray(rests[velocities[0]].width)
        below = {of: 1 for of, name in equation.derivatives if name == velocity} | {velocity: 0}
        orders = [
            term.derivative - below.get(term.signal or "", -2) if term.derivative else 0
            for term in equation.terms
        ]
        # A term may be a derivative of something else.
        if max(orders) > 1:
            return equation
        terms = (
            InMotion(term=term, velocity=velocity, width=width, of=term.of, derivative=order)
            for term, order in zip(equation.terms, orders)
        )
        return equation.of_terms(*terms)

    stages = model.by_stage(weighted) if rests else model.stages
    equations = (equation for stage in stages for equation in stage)
    unchanged = all(a is b for a, b in zip(equations, model.equations))
    return model if unchanged else replace(model, stages=stages)


def rests_of(model: "Model", record: Record) -> dict[str, Rest]:
    """Rests of the signals at whose zero some equation jumps, by signal; none under trace."""
    is_batch = next(iter(record.arrays.values())).ndim != 1
    if is_batch or not is_concrete(model, record) or is_under_trace():
        return {}
    # First what costs no call of a user's function.
    found = {name: rest for name in record.arrays if (rest := rest_of(record, name)) is not None}
    if not found:
        return {}
    terms = [term for equation in model.equations for term in equation.terms]
    jumping = reversing_states(terms, sorted(found), sorted(record.arrays))
    return {name: rest for name, rest in found.items() if name in jumping}


ASIDE, JUMP = 1e-9, 1e-4
"""A velocity to either side of zero, and the share of itself that a function jumps by there."""


def reversing_states(
    terms: Iterable[AbstractTerm], states: Sequence[str], signals: Sequence[str]
) -> tuple[str, ...]:
    """States at whose zero a term jumps, as dry friction does of a velocity.

    **Arguments:** terms of `signals`, the states among these.
    """
    jumping: set[str] = set()
    for term in terms:
        continuous = term.is_linear or (term.basis is not None and term.basis.is_continuous)
        if not continuous:
            jumping |= _jumping(term.of, term.functions, tuple(states), tuple(signals))
        elif callable(term.of):
            jumping |= _jumping_alone(term.of, None, tuple(states), tuple(signals))
    return tuple(state for state in states if state in jumping)


def _jumping(
    of: Expression,
    functions: Callable[[Array], Array] | None,
    states: tuple[str, ...],
    signals: tuple[str, ...],
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
            values = np.asarray(samples if functions is None else functions(samples))
    except Exception:  # whatever is wrong with a user's function is said where it is used
        return set()
    if not values.shape or values.shape[-1] != len(states) * places.size:
        return set()
    above, below, far, other = np.moveaxis(values.reshape(-1, len(states), places.size), -1, 0)
    jumps = np.abs(above - below) > JUMP * np.maximum(np.abs(far), np.abs(other))
    return {state for state, jump in zip(states, np.atleast_1d(jumps.any(axis=0))) if jump}


_jumping_alone = functools.lru_cache(_jumping)
