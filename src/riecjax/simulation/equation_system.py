"""Equations of motion read as a system: which signals are states, inputs and unknowns.

No equation says which of its signals is the state; the derivatives that appear do. Let q^(k) be
the highest derivative of a signal q in any of the equations. Then q, ..., q^(k-1) are states and
q^(k) is an unknown, for which the equations are solved at every instant. Names tie derivatives
together: where a term calls the derivative of x3 "x4", the derivative of x4 is the second one of
x3, and x4 is no state beside x3' but the same one.

What a static equation determines is an unknown too, and whatever else is read must be given: an
input. With as many equations as unknowns the system is square; whether it is regular depends on
the coefficients, and is checked where they are known.

A system to simulate, made from the very equations that were identified.

Let z be the unknowns: the highest derivative of each signal that moves, and what static equations
such as F_t = K_t x1 determine (`motions` reads off which these are). Mechanics is linear in its
accelerations, so the residuals r of all equations are affine in z,

    r(z) = r0 + J z,    and they vanish at    z = -J^-1 r0,

which is what a solver of differential equations asks for. r0 is r(0). Column i of J is the forward
derivative of r along e_i: exact for any expression that reads z linearly, where a difference
quotient would round, and all columns share one linearisation. J holds masses and their couplings;
for one unknown z is a division.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from riecjax.equations.dry_friction import reversing_states
from riecjax.equations.equation import Equation
from riecjax.equations.expressions import Expression
from riecjax.equations.procedure import Procedure, as_procedure
from riecjax.equations.term import AbstractTerm, Term, Terms
from riecjax.errors import ModelError, users_code
from riecjax.leaves import is_concrete
from riecjax.linear_algebra import solve_few
from riecjax.records.signals import Signals
from riecjax.simulation.hidden_elements import (
    ModeStates,
    SpringElement,
    carried_states,
    with_forces,
    with_springs,
)
from riecjax.simulation.reversals import regime_at
from riecjax.simulation.system import AbstractSystem, Quantities


class Motion(NamedTuple):
    """A signal, and the names of its derivatives up to the leading one, itself first."""

    signal: str
    names: tuple[str, ...]


class Structure(NamedTuple):
    """What each signal of the equations is.

    **Fields:** `motions`; `rates`, expressions for the derivatives of further states;
    `determined`, signals that static equations determine; `inputs`; `reversing`, states at whose
    zero the equations jump; `modes` that are hidden, each two further states; `forces` of elements
    with a spring in series, each a state.
    """

    motions: tuple[Motion, ...]
    rates: tuple[tuple[str, Expression], ...]
    determined: tuple[str, ...]
    inputs: tuple[str, ...]
    reversing: tuple[str, ...] = ()
    modes: tuple[ModeStates, ...] = ()
    forces: tuple[str, ...] = ()

    @property
    def states(self) -> tuple[str, ...]:
        """Signals and derivatives below the leading one, those with a rate, and hidden ones."""
        lower = (name for motion in self.motions for name in motion.names[:-1])
        hidden = (name for mode in self.modes for name in (mode.deflection, mode.velocity))
        return (*lower, *(name for name, _ in self.rates), *hidden, *self.forces)

    @property
    def unknowns(self) -> tuple[str, ...]:
        """What the equations are solved for: leading derivatives, and determined signals."""
        return (*(motion.names[-1] for motion in self.motions), *self.determined)


def read_structure(
    label: str,
    equations: tuple[Equation, ...],
    rates: Mapping[str, Expression],
    inputs: frozenset[str],
    modes: tuple[ModeStates, ...] = (),
    elements: tuple[SpringElement, ...] = (),
) -> Structure:
    """The structure of equations that are to be simulated, the forces of their modes among them,
    and of elements with a spring in series their forces.

    **Raises:** `ModelError` if they cannot be, whatever their coefficients; see
    [`equation_system`][].
    """
    motions = _motions(label, equations, inputs, rates)
    determined = tuple(
        _determined(label, equation, motions, rates)
        for equation in equations
        if not _is_dynamic(equation, motions)
    )
    forces = tuple(one.state for one in elements)
    structure = Structure(motions, tuple(rates.items()), determined, (), (), modes, forces)
    _check_count(label, equations, structure.unknowns)
    settled = {*structure.states, *structure.unknowns}
    terms = [(equation.name, term) for equation in equations for term in equation.terms]
    read = _expressions([*terms, *((label, one.element) for one in elements)], motions)
    reads = dict.fromkeys(name for each in (*read, *rates.values()) for name in signals_read(each))
    structure = structure._replace(inputs=tuple(name for name in reads if name not in settled))
    _check_derivatives(label, equations, structure)
    functions = [
        (term.of, term.basis if isinstance(term, Terms) else None)
        for equation in equations
        for term in equation.terms
    ]
    signals = (*structure.states, *structure.unknowns, *structure.inputs)
    return structure._replace(reversing=reversing_states(functions, structure.states, signals))


def _motions(
    label: str,
    equations: tuple[Equation, ...],
    inputs: frozenset[str],
    rates: Mapping[str, Expression],
) -> tuple[Motion, ...]:
    """State signals in order of appearance, with the order of their leading derivative."""
    terms = [
        term
        for equation in equations
        for term in equation.terms
        if isinstance(term.of, str) and term.of not in inputs and term.of not in rates
    ]
    of_signals = [term for term in terms if isinstance(term, Term) and term.derivative > 0]
    names: dict[str, str] = {}
    for term in of_signals:
        for lower, higher in zip((str(term.of), *term.measured), term.measured):
            names.setdefault(lower, higher)
    for term in of_signals:
        name = str(term.of)
        for _ in range(term.derivative):
            name = names.setdefault(name, f"d{name}")
    below = {higher: lower for lower, higher in names.items()}
    positions = {str(term.of) for term in of_signals}
    order: dict[str, int] = {}
    for term in of_signals:
        # A derivative of a velocity is one of the position, where the position is in the equations.
        ancestors = [str(term.of)]
        while ancestors[-1] in below:
            ancestors.append(below[ancestors[-1]])
        steps = max(i for i, name in enumerate(ancestors) if name in positions)
        signal, rise = ancestors[steps], term.derivative + steps
        order[signal] = max(order.get(signal, 0), rise)
    motions = []
    for signal, rise in order.items():
        if rise > 2:
            raise ModelError(
                f"{label} cannot be simulated: it holds a derivative of order {rise} of {signal}."
            )
        chain = [signal]
        while len(chain) <= rise:
            chain.append(names.get(chain[-1], f"d{chain[-1]}"))
        motions.append(Motion(signal, tuple(chain)))
    if not motions:
        raise ModelError(f"{label} cannot be simulated: {_why_static(equations)}")
    return tuple(motions)


def _why_static(equations: tuple[Equation, ...]) -> str:
    """Why no signal is a state, and what to write."""
    for equation in equations:
        for term in equation.terms:
            if term.derivative and not isinstance(term.of, str):
                read = ", ".join(signals_read(term.of))
                return (
                    f"it holds a derivative of the expression {label_of(term.of)} (of {read}) and "
                    f"no derivative of a signal, so that no signal is a state. Make the expression "
                    f"a signal first (on the command line: --derive NAME=FORMULA), and write the "
                    f"term of that name."
                )
    return (
        "it holds no derivative of a signal, so it is static and says nothing about motion. Write "
        "what moves as a derivative, such as Term('m', 'x', derivative=2)."
    )


def derivative_name(signal: str, term: AbstractTerm, motions: tuple[Motion, ...]) -> str:
    """Under which name a term's derivative of a signal is to be read."""
    if not term.derivative:
        return signal
    for motion in motions:
        if signal in motion.names:
            return motion.names[motion.names.index(signal) + term.derivative]
    measured = term.measured if isinstance(term, Term) else ()
    if term.derivative > len(measured):
        raise ModelError(
            f"a derivative of {signal} is needed and cannot be formed: name the signal that holds "
            f"it (measured=...)."
        )
    return measured[term.derivative - 1]


