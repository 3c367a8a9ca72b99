"""Hidden modes attached to a system that was written by hand.

Where the body's acceleration is coupled to no other, as in m v' = F(x, u), a force f that is taken
from the body changes v' by f / m and nothing else: the system need not be known from the inside.
Whether that is so, its equations tell.
"""

from collections.abc import Mapping
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from riecjax.equations.procedure import Procedure
from riecjax.errors import ModelError
from riecjax.leaves import Leaf
from riecjax.simulation.equation_system import EquationSystem, equation_system
from riecjax.simulation.hidden_elements import ModeStates, carried_states
from riecjax.simulation.system import AbstractSystem, Quantities


class AttachedMode(eqx.Module):
    """A mode on a body.

    **Fields:** `body_mass`, by which the body's acceleration is the force on it divided; `mass`,
    `stiffness` and `damping` of the mode; `states`, their names and that of the body's velocity.
    """

    body_mass: Leaf
    mass: Leaf
    stiffness: Leaf
    damping: Leaf
    states: ModeStates = eqx.field(static=True)


class WithModes(AbstractSystem):
    """A system some of whose bodies carry hidden modes.

    Exact where a body's acceleration is coupled to no other. Outputs are those of the system
    without modes: forces that depend on its states, not accelerations.

    **Fields:** `inner`, the system; `modes`.
    """

    inner: AbstractSystem
    modes: tuple[AttachedMode, ...]

    @property
    def states(self) -> Quantities:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The system's, then deflection and velocity of each mode."""
        names = [n for m in self.modes for n in (m.states.deflection, m.states.velocity)]
        units = [unit for mode in self.modes for unit in mode.states.units]
        return (*self.inner.states, *zip(names, units))

    @property
    def inputs(self) -> Quantities:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The system's."""
        return self.inner.inputs

    @property
    def outputs(self) -> Quantities:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The system's."""
        return self.inner.outputs

    @property
    def reversing(self) -> tuple[str, ...]:
        """The system's."""
        return self.inner.reversing

    @property
    def velocity_of(self) -> Mapping[str, str]:
        """The system's."""
        return self.inner.velocity_of

    @property
    def carried(self) -> Mapping[str, str]:
        """The modes' states."""
        return {**self.inner.carried, **carried_states(mode.states for mode in self.modes)}

    def derivative(
        self, state: Float[Array, " states"], inputs: Float[Array, " inputs"]
    ) -> Float[Array, " states"]:
        """Time derivative of the state, each body's less what its modes take."""
        count = len(self.inner.states)
        flow = self.inner.derivative(state[:count], inputs)
        signals = dict(zip(self.state_names, state))
        rates = []
        for mode in self.modes:
            names = mode.states
            values = dict(zip(names.parameters, (mode.mass, mode.stiffness, mode.damping)))
            own = names.rates(signals, values)
            taken = mode.mass * own[names.velocity] / mode.body_mass
            flow = flow.at[self.inner.state_names.index(names.body)].add(-taken)
            rates += [own[names.deflection], own[names.velocity]]
        return jnp.concatenate([flow, jnp.stack(rates)])

    def output(
        self, state: Float[Array, " states"], inputs: Float[Array, " inputs"]
    ) -> Mapping[str, Float[Array, ""]]:
        """The system's."""
        return self.inner.output(state[: len(self.inner.states)], inputs)


class Attachment(NamedTuple):
    """How a mode of a procedure is attached: its states, and the body's mass, named or known."""

    states: ModeStates
    body_mass: str | float

    def attached(self, values: Mapping[str, Leaf]) -> AttachedMode:
        """The mode with these values."""
        body = values[self.body_mass] if isinstance(self.body_mass, str) else self.body_mass
        mass, stiffness, damping = (jnp.asarray(values[n]) for n in self.states.parameters)
        return AttachedMode(jnp.asarray(body), mass, stiffness, damping, self.states)


def attachments(procedure: Procedure, inner: AbstractSystem) -> tuple[Attachment, ...] | None:
    """How modes of a procedure are attached to the system that it is of.

    **Returns:** `None` where the body's velocity is no state of the system, or where the equations
    say that its acceleration is coupled to others. Of equations that cannot be simulated, it is
    taken for granted that it is not.
    """
    equations = [equation for stage in procedure.stages for equation in stage]
    found = []
    for number, mode in enumerate(procedure.modes):
        states = ModeStates.of(number, mode, equations)
        inertia = next(term for e in equations if (term := mode.inertia(e)) is not None)
        mass = abs(float(inertia.number)) if inertia.name is None else inertia.name
        if states.body not in inner.state_names:
            return None
        found.append(Attachment(states, mass))
    generic = np.random.default_rng(0).uniform(0.5, 1.5, len(procedure.parameters))
    values = dict(zip(procedure.parameters, generic))
    try:
        system = equation_system(procedure, values)
    except ModelError:
        return tuple(found)
    return tuple(found) if all(_uncoupled(system, one, values) for one in found) else None


def _uncoupled(system: EquationSystem, one: Attachment, values: Mapping[str, float]) -> bool:
    """Whether a mode's spring accelerates its body by force over mass, and changes nothing else."""
    unknowns = system.structure.unknowns
    state = np.random.default_rng(1).uniform(0.2, 0.9, len(system.states))
    level = jnp.asarray(np.linspace(0.3, 0.7, len(system.inputs)))
    none = jnp.zeros(len(unknowns))
    stretched = state + (np.array(system.state_names) == one.states.deflection)
    before, slopes, _ = system.probed(jnp.asarray(state), level, none)
    after, _, _ = system.probed(jnp.asarray(stretched), level, none)
    change = -np.linalg.solve(np.asarray(slopes), np.asarray(after - before))
    bodies = [motion for motion in system.structure.motions if one.states.body in motion.names]
    if not bodies:
        return False
    mass = values[one.body_mass] if isinstance(one.body_mass, str) else one.body_mass
    expected = np.zeros(len(unknowns))
    stiffness = values[one.states.parameters.stiffness]
    expected[unknowns.index(bodies[0].names[-1])] = -stiffness / mass
    rounding = 1e3 * np.finfo(change.dtype).eps
    return bool(np.allclose(change, expected, rtol=rounding, atol=rounding * np.max(abs(expected))))
