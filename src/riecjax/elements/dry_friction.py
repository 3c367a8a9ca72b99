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
"""

import contextlib
import operator
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, ClassVar

import equinox as eqx
import numpy as np

from riecjax import arrays as xp
from riecjax.equations.element import Element
from riecjax.equations.equation import Equation
from riecjax.equations.expressions import Expression, combined, evaluate, product
from riecjax.equations.model import Model, with_rests
from riecjax.equations.term import AbstractTerm, reversing_states
from riecjax.errors import RiecjaxError
from riecjax.findings import Finding, in_percent
from riecjax.leaves import Leaf, size_of
from riecjax.records.faults.sampled_signal import Rest, rest_of
from riecjax.records.record import Record
from riecjax.records.signal import Signal

FAR = 1e6
"""Widths beyond which a weight is 1."""
MOVED = 2.0
"""Standard errors of the surer estimate from which on what is done at rest moves a parameter."""


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
    def unweighted(self) -> AbstractTerm:
        """The term."""
        return self.term

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
        ratio = combined(lambda v: xp.clip(v / self.width, -FAR, FAR), velocity)
        weight = combined(lambda r: r**2 / (1 + r**2), ratio)
        if order or not self.term.derivative:
            samples = self.term.samples(record, self.term.derivative if order else 0)
            return combined(lambda values, weight: values * weight[None], samples, weight)
        if self.derivative:
            of = combined(lambda v, r: v - self.width * xp.arctan(r), velocity, ratio)
        else:
            of = combined(operator.mul, velocity, weight)
        return combined(lambda values: (self.term.factor * values)[None], of)

    def __neg__(self) -> "InMotion":
        return eqx.tree_at(lambda own: own.term, self, -self.term)


class DryFrictionAtRest(Element):
    """Rests of a velocity at whose zero the equation of motion jumps.

    Every model has it. What is done there its `at_rest` says: `"mask"`, weights that vanish, or
    `"keep"`.
    """

    words: ClassVar = "dry friction at rest"

    def trusted(self, model: Model, record: Record) -> Model:
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

    def findings(
        self,
        model: Model,
        records: Sequence[Record],
        found: Any,
        otherwise: Callable[[Model], Any],
    ) -> list[Finding]:
        """That velocities rest, what was done about it, and what it did to the parameters."""
        rests = [rests_of(model, record) for record in records]
        names = tuple(dict.fromkeys(name for of in rests for name in of))
        if not names:
            return []
        count = sum(record.sample_count for record in records)
        shares = (max((rest.share for rest in of.values()), default=0.0) for of in rests)
        rested = sum(share * record.sample_count for share, record in zip(shares, records))
        masked = any(self.trusted(model, record) is not model for record in records)
        # Parameters that the other treatment moves, with both values.
        moved: dict[str, tuple[float, float]] = {}
        if masked or model.at_rest == "keep":
            with contextlib.suppress(RiecjaxError):
                beside = otherwise(with_rests(model, "keep" if model.at_rest == "mask" else "mask"))
                errors = np.minimum(*(np.asarray(one.standard_errors) for one in (found, beside)))
                pairs = {
                    name: (float(found[name]), float(beside[name])) for name in found.parameters
                }
                moved = {
                    name: (value, other)
                    for (name, (value, other)), error in zip(pairs.items(), errors)
                    if abs(other - value) > MOVED * error
                }
        width = max(rest.width for of in rests for rest in of.values())
        which = " and ".join(f"'{name}'" for name in names)
        if masked:
            done = f"weights that vanish there, over {width:.2g} to each side of zero, leave it out"
            change, step = "; with it", ""
        elif model.at_rest == "keep":
            done, change = "it was kept", "; without it"
            step = "Leave it out: at_rest='mask' (--at-rest mask)"
        else:
            done = (
                "it was kept, since the equation holds derivatives of other motions than this one"
            )
            change, step = "", "Mask it in the equation: where=rx.equations.faster_than(...)"
        listed = ", ".join(f"{n} {a:.4g} would be {b:.4g}" for n, (a, b) in moved.items())
        message = (
            f"{which} is at rest {in_percent(rested / count)} of the time, where friction is "
            f"whatever balances the other forces; {done}{change + ' ' if moved else ''}{listed}."
        )
        doubts = {} if masked else {n: abs(b - a) / size_of(a) for n, (a, b) in moved.items()}
        if step:
            message += f" {step}."
        options = ("--at-rest", "mask") if moved and not masked else ()
        return [Finding("at_rest", message, names, tuple(doubts), 0.0, doubts, options, step)]


def rests_of(model: Model, record: Record) -> dict[str, Rest]:
    """Rests of the signals at whose zero some equation jumps, by signal; none under trace."""
    is_batch = next(iter(record.arrays.values())).ndim != 1
    if is_batch or not xp.is_concrete(model, record):
        return {}
    terms = [term for equation in model.equations for term in equation.terms]
    names = sorted(record.arrays)
    jumping = reversing_states(terms, names, names)
    rests = {name: rest_of(record, name) for name in record.arrays if name in jumping}
    return {name: rest for name, rest in rests.items() if rest is not None}
