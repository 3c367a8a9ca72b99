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
such as F_t = K_t x1 determine (`read_structure` finds which these are). Mechanics is linear in its
accelerations, so the residuals r of all equations are affine in z,

    r(z) = r0 + J z,    and they vanish at    z = -J^-1 r0,

which is what a solver of differential equations asks for. J holds masses and their couplings. A
term of an unknown itself gives its factor to J, and a term of known signals its value to r0; only
where an expression reads unknowns J is its forward derivative, exact for any that reads them
linearly, where a difference quotient would round. An equation with one unknown left is a division,
which orders most mechanisms; what stays coupled is solved together.

Elements are written out: their states are further ones, and their forces stand in the equations
(`Element.attached`).
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from itertools import pairwise
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from riecjax import arrays as xp
from riecjax.equations.element import CarriedState, Element
from riecjax.equations.equation import Equation
from riecjax.equations.expressions import Expression, label_of, signals_read
from riecjax.equations.quantity import Quantity
from riecjax.equations.term import AbstractTerm, made_by, reversing_states
from riecjax.errors import ModelError, users_code
from riecjax.linear_algebra import solve_few
from riecjax.records.record import Signals
from riecjax.simulation.reversals import regime_at
from riecjax.simulation.system import AbstractSystem, Inputs, Quantities, State

Motion = tuple[str, ...]
"""A signal, and the names of its derivatives up to the leading one."""


def expression_read(term: AbstractTerm, motions: tuple[Motion, ...]) -> Expression:
    """A term's expression; of a signal, the name of the derivative that is to be read."""
    signal = term.signal
    if signal is None or not term.derivative:
        return term.of
    for motion in motions:
        if signal in motion:
            return motion[motion.index(signal) + term.derivative]
    if term.derivative > len(term.measured):
        raise ModelError(
            f"a derivative of {signal} is needed and cannot be formed: name the signal that holds "
            f"it (measured=...)."
        )
    return term.measured[term.derivative - 1]


