"""In which order equations are solved: one by one, or together.

Both are lists of stages. A stage is a group of equations whose normal equations are added; what
earlier stages found is known to later ones. The paper's three stages are `staged(...)` of three
equations; its remark that all parameters may be estimated at once is `simultaneous(...)`.

Unknown offsets and gains of sensors, as coefficients of the equations that read them.

A sensor that shows `z = x + b` turns a term `k x` into `k z - k b`: a constant beside it. Where k
is a known number the offset b itself is the coefficient; where k is estimated too, only the product
`k b` is, in the unit of the equation. A sensor that shows `z = F / g` turns a known term `a F` into
`g a z`, of the coefficient g. Either way the equations stay linear, and are those of the signals as
measured: what is simulated of them is what the sensors would show.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Literal, Protocol, TypeAlias

import equinox as eqx
import numpy as np

from riecjax.equations.equation import Equation
from riecjax.equations.expressions import Expression, constant, signals_read
from riecjax.equations.hidden_elements import (
    Expanded,
    HiddenMode,
    ModeParameters,
    SeriesSpring,
    force_elements,
    stiffness_name,
    why_no_element,
)
from riecjax.equations.memories import Memory
from riecjax.equations.term import AbstractTerm, Term
from riecjax.errors import ModelError, require
from riecjax.leaves import Leaf, is_concrete
from riecjax.records.faults.derivative_pairs import Relation
from riecjax.records.record import Record
from riecjax.shows import Shown


def _refuse_functions(equation: Equation, signal: str) -> None:
    """Refuse a function of the signal: in it, an offset or a gain is no coefficient."""
    for term in equation.terms:
        if signal in signals_read(term.of) and term.signal != signal:
            raise ModelError(
                f"{equation.name}: the term of {' and '.join(term.parameters) or 'no coefficient'} "
                f"is a function of '{signal}', in which an unknown offset or gain is no "
                f"coefficient of its own; calibrate that sensor."
            )


PROBES, EXACT = 32, 1e-5
"""Values that an expression is tried with, and how nearly it must be a sum of them."""


class _Probe(dict[str, np.ndarray]):
    """Random values of whatever signals are asked for."""

    def __missing__(self, name: str) -> np.ndarray:
        rng = np.random.default_rng(len(self))
        return self.setdefault(name, rng.standard_normal(PROBES))


def relation_of(signal: str, rate: Expression) -> Relation | None:
    """The relation that a rate of a signal stands for; `None` unless it is a sum of signals."""
    if isinstance(rate, str):
        return Relation(signal, ((rate, 1.0),))
    probe = _Probe()
    try:
        values = np.asarray(rate(probe), float)  # pyright: ignore[reportArgumentType]
    except Exception:  # of the user's function, which says so where it is used
        return None
    if values.shape != (PROBES,) or not 0 < len(probe) < PROBES // 2 or signal in probe:
        return None
    columns = np.transpose([*probe.values()])
    factors = np.linalg.lstsq(columns, values)[0]
    if not np.abs(columns @ factors - values).max() < EXACT * np.abs(factors).max():
        return None
    # What rounding adds to 1 would be told as a factor.
    told = zip(probe, np.round(factors, 6).tolist())
    return Relation(signal, tuple((name, factor) for name, factor in told if factor))


AtRest: TypeAlias = Literal["mask", "keep"]
"""What is done where a velocity with dry friction rests: weights that vanish there leave it out of
the sums, or it stays as any other sample."""


class Procedure(Shown, eqx.Module):
    """Stages of equations; see [`staged`][] and [`simultaneous`][].

    `modes` are hidden in every equation that accelerates their bodies, see
    [`Procedure.with_modes`][], and `springs` stand in series with force elements, see
    [`Procedure.with_series_springs`][]; `at_rest`, see [`AtRest`][riecjax.equations.AtRest];
    `kinematics`, see [`Procedure.with_rates`][]; `memories`, see [`Procedure.with_memories`][].
    """

    stages: tuple[tuple[Equation, ...], ...]
    modes: tuple[HiddenMode, ...] = ()
    springs: tuple[SeriesSpring, ...] = ()
    at_rest: AtRest = eqx.field(static=True, default="mask")
    kinematics: tuple[Relation, ...] = eqx.field(static=True, default=())
    memories: tuple[Memory, ...] = eqx.field(static=True, default=())

    @property
    def derivatives(self) -> tuple[tuple[str, str] | Relation, ...]:
        """Signals with those that are their time derivatives, alone or as a sum."""
        pairs = (pair for equation in self.equations for pair in equation.derivatives)
        return tuple(dict.fromkeys((*pairs, *self.kinematics)))

    def with_rates(self, rates: Mapping[str, Expression]) -> "Procedure":
        """The same equations, knowing what the time derivatives of some signals are.

        `rates` are expressions by signal, such as `{"x2": rx.difference("x3", "x4")}`. Where they
        are sums of signals with constant factors, recordings are held against them: which signal is
        late, or wrong in size, sign, unit or zero. Others are left out.
        """
        found = (relation_of(name, rate) for name, rate in rates.items())
        return replace(self, kinematics=(*self.kinematics, *(one for one in found if one)))

    def with_modes(self, *modes: HiddenMode) -> "Procedure":
        """The same equations with oscillators that they leave out.

        **Raises:** `ModelError` for a mode on a signal whose derivative no equation holds.
        """
        for mode in modes:
            require("a mode", mode, HiddenMode, "rx.HiddenMode(on='x4')")
            if not any(mode.inertia(e) is not None for e in self.equations):
                raise ModelError(
                    f"a hidden mode on '{mode.on}' needs a term that accelerates it, such as "
                    f"rx.Term('m', '{mode.on}', derivative=1): no equation has one."
                )
        return replace(self, modes=(*self.modes, *modes))

    def with_memories(self, *memories: Memory) -> "Procedure":
        """The same equations, reading states of hysteresis as signals.

        Recordings that lack them are given them from the velocities that drive them; simulations
        carry them along.
        """
        return replace(self, memories=(*self.memories, *memories))

    def with_terms(self, added: Mapping[str, Sequence[AbstractTerm]]) -> "Procedure":
        """The same equations with further terms, each for the equation of a name.

        They stand beside the inertia: where that has a minus they get one too, so that what resists
        motion has a positive coefficient.

        **Raises:** `ModelError` for an equation that there is none of, and for a coefficient that
        the model has already or that is added twice.
        """
        names = [name for stage in self.equation_names for name in stage]
        if unknown := [name for name in added if name not in names]:
            raise ModelError(
                f"no equation is called '{unknown[0]}'; there are: {', '.join(names)}."
            )
        taken = {*self.parameters}
        for name in (n for terms in added.values() for term in terms for n in term.parameters):
            if name in taken:
                raise ModelError(f"there is a coefficient '{name}' already: call it otherwise.")
            taken.add(name)
        rest = iter(names)

        def extended(equation: Equation) -> Sequence[AbstractTerm]:
            # What is differentiated most often stands for the inertia, a named coefficient first;
            # of a force element, which has none, what it was given.
            first = min(equation.terms, key=lambda t: (-t.derivative, not t.parameters))
            turned = is_concrete(first.factor) and float(np.asarray(first.factor)) < 0
            own = added.get(next(rest), ())
            return (*equation.terms, *(-term if turned else term for term in own))

        return self._with_equations(extended)

    def with_unknown_offset(self, signal: str, unit: str = "") -> "Procedure":
        """The same equations, with the unknown zero of a signal's sensor as a coefficient.

        A derivative of the signal has no offset. Coefficients are called `offset_SIGNAL`, in the
        signal's `unit`, where the term's own is known, else `k_offset_SIGNAL`, that is k times it.

        **Raises:** `ModelError` where no equation has a term of the signal itself, reads it in a
        function, or has a constant term already, from which no offset can be told apart.
        """

        def terms(equation: Equation) -> list[AbstractTerm]:
            _refuse_functions(equation, signal)
            own = [t for t in equation.terms if t.signal == signal and t.derivative == 0]
            if not own:
                return [*equation.terms]
            if taken := [n for t in equation.terms if t.of is constant for n in t.parameters]:
                raise ModelError(
                    f"{equation.name}: an offset of '{signal}' cannot be told apart from "
                    f"'{taken[0]}', which is constant too; give {signal}'s offset, or leave that "
                    f"term out."
                )
            if len(own) > 1:
                raise ModelError(f"{equation.name} has several terms of '{signal}'; add them up.")
            name = own[0].name
            number = -own[0].factor
            label = f"offset_{signal}" if name is None else f"{name}_offset_{signal}"
            of_unit = unit if name is None else equation.unit
            return [*equation.terms, Term(label, constant, unit=of_unit, sign=number)]

        return self._with_equations(
            terms, f"no equation has a term of '{signal}' itself, so that none tells of its offset."
        )

    def with_unknown_gain(self, signal: str) -> "Procedure":
        """The same equations for a sensor whose readings of `signal` are to be multiplied by
        `gain_SIGNAL`.

        **Raises:** `ModelError` where a term of the signal has a coefficient that is estimated too,
        where one reads it in a function, or where no equation reads it.
        """

        def changed(term: AbstractTerm) -> AbstractTerm:
            if term.signal != signal:
                return term
            if term.name is not None:
                raise ModelError(
                    f"the gain of '{signal}' cannot be told apart from '{term.name}', which "
                    f"multiplies it: {term.name} comes out multiplied by the gain."
                )
            order, measured, factor = term.derivative, term.measured, term.factor
            return Term(f"gain_{signal}", term.of, derivative=order, measured=measured, sign=factor)

        def terms(equation: Equation) -> list[AbstractTerm]:
            _refuse_functions(equation, signal)
            return list(map(changed, equation.terms))

        return self._with_equations(
            terms, f"no equation reads '{signal}', so that none tells of its gain."
        )

    def _with_equations(
        self, terms: Callable[[Equation], Sequence[AbstractTerm]], unread: str = ""
    ) -> "Procedure":
        """Equations of other terms in their place; `unread` is an error where none is another."""

        def other(equation: Equation) -> Equation:
            return eqx.tree_at(lambda e: e.terms, equation, tuple(terms(equation)))

        stages = tuple(tuple(map(other, stage)) for stage in self.stages)
        after = replace(self, stages=stages)
        if unread and after.parameters == self.parameters:
            raise ModelError(unread)
        return after

    def with_series_springs(self, *springs: SeriesSpring) -> "Procedure":
        """The same equations with springs in series with force elements.

        **Raises:** `ModelError` for an element that no equation holds, that is no damper, that has
        a spring, or that is of other signals in one term than in another.
        """
        taken = [name for spring in self.springs for name in self._element(spring).parameters]
        for spring in springs:
            require("a spring", spring, SeriesSpring, "rx.SeriesSpring(of='c')")
            if spring.of in taken:
                raise ModelError(f"'{spring.of}' has a spring in series already.")
            taken += self._element(spring).parameters
        return replace(self, springs=(*self.springs, *springs))

    def _element(self, spring: SeriesSpring) -> AbstractTerm:
        """The term that a spring is in series with, in whichever equations."""
        every = [t for e in self.equations for t in e.terms if spring.of in t.parameters]
        if not every:
            raise ModelError(
                f"no equation has a coefficient '{spring.of}' that a spring could be in series "
                f"with; there are: {', '.join(self.parameters)}."
            )
        if any((t.of, t.derivative) != (every[0].of, every[0].derivative) for t in every):
            raise ModelError(
                f"{spring.of} is of other signals in one term than in another, so that it is no "
                f"one element that a spring could be in series with."
            )
        if wrong := why_no_element(every[0], self.equations):
            fitting = force_elements(self.equations, self.equations)
            raise ModelError(
                f"'{spring.of}' {wrong}. A spring is in series with a damper, a term of a velocity "
                f"or a map of one: {', '.join(fitting) or 'no equation has any'}."
            )
        return every[0]

    @property
    def equations(self) -> tuple[Equation, ...]:
        """Of all stages, in order."""
        return tuple(equation for stage in self.stages for equation in stage)

    @property
    def has_hidden(self) -> bool:
        """Whether equations leave out modes or springs."""
        return bool(self.modes or self.springs)

    def mode_named(self, names: ModeParameters) -> HiddenMode:
        """The mode whose parameters these are."""
        number = [ModeParameters.of(i) for i, _ in enumerate(self.modes)].index(names)
        return self.modes[number]

    @property
    def expanded(self) -> tuple[tuple[Expanded, ...], ...]:
        """Each equation with modes and springs, linear in more columns than it has parameters."""
        return tuple(
            tuple(Expanded.of(e, self.modes, self.springs) for e in stage) for stage in self.stages
        )

    @property
    def linear(self) -> "Procedure":
        """Equations without hidden elements, whose sums tell of these with any: itself if there
        are none."""
        if not self.has_hidden:
            return self
        stages = tuple(tuple(e.equation for e in stage) for stage in self.expanded)
        # Their derivatives are of more than one body, which do not rest together.
        return Procedure(stages, at_rest="keep")

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of all coefficients, in order of first appearance."""
        return tuple(dict.fromkeys(name for names in self.stage_parameters for name in names))

    @property
    def stage_parameters(self) -> list[tuple[str, ...]]:
        """Names of the coefficients of each stage, in order of first appearance."""
        if not self.has_hidden:
            every = [[e.parameters for e in stage] for stage in self.stages]
        else:
            every = [[e.all_parameters for e in stage] for stage in self.expanded]
        # A spring in series with a map is in no expanded equation.
        for i, spring in enumerate(self.springs):
            for of, equations in zip(every, self.stages):
                if any(spring.element(e) is not None for e in equations):
                    of.append((stiffness_name(i),))
        return [tuple(dict.fromkeys(name for of in stage for name in of)) for stage in every]

    @property
    def equation_names(self) -> list[tuple[str, ...]]:
        """Names of the equations of each stage, numbered where several are called the same."""
        names = iter(told_apart([equation.name for equation in self.equations]))
        return [tuple(next(names) for _ in stage) for stage in self.stages]

    @property
    def units(self) -> dict[str, str]:
        """Unit of each coefficient."""
        units: dict[str, str] = {}
        for equation in self.equations:
            units |= {k: v for k, v in equation.units.items() if v or k not in units}
        for number, mode in enumerate(self.modes):
            units |= mode.units(number, self.equations)
        for number, spring in enumerate(self.springs):
            units[stiffness_name(number)] = spring.unit(self.equations)
        return units

    @property
    def known(self) -> Mapping[str, Leaf]:
        """Values that the equations themselves call known."""
        return {
            name: value for equation in self.equations for name, value in equation.known.items()
        }

    def plan(self, known: set[str]) -> list[tuple[str, tuple[str, ...]]]:
        """(stage name, parameters it finds) for each stage, given what is known beforehand.

        **Raises:** `ModelError` if a stage has nothing to set its scale: every coefficient in it
        is unknown and no term is known, so that zero would solve it.
        """
        found: set[str] = set(known)
        plan = []
        for stage, names in zip(self.stages, self.stage_parameters):
            unknown = tuple(name for name in names if name not in found)
            label = " + ".join(equation.name for equation in stage)
            # A known term sets an equation's scale, if through parameters that it shares.
            reached, size = set(found), -1
            while len(reached) > size:
                size = len(reached)
                for equation in stage:
                    if equation.has_target or set(equation.parameters) & reached:
                        reached |= set(equation.parameters)
            if unknown and not all(reached & set(equation.parameters) for equation in stage):
                coefficients = {name for equation in stage for name in equation.parameters}
                own = [name for name in unknown if name in coefficients]
                raise ModelError(
                    f"{label}: every coefficient is unknown, so all of them zero would fit. "
                    f"Fix one of {', '.join(own)} (on the command line: --set NAME=VALUE)."
                )
            plan.append((label, unknown))
            found |= set(unknown)
        return plan


