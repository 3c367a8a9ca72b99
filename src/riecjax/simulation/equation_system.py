"""A system to simulate, made from the very equations that were identified.

The residual of an equation is a sum of terms. With the highest derivative of each state signal
called unknown, the residuals of all equations are linear in the unknowns z, r(z) = r0 + J z, and
z = -J^-1 r0 is what a solver of differential equations asks for. J is formed by forward
derivatives along z, exact for any expression that reads z linearly; for one unknown, that is one
division.

A static equation beside dynamic ones, such as F_t = K_t x1, determines a quantity instead of a
derivative: that quantity is one more unknown, and an output of the system.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from riecjax.equations.equation import Equation
from riecjax.equations.expressions import Expression
from riecjax.equations.procedure import Procedure
from riecjax.equations.term import AbstractTerm, Term, Terms
from riecjax.errors import ModelError, users_code
from riecjax.leaves import is_concrete
from riecjax.records.record import Signals
from riecjax.simulation.system import AbstractSystem, Quantities

Rates = tuple[tuple[str, Expression], ...]


class _Motion(NamedTuple):
    """A state signal: the order of its leading derivative, and the names of its derivatives."""

    signal: str
    order: int
    names: tuple[str, ...]
    """Name of the signal itself, its first and its second derivative, up to the leading one."""


class EquationSystem(AbstractSystem):
    """Equations with values for their coefficients, as a system; see [`equation_system`][].

    Values are array leaves and the structure is static: new values compile nothing anew.
    """

    equations: tuple[Equation, ...]
    values: dict[str, Array]
    motions: tuple[_Motion, ...] = eqx.field(static=True)
    rates: Rates = eqx.field(static=True)
    determined: tuple[str, ...] = eqx.field(static=True)
    driving: tuple[str, ...] = eqx.field(static=True)
    units: tuple[tuple[str, str], ...] = eqx.field(static=True)

    @property
    def states(self) -> Quantities:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Each state signal, with its first derivative where the second one leads."""
        names = [name for motion in self.motions for name in motion.names[: motion.order]]
        return self._with_units([*names, *(name for name, _ in self.rates)])

    @property
    def inputs(self) -> Quantities:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Every other signal that the equations read."""
        return self._with_units(self.driving)

    @property
    def outputs(self) -> Quantities:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Leading derivatives under their recorded names, and what static equations determine."""
        kept = {f"d{name}" for name in self.state_names}
        leading = [motion.names[-1] for motion in self.motions]
        return self._with_units([*(n for n in leading if n not in kept), *self.determined])

    @property
    def velocity_of(self) -> Mapping[str, str]:
        """State to the state that is its time derivative."""
        return {m.signal: m.names[1] for m in self.motions if m.order == 2}

    def derivative(
        self, state: Float[Array, " states"], inputs: Float[Array, " inputs"]
    ) -> Float[Array, " states"]:
        """Time derivative of the state, by solving the equations for their unknowns."""
        signals, unknown = self._signals(state, inputs)
        flow = self._flow(signals, unknown)
        return jnp.concatenate([flow[name] for name in self.state_names])

    def output(
        self, state: Float[Array, " states"], inputs: Float[Array, " inputs"]
    ) -> Mapping[str, Float[Array, ""]]:
        """Leading derivatives under their recorded names, and what static equations determine."""
        signals, unknown = self._signals(state, inputs)
        found = {**signals, **dict(zip(self._unknown_names, unknown))}
        return {name: found[name][0] for name, _ in self.outputs}

    def residual_slopes(
        self, state: Float[Array, " states"], inputs: Float[Array, " inputs"]
    ) -> Float[Array, "equations unknowns"]:
        """How the equations' residuals depend on their unknowns at a point: J of the module."""
        return self._linear(self._known_signals(state, inputs))[1]

    # Signals have shape (1,), so that an expression written for the samples of a record needs no
    # second version for a point.
    def _known_signals(self, state: Array, inputs: Array) -> dict[str, Array]:
        names = (*self.state_names, *self.driving)
        levels = [state[i : i + 1] for i in range(len(self.states))]
        levels += [inputs[i : i + 1] for i in range(len(self.driving))]
        return dict(zip(names, levels))

    def _signals(self, state: Array, inputs: Array) -> tuple[dict[str, Array], Array]:
        signals = self._known_signals(state, inputs)
        rest, slopes = self._linear(signals)
        return signals, _solve(slopes, -rest)[:, None]

    def _linear(self, signals: dict[str, Array]) -> tuple[Array, Array]:
        """Residuals with every unknown zero, and their derivatives by the unknowns."""
        count = len(self._unknown_names)
        some = next(iter(signals.values()))
        along = jnp.eye(count, dtype=some.dtype)
        zero = jnp.zeros((count, 1), some.dtype)
        residuals, push = jax.linearize(lambda z: self._residuals(signals, z), zero)
        columns = [push(along[i][:, None]) for i in range(count)]
        return residuals, jnp.stack(columns, axis=-1)

    def _residuals(self, signals: dict[str, Array], unknown: Array) -> Float[Array, " equations"]:
        sums = [
            sum(
                (self._term(term, signals, unknown) for term in equation.terms),
                start=jnp.zeros((), unknown.dtype),
            )
            for equation in self.equations
        ]
        return jnp.stack(sums)

    def _term(self, term: AbstractTerm, signals: dict[str, Array], unknown: Array) -> Array:
        values = [self.values[name] for name in term.parameters]
        if isinstance(term, Terms):
            functions = term.basis(self._expression(term, signals, unknown))[:, 0]
            return jnp.asarray(term.sign) * jnp.stack(values) @ functions
        assert isinstance(term, Term)
        factor = jnp.asarray(term.number) * (values[0] if values else 1.0)
        return factor * self._expression(term, signals, unknown)[0]

    def _expression(
        self, term: AbstractTerm, signals: dict[str, Array], unknown: Array
    ) -> Float[Array, " 1"]:
        """The term's expression, differentiated in time as often as the term says."""
        available = {**signals, **dict(zip(self._unknown_names, unknown))}
        if isinstance(term.of, str):
            return available[_derivative_name(term.of, term, self.motions)]
        of = term.of
        states = {name: signals[name] for name in self.state_names}

        def level(states: dict[str, Array]) -> Array:
            # A constant may be one number for all samples.
            return jnp.atleast_1d(jnp.asarray(of(Signals({**available, **states}))))

        def rate(function: Callable[[dict[str, Array]], Array]):
            def along_motion(states: dict[str, Array]) -> Array:
                flow = self._flow({**signals, **states}, unknown)
                return jax.jvp(function, (states,), (flow,))[1]

            return along_motion

        for _ in range(term.derivative):
            level = rate(level)
        with users_code(f"the expression {_label(of)}"):
            return level(states)

    def _flow(self, signals: Mapping[str, Array], unknown: Array) -> dict[str, Array]:
        """Time derivative of every state signal."""
        available = {**signals, **dict(zip(self._unknown_names, unknown))}
        flow = {
            name: available[following]
            for motion in self.motions
            for name, following in zip(motion.names, motion.names[1:])
        }
        for name, expression in self.rates:
            flow[name] = (
                available[expression]
                if isinstance(expression, str)
                else jnp.atleast_1d(jnp.asarray(expression(Signals(available))))
            )
        return flow

    @property
    def _unknown_names(self) -> tuple[str, ...]:
        return (*(motion.names[-1] for motion in self.motions), *self.determined)

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
    equations = _equations(model)
    label = " + ".join(equation.name for equation in equations)
    numbers = _numbers(label, equations, values)
    motions = _motions(label, equations, frozenset(inputs), rates or {})
    determined = tuple(
        _determined(label, equation, motions, rates or {})
        for equation in equations
        if not _is_dynamic(equation, motions)
    )
    _check_count(label, equations, motions, determined)
    settled = {name for motion in motions for name in motion.names} | set(determined)
    settled |= set(rates or {})
    reads = dict.fromkeys(
        name
        for expression in _expressions(equations, motions, rates or {})
        for name in _reads(expression)
    )
    system = EquationSystem(
        equations,
        numbers,
        motions,
        tuple((rates or {}).items()),
        determined,
        tuple(name for name in reads if name not in settled),
        tuple(sorted((units or {}).items())),
    )
    _check_derivatives(label, system)
    if is_concrete(equations, numbers):
        _check_solvable(label, system)
    return system


