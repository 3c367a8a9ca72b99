"""A state-space system, the form in which every model is simulated."""

from collections.abc import Mapping
from typing import ClassVar

import equinox as eqx
from jaxtyping import Array, Float

Quantities = tuple[tuple[str, str], ...]
"""(name, unit) of several quantities, in order."""


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

    def derivative(
        self, state: Float[Array, " states"], inputs: Float[Array, " inputs"]
    ) -> Float[Array, " states"]:
        """Time derivative of the state."""
        raise NotImplementedError

    def output(
        self, state: Float[Array, " states"], inputs: Float[Array, " inputs"]
    ) -> Mapping[str, Float[Array, ""]]:
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
    def velocity_of(self) -> Mapping[str, str]:
        """State to the state that is its time derivative: `d<state>`, where there is one."""
        names = self.state_names
        return {name: f"d{name}" for name in names if f"d{name}" in names}
