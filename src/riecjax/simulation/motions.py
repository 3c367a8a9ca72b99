"""Equations of motion read as a system: which signals are states, inputs and unknowns.

No equation says which of its signals is the state; the derivatives that appear do. Let q^(k) be
the highest derivative of a signal q in any of the equations. Then q, ..., q^(k-1) are states and
q^(k) is an unknown, for which the equations are solved at every instant. Names tie derivatives
together: where a term calls the derivative of x3 "x4", the derivative of x4 is the second one of
x3, and x4 is no state beside x3' but the same one.

What a static equation determines is an unknown too, and whatever else is read must be given: an
input. With as many equations as unknowns the system is square; whether it is regular depends on
the coefficients, and is checked where they are known.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from riecjax.equations.equation import Equation
from riecjax.equations.expressions import Expression
from riecjax.equations.jumps import reversing_states
from riecjax.equations.term import AbstractTerm, Term, Terms
from riecjax.errors import ModelError, users_code
from riecjax.records.signals import Signals
from riecjax.simulation.hidden_modes import ModeStates
from riecjax.simulation.series_springs import SpringElement


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
