"""A state-space system, the form in which every model is simulated."""

from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, ClassVar

import equinox as eqx
from jaxtyping import Array, Float

from riecjax import arrays as xp
from riecjax.errors import DataError, ModelError
from riecjax.records.record import Record

Quantities = tuple[tuple[str, str], ...]
"""(name, unit) of several quantities, in order."""
PREDICTS_WELL = 80.0
"""Fit in percent from which a signal is predicted well: an error of a fifth of its deviation."""
State = Float[Array, " states"]
Inputs = Float[Array, " inputs"]


class AbstractSystem(eqx.Module):
    """`x' = derivative(x, u)`, autonomous but for its sampled inputs u.

    Subclasses name their states, inputs and outputs with units, in the order in which the arrays
    hold them: as class variables, or as properties where instances differ.
    """

    states: ClassVar[Quantities] = ()
    """(name, unit) of each state."""
    inputs: ClassVar[Quantities] = ()
    """(name, unit) of each input."""
    outputs: ClassVar[Quantities] = ()
    """(name, unit) of each further quantity that `output` returns."""
    reversing: ClassVar[tuple[str, ...]] = ()
    """Velocities at whose zero friction makes the derivative jump: fixed steps end there."""
    carried: ClassVar[tuple[str, ...]] = ()
    """States of hidden elements, which no recording need hold."""

    def derivative(self, state: State, inputs: Inputs) -> State:
        """Time derivative of the state."""
        raise NotImplementedError

    def output(self, state: State, inputs: Inputs) -> Mapping[str, Float[Array, ""]]:
        """Further quantities of interest (forces, accelerations) by name."""
        return {}

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states in order."""
        return tuple(name for name, _ in self.states)

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the inputs in order."""
        return tuple(name for name, _ in self.inputs)

    @property
    def simulated_names(self) -> tuple[str, ...]:
        """What a simulation makes: states, the derivative `d<state>` of each, and outputs."""
        names = self.state_names
        made = dict.fromkeys([*names, *(f"d{n}" for n in names), *(n for n, _ in self.outputs)])
        return tuple(name for name in made if name not in self.input_names)

    def require_states(self, names: Iterable[str]) -> None:
        """Raise `ModelError` for a name that no state has."""
        if unknown := [name for name in names if name not in self.state_names]:
            raise ModelError(
                f"unknown state '{unknown[0]}'; the states are: {', '.join(self.state_names)}."
            )

    @property
    def velocity_of(self) -> Mapping[str, str]:
        """State to the state that is its time derivative: `d<state>`, where there is one."""
        names = self.state_names
        return {name: f"d{name}" for name in names if f"d{name}" in names}

    def carried_levels(
        self, signals: Mapping[str, Float[Array, " n"]]
    ) -> Mapping[str, Float[Array, " n"]]:
        """Samples of what is `carried`, as far as these samples of signals tell them: of a mass
        that is carried along, its body's velocity."""
        return {}


def state_sources(system: AbstractSystem, record: Record) -> dict[str, str]:
    """Source of each state: `measured`, `differences` of its recorded integral, or `zero`."""
    integral = {velocity: state for state, velocity in system.velocity_of.items()}
    return {
        name: "measured"
        if name in record.arrays
        else "differences"
        if integral.get(name) in record.arrays
        else "zero"
        for name in system.state_names
    }


def input_levels(system: AbstractSystem, record: Record) -> Float[Array, "n inputs"]:
    """Each input at each sample; of a free motion none, as a record gives its sampling."""
    columns = [record[name] for name in system.input_names]
    return xp.stack(columns, axis=-1) if columns else xp.zeros((record.sample_count, 0))


def measured_states(
    system: AbstractSystem, record: Record, given: Mapping[str, Any] = MappingProxyType({})
) -> Float[Array, "n states"]:
    """Each state at each sample: as it is `given`, or recorded; zero where nothing tells it, or
    what is carried along has."""
    integral = {velocity: state for state, velocity in system.velocity_of.items()}
    count, dtype = record.sample_count, record.time_step.dtype
    columns = {}
    for name, source in state_sources(system, record).items():
        if name in given:
            columns[name] = xp.full(count, given[name], dtype)
        elif source == "measured":
            columns[name] = record[name]
        elif source == "differences":
            # Second-order differences, one-sided at the ends.
            q = record[integral[name]]
            first = -3 * q[0] + 4 * q[1] - q[2]
            last = 3 * q[-1] - 4 * q[-2] + q[-3]
            rises = xp.concatenate([first[None], q[2:] - q[:-2], last[None]])
            columns[name] = rises / (2 * record.time_step)
        else:
            columns[name] = xp.zeros(count, dtype)
    carried = system.carried_levels({**record.arrays, **columns})
    columns |= {n: carried[n] for n in carried if n not in record.arrays and n not in given}
    return xp.stack([columns[name] for name in system.state_names], axis=-1)


def compared_signals(
    system: AbstractSystem, records: Sequence[Record], asked: Sequence[str] | None = None
) -> tuple[str, ...]:
    """What of a simulation is compared with records: what is asked for, or the states that all of
    them hold, or if there are none, all else that is simulated and recorded.

    **Raises:** `ModelError` for what is not simulated; `DataError` for what is not recorded, inputs
    among it.
    """
    available = system.simulated_names
    if unknown := [name for name in asked or () if name not in available]:
        raise ModelError(
            f"the simulation has no signal '{unknown[0]}' to compare; it has: "
            f"{', '.join(available)}."
        )
    for record in records:
        for name in (*system.input_names, *(asked or ())):
            record.signal(name)  # or an error that says which there are
    held = [name for name in available if all(name in record.arrays for record in records)]
    chosen = asked or [name for name in system.state_names if name in held] or held
    if not chosen:
        raise DataError(
            f"the records hold nothing that is simulated, so there is nothing to compare; needed "
            f"is one of: {', '.join(available)}."
        )
    return tuple(chosen)
