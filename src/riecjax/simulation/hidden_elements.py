"""Hidden modes written out for a simulation: two more states each, and their force on the body.

With velocity v of the body, w of the mass, and deflection d,

    d' = v - w,    M w' = f,    f = K d + B (v - w),

and every equation that accelerates the body gains f, with the sign of its inertia. No acceleration
is in f, so that the equations have no more unknowns than without modes.

Springs in series with force elements, written out for a simulation: one more state each.

With f the force of both, v the velocity across them and v_in(f) that across the element alone,

    f' = K (v - v_in(f)),

v_in being the inverse of the element's law: f / c of a linear one, and of a piecewise linear map
through (v_i, F_i) the map through (F_i, v_i). The law must rise; where values tried on the way to
an answer do not, a least slope stands in for them.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from riecjax.equations.bases import RoofFunctions
from riecjax.equations.equation import Equation
from riecjax.equations.expressions import difference
from riecjax.equations.hidden_elements import (
    HiddenMode,
    ModeParameters,
    SeriesSpring,
    element_sign,
    inertia_sign,
    stiffness_name,
)
from riecjax.equations.term import AbstractTerm, Term, Terms
from riecjax.errors import ModelError
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


LEAST_SLOPE = 0.01
"""Of a map, as a share of its mean slope."""


class SpringElement(eqx.Module):
    """A force element with a spring in series.

    **Fields:** `element`, its term; `state`, the name of its force, and the force's `unit`;
    `stiffness`, the name of the spring's parameter.
    """

    element: AbstractTerm
    state: str = eqx.field(static=True)
    unit: str = eqx.field(static=True)
    stiffness: str = eqx.field(static=True)

    def rate(
        self, velocity: Float[Array, " 1"], force: Float[Array, " 1"], values: Mapping[str, Array]
    ) -> Float[Array, " 1"]:
        """Time derivative of the force."""
        own = jnp.stack([values[name] for name in self.element.parameters])
        return values[self.stiffness] * (velocity - self._inner(own, force))

    def static(
        self, velocity: Float[Array, " n"], values: Mapping[str, Array]
    ) -> Float[Array, " n"]:
        """The force at a velocity that does not change: the spring takes up none of it."""
        own = jnp.stack([values[name] for name in self.element.parameters])
        if isinstance(self.element, Term):
            return own[0] * velocity
        assert isinstance(self.element, Terms)
        assert isinstance(self.element.basis, RoofFunctions)
        forces = _rising(own, self.element.basis.break_points)
        return self.element.basis.interpolate(forces, velocity)

    def _inner(self, values: Float[Array, " p"], force: Float[Array, " 1"]) -> Float[Array, " 1"]:
        if isinstance(self.element, Term):
            return force / values[0]
        assert isinstance(self.element, Terms)
        assert isinstance(self.element.basis, RoofFunctions)
        points = self.element.basis.break_points
        return RoofFunctions(_rising(values, points)).interpolate(points, force)


def _rising(forces: Float[Array, " points"], at: Float[Array, " points"]) -> Array:
    """The same map where it rises, and one of least slope where it does not."""
    mean = jnp.abs((forces[-1] - forces[0]) / (at[-1] - at[0]))
    least = LEAST_SLOPE * jnp.where(mean > 0, mean, 1.0) * jnp.diff(at)
    rises = jnp.maximum(jnp.diff(forces), least)
    return forces[0] + jnp.concatenate([jnp.zeros(1, forces.dtype), jnp.cumsum(rises)])


def with_springs(
    equations: tuple[Equation, ...], springs: Sequence[SeriesSpring]
) -> tuple[tuple[Equation, ...], tuple[SpringElement, ...]]:
    """Equations that hold elements' forces in the elements' places, and these elements.

    **Raises:** `ModelError` for an element whose law has no inverse that is known.
    """
    found = tuple(_element(number, spring, equations) for number, spring in enumerate(springs))
    replaced = []
    for equation in equations:
        terms = []
        for term in equation.terms:
            name = next((f.state for f, s in zip(found, springs) if s.of in term.parameters), None)
            terms.append(term if name is None else Term(element_sign(term), name))
        replaced.append(
            Equation(*terms, name=equation.name, unit=equation.unit, where=equation.where)
        )
    return tuple(replaced), found


def _element(number: int, spring: SeriesSpring, equations: Sequence[Equation]) -> SpringElement:
    first = next(e for equation in equations if (e := spring.element(equation)) is not None)
    if isinstance(first, Terms) and not isinstance(first.basis, RoofFunctions):
        raise ModelError(
            f"a spring in series with {first.prefix} needs the inverse of its law, which is known "
            f"of one coefficient and of roof functions (rx.roof) only."
        )
    name = "series_force" if number == 0 else f"series_{number + 1}_force"
    force = next((e.unit for e in equations if spring.element(e) is not None), "")
    return SpringElement(first, name, force, stiffness_name(number))
