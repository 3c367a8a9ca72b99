"""What refinement makes small: a sum of squares over windows, and its expansion to first order."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from riecjax.estimation.blocks import ShortBlocks
from riecjax.estimation.normal_equations import NormalEquations


class Expansion(NamedTuple):
    """Residuals at a point and their first derivatives, as moments.

    **Fields:**

    - `pieces`: for each record the Gram matrices of residual, its derivatives by the parameters
      and by the window's start, of each window cut into pieces of time; shape
      `(windows, pieces, 1 + p + s, 1 + p + s)`.
    - `energy`: sum of squared residuals of each quantity in the misfit's `labels`.
    """

    pieces: list[Float[Array, "windows pieces columns columns"]]
    energy: Float[Array, " quantities"]

    def moments(self) -> Float[Array, "windows columns columns"]:
        """Of each window."""
        return jnp.concatenate([jnp.sum(record, axis=1) for record in self.pieces])


class AbstractMisfit(eqx.Module):
    """A sum of squared residuals of parameters and of starts of windows."""

    names: eqx.AbstractVar[tuple[str, ...]]
    """Parameters that are free, over all records."""

    @property
    def labels(self) -> tuple[str, ...]:
        """Quantities whose residuals are told one by one."""
        raise NotImplementedError

    @property
    def units(self) -> tuple[str, ...]:
        """Units of `labels`."""
        raise NotImplementedError

    @property
    def start_names(self) -> tuple[str, ...]:
        """Names of the states whose starts are estimated."""
        return ()

    @property
    def longest_window(self) -> Float[Array, ""]:
        """Seconds after which two residuals share no data."""
        raise NotImplementedError

    def first_starts(self) -> Float[Array, "windows s"]:
        """Initial states to start from, of those components that are estimated."""
        return jnp.zeros((1, 0))

    def start_scale(self) -> Float[Array, " s"]:
        """Size of these components."""
        return jnp.ones(0)

    def settled_energy(
        self, theta: Float[Array, " p"], starts: Float[Array, "windows s"]
    ) -> Float[Array, " quantities"]:
        """`energy` of the starts that leave least with these parameters, searched from others."""
        return self.energy(theta, starts)

    @property
    def steps_label(self) -> str:
        """How finely it is simulated; empty where nothing is."""
        return ""

    def finer(self, factor: int) -> "AbstractMisfit | None":
        """This misfit simulated in steps so many times as short; None where there are no steps."""
        return None

    @property
    def room_for_steps(self) -> int:
        """How many times as short its steps may be made without being asked; 1 for not at all."""
        return 1

    def energy(
        self, theta: Float[Array, " p"], starts: Float[Array, "windows s"]
    ) -> Float[Array, " quantities"]:
        """Sum of squared residuals of each of `labels`, without derivatives."""
        raise NotImplementedError

    def expansion(self, theta: Float[Array, " p"], starts: Float[Array, "windows s"]) -> Expansion:
        """The residuals at a point, to first order."""
        raise NotImplementedError

    def rms(self, energy: Float[Array, " quantities"]) -> Float[Array, " quantities"]:
        """Root mean square of what is left of each of `labels`, in its unit."""
        raise NotImplementedError

    def independent_rows(self) -> Float[Array, ""]:
        """Number of residuals that may be taken as independent, for the weight of priors."""
        raise NotImplementedError

    def blocks(self, expansion: Expansion) -> tuple[NormalEquations, ShortBlocks]:
        """Normal equations of the changes of the parameters, in short blocks of time.

        Leading axes `(records, short blocks)`; starts of windows are projected out.
        """
        raise NotImplementedError