def _equations(model: Equation | Procedure) -> tuple[Equation, ...]:
    if isinstance(model, Equation):
        return (model,)
    return tuple(equation for stage in model.stages for equation in stage)


def _numbers(
    label: str, equations: tuple[Equation, ...], values: Mapping[str, Array | float]
) -> dict[str, Array]:
    known: dict[str, Any] = {}
    for equation in equations:
        known |= equation.known
    known |= values
    names = dict.fromkeys(name for equation in equations for name in equation.parameters)
    if missing := [name for name in names if name not in known]:
        raise ModelError(f"{label}: no value is given for {', '.join(missing)}.")
    numbers = {name: jnp.asarray(known[name], jnp.result_type(float)) for name in names}
    for name, number in numbers.items():
        if number.shape != ():
            raise ModelError(f"{label}: {name} must be one number; it has shape {number.shape}.")
    return numbers


def _motions(
    label: str,
    equations: tuple[Equation, ...],
    inputs: frozenset[str],
    rates: Mapping[str, Expression],
) -> tuple[_Motion, ...]:
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
        for _ in range(rise):
            chain.append(names.get(chain[-1], f"d{chain[-1]}"))
        motions.append(_Motion(signal, rise, tuple(chain)))
    if not motions:
        raise ModelError(f"{label} cannot be simulated: {_why_static(equations)}")
    return tuple(motions)


