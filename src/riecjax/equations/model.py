"""Models: equations of motion, in which order they are solved, what they leave out, what is known.

Equations stand in stages. A stage is a group of equations whose normal equations are added; what
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
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypeVar, get_args

import equinox as eqx
import numpy as np

from riecjax import arrays as xp
from riecjax.equations.equation import Equation, first_stated, require_agreement
from riecjax.equations.equation_system import EquationSystem, read_system
from riecjax.equations.expressions import Expression, constant, relation_of, signals_read
from riecjax.equations.hidden_elements import (
    Expanded,
    HiddenElement,
    HiddenMode,
    SeriesSpring,
    force_elements,
    why_no_element,
)
from riecjax.equations.memories import Memory
from riecjax.equations.quantity import BY_EQUATIONS, FrozenDict, Machine, Quantity
from riecjax.equations.term import AbstractTerm, Term
from riecjax.errors import ModelError, refuse_unknown, require
from riecjax.leaves import Leaf, PlainMethods, is_number
from riecjax.records.record import Record
from riecjax.shows import Shown

if TYPE_CHECKING:
    from riecjax.records.relations import Relation
    from riecjax.settings import Elements


AtRest: TypeAlias = Literal["mask", "keep"]
"""What is done where a velocity with dry friction rests: weights that vanish there leave it out of
the sums, or it stays as any other sample."""


Made = TypeVar("Made")
OWN = "your own equation"
"""What a model says of itself where it is not described."""
Stages = tuple[tuple[Equation, ...], ...]
FIELDS = (
    ("name", str, "rx.Model('cart', stages=rx.Equation(...)): the name stands first"),
    ("derived", Mapping, "derived={'dx': 'x'}"),
    ("rates", Mapping, "rates={'x1': rx.difference('v_r', 'x3')}"),
    ("band", (tuple, list, type(None)), "band=(1.0, 10.0), in hertz"),
    ("modes", (tuple, list), "modes=(rx.HiddenMode(on='x4'),)"),
    ("springs", (tuple, list), "springs=(rx.SeriesSpring(of='c'),)"),
    ("memories", (tuple, list), "memories=(memory,)"),
)
"""Fields of a model, what they may be, and what to write instead."""


def _in_stages(given: "Sequence[Equation | Sequence[Equation]] | Equation | Model") -> Stages:
    """Stages as they are given: of an equation or a model, its own."""
    if isinstance(given, Model):
        if given.has_hidden or given.memories or given.rates:
            raise ModelError("stages= takes equations: add what else the model has to the new one.")
        return given.stages
    write = "stages=rx.Equation(...), or rx.staged(*equations)"
    stages = []
    for stage in given if isinstance(given, tuple | list) else (given,):
        stages.append(tuple(stage) if isinstance(stage, tuple | list) else (stage,))
        for equation in stages[-1]:
            require("what is in stages", equation, Equation, write)
    return tuple(stages)


class Model(PlainMethods, Shown, eqx.Module):
    """Equations in stages, what they leave out, and what is known of their signals.

    It can be identified, simulated, or both; a model of equations is simulated by these. Where
    something else moves than what is identified, `system` says what.

    **Fields:**

    - `name`, `summary`: for listings.
    - `stages` of equations: an `Equation`, or several by [`staged`][] or [`simultaneous`][].
    - `signals`: what identification reads from a record.
    - `derived`: signal to the signal whose time derivative it is, formed by local polynomials
      (where there is no noise, by central differences) if the record lacks it.
    - `parameters`: of the equations, with what they mean and values to simulate with. Those that
      are not given are added.
    - `inputs`: what drives it. Recordings that hold these are simulated with `rates`.
    - `rates`: of states whose derivative no equation holds, such as x1' = v_r - x3: signal to an
      expression, see [`Model.with_rates`][].
    - `system`: what is simulated, where no equation that is linear in its parameters can say it: a
      function of these by name, or a [`Machine`][riecjax.equations.Machine] of others.
    - `band`: lowest and highest frequency in hertz that the model should explain. Windows are half
      its periods long (eq. 26) unless other lengths are asked for.
    - `written`: signals that a simulated recording holds; all by default.
    - `note`: something a user should know before using it.
    - `modes`: oscillators that the equations leave out, see [`Model.with_modes`][]; `springs` in
      series with force elements, see [`Model.with_series_springs`][]; `memories`, see
      [`Model.with_memories`][]; `at_rest`, see [`AtRest`][riecjax.equations.AtRest].
    """

    # Compared by identity, so that a jitted function can take one as static.
    __eq__, __hash__ = object.__eq__, object.__hash__

    name: str = eqx.field(static=True, default="")
    summary: str = eqx.field(static=True, default=OWN)
    stages: Stages = eqx.field(converter=_in_stages, default=())
    signals: tuple[Quantity, ...] = eqx.field(static=True, default=())
    derived: Mapping[str, str] = eqx.field(static=True, default=FrozenDict())
    parameters: tuple[Quantity, ...] = eqx.field(static=True, default=())
    inputs: tuple[Quantity, ...] = eqx.field(static=True, default=())
    rates: Mapping[str, Expression] = eqx.field(static=True, default=FrozenDict())
    system: Any = eqx.field(static=True, default=BY_EQUATIONS)
    band: tuple[float, float] | None = eqx.field(static=True, default=None)
    written: tuple[str, ...] = eqx.field(static=True, default=())
    note: str = eqx.field(static=True, default="")
    modes: tuple[HiddenMode, ...] = ()
    springs: tuple[SeriesSpring, ...] = ()
    memories: tuple[Memory, ...] = eqx.field(static=True, default=())
    at_rest: AtRest = eqx.field(static=True, default="mask")

    def __post_init__(self) -> None:
        # The field's converter comes after, for what stands here is needed first.
        for name, kinds, write in FIELDS:
            require(f"{name} of a model", getattr(self, name), kinds, write)
        ends = (0, *((1, 2) if self.band is None else self.band), np.inf)
        if len(ends) != 4 or not all(map(is_number, ends)) or not (np.diff(ends) > 0).all():
            raise ModelError(f"a model's band is from a low to a high frequency; got {self.band}.")
        if self.at_rest not in get_args(AtRest):
            raise ModelError(f"at_rest must be 'mask' or 'keep'; got {self.at_rest!r}.")
        self.stages = _in_stages(self.stages)
        self.system = self.system if isinstance(self.system, Machine) else Machine(self.system)
        for field_name in ("signals", "parameters", "inputs"):
            quantities = getattr(self, field_name)
            for quantity in quantities:
                write = f"{field_name}=(Quantity('x', 'm', 'position'), ...)"
                require(f"what is in {field_name}", quantity, Quantity, write)
            if len({quantity.name for quantity in quantities}) < len(quantities):
                raise ModelError(f"a name stands twice in {field_name}.")
        self.derived, self.rates = FrozenDict(self.derived), FrozenDict(self.rates)
        for mode in self.modes:
            require("a mode", mode, HiddenMode, "rx.HiddenMode(on='x4')")
            if not any(mode.term_in(e) is not None for e in self.equations):
                raise ModelError(
                    f"a hidden mode on '{mode.on}' needs a term that accelerates it, such as "
                    f"rx.Term('m', '{mode.on}', derivative=1): no equation has one."
                )
        self.modes = tuple(replace(mode, number=i) for i, mode in enumerate(self.modes))
        names = dict.fromkeys(name for equation in self.equations for name in equation.parameters)
        taken: list[str] = []
        for spring in self.springs:
            require("a spring", spring, SeriesSpring, "rx.SeriesSpring(of='c')")
            if spring.of in taken:
                raise ModelError(f"'{spring.of}' has a spring in series already.")
            every = [t for e in self.equations for t in e.terms if spring.of in t.parameters]
            if not every:
                raise ModelError(
                    f"no equation has a coefficient '{spring.of}' that a spring could be in series "
                    f"with; there are: {', '.join(names)}."
                )
            if any((t.of, t.derivative) != (every[0].of, every[0].derivative) for t in every):
                raise ModelError(
                    f"{spring.of} is of other signals in one term than in another, so that it is "
                    f"no one element that a spring could be in series with."
                )
            if wrong := why_no_element(every[0], self.equations):
                fitting = force_elements(self.equations, self.equations)
                raise ModelError(
                    f"'{spring.of}' {wrong}. A spring is in series with a damper, a term of a "
                    f"velocity or a map of one: {', '.join(fitting) or 'no equation has any'}."
                )
            taken += every[0].parameters
        self.springs = tuple(replace(spring, number=i) for i, spring in enumerate(self.springs))
        require_agreement(self.equations, self.parameters)
        units, listed = self.units, {quantity.name for quantity in self.parameters}
        quantities = {name: Quantity(name, units[name], "") for name in names} | self._of_hidden
        self.parameters += tuple(q for name, q in quantities.items() if name not in listed)

    @property
    def kinematics(self) -> "tuple[Relation, ...]":
        """Rates that are sums of signals with constant factors."""
        sums = (relation_of(name, rate) for name, rate in self.rates.items())
        return tuple(relation for relation in sums if relation)

    @property
    def derivatives(self) -> "tuple[tuple[str, str] | Relation, ...]":
        """Signals with those that are their time derivatives, alone or as a sum."""
        pairs = (pair for equation in self.equations for pair in equation.derivatives)
        derived = ((of, name) for name, of in self.derived.items())
        return tuple(dict.fromkeys((*derived, *pairs, *self.kinematics)))

    def with_rates(self, rates: Mapping[str, Expression]) -> "Model":
        """The same equations, knowing what the time derivatives of some signals are.

        `rates` are expressions by signal, such as `{"x2": rx.difference("x3", "x4")}`. Where they
        are sums of signals with constant factors, recordings are held against them: which signal is
        late, or wrong in size, sign, unit or zero. Simulations have these signals for states.
        """
        return replace(self, rates={**self.rates, **rates})

    def with_modes(self, *modes: HiddenMode, values: Mapping[str, float] | None = None) -> "Model":
        """The same model with oscillators that its equations leave out.

        Their parameters join the model's, and it is simulated by its equations.

        **Arguments:** `values` of parameters to simulate with.

        **Raises:** `ModelError` for a mode on a signal whose derivative no equation holds.
        """
        return replace(self, system=BY_EQUATIONS, modes=(*self.modes, *modes)).with_values(
            values or {}
        )

    def with_series_springs(self, *springs: SeriesSpring) -> "Model":
        """The same model with springs in series with force elements, see [`SeriesSpring`][].

        Their stiffnesses join the model's parameters, and it is simulated by its equations.

        **Raises:** `ModelError` for an element that no equation holds, that is no damper, that has
        a spring, or that is of other signals in one term than in another.
        """
        return replace(self, system=BY_EQUATIONS, springs=(*self.springs, *springs))

    def with_memories(self, *memories: Memory) -> "Model":
        """The same equations, reading states of hysteresis as signals.

        Recordings that lack them are given them from the velocities that drive them; simulations
        carry them along.
        """
        return replace(self, memories=(*self.memories, *memories))

    def with_values(self, values: Mapping[str, float]) -> "Model":
        """The same model with these values of parameters to simulate with.

        **Raises:** `ModelError` for a parameter that the model does not have.
        """
        names = [quantity.name for quantity in self.parameters]
        refuse_unknown([name for name in values if name not in names], names, "there are")
        return replace(
            self,
            parameters=tuple(
                quantity._replace(default=values.get(quantity.name, quantity.default))
                for quantity in self.parameters
            ),
        )

    def with_terms(
        self,
        added: Mapping[str, Sequence[AbstractTerm]],
        memories: Sequence[Memory] = (),
        values: Mapping[str, float] | None = None,
        meanings: Mapping[str, str] | None = None,
    ) -> "Model":
        """The same model with further terms, each for the equation of a name.

        They stand beside the inertia: where that has a minus they get one too, so that what resists
        motion has a positive coefficient. Their coefficients join the model's parameters, and it is
        simulated by its equations.

        **Arguments:** `added`, terms by the name of their equation; `memories`, states that they
        read and recordings lack, see [`Model.with_memories`][]; `values` of parameters to simulate
        with; `meanings` of those that are added.

        **Raises:** `ModelError` for an equation that there is none of, and for a coefficient that
        the model has already or that is added twice.
        """
        for name, terms in added.items():
            write = f"{{'{name}': [rx.Term('d', 'v')]}}"
            require(f"what is added to {name}", terms, (tuple, list), write)
        names = [name for stage in self.equation_names for name in stage]
        if unknown := [name for name in added if name not in names]:
            raise ModelError(
                f"no equation is called '{unknown[0]}'; there are: {', '.join(names)}."
            )
        new = [n for terms in added.values() for term in terms for n in term.parameters]
        taken = (*self.parameter_names, *new)
        if twice := [name for name in new if taken.count(name) > 1]:
            raise ModelError(f"there is a coefficient '{twice[0]}' already: call it otherwise.")
        rest = iter(names)

        def extended(equation: Equation) -> Sequence[AbstractTerm]:
            # What is differentiated most often stands for the inertia, a named coefficient first;
            # of a force element, which has none, what it was given.
            first = min(equation.terms, key=lambda t: (-t.derivative, not t.parameters))
            turned = xp.is_concrete(first.factor) and float(np.asarray(first.factor)) < 0
            own = added.get(next(rest), ())
            return (*equation.terms, *(-term if turned else term for term in own))

        model = self.with_memories(*memories)._with_equations(
            extended, lambda name: (meanings or {}).get(name, "")
        )
        return replace(model, written=()).with_values(values or {})

    def with_sensor_errors(self, offsets: Sequence[str] = (), gains: Sequence[str] = ()) -> "Model":
        """The same model with unknown offsets and gains of the sensors of these signals.

        They join its parameters. What is simulated are its equations, and by them the signals as
        these sensors show them. A derivative of a signal has no offset. Coefficients of an offset
        are called `offset_SIGNAL`, in the signal's unit, where the term's own is known, else
        `k_offset_SIGNAL`, that is k times it; of a gain `gain_SIGNAL`, by which readings are to be
        multiplied.

        **Raises:** `ModelError` where no equation has a term of the signal itself, or reads it in a
        function; where it has a constant term already, from which no offset can be told apart; and
        where a term whose sensor has a gain has a coefficient that is estimated too.
        """
        for what, signals in {"offsets": offsets, "gains": gains}.items():
            require(what, signals, (tuple, list), f"{what}=['F']")
        units = {quantity.name: quantity.unit for quantity in self.signals}

        def terms(equation: Equation, signal: str, is_gain: bool) -> list[AbstractTerm]:
            label = f"{'gain' if is_gain else 'offset'}_{signal}"
            for term in equation.terms:
                if signal in signals_read(term.of) and term.signal != signal:
                    named = " and ".join(term.parameters) or "no coefficient"
                    raise ModelError(
                        f"{equation.name}: the term of {named} is a function of '{signal}', in "
                        f"which an unknown offset or gain is no coefficient of its own; calibrate "
                        f"that sensor."
                    )
            own = [term for term in equation.terms if term.signal == signal]
            named = [term.name for term in own if term.name is not None]
            if is_gain:
                if named:
                    raise ModelError(
                        f"the gain of '{signal}' cannot be told apart from '{named[0]}', which "
                        f"multiplies it: {named[0]} comes out multiplied by the gain."
                    )
                return [
                    Term(label, t.of, derivative=t.derivative, measured=t.measured, sign=t.factor)
                    if t.signal == signal
                    else t
                    for t in equation.terms
                ]
            if not (own := [term for term in own if not term.derivative]):
                return [*equation.terms]
            if taken := [n for t in equation.terms if t.of is constant for n in t.parameters]:
                raise ModelError(
                    f"{equation.name}: an offset of '{signal}' cannot be told apart from "
                    f"'{taken[0]}', which is constant too; give {signal}'s offset, or leave that "
                    f"term out."
                )
            if len(own) > 1:
                raise ModelError(f"{equation.name} has several terms of '{signal}'; add them up.")
            (term,), unit = own, units.get(signal) or str(own[0].unit)
            if term.name is not None:
                label, unit = f"{term.name}_{label}", equation.unit
            return [*equation.terms, Term(label, constant, unit=unit, sign=-term.factor)]

        model = self
        for signal, is_gain in (*((s, False) for s in offsets), *((s, True) for s in gains)):
            with_error = partial(terms, signal=signal, is_gain=is_gain)
            before, model = model, model._with_equations(with_error, lambda _: "of a sensor")
            if len(model.parameters) == len(before.parameters):
                raise ModelError(
                    f"no equation reads '{signal}', so that none tells of its gain."
                    if is_gain
                    else f"no equation has a term of '{signal}' itself, so that none tells of its "
                    f"offset."
                )
        return model

    def _with_equations(
        self, terms: Callable[[Equation], Sequence[AbstractTerm]], meaning: Callable[[str], str]
    ) -> "Model":
        """Equations of other terms in their place, and what the parameters mean that these add."""
        stages = self.by_stage(lambda equation: equation.of_terms(*terms(equation)))
        after = replace(self, system=BY_EQUATIONS, stages=stages)
        added = after.parameters[len(self.parameters) :]
        meant = (q._replace(meaning=meaning(q.name)) for q in added)
        return replace(after, parameters=(*self.parameters, *meant))

    def with_elements(self, elements: "Elements") -> "Model":
        """The same model with what it leaves out, and with what its sensors get wrong.

        **Raises:** `ModelError` as the methods that add each, and for an unknown kind.
        """
        plain = {
            "spring": elements.springs,
            "offset": elements.offsets_of,
            "gain": elements.gains_of,
        }
        asked = [("mode", signal, hertz) for signal, hertz in elements.modes]
        asked += [(kind, signal, None) for kind, signals in plain.items() for signal in signals]
        asked += elements.added
        for kind, signal, hertz in asked:
            if kind not in ("mode", *plain):
                listed = ", ".join(("mode", *plain))
                raise ModelError(f"there is no element '{kind}'; there are: {listed}.")
            if kind in plain and hertz is not None:
                raise ModelError(f"{kind}:{signal} is near no frequency: leave out ={hertz:g}.")
        of_kind = {kind: [signal for each, signal, _ in asked if each == kind] for kind in plain}
        offsets, gains = (tuple(dict.fromkeys(of_kind[kind])) for kind in ("offset", "gain"))
        model = self.with_sensor_errors(offsets, gains)
        model = model.solved_together() if elements.together else model
        if modes := [HiddenMode(signal, hertz) for kind, signal, hertz in asked if kind == "mode"]:
            model = model.with_modes(*modes)
        if springs := of_kind["spring"]:
            model = model.with_series_springs(*map(SeriesSpring, springs))
        return model

    def solved_together(self) -> "Model":
        """The same model with the equations of all stages in one, as by [`simultaneous`][]."""
        every = tuple(equation for stage in self.stages for equation in stage)
        return replace(self, stages=(every,))

    @property
    def simulation_parameters(self) -> tuple[Quantity, ...]:
        """Parameters of the simulated system, with defaults."""
        return self.system.parameters or self.parameters

    def build_system(self, settings: Mapping[str, Leaf | float]) -> Any:
        """The system to simulate, with its defaults replaced by `settings`.

        **Raises:** `ModelError` if its equations cannot be simulated; for a setting that is unknown
        or has neither value nor default.
        """
        build = self.system.build
        if build is None and not self.stages:
            raise ModelError(f"model '{self.name}' has neither equations nor a system.")
        quantities = self.simulation_parameters
        names = [quantity.name for quantity in quantities]
        refuse_unknown([n for n in settings if n not in names], names, f"{self.name} has")
        values: dict[str, Any] = {q.name: settings.get(q.name, q.default) for q in quantities}
        if unset := [name for name, value in values.items() if value is None]:
            raise ModelError(
                f"{self.name} needs a value for {', '.join(unset)} (--set {unset[0]}=VALUE)."
            )
        if build is None:
            return equation_system(self, values)
        return build({name: xp.asarray(value, float) for name, value in values.items()})

    def identified_system(self, values: Mapping[str, Any], record: Record) -> Any:
        """The system to validate identified values with on a record.

        What the model simulates if the record holds its inputs, else one made of its equations.

        **Raises:** `ModelError` if the equations cannot be simulated.
        """
        if self.has_own_system(record):
            return self.build_system({name: float(value) for name, value in values.items()})
        # A recording may have measured the signals that rates are of.
        return equation_system(self, values, rates=None if self.is_driven_by(record) else {})

    def has_own_system(self, record: Record) -> bool:
        """Whether a record drives a system of the model's own that its parameters are those of."""
        names = {parameter.name for parameter in self.simulation_parameters}
        own = names == {parameter.name for parameter in self.parameters} or not self.stages
        return self.system.build is not None and own and self.is_driven_by(record)

    def says_change_of(self, signal: str) -> bool:
        """Whether a rate, or an equation among several, says how a signal changes."""
        terms = (term for equation in self.equations for term in equation.terms if term.derivative)
        solved = len(self.equations) > 1 and any(term.of == signal for term in terms)
        return solved or signal in self.rates

    def is_driven_by(self, record: Record) -> bool:
        """Whether a record holds the inputs, of which there are some."""
        return bool(self.inputs) and all(q.name in record.signals for q in self.inputs)

    @property
    def equations(self) -> tuple[Equation, ...]:
        """Of all stages, in order."""
        return tuple(equation for stage in self.stages for equation in stage)

    @property
    def has_hidden(self) -> bool:
        """Whether equations leave out modes or springs."""
        return bool(self.modes or self.springs)

    @property
    def hidden(self) -> tuple[HiddenElement, ...]:
        """What equations leave out: modes, and then springs."""
        return (*self.modes, *self.springs)

    @property
    def _of_hidden(self) -> dict[str, Quantity]:
        """Parameters of hidden elements, by name."""
        every = (q for element in self.hidden for q in element.quantities(self.equations))
        return {quantity.name: quantity for quantity in every}

    def by_stage(self, of: Callable[[Equation], Made]) -> tuple[tuple[Made, ...], ...]:
        """What is made of each equation, stage by stage."""
        return tuple(tuple(map(of, stage)) for stage in self.stages)

    @property
    def expanded(self) -> tuple[tuple[Expanded, ...], ...]:
        """Each equation with modes and springs, linear in more columns than it has parameters."""
        return self.by_stage(lambda equation: Expanded.of(equation, self.hidden))

    @property
    def linear(self) -> "Model":
        """Equations without hidden elements, whose sums tell of these with any.

        They are without what a catalogue says too: nothing is compiled anew for other words.
        """
        if not self.has_hidden:
            return Model(stages=self.stages, at_rest=self.at_rest)
        stages = tuple(tuple(e.equation for e in stage) for stage in self.expanded)
        # Their derivatives are of more than one body, which do not rest together.
        return Model(stages=stages, at_rest="keep")

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of all coefficients, in order of first appearance."""
        return tuple(dict.fromkeys(name for names in self.stage_parameters for name in names))

    @property
    def stage_parameters(self) -> list[tuple[str, ...]]:
        """Names of the coefficients of each stage, in order of first appearance."""

        def names(equation: Equation) -> list[str]:
            there = (e for e in self.hidden if e.term_in(equation) is not None)
            return [*equation.parameters, *(name for element in there for name in element.hidden)]

        return [tuple(dict.fromkeys(n for e in stage for n in names(e))) for stage in self.stages]

    @property
    def equation_names(self) -> list[tuple[str, ...]]:
        """Names of the equations of each stage, numbered where several are called the same."""
        names = iter(told_apart([equation.name for equation in self.equations]))
        return [tuple(next(names) for _ in stage) for stage in self.stages]

    @property
    def units(self) -> dict[str, str]:
        """Unit of each coefficient."""
        units = [pair for equation in self.equations for pair in equation.units.items()]
        return first_stated(units) | {
            name: quantity.unit for name, quantity in self._of_hidden.items()
        }

    @property
    def known(self) -> Mapping[str, Leaf]:
        """Values that the equations themselves call known."""
        return {name: value for e in self.equations for name, value in e.known.items()}

    def plan(self, known: set[str]) -> list[tuple[str, tuple[str, ...]]]:
        """(stage name, parameters it finds) for each stage, given what is known beforehand.

        **Raises:** `ModelError` if a stage has nothing to set its scale: every coefficient in it
        is unknown and no term is known, so that zero would solve it.
        """
        found: set[str] = set(known)
        plan = []
        for stage, names in zip(self.stages, self.stage_parameters):
            unknown = tuple(name for name in names if name not in found)
            label = names_of(stage)
            # A known term sets an equation's scale, if through parameters that it shares.
            reached = set(found)
            for equation in stage * len(stage):
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


def equation_system(
    model: Equation | Model,
    values: Mapping[str, Leaf | float],
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
      as `{"x2": difference("x3", "x4")}` that no coefficient appears in; by default the model's.
    - `inputs`: signals to take as inputs although their derivative appears, as of a base that is
      moved; the derivative is an input too, under its name from `measured`.
    - `units`: signal name to unit.

    **Raises:** `ModelError` if a coefficient has no value; if the equations cannot be simulated
    because none holds a derivative, their number is not that of the unknowns, a derivative is of
    third order or of an expression of inputs; or, with values that can be looked at, if the
    leading coefficient is zero or the unknowns do not enter linearly.
    """
    model = as_model(model)
    label, known = names_of(model.equations), {**model.known, **values}
    if unset := [name for name in model.parameter_names if name not in known]:
        raise ModelError(f"{label}: no value is given for {', '.join(unset)}.")
    numbers = {name: xp.asarray(known[name], float) for name in model.parameter_names}
    for name, number in numbers.items():
        if number.shape != ():
            raise ModelError(f"{label}: {name} must be one number; it has shape {number.shape}.")
    further: dict[str, Expression] = {memory.state: memory for memory in model.memories}
    further |= model.rates if rates is None else rates
    elements, listed = (model.modes, model.springs), (*model.signals, *model.inputs)
    return read_system(
        label, model.equations, elements, numbers, further, inputs, listed, units or {}
    )