def _is_dynamic(equation: Equation, motions: tuple[Motion, ...]) -> bool:
    leading = {motion.names[-1] for motion in motions}
    for term in equation.terms:
        if isinstance(term.of, str):
            if derivative_name(term.of, term, motions) in leading:
                return True
        elif term.derivative or leading & set(signals_read(term.of)):
            return True
    return False


def _determined(
    label: str, equation: Equation, motions: tuple[Motion, ...], rates: Mapping[str, Expression]
) -> str:
    """The signal that a static equation determines."""
    settled = {name for motion in motions for name in motion.names} | set(rates)
    for term in equation.terms:
        free = not term.parameters and isinstance(term.of, str) and not term.derivative
        if free and term.of not in settled:
            return str(term.of)
    raise ModelError(
        f"{label} cannot be simulated: {equation.name} holds no leading derivative, and no signal "
        f"with a number for coefficient that it could determine."
    )


def _check_count(label: str, equations: tuple[Equation, ...], unknowns: tuple[str, ...]) -> None:
    if repeated := {name for name in unknowns if unknowns.count(name) > 1}:
        raise ModelError(
            f"{label} cannot be simulated: two equations determine {', '.join(sorted(repeated))}."
        )
    if len(equations) == len(unknowns):
        return
    remedy = (
        "Leave out those that follow from the others."
        if len(equations) > len(unknowns)
        else "Add equations, or name those signals that are measured as inputs (inputs=...)."
    )
    raise ModelError(
        f"{label} cannot be simulated: {len(equations)} equation(s) for {len(unknowns)} unknown(s) "
        f"({', '.join(unknowns)}). {remedy}"
    )


