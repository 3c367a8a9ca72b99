"""What sums alone tell of an answer: an assessment for which no sample is read again."""

from collections.abc import Mapping, Sequence

from jaxtyping import Array

from riecjax.assessment.assessment import Assessment
from riecjax.equations.procedure import Procedure
from riecjax.errors import DataError
from riecjax.estimation.check import Check, raise_if_refused
from riecjax.estimation.excitation import excitations
from riecjax.estimation.identify import estimate
from riecjax.estimation.mode_evidence import mode_evidence
from riecjax.estimation.mode_windows import linearised
from riecjax.estimation.parameters import plan_parameters
from riecjax.findings import Finding
from riecjax.leaves import on_host
from riecjax.models.model import Model
from riecjax.studies.sweep import window_sweep
from riecjax.summaries.summary import Summary
from riecjax.uncertainty.intervals import AbstractIntervals


def assess_sums(
    model: Model,
    procedure: Procedure,
    summary: Summary,
    *,
    lengths: Summary | None = None,
    findings: Sequence[Finding] = (),
    known: Mapping[str, float | Array] | None = None,
    intervals: AbstractIntervals | None = None,
) -> Assessment:
    """As [`assess`][riecjax.assess], without what needs samples: tests of residuals, refinement
    and simulation (not under jit).

    **Arguments:** `procedure` that the model builds; `summary` of recordings; `lengths`, sums of
    the same by window lengths, for drift; `findings` of the recordings, each with the parameters
    that it concerns, or for all.

    **Raises:** as [`estimate`][riecjax.estimate], and `IdentifiabilityError` for what
    [`check`][riecjax.check] refuses.
    """
    found = on_host(estimate(procedure, summary, known=known, intervals=intervals))
    plan = plan_parameters(procedure, len(summary.recordings), known, ())
    excited = excitations(linearised(procedure, summary, plan.given), plan)
    raise_if_refused(excited)
    told = [*findings, *(finding for stage in excited for finding in stage.findings())]
    sweep = None
    if lengths is not None and not procedure.has_hidden:
        try:
            sweep = on_host(window_sweep(procedure, lengths, known=known))
        except DataError:
            sweep = None  # too short for any
    return Assessment(
        model=model,
        procedure=procedure,
        recordings=(),
        validated_on=(),
        checked=Check(told, excited, ()),
        estimate=found,
        sweep=sweep,
        residuals=None,
        choice=None,
        validations=(),
        refinement=None,
        failures=(),
        key=None,
        modes=mode_evidence(procedure, found) if procedure.modes else (),
    )
