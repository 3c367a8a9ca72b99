"""Models: equations of motion, in which order they are solved, what they leave out, what is known.

Equations stand in stages. A stage is a group of equations whose normal equations are added; what
earlier stages found is known to later ones. The paper's three stages are `staged(...)` of three
equations; its remark that all parameters may be estimated at once is `simultaneous(...)`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypeVar, get_args

import equinox as eqx
import numpy as np

from riecjax import arrays as xp
from riecjax.equations.element import Element
from riecjax.equations.equation import Equation, first_stated, require_agreement
from riecjax.equations.equation_system import EquationSystem, read_system
from riecjax.equations.expanded import Expanded
from riecjax.equations.expressions import Expression, relation_of
from riecjax.equations.quantity import BY_EQUATIONS, FrozenDict, Machine, Quantity
from riecjax.equations.term import AbstractTerm
from riecjax.errors import ModelError, refuse_unknown, require, users_code
from riecjax.leaves import Leaf, PlainMethods, is_number
from riecjax.records.record import Record, Records, as_records
from riecjax.shows import Shown

if TYPE_CHECKING:
    from riecjax.records.relations import Relation


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
    ("elements", (tuple, list), "elements=(rx.HiddenMode(on='x4'),)"),
)
"""Fields of a model, what they may be, and what to write instead."""


def _in_stages(given: "Sequence[Equation | Sequence[Equation]] | Equation | Model") -> Stages:
    """Stages as they are given: of an equation or a model, its own."""
    if isinstance(given, Model):
        if given.elements or given.rates:
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
    - `elements`: what no term of the equations says, see [`Model.with_elements`][].
    - `at_rest`: what is done where dry friction rests, see [`AtRest`][riecjax.equations.AtRest].
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
    elements: tuple[Element, ...] = ()
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
        meanings = self._joined()
        names = dict.fromkeys(name for equation in self.equations for name in equation.parameters)
        require_agreement(self.equations, self.parameters)
        units, listed = self.units, {quantity.name for quantity in self.parameters}
        own = {name: Quantity(name, units[name], meanings.get(name, "")) for name in names}
        quantities = own | self._of_hidden
        self.parameters += tuple(q for name, q in quantities.items() if name not in listed)

    def _joined(self) -> dict[str, str]:
        """Number elements that are new here, have the equations say of them what terms can, and
        return what the coefficients mean that these add."""
        elements, self.elements = self.elements, ()
        units = {quantity.name: quantity.unit for quantity in self.signals}
        meanings: dict[str, str] = {}
        for element in elements:
            require("an element", element, Element, "rx.HiddenMode(on='x4')")
            element.require_whole()
            with users_code(f"the element {type(element).__name__}"):
                element.require(self.equations, self.elements)
            if element.number is None:
                before = {name for equation in self.equations for name in equation.parameters}
                with users_code(f"the element {type(element).__name__}"):
                    self.stages = self.by_stage(partial(element.in_equation, units=units))
                names = [name for equation in self.equations for name in equation.parameters]
                meanings |= {name: element.meaning for name in names if name not in before}
                acts = any(element.term_in(equation) is not None for equation in self.equations)
                if element.is_of_equations and {*names} == before and not acts:
                    raise ModelError(f"no equation has {element.described}: it changes none.")
                alike = [other for other in self.elements if type(other) is type(element)]
                element = replace(element, number=len(alike))
            self.elements = (*self.elements, element)
        return meanings

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

    def with_elements(
        self, *elements: Element, values: Mapping[str, float] | None = None
    ) -> "Model":
        """The same model with what no term of its equations says.

        Such as [`HiddenMode`][], [`SeriesSpring`][], [`Backlash`][], hysteresis
        ([`Dahl`][riecjax.elements.Dahl]), the unknown zero or gain of a sensor
        ([`SensorZero`][riecjax.elements.SensorZero]), or a class of your own. Their parameters join
        the model's, and it is simulated by its equations.

        **Arguments:** `values` of parameters to simulate with.

        **Raises:** `ModelError` for an element that these equations cannot have.
        """
        if not elements:
            return self.with_values(values or {})
        model = replace(self, system=BY_EQUATIONS, elements=(*self.elements, *elements))
        return model.with_values(values or {})

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
        elements: Sequence[Element] = (),
        values: Mapping[str, float] | None = None,
        meanings: Mapping[str, str] | None = None,
    ) -> "Model":
        """The same model with further terms, each for the equation of a name.

        They stand beside the inertia: where that has a minus they get one too, so that what resists
        motion has a positive coefficient. Their coefficients join the model's parameters, and it is
        simulated by its equations.

        **Arguments:** `added`, terms by the name of their equation; `elements` that they read, as
        states that recordings lack; `values` of parameters to simulate with; `meanings` of those
        that are added.

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

        model, named = self.with_elements(*elements), {q.name for q in self.parameters}
        stages = model.by_stage(lambda equation: equation.of_terms(*extended(equation)))
        model = replace(model, system=BY_EQUATIONS, stages=stages, written=())
        parameters = tuple(
            q if q.name in named else q._replace(meaning=(meanings or {}).get(q.name, q.meaning))
            for q in model.parameters
        )
        return replace(model, parameters=parameters).with_values(values or {})

    def for_records(self, records: Records) -> "Model":
        """The same model, what its elements leave open set as these records suggest.

        **Raises:** as [`as_records`][riecjax.records.record.as_records], and as each element does.
        """
        if not self.elements:
            return self
        every = as_records(records)
        elements = tuple(element.for_records(every, self.equations) for element in self.elements)
        unchanged = all(a is b for a, b in zip(elements, self.elements))
        return self if unchanged else replace(self, elements=elements)

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
        """Whether elements have parameters that are no coefficients of the equations."""
        return bool(self.hidden)

    @property
    def hidden(self) -> tuple[Element, ...]:
        """Elements with parameters that are no coefficients, first those that change equations
        most."""
        hidden = [element for element in self.elements if element.hidden]
        return tuple(sorted(hidden, key=lambda element: -element.order))

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
        """Each equation with searched elements, linear in more columns than it has parameters."""
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
    given = dict(model.rates if rates is None else rates)
    listed = (*model.signals, *model.inputs)
    elements = sorted(model.elements, key=lambda element: -element.order)
    return read_system(
        label, model.equations, elements, numbers, given, inputs, listed, units or {}
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
