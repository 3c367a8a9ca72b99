"""Rows of a regression: the residuals of one equation, linear in its parameters."""

from collections.abc import Mapping, Sequence

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int


class Rows(eqx.Module):
    """Regression rows: target (first) and regressors of every residual of a criterion.

    **Fields:**

    - `columns`: shape `(1 + parameters, rows)`; the first holds the target.
    - `position`: where in the record each row starts, in samples.
    - `parameters`: names of the regressors.
    - `valid`: False for rows that touch a missing or masked sample; their columns are zero. `None`
      where there are none.
    """

    columns: Float[Array, "columns rows"]
    position: Int[Array, " rows"] | Float[Array, " rows"]
    parameters: tuple[str, ...] = eqx.field(static=True)
    valid: Bool[Array, " rows"] | None = None

    @classmethod
    def of(
        cls,
        columns: Float[Array, "columns rows"],
        position: Array,
        parameters: tuple[str, ...],
        valid: Bool[Array, " rows"] | None,
    ) -> "Rows":
        """Rows of which those that are not valid become zero."""
        if valid is not None:
            columns = jnp.where(valid[None, :], columns, 0.0)
        return cls(columns, position, parameters, valid)

    @property
    def target(self) -> Float[Array, " rows"]:
        """Left-hand side y."""
        return self.columns[0]

    @property
    def regressors(self) -> Float[Array, "rows parameters"]:
        """Regressor matrix A."""
        return self.columns[1:].T

    def embed(self, parameters: tuple[str, ...]) -> "Rows":
        """The same rows among more parameters, with zeros for those that do not occur."""
        zero = jnp.zeros_like(self.target)
        own = dict(zip(self.parameters, self.columns[1:]))
        columns = jnp.stack([self.target, *(own.get(name, zero) for name in parameters)])
        return Rows(columns, self.position, parameters, self.valid)

    def fix(self, known: Mapping[str, Array]) -> "Rows":
        """The rows left when these parameters take these values: their columns join the target."""
        own = dict(zip(self.parameters, self.columns[1:]))
        given = [known[name] * column for name, column in own.items() if name in known]
        unknown = tuple(name for name in self.parameters if name not in known)
        target = self.target - sum(given, start=jnp.zeros_like(self.target))
        columns = jnp.stack([target, *(own[name] for name in unknown)])
        return Rows(columns, self.position, unknown, self.valid)

    def rename(self, parameters: tuple[str, ...]) -> "Rows":
        """The same rows with other names for the regressors."""
        return Rows(self.columns, self.position, parameters, self.valid)

    def count(self) -> Float[Array, ""]:
        """Number of valid rows."""
        if self.valid is None:
            return jnp.asarray(self.columns.shape[1], self.columns.dtype)
        return jnp.sum(self.valid, dtype=self.columns.dtype)

    @staticmethod
    def concatenate(parts: Sequence["Rows"]) -> "Rows":
        """Rows of the same parameters, one after the other."""
        columns = jnp.concatenate([part.columns for part in parts], axis=1)
        position = jnp.concatenate([part.position for part in parts])
        valid = None
        if any(part.valid is not None for part in parts):
            masks = [
                jnp.ones(part.columns.shape[1], bool) if part.valid is None else part.valid
                for part in parts
            ]
            valid = jnp.concatenate(masks)
        return Rows(columns, position, parts[0].parameters, valid)
