"""A system to simulate, made from the very equations that were identified.

Let z be the unknowns: the highest derivative of each signal that moves, and what static equations
such as F_t = K_t x1 determine (`motions` reads off which these are). Mechanics is linear in its
accelerations, so the residuals r of all equations are affine in z,

    r(z) = r0 + J z,    and they vanish at    z = -J^-1 r0,

which is what a solver of differential equations asks for. r0 is r(0). Column i of J is the forward
derivative of r along e_i: exact for any expression that reads z linearly, where a difference
quotient would round, and all columns share one linearisation. J holds masses and their couplings;
for one unknown z is a division.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from riecjax.equations.equation import Equation
from riecjax.equations.expressions import Expression
from riecjax.equations.procedure import Procedure, as_procedure
from riecjax.equations.term import AbstractTerm, Term, Terms
from riecjax.errors import ModelError, users_code
from riecjax.leaves import is_concrete
from riecjax.linear_algebra import solve_few
from riecjax.records.signals import Signals
from riecjax.simulation.hidden_modes import carried_states, with_forces
from riecjax.simulation.motions import (
    Structure,
    derivative_name,
    label_of,
    read_structure,
    signals_read,
)
from riecjax.simulation.reversals import regime_at
from riecjax.simulation.series_springs import SpringElement, with_springs
from riecjax.simulation.system import AbstractSystem, Quantities


class EquationSystem(AbstractSystem):
    """Equations with values for their coefficients, as a system; see [`equation_system`][].

    Values are array leaves and the structure is static: new values compile nothing anew.
    """

    equations: tuple[Equation, ...]
    values: dict[str, Array]
    structure: Structure = eqx.field(static=True)
    units: tuple[tuple[str, str], ...] = eqx.field(static=True)
    elements: tuple[SpringElement, ...] = ()

    @property
    def states(self) -> Quantities:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Signals and first derivatives below leading ones, and those of hidden elements."""
        return self._with_units(self.structure.states)

    @property
    def inputs(self) -> Quantities:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Every other signal that the equations read."""
        return self._with_units(self.structure.inputs)

    @property
    def outputs(self) -> Quantities:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Leading derivatives under their recorded names, and what static equations determine."""
        rates = {f"d{name}" for name in self.structure.states}
        return self._with_units([n for n in self.structure.unknowns if n not in rates])

    @property
    def reversing(self) -> tuple[str, ...]:
        """States at whose zero the equations jump: velocities with dry friction."""
        return self.structure.reversing

    @property
    def carried(self) -> Mapping[str, str]:
        """States of hidden modes, and forces of springs."""
        return carried_states(self.structure.modes) | dict.fromkeys(self.structure.forces, "")

    def carried_levels(
        self, signals: Mapping[str, Float[Array, " n"]]
    ) -> Mapping[str, Float[Array, " n"]]:
        """As of any system, and the forces that elements have where their springs are at rest."""
        found = dict(super().carried_levels(signals))
        for one in self.elements:
            of = one.element.of
            if not one.element.derivative and set(signals_read(of)) <= signals.keys():
                with users_code(f"the expression {label_of(of)}"):
                    across = signals[of] if isinstance(of, str) else of(Signals(dict(signals)))
                found[one.state] = one.static(jnp.asarray(across), self.values)
        return found

    @property
    def velocity_of(self) -> Mapping[str, str]:
        """State to the state that is its time derivative."""
        return {m.signal: m.names[1] for m in self.structure.motions if len(m.names) == 3}

    def derivative(
        self, state: Float[Array, " states"], inputs: Float[Array, " inputs"]
    ) -> Float[Array, " states"]:
        """Time derivative of the state, by solving the equations for their unknowns."""
        flow = self._flow(self._solved(self._known_signals(state, inputs)))
        return jnp.concatenate([flow[name] for name in self.state_names])

    def output(
        self, state: Float[Array, " states"], inputs: Float[Array, " inputs"]
    ) -> Mapping[str, Float[Array, ""]]:
        """Leading derivatives under their recorded names, and what static equations determine.

        At rest under dry friction, which does not name a force, a mass that sticks has none of the
        first, and one that is let go has that of the side it leaves on.
        """
        if not self.reversing:
            signals = self._solved(self._known_signals(state, inputs))
            return {name: signals[name][0] for name, _ in self.outputs}
        regime = regime_at(self, state, inputs)
        signals = self._solved(self._known_signals(regime.seen(state), inputs))
        held = {
            following: regime.stuck[self.state_names.index(name)]
            for motion in self.structure.motions
            for name, following in zip(motion.names, motion.names[1:])
        }
        return {
            name: jnp.where(held.get(name, False), 0.0, signals[name][0])
            for name, _ in self.outputs
        }

    @eqx.filter_jit
    def probed(
        self, state: Array, inputs: Array, unknowns: Array
    ) -> tuple[Float[Array, " n"], Float[Array, "n n"], Float[Array, " n"]]:
        """r0 and J at a point, and the residuals of some values of the unknowns."""
        signals = self._known_signals(state, inputs)
        whole = self._with_unknowns(signals, unknowns[:, None])
        return *self._linear(signals), self._residuals(whole)

    # Signals have shape (1,), so that an expression written for the samples of a record needs no
    # second version for a point.
    def _known_signals(self, state: Array, inputs: Array) -> dict[str, Array]:
        levels = {name: state[i : i + 1] for i, name in enumerate(self.structure.states)}
        return levels | {n: inputs[i : i + 1] for i, n in enumerate(self.structure.inputs)}

    def _solved(self, signals: dict[str, Array]) -> dict[str, Array]:
        """Known signals and unknowns."""
        rest, slopes = self._linear(signals)
        return self._with_unknowns(signals, solve_few(slopes, -rest)[:, None])

    def _with_unknowns(self, signals: dict[str, Array], unknown: Array) -> dict[str, Array]:
        return {**signals, **dict(zip(self.structure.unknowns, unknown))}

    def _linear(self, signals: dict[str, Array]) -> tuple[Array, Array]:
        count = len(self.structure.unknowns)
        zero = jnp.zeros((count, 1), next(iter(signals.values())).dtype)
        residuals, push = jax.linearize(
            lambda z: self._residuals(self._with_unknowns(signals, z)), zero
        )
        along = jnp.eye(count, dtype=zero.dtype)
        return residuals, jnp.stack([push(along[i][:, None]) for i in range(count)], axis=-1)

    def _residuals(self, signals: dict[str, Array]) -> Float[Array, " equations"]:
        """What each equation leaves of one sample of all signals and unknowns."""
        zero = jnp.zeros((), next(iter(signals.values())).dtype)
        sums = [
            sum((self._term(term, signals) for term in equation.terms), start=zero)
            for equation in self.equations
        ]
        return jnp.stack(sums)

    def _term(self, term: AbstractTerm, signals: dict[str, Array]) -> Array:
        values = [self.values[name] for name in term.parameters]
        if isinstance(term, Terms):
            functions = term.basis(self._expression(term, signals))[:, 0]
            return jnp.asarray(term.sign) * jnp.stack(values) @ functions
        assert isinstance(term, Term)
        factor = jnp.asarray(term.number) * (values[0] if values else 1.0)
        return factor * self._expression(term, signals)[0]

    def _expression(self, term: AbstractTerm, signals: dict[str, Array]) -> Float[Array, " 1"]:
        """The term's expression, differentiated in time as often as the term says.

        Of an expression f of states x the chain rule gives d/dt f = f'(x) x', a forward derivative
        along the flow, and of that once more the second: no formula is differentiated by hand.
        """
        if isinstance(term.of, str):
            return signals[derivative_name(term.of, term, self.structure.motions)]
        of = term.of

        def level(states: dict[str, Array]) -> Array:
            # A constant may be one number for all samples.
            return jnp.atleast_1d(jnp.asarray(of(Signals({**signals, **states}))))

        def rate(function: Callable[[dict[str, Array]], Array]):
            def along_motion(states: dict[str, Array]) -> Array:
                return jax.jvp(function, (states,), (self._flow({**signals, **states}),))[1]

            return along_motion

        for _ in range(term.derivative):
            level = rate(level)
        with users_code(f"the expression {label_of(of)}"):
            return level({name: signals[name] for name in self.structure.states})

    def _flow(self, signals: Mapping[str, Array]) -> dict[str, Array]:
        """Time derivative of every state signal."""
        flow = {
            name: signals[following]
            for motion in self.structure.motions
            for name, following in zip(motion.names, motion.names[1:])
        }
        for name, expression in self.structure.rates:
            flow[name] = (
                signals[expression]
                if isinstance(expression, str)
                else jnp.atleast_1d(jnp.asarray(expression(Signals(signals))))
            )
        for mode in self.structure.modes:
            flow |= mode.rates(signals, self.values)
        for one in self.elements:
            across = self._expression(one.element, dict(signals))
            flow[one.state] = one.rate(across, signals[one.state], self.values)
        return flow

    def _with_units(self, names: Sequence[str]) -> Quantities:
        units = dict(self.units)
        return tuple((name, units.get(name, "")) for name in names)