class HasProcedure(Protocol):
    """Something that builds a procedure, such as a built-in `Model`."""

    def build_procedure(self) -> Procedure:
        """The procedure."""
        ...


def as_procedure(model: Equation | Procedure | HasProcedure) -> Procedure:
    """The procedure of an equation, of a model, or itself.

    **Raises:** `ModelError` for anything else, saying what to write.
    """
    if isinstance(model, Procedure):
        return model
    if isinstance(model, Equation):
        return staged(model)
    require_no_slip(model)
    if not hasattr(model, "build_procedure"):
        require("the model", model, (Equation, Procedure), SOME_MODEL)
    return model.build_procedure()


SOME_MODEL = "an rx.Equation(...), rx.staged(...) of several, or rx.find_model('quarter-car')"


def require_no_slip(model: object) -> None:
    """Raise `ModelError` for what is often taken for a model, saying what to write."""
    if isinstance(model, str):
        write = f"rx.find_model('{model}') for a built-in model or one of a file"
    elif isinstance(model, list | tuple):
        write = "rx.staged(*equations), or rx.simultaneous(*equations) to solve them together"
    elif isinstance(model, Record):
        write = "the model first, then its records"
    elif isinstance(model, type) and (
        issubclass(model, Equation | Procedure) or hasattr(model, "build_procedure")
    ):
        write = SOME_MODEL
    else:
        return
    require("the model", model, (), write)


