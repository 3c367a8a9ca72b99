"""Hidden modes written out for a simulation: two more states each, and their force on the body.

With velocity v of the body, w of the mass, and deflection d,

    d' = v - w,    M w' = f,    f = K d + B (v - w),

and every equation that accelerates the body gains f, with the sign of its inertia. No acceleration
is in f, so that the equations have no more unknowns than without modes.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array

from riecjax.equations.equation import Equation
from riecjax.equations.expressions import difference
from riecjax.equations.hidden_modes import HiddenMode, ModeParameters, inertia_sign
from riecjax.equations.term import Term
from riecjax.leaves import Leaf


class ModeStates(NamedTuple):
    """Names of a mode's states, and of what they depend on.

    **Fields:** `deflection`, body minus mass; `velocity` of the mass; `body`, the signal that is
    the body's velocity; `parameters`; `units` of the two states.
    """

    deflection: str
    velocity: str
    body: str
    parameters: ModeParameters
    units: tuple[str, str]

    @classmethod
    def of(cls, number: int, mode: HiddenMode, equations: Sequence[Equation]) -> "ModeStates":
        """Of the mode with this number, from 0, that some of the equations have."""
        name = "mode" if number == 0 else f"mode_{number + 1}"
        parameters = ModeParameters.of(number)
        mass = mode.units(number, equations)[parameters.mass]
        units = {"kg": ("m", "m/s"), "kg m^2": ("rad", "rad/s")}.get(mass, ("", ""))
        body = body_velocity(mode, equations)
        return cls(f"{name}_deflection", f"{name}_velocity", body, parameters, units)

    def rates(self, signals: Mapping[str, Array], values: Mapping[str, Leaf]) -> dict[str, Array]:
        """Time derivatives of the two states."""
        mass, stiffness, damping = (jnp.asarray(values[name]) for name in self.parameters)
        stretching = signals[self.body] - signals[self.velocity]
        force = stiffness * signals[self.deflection] + damping * stretching
        return {self.deflection: stretching, self.velocity: force / mass}

    def force(self, sign: Leaf) -> tuple[Term, Term]:
        """Terms of the force in an equation whose inertia has this sign."""
        _, stiffness, damping = self.parameters
        return (
            Term(stiffness, self.deflection, sign=sign),
            Term(damping, difference(self.body, self.velocity), sign=sign),
        )


def body_velocity(mode: HiddenMode, equations: Sequence[Equation]) -> str:
    """The signal that is the velocity of a mode's body."""
    inertia = next(term for e in equations if (term := mode.inertia(e)) is not None)
    if inertia.derivative == 1:
        return mode.on
    terms = [term for e in equations for term in e.terms if term.of == inertia.of]
    named = (t.measured[0] for t in terms if isinstance(t, Term) and t.derivative and t.measured)
    return next(named, f"d{inertia.of}")


def with_forces(
    equations: tuple[Equation, ...], modes: Sequence[HiddenMode]
) -> tuple[tuple[Equation, ...], tuple[ModeStates, ...]]:
    """Equations with the forces of their modes, and the states that these read."""
    states = tuple(ModeStates.of(number, mode, equations) for number, mode in enumerate(modes))
    carrying = []
    for equation in equations:
        terms = list(equation.terms)
        for mode, own in zip(modes, states):
            if (inertia := mode.inertia(equation)) is not None:
                terms += own.force(inertia_sign(inertia))
        carrying.append(
            Equation(*terms, name=equation.name, unit=equation.unit, where=equation.where)
            if len(terms) > len(equation.terms)
            else equation
        )
    return tuple(carrying), states


def carried_states(modes: Iterable[ModeStates]) -> dict[str, str]:
    """States of modes to what they start from: the body's velocity, or nothing."""
    found: dict[str, str] = {}
    for mode in modes:
        found |= {mode.deflection: "", mode.velocity: mode.body}
    return found