def equation_system(
    model: Equation | Procedure,
    values: Mapping[str, Array | float],
    *,
    rates: Mapping[str, Expression] | None = None,
    inputs: Sequence[str] = (),
    units: Mapping[str, str] | None = None,
) -> EquationSystem:
    """The system that equations describe, to be simulated, linearised and validated.

    The highest derivative of each signal in the equations leads: a second derivative of `y` makes
    `y` and its first derivative states, a first derivative of `x4` makes `x4` a state. A
    derivative has the name that `measured` of its term gives it, else a `d` before the signal's,
    and may be read under that name by any term. Every other signal that is read is an input. There
    must be one equation for each leading derivative, which may appear in several.

    A static equation beside dynamic ones determines a quantity, an output: the first plain signal
    with a number for coefficient, as `Term(1.0, "F_t")` in F_t = K_t x1. `where` of an equation
    says which samples to identify from and means nothing here.

    A hidden mode has two further states, `mode_deflection` (body minus mass) and `mode_velocity`,
    of a second one `mode_2_deflection` and `mode_2_velocity`. An element with a spring in series
    has its force, `series_force`, of a second one `series_2_force`.

    **Arguments:**

    - `values`: value of every coefficient, scalars; for those with a `known` value it may be left
      out. Others are ignored.
    - `rates`: further states by their time derivative, signal name to expression: kinematics such
      as `{"x2": difference("x3", "x4")}` that no coefficient appears in.
    - `inputs`: signals to take as inputs although their derivative appears, as of a base that is
      moved; the derivative is an input too, under its name from `measured`.
    - `units`: signal name to unit.

    **Raises:** `ModelError` if a coefficient has no value; if the equations cannot be simulated
    because none holds a derivative, their number is not that of the unknowns, a derivative is of
    third order or of an expression of inputs; or, with values that can be looked at, if the
    leading coefficient is zero or the unknowns do not enter linearly.
    """
    procedure = as_procedure(model)
    equations = tuple(equation for stage in procedure.stages for equation in stage)
    label = " + ".join(equation.name for equation in equations)
    numbers = _numbers(label, procedure, values)
    equations, elements = with_springs(equations, procedure.springs)
    equations, modes = with_forces(equations, procedure.modes)
    rates = {**{one.state: one for one in procedure.memories}, **(rates or {})}
    structure = read_structure(label, equations, rates, frozenset(inputs), modes, elements)
    own = {k: v for m in modes for k, v in zip((m.deflection, m.velocity), m.units)}
    own |= {one.state: one.unit for one in elements}
    named = tuple(sorted((own | dict(units or {})).items()))
    system = EquationSystem(equations, numbers, structure, named, elements)
    if is_concrete(equations, numbers):
        _check_solvable(label, system)
    return system