def _why_static(equations: tuple[Equation, ...]) -> str:
    """Why no signal is a state, and what to write."""
    for equation in equations:
        for term in equation.terms:
            if term.derivative and not isinstance(term.of, str):
                read = ", ".join(_reads(term.of))
                return (
                    f"it holds a derivative of the expression {_label(term.of)} (of {read}) and no "
                    f"derivative of a signal, so that no signal is a state. Make the expression a "
                    f"signal first (on the command line: --derive NAME=FORMULA), and write the "
                    f"term of that name."
                )
    return (
        "it holds no derivative of a signal, so it is static and says nothing about motion. Write "
        "what moves as a derivative, such as Term('m', 'x', derivative=2)."
    )


def _derivative_name(signal: str, term: AbstractTerm, motions: tuple[_Motion, ...]) -> str:
    """Under which name a term's derivative of a signal is to be read."""
    for motion in motions:
        if signal in motion.names and term.derivative:
            return motion.names[motion.names.index(signal) + term.derivative]
    if not term.derivative:
        return signal
    measured = term.measured if isinstance(term, Term) else ()
    if term.derivative > len(measured):
        raise ModelError(
            f"a derivative of {signal} is needed and cannot be formed: name the signal that holds "
            f"it (measured=...)."
        )
    return measured[term.derivative - 1]


def _is_dynamic(equation: Equation, motions: tuple[_Motion, ...]) -> bool:
    leading = {motion.names[-1] for motion in motions}
    for term in equation.terms:
        if isinstance(term.of, str):
            if _derivative_name(term.of, term, motions) in leading:
                return True
        elif term.derivative or leading & set(_reads(term.of)):
            return True
    return False


def _determined(
    label: str,
    equation: Equation,
    motions: tuple[_Motion, ...],
    rates: Mapping[str, Expression],
) -> str:
    settled = {name for motion in motions for name in motion.names} | set(rates)
    for term in equation.terms:
        free = not term.parameters and isinstance(term.of, str) and not term.derivative
        if free and term.of not in settled:
            return str(term.of)
    raise ModelError(
        f"{label} cannot be simulated: {equation.name} holds no leading derivative, and no signal "
        f"with a number for coefficient that it could determine."
    )


def _check_count(
    label: str,
    equations: tuple[Equation, ...],
    motions: tuple[_Motion, ...],
    determined: tuple[str, ...],
) -> None:
    unknowns = [*(motion.names[-1] for motion in motions), *determined]
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
    equations: tuple[Equation, ...], motions: tuple[_Motion, ...], rates: Mapping[str, Expression]
) -> list[Expression]:
    found: list[Expression] = []
    for equation in equations:
        for term in equation.terms:
            if not isinstance(term, Term | Terms):
                raise ModelError(
                    f"{equation.name} cannot be simulated: {type(term).__name__} is a term of an "
                    f"unknown kind."
                )
            found.append(
                _derivative_name(term.of, term, motions) if isinstance(term.of, str) else term.of
            )
    return [*found, *rates.values()]


class _Listening(Signals):
    """Signals of any name, that note which names are read."""

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


def _reads(expression: Expression) -> tuple[str, ...]:
    """Signals that an expression reads, in order."""
    if isinstance(expression, str):
        return (expression,)
    signals = _Listening()
    with users_code(f"the expression {_label(expression)}"):
        shape = jax.eval_shape(lambda: jnp.asarray(expression(signals))).shape
    if shape != (1,) and (shape != () or signals.order):
        raise ModelError(
            f"the expression {_label(expression)} must return one number for each sample; for one "
            f"sample it returned shape {shape}."
        )
    return tuple(dict.fromkeys(signals.order))