class EquationSystem(AbstractSystem):
    """Equations with values for their coefficients, as a system; see [`equation_system`][].

    Values are array leaves and all else is static: new values compile nothing anew.

    **Fields:** `equations`, those of elements among them, with the `values` of their coefficients;
    `attached`, states of elements; what each signal is: `states`, below the leading derivatives,
    `inputs` and `outputs`; `motions`; `rates`, expressions for the derivatives of further states;
    `unknowns`, what the equations are solved for; `reversing`, states at whose zero the equations
    jump; `implicit`, places of terms that are functions of unknowns.
    """

    equations: tuple[Equation, ...]
    values: dict[str, Array]
    attached: tuple[CarriedState, ...]
    states: Quantities = eqx.field(static=True)  # pyright: ignore
    inputs: Quantities = eqx.field(static=True)  # pyright: ignore
    outputs: Quantities = eqx.field(static=True)  # pyright: ignore
    motions: tuple[Motion, ...] = eqx.field(static=True)
    rates: tuple[tuple[str, Expression], ...] = eqx.field(static=True)
    unknowns: tuple[str, ...] = eqx.field(static=True)
    reversing: tuple[str, ...] = eqx.field(static=True)  # pyright: ignore
    implicit: frozenset[tuple[int, int]] = eqx.field(static=True)

    @property
    def carried(self) -> tuple[str, ...]:  # pyright: ignore
        """States of elements."""
        return tuple(state.name for state in self.attached)

    def carried_levels(
        self, signals: Mapping[str, Float[Array, " n"]]
    ) -> Mapping[str, Float[Array, " n"]]:
        """States of elements at rest, as far as signals tell them."""
        levels: dict[str, Array] = {}
        for state in self.attached:
            levels |= state.at_rest(signals, self.values)
        return levels

    @property
    def velocity_of(self) -> Mapping[str, str]:
        """State to the state that is its time derivative."""
        return {m[0]: m[1] for m in self.motions if len(m) == 3}

    def derivative(self, state: State, inputs: Inputs) -> State:
        """Time derivative of the state, by solving the equations for their unknowns."""
        flow = self._flow(self._solved(self._known_signals(state, inputs)))
        return xp.concatenate([flow[name] for name in self.state_names])

    def output(self, state: State, inputs: Inputs) -> Mapping[str, Float[Array, ""]]:
        """Leading derivatives under their recorded names, and what static equations determine.

        At rest under dry friction, which does not name a force, a mass that sticks has none of the
        first, and one that is let go has that of the side it leaves on.
        """
        stuck: dict[str, Array] = {}
        if self.reversing:
            regime = regime_at(self, state, inputs)
            state = regime.seen(state)
            pairs = (pair for motion in self.motions for pair in pairwise(motion))
            stuck = {rate: regime.stuck[self.state_names.index(name)] for name, rate in pairs}
        signals = self._solved(self._known_signals(state, inputs))
        values = {name: signals[name][0] for name, _ in self.outputs}
        return {n: xp.where(stuck[n], 0.0, v) if n in stuck else v for n, v in values.items()}

    def probed(
        self, state: Array, inputs: Array, unknowns: Array
    ) -> tuple[Float[Array, " n"], Float[Array, "n n"], Float[Array, " n"]]:
        """r0 and J at a point, and the residuals of some values of the unknowns."""
        signals = self._known_signals(state, inputs)
        rows, names = self._rows(signals), self.unknowns
        none = xp.zeros_like(unknowns[0])
        slopes = [xp.stack([slopes.get(name, none) for name in names]) for _, slopes in rows]
        whole = {**signals, **dict(zip(names, unknowns[:, None]))}
        found = [sum((self._term(t, whole) for t in e.terms), start=none) for e in self.equations]
        return xp.stack([rest for rest, _ in rows]), xp.stack(slopes), xp.stack(found)

    # Signals have shape (1,), so that an expression written for the samples of a record needs no
    # second version for a point.
    def _known_signals(self, state: Array, inputs: Array) -> dict[str, Array]:
        levels = {name: state[i : i + 1] for i, name in enumerate(self.state_names)}
        return levels | {n: inputs[i : i + 1] for i, n in enumerate(self.input_names)}

    def _solved(self, signals: dict[str, Array]) -> dict[str, Array]:
        """Known signals and unknowns."""
        rows = dict(enumerate(self._rows(signals)))
        solution: dict[str, Array] = {}

        def without_solved(rest: Array, slopes: dict[str, Array]) -> Array:
            return sum((slopes[n] * solution[n] for n in slopes if n in solution), start=rest)

        # An equation with one unknown left is a division; those that are coupled remain.
        while single := [i for i, (_, slopes) in rows.items() if len({*slopes} - {*solution}) == 1]:
            rest, slopes = rows.pop(single[0])
            (name,) = {*slopes} - {*solution}
            solution[name] = -without_solved(rest, slopes) / slopes[name]
        coupled = [name for name in self.unknowns if name not in solution]
        if coupled:
            rest = xp.stack([without_solved(*row) for row in rows.values()])
            none = xp.zeros_like(rest[0])
            matrix = [xp.stack([row[1].get(n, none) for n in coupled]) for row in rows.values()]
            solution |= dict(zip(coupled, solve_few(xp.stack(matrix), -rest)))
        return signals | {name: value[None] for name, value in solution.items()}

    def _rows(self, signals: dict[str, Array]) -> list[tuple[Array, dict[str, Array]]]:
        """Of each equation r0, and those columns of J in which it may be other than zero."""
        zero = xp.zeros((1,), next(iter(signals.values())).dtype)
        zeros = dict.fromkeys(self.unknowns, zero)
        rows = []
        for i, equation in enumerate(self.equations):
            values, slopes = [], {}
            for j, term in enumerate(equation.terms):
                columns = {}
                if (i, j) in self.implicit:
                    value, push = jax.linearize(
                        lambda unknowns, term=term: self._term(term, {**signals, **unknowns}), zeros
                    )
                    values.append(value)
                    columns = {name: push({**zeros, name: zero + 1}) for name in zeros}
                elif (name := str(expression_read(term, self.motions))) in zeros:
                    columns = {name: self._term(term, {name: zero + 1})}
                else:
                    values.append(self._term(term, signals))
                for name, column in columns.items():
                    slopes[name] = slopes[name] + column if name in slopes else column
            rows.append((sum(values, start=zero[0]), slopes))
        return rows

    def _term(self, term: AbstractTerm, signals: dict[str, Array]) -> Array:
        values = [self.values[name] for name in term.parameters]
        law = partial(term.force, values)
        return xp.asarray(term.factor) * self._expression(term, signals, law)[0]

    def _expression(
        self,
        term: AbstractTerm,
        signals: dict[str, Array],
        function: Callable[[Array], Array] = lambda x: x,
    ) -> Array:
        """A function of the term's expression, differentiated in time as the term says.

        Of an expression f of states x the chain rule gives d/dt f = f'(x) x', a forward derivative
        along the flow, and of that once more the second: no formula is differentiated by hand.
        """
        of = expression_read(term, self.motions)
        if isinstance(of, str) and term.signal is not None:
            return function(signals[of])

        def level(states: dict[str, Array]) -> Array:
            # A constant may be one number for all samples.
            known = Signals({**signals, **states})
            samples = known[of] if isinstance(of, str) else of(known)
            return function(xp.atleast_1d(xp.asarray(samples)))

        def rate(function: Callable[[dict[str, Array]], Array]):
            def along_motion(states: dict[str, Array]) -> Array:
                return jax.jvp(function, (states,), (self._flow({**signals, **states}),))[1]

            return along_motion

        for _ in range(term.derivative):
            level = rate(level)
        with users_code(f"the expression {label_of(of)}"):
            return level({name: signals[name] for name in self.state_names})

    def _flow(self, signals: Mapping[str, Array]) -> dict[str, Array]:
        """Time derivative of every state signal."""
        flow = {
            name: signals[following]
            for motion in self.motions
            for name, following in pairwise(motion)
        }
        known = Signals(signals)
        flow |= {
            name: signals[rate] if isinstance(rate, str) else xp.atleast_1d(xp.asarray(rate(known)))
            for name, rate in self.rates
        }
        for state in self.attached:
            if state.term is not None:
                read = self._expression(state.term, dict(signals))
                flow[state.name] = state.rate(signals, self.values, read)
        return flow