def _numbers(
    label: str, procedure: Procedure, values: Mapping[str, Array | float]
) -> dict[str, Array]:
    known: dict[str, Any] = {**procedure.known, **values}
    names = procedure.parameters
    if missing := [name for name in names if name not in known]:
        raise ModelError(f"{label}: no value is given for {', '.join(missing)}.")
    numbers = {name: jnp.asarray(known[name], jnp.result_type(float)) for name in names}
    for name, number in numbers.items():
        if number.shape != ():
            raise ModelError(f"{label}: {name} must be one number; it has shape {number.shape}.")
    return numbers


def _check_solvable(label: str, system: EquationSystem) -> None:
    """Whether J is regular, and the residuals linear in the unknowns.

    At a point in general position, where an accidental zero is all but impossible. J is scaled by
    columns and rows first: its rank must not depend on the units of unknowns and equations.
    """
    for mode in system.structure.modes:
        if float(system.values[mode.parameters.mass]) == 0:
            raise ModelError(f"{label} cannot be simulated: {mode.parameters.mass} is zero.")
    for one in system.elements:
        if isinstance(one.element, Term) and float(system.values[one.element.parameters[0]]) == 0:
            which = one.element.parameters[0]
            raise ModelError(f"{label} cannot be simulated: {which}, a spring in series, is zero.")
    state = jnp.asarray(np.random.default_rng(0).uniform(0.2, 0.9, (2, len(system.states)))[0])
    level = jnp.asarray(np.linspace(0.3, 0.7, len(system.structure.inputs)))
    unknowns = system.structure.unknowns
    probe = np.random.default_rng(1).uniform(0.5, 1.5, len(unknowns))
    probed = system.probed(state, level, jnp.asarray(probe))
    rest, slopes, found = (np.asarray(part) for part in probed)
    columns = np.max(np.abs(slopes), axis=0, initial=0.0)
    rows = np.max(np.abs(slopes), axis=1, initial=0.0)
    if not np.all(np.isfinite(slopes)):
        raise ModelError(f"{label} cannot be simulated: its leading coefficients are not finite.")
    if not columns.all():
        which = unknowns[int(np.argmin(columns != 0))]
        raise ModelError(f"{label} cannot be simulated: the coefficient of {which} is zero.")
    scaled = slopes / columns / np.where(rows > 0, rows, 1.0)[:, None]
    if not rows.all() or np.linalg.matrix_rank(scaled / np.max(np.abs(scaled))) < len(unknowns):
        raise ModelError(
            f"{label} cannot be simulated: its equations are not independent in "
            f"{', '.join(unknowns)}."
        )
    size = np.abs(rest) + np.abs(slopes) @ probe
    if np.any(np.abs(found - rest - slopes @ probe) > 1e-4 * size):
        raise ModelError(
            f"{label} cannot be simulated: {', '.join(unknowns)} must enter its equations linearly."
        )
