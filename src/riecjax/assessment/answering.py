"""Whether recordings can answer what a model asks, by windows or else by refinement."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from jaxtyping import Array, Key

from riecjax.assessment.asked import Asked, require_memory_to_assess
from riecjax.criteria.criterion import AbstractCriterion
from riecjax.equations.equation import Equation
from riecjax.equations.procedure import HasProcedure, Procedure
from riecjax.errors import IdentifiabilityError
from riecjax.estimation.check import Check, check
from riecjax.estimation.identify import estimate
from riecjax.leaves import on_host
from riecjax.models.model import as_model
from riecjax.records.record import Records
from riecjax.records.recording import as_recordings
from riecjax.summaries.summarise import summarise
from riecjax.uncertainty.intervals import Sandwich


class Answering(NamedTuple):
    """What was `checked`, and what answers.

    **Fields:** `by_refinement`: standard error of each parameter as a share of its value, where
    windows cannot tell parameters from noise, and output error from these recordings can.
    """

    checked: Check
    by_refinement: dict[str, float] | None

    @property
    def answerable(self) -> bool:
        """Whether there is an answer, by windows or by refinement."""
        return self.checked.answerable or self.by_refinement is not None


def check_answering(
    model: Equation | Procedure | HasProcedure,
    records: Records,
    criterion: AbstractCriterion,
    *,
    key: Key[Array, ""] | None = None,
    known: Mapping[str, float | Array] | None = None,
    per_record: Sequence[str] = (),
) -> Answering:
    """[`check`][], and where noise rules out an answer by windows, whether refinement has one.

    Windows need derivatives of what is recorded, whose noise grows with frequency; output error
    compares what was recorded. How well it answers is what [`assess`][] would find: at its optimum
    the bound of Cramer and Rao, where its residuals are white.

    **Raises:** as [`check`][].
    """
    described = as_model(model)
    procedure, recordings = described.build_procedure(), as_recordings(records)
    require_memory_to_assess(
        procedure, [each.record for each in recordings], criterion, checking=True
    )
    settings = {"known": known, "per_record": per_record}
    summary = summarise(procedure, recordings, criterion, key=key, survey=True)
    checked = check(procedure, recordings, criterion, key=key, summary=summary, **settings)
    if checked.refusal is None or checked.refusal.code != "unidentifiable":
        return Answering(checked, None)
    # Not earlier: to import all that simulates takes seconds.
    from riecjax.assessment.refining import answered

    parts = (described, procedure, criterion, recordings, [], [], key, settings, Sandwich())
    try:
        start = on_host(estimate(procedure, summary, **settings, intervals=Sandwich()))
    except IdentifiabilityError:
        return Answering(checked, None)
    refinement, _, _ = answered(Asked(*parts), start, True, "auto", (None, None), None, None)
    if refinement is None or refinement.refined is None or not refinement.chosen:
        return Answering(checked, None)
    refined = refinement.refined
    errors = zip(refined.parameters, refined.standard_errors)
    return Answering(
        checked, {n: float(e) / max(abs(float(refined[n])), 1e-300) for n, e in errors}
    )
