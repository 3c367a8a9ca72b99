"""What the command line needs to know of a model, in plain data: listing imports no JAX."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

from riecjax.errors import ModelError, require, users_code
from riecjax.shows import Shown

if TYPE_CHECKING:
    from jaxtyping import Array

    from riecjax.equations.equation import Equation
    from riecjax.equations.hidden_elements import HiddenMode, SeriesSpring
    from riecjax.equations.memories import Memory
    from riecjax.equations.procedure import HasProcedure, Procedure
    from riecjax.equations.term import AbstractTerm
    from riecjax.records.record import Record
    from riecjax.refinement.objective import AbstractParametric
    from riecjax.settings import Elements
    from riecjax.simulation.equation_system import Attachment
    from riecjax.simulation.system import AbstractSystem


class Quantity(NamedTuple):
    """A parameter or signal: name, unit, meaning, and for simulation a default value."""

    name: str
    unit: str
    meaning: str
    default: float | None = None


# Compared by identity, so that a jitted function can take one as static.
@dataclass(frozen=True, eq=False, repr=False)
class Model(Shown):
    """A named model that can be identified, simulated, or both.

    **Fields:**

    - `name`, `summary`: for listings.
    - `signals`: what identification reads from a record.
    - `derived`: signal to the signal whose time derivative it is, formed by central differences
      if the record lacks it.
    - `procedure`: builds what is identified, given as `module:function` or the function.
    - `parameters`: what it identifies.
    - `system`: builds what is simulated from parameter values, likewise.
    - `own_simulation_parameters`: what that takes, with defaults; the identified ones unless given.
    - `band`: lowest and highest frequency in hertz that the model should explain. Windows are half
      its periods long (eq. 26) unless other lengths are asked for.
    - `rates`: of states whose derivative no equation holds, such as x1' = v_r - x3: signal to an
      expression, a function or `module:function`. Recordings are held against them, see
      [`Procedure.with_rates`][]. With them the equations are simulated, driven by
      `inputs`, where the model's own system knows nothing of hidden elements.
    - `written`: signals that a simulated recording holds; all by default.
    - `note`: something a user should know before using it.
    - `modes`: oscillators that the equations leave out, see `with_modes`; `springs` in series with
      force elements, see `with_series_springs`.
    - `sensors`: errors of sensors among its parameters, see `with_sensor_errors`.
    """

    name: str
    summary: str
    signals: tuple[Quantity, ...] = ()
    derived: Mapping[str, str] = field(default_factory=dict)
    procedure: str | Callable[[], Any] | None = None
    parameters: tuple[Quantity, ...] = ()
    system: str | Callable[[Mapping[str, Array]], AbstractSystem] | None = None
    own_simulation_parameters: tuple[Quantity, ...] = ()
    inputs: tuple[Quantity, ...] = ()
    band: tuple[float, float] | None = None
    rates: Mapping[str, str | Callable[..., Any]] = field(default_factory=dict)
    written: tuple[str, ...] = ()
    note: str = ""
    modes: tuple[HiddenMode, ...] = ()
    springs: tuple[SeriesSpring, ...] = ()
    sensors: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for field_name in ("signals", "parameters", "own_simulation_parameters", "inputs"):
            for quantity in getattr(self, field_name):
                write = f"{field_name}=(Quantity('x', 'm', 'position'), ...)"
                require(f"what is in {field_name}", quantity, Quantity, write)

    @property
    def simulation_parameters(self) -> tuple[Quantity, ...]:
        """Parameters of the simulated system, with defaults."""
        return self.own_simulation_parameters or self.parameters

    def with_modes(self, *modes: HiddenMode, values: Mapping[str, float] | None = None) -> Model:
        """The same model with oscillators that its equations leave out.

        Their parameters join the model's. Its own system carries them where that is exact: where
        its equations say that the body's acceleration is coupled to no other.

        **Arguments:** `values` of parameters to simulate with.

        **Raises:** `ModelError` for a mode on a signal whose derivative no equation holds.
        """
        from riecjax.equations.hidden_elements import ModeParameters

        carrying = replace(self, modes=(*self.modes, *modes))
        procedure = carrying.build_procedure()
        added: list[Quantity] = []
        for number, mode in enumerate(modes, len(procedure.modes) - len(modes)):
            for part, name in ModeParameters.of(number)._asdict().items():
                unit = procedure.units[name]
                added.append(Quantity(name, unit, f"{part} of the hidden mode on {mode.on}"))
        own = self.own_simulation_parameters
        if {q.name for q in own} == {q.name for q in self.parameters}:
            own = (*own, *added)
        return replace(
            carrying,
            parameters=_with_defaults((*self.parameters, *added), values),
            own_simulation_parameters=_with_defaults(own, values),
        )

    def with_terms(
        self,
        added: Mapping[str, Sequence[AbstractTerm]],
        memories: Sequence[Memory] = (),
        values: Mapping[str, float] | None = None,
        meanings: Mapping[str, str] | None = None,
    ) -> Model:
        """The same model with further terms, see [`Procedure.with_terms`][].

        Their coefficients join its parameters, and it is simulated by its equations. To be called
        before hidden elements are added.

        **Arguments:** `added`, terms by the name of their equation; `memories`, states that they
        read and recordings lack, see [`Procedure.with_memories`][]; `values` of parameters to
        simulate with; `meanings` of those that are added.

        **Raises:** as [`Procedure.with_terms`][].
        """
        procedure = self.build_procedure().with_memories(*memories).with_terms(added)
        said = meanings or {}
        listed = {quantity.name for quantity in self.parameters}
        own = [
            *self.parameters,
            *(
                Quantity(name, procedure.units.get(name, ""), said.get(name, ""))
                for name in procedure.parameters
                if name not in listed
            ),
        ]
        return replace(
            self,
            procedure=lambda: procedure,
            parameters=_with_defaults(own, values),
            system=None,
            own_simulation_parameters=(),
            written=(),
        )

    def with_sensor_errors(self, offsets: Sequence[str] = (), gains: Sequence[str] = ()) -> Model:
        """The same model with unknown offsets and gains of the sensors of these signals.

        They join its parameters. What is simulated then are its equations, and by them the signals
        as these sensors show them. To be called before hidden elements are added.

        **Raises:** `ModelError` where an offset or gain is no coefficient, or cannot be told apart
        from one; see [`riecjax.equations.procedure`][].
        """
        units = {signal.name: signal.unit for signal in self.signals}
        procedure = self.build_procedure()
        for signal in offsets:
            procedure = procedure.with_unknown_offset(signal, units.get(signal, ""))
        for signal in gains:
            procedure = procedure.with_unknown_gain(signal)
        known = {parameter.name for parameter in self.parameters}
        added = [
            Quantity(name, procedure.units[name], "of a sensor")
            for name in procedure.parameters
            if name not in known
        ]
        if not added:
            return self
        return replace(
            self,
            procedure=lambda: procedure,
            parameters=(*self.parameters, *added),
            sensors=(*self.sensors, *(quantity.name for quantity in added)),
        )

    def with_series_springs(self, *springs: SeriesSpring) -> Model:
        """The same model with springs in series with force elements, see [`SeriesSpring`][].

        It is simulated by its equations, and its `rates`: its own system knows of no springs.

        **Raises:** `ModelError` for an element that no equation holds.
        """
        from riecjax.equations.hidden_elements import stiffness_name

        carrying = replace(self, springs=(*self.springs, *springs))
        units = carrying.build_procedure().units
        names = [stiffness_name(i) for i in range(len(self.springs), len(carrying.springs))]
        added = (Quantity(name, units[name], "spring in series") for name in names)
        return replace(carrying, parameters=(*self.parameters, *added))

    def with_elements(self, elements: Elements) -> Model:
        """The same model with what it leaves out, and with what its sensors get wrong.

        **Raises:** `ModelError` as the methods that add each, and for an unknown kind.
        """
        from riecjax.equations.hidden_elements import HiddenMode, SeriesSpring

        added: dict[str, list[Any]] = {"mode": [*elements.modes], "spring": [*elements.springs]}
        added |= {"offset": [*elements.offsets_of], "gain": [*elements.gains_of]}
        others = []
        for kind, signal, hertz in elements.added:
            if kind not in added:
                from riecjax.extensions import element

                others.append((kind, element(kind, [*added]), signal, hertz))
            elif kind == "mode":
                added[kind].append((signal, hertz))
            elif hertz is not None:
                raise ModelError(f"{kind}:{signal} is near no frequency: leave out ={hertz:g}.")
            else:
                added[kind].append(signal)
        offsets, gains = (tuple(dict.fromkeys(added[kind])) for kind in ("offset", "gain"))
        model = self.with_sensor_errors(offsets, gains)
        for kind, add, signal, hertz in others:
            with users_code(f"the element '{kind}'"):
                model = add(model, signal, hertz)
            write = "a function that returns the model with it"
            require(f"what the element '{kind}' returned", model, Model, write)
        model = model.with_modes(*(HiddenMode(*each) for each in added["mode"]))
        return model.with_series_springs(*map(SeriesSpring, added["spring"]))

    def build_procedure(self) -> Procedure:
        """The equations to identify.

        **Raises:** `ModelError` if this model is only for simulation.
        """
        from riecjax.equations.equation import Equation
        from riecjax.equations.procedure import Procedure, staged

        if self.procedure is None:
            raise ModelError(f"model '{self.name}' can be simulated but not identified.")
        with users_code(self.name):
            built = _resolve(self.procedure)()
        if not isinstance(built, Equation | Procedure):
            raise ModelError(f"{self.name}: its procedure must build an Equation or a Procedure.")
        procedure = staged(built) if isinstance(built, Equation) else built
        procedure = procedure.with_rates({n: _resolve(rate) for n, rate in self.rates.items()})
        return procedure.with_modes(*self.modes).with_series_springs(*self.springs)

    def build_system(self, settings: Mapping[str, float]) -> AbstractSystem:
        """The system to simulate, with its defaults replaced by `settings`.

        Its equations', where the model has none of its own.

        **Raises:** `ModelError` if its equations cannot be simulated, or its system cannot carry
        its modes; for a setting that is unknown or has neither value nor default.
        """
        import jax.numpy as jnp

        if self.system is None and self.procedure is None:
            raise ModelError(f"model '{self.name}' has neither equations nor a system.")
        if self.system is not None and (self.springs or self.sensors):
            lacks = "springs in series" if self.springs else "errors of sensors"
            raise ModelError(
                f"the system of {self.name} has no {lacks}: simulate its equations, "
                f"rx.equation_system(model.build_procedure(), values)."
            )
        names = [parameter.name for parameter in self.simulation_parameters]
        for name in settings:
            if name not in names:
                raise ModelError(
                    f"unknown parameter '{name}'; {self.name} has: {', '.join(names)}."
                )
        values = {p.name: settings.get(p.name, p.default) for p in self.simulation_parameters}
        if missing := [name for name, value in values.items() if value is None]:
            raise ModelError(
                f"{self.name} needs a value for {', '.join(missing)} (--set {missing[0]}=VALUE)."
            )
        if self.system is not None and self._carries and self._attachments is None:
            raise ModelError(
                f"the system of {self.name} cannot carry a hidden mode, whose body's velocity it "
                f"does not have or accelerates together with others: simulate its equations, "
                f"rx.equation_system(model.build_procedure(), values)."
            )
        numbers = {name: jnp.asarray(value, float) for name, value in values.items()}
        if self.system is None:
            from riecjax.simulation.equation_system import equation_system

            rates = {name: _resolve(rate) for name, rate in self.rates.items()}
            return equation_system(self.build_procedure(), numbers, rates=rates)
        return self._built(numbers)

    def identified_system(self, values: Mapping[str, Array], record: Record) -> AbstractSystem:
        """The system to validate identified values with on a record.

        The model's own if the record holds its inputs, else one made of its equations.

        **Raises:** `ModelError` if the equations cannot be simulated.
        """
        from riecjax.simulation.equation_system import equation_system

        names = {parameter.name for parameter in self.simulation_parameters}
        if self._drives(record) and names == set(values):
            return self.build_system({name: float(value) for name, value in values.items()})
        return equation_system(self.build_procedure(), values, rates=self._driven_rates(record))

    def parametric_system(self, record: Record) -> AbstractParametric:
        """The system for every value of its parameters, to refine them on a record.

        The model's own if the record holds its inputs, else one made of its equations.

        **Raises:** `ModelError` if the equations cannot be simulated.
        """
        from riecjax.refinement.objective import ByCoefficients, ByFunction

        parameters = self.simulation_parameters
        names = {parameter.name for parameter in parameters}
        identified = {parameter.name for parameter in self.parameters}
        if not self._drives(record) or (self.procedure is not None and names != identified):
            return ByCoefficients.of(self.build_procedure(), self._driven_rates(record))
        assert self.system is not None
        return ByFunction(
            self._built if self._carries else _resolve(self.system),
            tuple(parameter.name for parameter in parameters),
            tuple((parameter.name, parameter.unit) for parameter in parameters),
            {p.name: p.default for p in parameters if p.default is not None},
        )

    def _drives(self, record: Record) -> bool:
        """Whether a record holds the inputs of the model's own system, with its modes."""
        return self._holds_inputs(record) and not self._outgrown

    def _holds_inputs(self, record: Record) -> bool:
        return self.system is not None and all(q.name in record.signals for q in self.inputs)

    @property
    def _outgrown(self) -> bool:
        """Whether there are hidden elements that the model's own system cannot have."""
        return bool(self.springs or self.sensors) or (self._carries and self._attachments is None)

    def _driven_rates(self, record: Record) -> dict[str, Callable[..., Any]]:
        """Rates with which the equations stand in for the model's own system on a record."""
        stands_in = self._holds_inputs(record) and self._outgrown
        return {n: _resolve(rate) for n, rate in self.rates.items()} if stands_in else {}

    @property
    def _carries(self) -> bool:
        """Whether modes are among what the model's own system is simulated with."""
        return bool(self.modes) and self.simulation_parameters[-1:] == self.parameters[-1:]

    @cached_property
    def _attachments(self) -> tuple[Attachment, ...] | None:
        """How modes are attached to the model's own system, if they can be."""
        import jax.numpy as jnp

        from riecjax.simulation.equation_system import attachments

        values = {q.name: 1.0 if q.default is None else q.default for q in self.parameters}
        assert self.system is not None
        inner = _resolve(self.system)({name: jnp.asarray(v) for name, v in values.items()})
        return attachments(self.build_procedure(), inner)

    def _built(self, values: Mapping[str, Any]) -> AbstractSystem:
        """The model's own system with these values, carrying its modes."""
        import jax.numpy as jnp

        from riecjax.simulation.equation_system import WithModes

        assert self.system is not None
        if not self._carries:
            return _resolve(self.system)(values)
        added = self._attachments or ()
        own = {name for one in added for name in one.states.parameters}
        inner = _resolve(self.system)({n: v for n, v in values.items() if n not in own})
        read = own | {one.body_mass for one in added if isinstance(one.body_mass, str)}
        return WithModes(inner, added, {name: jnp.asarray(values[name]) for name in sorted(read)})


def _with_defaults(
    quantities: Sequence[Quantity], values: Mapping[str, float] | None
) -> tuple[Quantity, ...]:
    given = values or {}
    return tuple(q._replace(default=given.get(q.name, q.default)) for q in quantities)


def as_model(model: Equation | Procedure | HasProcedure, name: str = "") -> Model:
    """The model itself, or one of an equation or a procedure, by default of the equations' name.

    **Raises:** `ModelError` for anything else, saying what to write.
    """
    from riecjax.equations.procedure import as_procedure

    if isinstance(model, Model):
        return model
    procedure = as_procedure(model)
    name = name or " + ".join(equation.name for stage in procedure.stages for equation in stage)
    units = procedure.units
    parameters = tuple(Quantity(p, units.get(p, ""), "") for p in procedure.parameters)
    return Model(name, "your own equation", procedure=lambda: procedure, parameters=parameters)


def _resolve(reference: str | Callable[..., Any]) -> Callable[..., Any]:
    if callable(reference):
        return reference
    module, _, attribute = reference.partition(":")
    return getattr(importlib.import_module(module), attribute)