def _expressions(
    terms: Sequence[tuple[str, AbstractTerm]], motions: tuple[Motion, ...]
) -> list[Expression]:
    """What terms read, each with the name of its equation."""
    found: list[Expression] = []
    for name, term in terms:
        if not isinstance(term, Term | Terms):
            raise ModelError(
                f"{name} cannot be simulated: {type(term).__name__} is a term of an unknown kind."
            )
        found.append(
            derivative_name(term.of, term, motions) if isinstance(term.of, str) else term.of
        )
    return found


class _Listening(Signals):
    """Signals of any name, which note in what order they are read."""

    def __getitem__(self, name: str) -> Array:
        if name not in self._arrays:
            self.read.add(name)
            self.order.append(name)
        return jnp.full(1, 0.5)

    def __init__(self):
        # An expression may ask for some signal, no matter which, to learn the number of samples.
        super().__init__({"": jnp.zeros(1)})
        self.order: list[str] = []

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str)

    def __iter__(self) -> Iterator[str]:
        return iter(self._arrays)


def signals_read(expression: Expression) -> tuple[str, ...]:
    """Signals that an expression reads, in order."""
    if isinstance(expression, str):
        return (expression,)
    signals = _Listening()
    with users_code(f"the expression {label_of(expression)}"):
        shape = jax.eval_shape(lambda: jnp.asarray(expression(signals))).shape
    if shape != (1,) and (shape != () or signals.order):
        raise ModelError(
            f"the expression {label_of(expression)} must return one number for each sample; for "
            f"one sample it returned shape {shape}."
        )
    return tuple(dict.fromkeys(signals.order))


def label_of(expression: Expression) -> str:
    """What an expression is called in messages."""
    return expression if isinstance(expression, str) else getattr(expression, "__name__", "given")


def _check_derivatives(label: str, equations: tuple[Equation, ...], structure: Structure) -> None:
    """Whether the time derivatives of expressions follow from the states and the unknowns.

    d/dt f(x) = f'(x) x' reads the first derivatives of what f reads, which states have. The second
    derivative reads theirs in turn, which only a signal has whose own second derivative leads.
    """
    positions = {motion.signal for motion in structure.motions if len(motion.names) == 3}
    for equation in equations:
        for term in equation.terms:
            if not term.derivative or isinstance(term.of, str):
                continue
            allowed = set(structure.states) if term.derivative == 1 else positions
            if beyond := [name for name in signals_read(term.of) if name not in allowed]:
                raise ModelError(
                    f"{label} cannot be simulated: derivative {term.derivative} of the expression "
                    f"{label_of(term.of)} needs derivatives of {', '.join(beyond)}, which no "
                    f"equation leads to. Where a term reads a recorded derivative, write "
                    f"Term('NAME', '{beyond[0]}', derivative=2, measured=('d{beyond[0]}', "
                    f"'dd{beyond[0]}')) instead (derivative=1 of a velocity)."
                )


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