def with_rests(procedure: Procedure, at_rest: AtRest | None) -> Procedure:
    """The procedure, with this done at rest, or what it says itself.

    **Raises:** `ModelError` for a word that says nothing of it.
    """
    if at_rest not in ("mask", "keep", None):
        raise ModelError(f"at_rest must be 'mask' or 'keep'; got {at_rest!r}.")
    return procedure if at_rest is None else replace(procedure, at_rest=at_rest)


def staged(*equations: Equation) -> Procedure:
    """Solve equations one after the other; each takes what came before as known.

    **Raises:** `ModelError` for what is no `Equation`.
    """
    _require_equations(equations, "staged")
    return Procedure(tuple((equation,) for equation in equations))


def simultaneous(*equations: Equation) -> Procedure:
    """Solve equations together for all their parameters: one Gram matrix, summed over them.

    The equations' residuals are weighted alike, so they should be in the same unit. An equation
    all of whose terms are unknown pulls its coefficients towards zero, where its residual vanishes:
    by how much is a finding, `no_known_term`, and solving it after the others by [`staged`][]
    avoids it.

    **Raises:** `ModelError` for what is no `Equation`.
    """
    _require_equations(equations, "simultaneous")
    return Procedure((equations,))


def _require_equations(equations: tuple[object, ...], name: str) -> None:
    for equation in equations:
        require(
            f"an equation of {name}(...)",
            equation,
            Equation,
            f"rx.{name}(first, second): equations one by one, rx.{name}(*equations) of a list",
        )
    if not equations:
        raise ModelError(f"{name}(...) needs at least one equation.")


def told_apart(names: Sequence[str]) -> tuple[str, ...]:
    """The names, numbered where several are equal: `spring (1)`, `spring (2)`."""
    return tuple(
        f"{name} ({1 + names[:i].count(name)})" if names.count(name) > 1 else name
        for i, name in enumerate(names)
    )
