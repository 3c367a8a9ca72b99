"""An equation of motion, linear in its parameters."""

from collections.abc import Mapping

import equinox as eqx

from riecjax.equations.term import AbstractTerm, Term, Terms, merge_known
from riecjax.errors import ModelError
from riecjax.leaves import Leaf


class Equation(eqx.Module):
    """Terms that sum to zero, up to the equation error.

    `M_s x4' = K_s x2 + F(x3 - x4)` is written as

    ```python
    Equation(
        Term("M_s", "x4", derivative=1, unit="kg"),
        -Term("K_s", "x2", unit="N/m"),
        -Terms("F", roof([-0.8, -0.3, 0.3, 0.8]), of=relative_velocity, unit="N"),
    )
    ```

    **Arguments:** the terms; `name` for messages and tables; `unit` of the terms, for figures.

    **Raises:** `ModelError` if there is no unknown coefficient.
    """

    terms: tuple[AbstractTerm, ...]
    name: str = eqx.field(static=True)
    unit: str = eqx.field(static=True)

    def __init__(self, *terms: AbstractTerm, name: str = "equation", unit: str = ""):
        self.terms = terms
        self.name = name
        self.unit = unit
        if not self.parameters:
            raise ModelError(f"{name}: an equation needs at least one named coefficient.")

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the coefficients, known ones included, in order of first appearance."""
        return tuple(dict.fromkeys(name for term in self.terms for name in term.parameters))

    @property
    def units(self) -> dict[str, str]:
        """Unit of each named coefficient."""
        units: dict[str, str] = {}
        for term in self.terms:
            if isinstance(term, Term | Terms):
                for name in term.parameters:
                    units.setdefault(name, term.unit)
        return units

    @property
    def known(self) -> Mapping[str, Leaf]:
        """Values of the named coefficients that are known in advance."""
        return merge_known(self.terms)

    @property
    def has_target(self) -> bool:
        """Whether a term without an unknown name sets the scale of the solution."""
        return any(not term.parameters for term in self.terms)
