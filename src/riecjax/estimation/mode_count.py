"""How many hidden modes recordings carry: one more as long as it is carried."""

from collections.abc import Mapping
from typing import NamedTuple

from jaxtyping import Array

from riecjax.equations.equation import Equation
from riecjax.equations.hidden_elements import HiddenMode, ModeParameters
from riecjax.equations.procedure import HasProcedure, Procedure, as_procedure
from riecjax.errors import IdentifiabilityError
from riecjax.estimation.estimate import Estimate
from riecjax.estimation.identify import identify
from riecjax.estimation.mode_evidence import ModeEvidence, mode_evidence
from riecjax.records.record import Records

MOST = 2
"""Modes that are tried unless more are asked for: each takes two more derivatives of the motion."""


class CarriedModes(NamedTuple):
    """Hidden modes that recordings carry.

    **Fields:** `procedure` with as many modes as are carried, and its `estimate`; `evidence` for
    each mode that was tried, of which the last may not be carried.
    """

    procedure: Procedure
    estimate: Estimate
    evidence: tuple[ModeEvidence, ...]


def carried_modes(
    model: Equation | Procedure | HasProcedure,
    records: Records,
    on: str,
    *,
    most: int = MOST,
    known: Mapping[str, float | Array] | None = None,
) -> CarriedModes:
    """Add hidden modes on one body as long as they predict time that they were not found from.

    **Arguments:** `on`, the body's velocity, see [`HiddenMode`][riecjax.HiddenMode]; `most` modes
    to try; `model`, `records` and `known` as for [`identify`][riecjax.identify].

    **Raises:** as [`identify`][riecjax.identify] of the model without modes.
    """
    procedure = as_procedure(model)
    estimate, evidence = identify(procedure, records, known=known), []
    for _ in range(most):
        further = procedure.with_modes(HiddenMode(on))
        try:
            tried = identify(further, records, known=known)
        except IdentifiabilityError:
            break  # it cannot be told from those that are there
        names = ModeParameters.of(len(procedure.modes))
        new = next(one for one in mode_evidence(further, tried) if one.parameters == names)
        evidence.append(new)
        if not new.carried:
            break
        procedure, estimate = further, tried
    return CarriedModes(procedure, estimate, tuple(evidence))