def as_model(model: Equation | Model) -> Model:
    """The model itself, or one of an equation, named as that is.

    **Raises:** `ModelError` for anything else, saying what to write, and for a model that has no
    equations.
    """
    require_no_slip(model)
    require("the model", model, (Equation, Model), SOME_MODEL)
    made = staged(model) if isinstance(model, Equation) else model
    if not made.stages:
        raise ModelError(f"model '{made.name}' can be simulated but not identified.")
    return made


SOME_MODEL = "an rx.Equation(...), rx.staged(...) of several, or rx.find_model('quarter-car')"


def require_no_slip(model: object) -> None:
    """Raise `ModelError` for what is often taken for a model, saying what to write."""
    if isinstance(model, str):
        write = f"rx.find_model('{model}') for a built-in model or one of a file"
    elif isinstance(model, list | tuple):
        write = "rx.staged(*equations), or rx.simultaneous(*equations) to solve them together"
    elif isinstance(model, Record):
        write = "the model first, then its records"
    elif isinstance(model, type) and issubclass(model, Equation | Model):
        write = SOME_MODEL
    else:
        return
    require("the model", model, (), write)


def with_rests(model: Model, at_rest: AtRest | None) -> Model:
    """The model, with this done at rest, or what it says itself."""
    return model if at_rest is None else replace(model, at_rest=at_rest)