def _label(expression: Expression) -> str:
    return expression if isinstance(expression, str) else getattr(expression, "__name__", "given")


def _check_derivatives(label: str, system: EquationSystem) -> None:
    """Whether the time derivatives of expressions follow from the states and the unknowns."""
    positions = {motion.signal for motion in system.motions if motion.order == 2}
    for equation in system.equations:
        for term in equation.terms:
            if not term.derivative or isinstance(term.of, str):
                continue
            allowed = set(system.state_names) if term.derivative == 1 else positions
            if beyond := [name for name in _reads(term.of) if name not in allowed]:
                raise ModelError(
                    f"{label} cannot be simulated: derivative {term.derivative} of the expression "
                    f"{_label(term.of)} needs derivatives of {', '.join(beyond)}, which no "
                    f"equation leads to. Where a term reads a recorded derivative, write "
                    f"Term('NAME', '{beyond[0]}', derivative=2, measured=('d{beyond[0]}', "
                    f"'dd{beyond[0]}')) instead (derivative=1 of a velocity)."
                )


def _check_solvable(label: str, system: EquationSystem) -> None:
    # At points in general position, where an accidental zero is all but impossible.
    points = np.random.default_rng(0).uniform(0.2, 0.9, (2, len(system.states)))
    level = jnp.asarray(np.linspace(0.3, 0.7, len(system.driving)))
    slopes = np.asarray(system.residual_slopes(jnp.asarray(points[0]), level))
    scale = np.max(np.abs(slopes), axis=0, initial=0.0)
    rows = np.max(np.abs(slopes), axis=1, initial=0.0)
    unknowns = system._unknown_names
    if not np.all(np.isfinite(slopes)):
        raise ModelError(f"{label} cannot be simulated: its leading coefficients are not finite.")
    if not scale.all():
        which = unknowns[int(np.argmin(scale != 0))]
        raise ModelError(f"{label} cannot be simulated: the coefficient of {which} is zero.")
    scaled = slopes / scale / np.where(rows > 0, rows, 1.0)[:, None]
    if not rows.all() or np.linalg.matrix_rank(scaled / np.max(np.abs(scaled))) < len(unknowns):
        raise ModelError(
            f"{label} cannot be simulated: its equations are not independent in "
            f"{', '.join(unknowns)}."
        )
    signals = system._known_signals(jnp.asarray(points[0]), level)
    rest, _ = system._linear(signals)
    probe = jnp.asarray(np.random.default_rng(1).uniform(0.5, 1.5, (len(unknowns), 1)))
    found = np.asarray(system._residuals(signals, probe))
    linear = np.asarray(rest) + slopes @ np.asarray(probe)[:, 0]
    size = np.abs(np.asarray(rest)) + np.abs(slopes) @ np.abs(np.asarray(probe)[:, 0])
    if np.any(np.abs(found - linear) > 1e-4 * size):
        raise ModelError(
            f"{label} cannot be simulated: {', '.join(unknowns)} must enter its equations linearly."
        )


def _solve(matrix: Float[Array, "p p"], right: Float[Array, " p"]) -> Float[Array, " p"]:
    """Solution of a small system of equations.

    Up to three unknowns by determinants: a library call in every stage of every step made the
    quarter car's three equations eight times slower.
    """
    count = right.shape[0]
    if count == 1:
        return right / matrix[0]
    if count == 2:
        (a, b), (c, d) = matrix[0], matrix[1]
        e, f = right[0], right[1]
        return jnp.stack([d * e - b * f, a * f - c * e]) / (a * d - b * c)
    if count == 3:
        a, b, c = ([matrix[i, j] for i in range(3)] for j in range(3))
        r = [right[i] for i in range(3)]
        whole = _determinant(a, b, c)
        shares = [_determinant(r, b, c), _determinant(a, r, c), _determinant(a, b, r)]
        return jnp.stack(shares) / whole
    return jnp.linalg.solve(matrix, right)


def _determinant(a: list[Array], b: list[Array], c: list[Array]) -> Array:
    return (
        a[0] * (b[1] * c[2] - b[2] * c[1])
        + a[1] * (b[2] * c[0] - b[0] * c[2])
        + a[2] * (b[0] * c[1] - b[1] * c[0])
    )