def read_system(
    label: str,
    equations: tuple[Equation, ...],
    elements: Sequence[Element],
    values: dict[str, Array],
    rates: dict[str, Expression],
    inputs: Sequence[str],
    listed: Sequence[Quantity],
    units: Mapping[str, str],
) -> EquationSystem:
    """The system that equations describe, with elements written out in them.

    **Arguments:** `listed`, signals in the model's order, which is that of states.

    **Raises:** `ModelError` if they cannot be simulated; see [`equation_system`][].
    """
    attached: list[CarriedState] = []
    of_elements: dict[str, Expression] = {}
    for element in elements:
        equations, further, states = element.attached(equations)
        of_elements |= further
        attached += states
    rates = {**of_elements, **rates}
    # State signals in order of appearance, each with its longest chain of derivatives.
    differentiated = [term for equation in equations for term in equation.terms if term.derivative]
    moving = [
        (term.signal, term.derivative, term.measured)
        for term in differentiated
        if term.signal is not None and term.signal not in inputs and term.signal not in rates
    ]
    names: dict[str, str] = {}
    for name, _, measured in moving:
        for lower, higher in zip((name, *measured), measured):
            names.setdefault(lower, higher)
    for name, derivative, _ in moving:
        for _ in range(derivative):
            name = names.setdefault(name, f"d{name}")
    below = {higher: lower for lower, higher in names.items()}
    positions = {name for name, _, _ in moving}
    longest: dict[str, Motion] = {}
    for name, derivative, _ in moving:
        # A derivative of a velocity is one of the position, where the position is in the equations.
        ancestors = [name]
        while ancestors[-1] in below:
            ancestors.append(below[ancestors[-1]])
        steps = max(i for i, name in enumerate(ancestors) if name in positions)
        signal, rise = ancestors[steps], derivative + steps
        if rise > 2:
            raise ModelError(
                f"{label} cannot be simulated: it holds a derivative of order {rise} of {signal}."
            )
        chain = [signal]
        for _ in range(rise):
            chain.append(names[chain[-1]])
        longest[signal] = max(longest.get(signal, ()), tuple(chain), key=len)
    if not longest:
        why = (
            "it holds no derivative of a signal, so it is static and says nothing about motion. "
            "Write what moves as a derivative, such as Term('m', 'x', derivative=2)."
        )
        if of := next((term.of for term in differentiated if term.signal is None), None):
            why = (
                f"it holds a derivative of the expression {label_of(of)} (of "
                f"{', '.join(signals_read(of))}) and no derivative of a signal, so that no signal "
                f"is a state. Make the expression a signal first (on the command line: --derive "
                f"NAME=FORMULA), and write the term of that name."
            )
        raise ModelError(f"{label} cannot be simulated: {why}")
    motions = tuple(longest.values())
    leading = {motion[-1] for motion in motions}

    def is_dynamic(term: AbstractTerm) -> bool:
        is_moving = term.signal is None and term.derivative > 0
        return is_moving or bool(leading & {*signals_read(expression_read(term, motions))})

    # A static equation determines its first plain signal with a number for coefficient.
    in_motion = {name for motion in motions for name in motion} | set(rates)
    determined = []
    for equation in (e for e in equations if not any(map(is_dynamic, e.terms))):
        known = (t.signal for t in equation.terms if not (t.parameters or t.derivative))
        free = next((of for of in known if of is not None and of not in in_motion), None)
        if free is None:
            raise ModelError(
                f"{label} cannot be simulated: {equation.name} holds no leading derivative, and no "
                f"signal with a number for coefficient that it could determine."
            )
        determined.append(free)
    unknowns = (*(motion[-1] for motion in motions), *determined)
    if repeated := {name for name in unknowns if unknowns.count(name) > 1}:
        raise ModelError(
            f"{label} cannot be simulated: two equations determine {', '.join(sorted(repeated))}."
        )
    if len(equations) != len(unknowns):
        remedy = (
            "Leave out those that follow from the others."
            if len(equations) > len(unknowns)
            else "Add equations, or name those signals that are measured as inputs (inputs=...)."
        )
        raise ModelError(
            f"{label} cannot be simulated: {len(equations)} equation(s) for {len(unknowns)} "
            f"unknown(s) ({', '.join(unknowns)}). {remedy}"
        )
    # States in the model's order, those of elements last.
    carried = [state.name for state in attached]
    place = {name: i for i, name in enumerate((*(q.name for q in listed), "", *carried))}
    lower = (name for motion in motions for name in motion[:-1])
    unsorted = dict.fromkeys((*lower, *rates, *carried))
    states = sorted(unsorted, key=lambda name: place.get(name, place[""]))
    terms = [term for equation in equations for term in equation.terms]
    read: list[Expression] = []
    for term in (*terms, *(state.term for state in attached if state.term is not None)):
        if not term.is_linear and term.basis is None and type(term).force is AbstractTerm.force:
            try:
                jax.eval_shape(lambda x, t=term: made_by(t, lambda: t.functions(x), 1), np.zeros(1))
            except ModelError as error:
                raise ModelError(f"{label} cannot be simulated: {error}") from None
        read.append(expression_read(term, motions))
    reads = dict.fromkeys(name for each in (*read, *rates.values()) for name in signals_read(each))
    driving = tuple(name for name in reads if name not in (*states, *unknowns))
    # Whether the time derivatives of expressions follow from the states and the unknowns.
    # d/dt f(x) = f'(x) x' reads the first derivatives of what f reads, which states have. The
    # second reads theirs in turn, which only a signal has whose own second derivative leads.
    positions = {motion[0] for motion in motions if len(motion) == 3}
    for term in terms:
        if not term.derivative or term.signal is not None:
            continue
        allowed = set(states) if term.derivative == 1 else positions
        if beyond := [name for name in signals_read(term.of) if name not in allowed]:
            raise ModelError(
                f"{label} cannot be simulated: derivative {term.derivative} of the expression "
                f"{label_of(term.of)} needs derivatives of {', '.join(beyond)}, which no equation "
                f"leads to. Where a term reads a recorded derivative, write Term('NAME', "
                f"'{beyond[0]}', derivative=2, measured=('d{beyond[0]}', 'dd{beyond[0]}')) instead "
                f"(derivative=1 of a velocity)."
            )
    implicit = frozenset(
        (i, j)
        for i, equation in enumerate(equations)
        for j, term in enumerate(equation.terms)
        if term.signal is None and (term.derivative or {*unknowns} & {*signals_read(term.of)})
    )
    # A derivative of a state has its name from the simulation, others the recorded one.
    derivatives = {f"d{name}" for name in states}
    stated = {q.name: q.unit for q in listed if q.unit} | {s.name: s.unit for s in attached}

    def with_units(names: Iterable[str]) -> Quantities:
        return tuple((name, units.get(name, stated.get(name, ""))) for name in names)

    system = EquationSystem(
        equations=equations,
        values=values,
        attached=tuple(attached),
        states=with_units(states),
        inputs=with_units(driving),
        outputs=with_units(name for name in unknowns if name not in derivatives),
        motions=motions,
        rates=tuple(rates.items()),
        unknowns=unknowns,
        reversing=reversing_states(terms, states, (*states, *unknowns, *driving)),
        implicit=implicit,
    )
    if xp.is_concrete(equations, values):
        require_solvable(label, system)
    return system


def require_solvable(label: str, system: EquationSystem) -> None:
    """Whether J is regular, and the residuals linear in the unknowns.

    At a point in general position, where an accidental zero is all but impossible. J is scaled by
    columns and rows first: its rank must not depend on the units of unknowns and equations.
    """
    for why in (state.why_not(system.values) for state in system.attached):
        if why:
            raise ModelError(f"{label} cannot be simulated: {why}.")
    state: Any = np.random.default_rng(0).uniform(0.2, 0.9, len(system.states))
    level: Any = np.linspace(0.3, 0.7, len(system.inputs))
    unknowns = system.unknowns
    probe: Any = np.random.default_rng(1).uniform(0.5, 1.5, len(unknowns))
    # Derivatives of what reads unknowns are JAX's, which compiles one program sooner than each
    # step.
    look = eqx.filter_jit(EquationSystem.probed) if system.implicit else EquationSystem.probed
    rest, slopes, found = map(np.asarray, look(system, state, level, probe))
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