def staged(*equations: Equation) -> Model:
    """Solve equations one after the other; each takes what came before as known.

    **Raises:** `ModelError` for what is no `Equation`.
    """
    _require_equations(equations, "staged")
    return Model(names_of(equations), stages=tuple((equation,) for equation in equations))


def simultaneous(*equations: Equation) -> Model:
    """Solve equations together for all their parameters: one Gram matrix, summed over them.

    The equations' residuals are weighted alike, so they should be in the same unit. An equation
    all of whose terms are unknown pulls its coefficients towards zero, where its residual vanishes:
    by how much is a finding, `no_known_term`, and solving it after the others by [`staged`][]
    avoids it.

    **Raises:** `ModelError` for what is no `Equation`.
    """
    _require_equations(equations, "simultaneous")
    return Model(names_of(equations), stages=(equations,))


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


def names_of(equations: Sequence[Equation]) -> str:
    """What equations are called together, and a model that has no other name."""
    return " + ".join(equation.name for equation in equations)


def told_apart(names: Sequence[str]) -> tuple[str, ...]:
    """The names, numbered where several are equal: `spring (1)`, `spring (2)`."""
    return tuple(
        f"{name} ({1 + names[:i].count(name)})" if names.count(name) > 1 else name
        for i, name in enumerate(names)
    )
