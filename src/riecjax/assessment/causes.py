"""Findings grouped by what lies behind them, with what to do about each.

One missing mode shows in the spectra of two equations, as correlations with three signals and in
seven parameters that drift: eight findings, one cause. A reader needs the cause, its remedy, and
which parameters it concerns; the findings stay as its evidence.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

from riecjax.assessment.doubt import Doubt, concerned
from riecjax.equations.hidden_modes import is_hidden_name
from riecjax.findings import Finding
from riecjax.studies.drift import MOST, WindowSweep
from riecjax.validation.residuals import EquationResidual

if TYPE_CHECKING:
    from riecjax.assessment.assessment import Assessment

KINDS = {
    "undetermined": (
        "unidentifiable",
        "undetermined",
        "mode_not_carried",
        "series_spring_not_carried",
        "negative_value",
        "interval_wider_than_estimate",
        "not_excited",
        "rarely_excited",
    ),
    "sensors": (
        "time_unit_doubtful",
        "unit_mismatch",
        "not_its_derivative",
        "constant_signal",
        "stuck_sensor",
        "clipped",
        "outliers",
        "missing_samples",
        "quantised",
        "column_left_out",
        "part_left_out",
        "nothing_cut",
        "rows_left_out",
    ),
    "model": (
        "prior_disagrees",
        "unmodelled_mode",
        "large_residual",
        "residual_follows_signal",
        "window_sensitive",
        "uneven_errors",
        "does_not_predict",
        "records_disagree",
        "no_known_term",
        "break_points_outside",
    ),
    "noise": ("noise_dominates",),
    "data": (
        "nearly_collinear",
        "ill_conditioned",
        "few_blocks",
        "few_effective_windows",
        "short_record",
    ),
    "computation": (
        "mode_elsewhere",
        "coarse_sampling",
        "coarse_steps",
        "refinement_not_converged",
        "refined_predicts_worse",
        "at_bound",
        "short_windows",
        "single_precision",
        "band_snapped",
        "residuals_not_tested",
        "not_validated",
    ),
}
"""Codes of each kind of cause, first what says most of it."""
PHRASES = {
    "unidentifiable": "the recordings cannot tell {parameters} apart",
    "undetermined": "the recordings say nothing of {parameters}",
    "mode_not_carried": "the recordings carry no such mode",
    "mode_elsewhere": "no mode is near the frequency asked for",
    "series_spring_not_carried": "the recordings do not tell {parameters} from infinity",
    "negative_value": "{parameters} is below zero",
    "interval_wider_than_estimate": "the recordings hardly determine {parameters}",
    "rarely_excited": "{parameters} is seldom excited",
    "time_unit_doubtful": "time may be in another unit than seconds",
    "unit_mismatch": "{signals} has another unit than the model expects",
    "not_its_derivative": "{signals} do not fit each other",
    "constant_signal": "{signals} never varies",
    "stuck_sensor": "{signals} is stuck for a while",
    "clipped": "{signals} is clipped",
    "outliers": "{signals} has outliers",
    "missing_samples": "samples of {signals} are missing",
    "quantised": "{signals} is coarsely quantised",
    "large_residual": "the model leaves more than half of the signal",
    "residual_follows_signal": "what the model leaves follows {signals}",
    "window_sensitive": "estimates drift with window length",
    "uneven_errors": "errors differ much along the record",
    "does_not_predict": "the model does not predict",
    "records_disagree": "the recordings disagree",
    "no_known_term": "no term of an equation is known",
    "noise_dominates": "noise of {signals} makes much of what tells {parameters} apart",
    "nearly_collinear": "little tells {parameters} apart",
    "ill_conditioned": "little tells some parameters apart",
    "few_blocks": "few stretches of the record tell of {parameters}",
    "few_effective_windows": "few independent windows tell of {parameters}",
    "short_record": "the record is short",
    "coarse_sampling": "the motion is sampled coarsely",
    "coarse_steps": "the simulation's steps are coarse",
    "refinement_not_converged": "the refinement did not converge",
    "refined_predicts_worse": "the refined model predicts worse",
    "at_bound": "{parameters} sits on a bound",
    "single_precision": "it was computed in 32-bit",
}


class Step(NamedTuple):
    """Something to do next: what for, and the options of `riecjax identify` that do it."""

    words: str
    options: tuple[str, ...] = ()


class Cause(NamedTuple):
    """What lies behind some findings.

    **Fields:** `kind`; `phrase`, what it is; `findings`, its evidence; `parameters` that it
    concerns; `share`, how far it puts one of them in doubt at most, over its value; `step`, what
    to do about it, if that is known.
    """

    kind: str
    phrase: str
    findings: tuple[Finding, ...]
    parameters: tuple[str, ...]
    share: float
    step: Step | None

    @property
    def voids(self) -> bool:
        """Whether it leaves nothing of an answer, so that it is to be seen to first."""
        return self.kind == "sensors" and self.share >= 1


def causes(assessment: "Assessment", found: Mapping[str, Doubt]) -> list[Cause]:
    """Of all findings, first what does most to the parameters."""
    answer = assessment.answer
    size = {name: max(abs(float(answer[name])), 1e-300) for name in found}
    grouped, said = [], assessment.findings()
    for kind, codes in KINDS.items():
        own = [f for code in codes for f in said if f.code == code]
        if not own:
            continue
        of = {name for f in own for name in concerned(assessment, f)}
        names = tuple(name for name in found if name in of)
        share = max((found[n].by_kind(kind) / size[n] for n in names), default=0.0)
        phrase = _phrase(assessment, own[0])
        grouped.append(Cause(kind, phrase, tuple(own), names, share, _step(assessment, own)))
    return sorted(grouped, key=lambda c: (c.kind != "undetermined", not c.voids, -c.share))


def _phrase(assessment: "Assessment", finding: Finding) -> str:
    if finding.code == "unmodelled_mode":
        peaks = (one.peak for one in _equations(assessment) if one.peak is not None)
        peak = max(peaks, key=lambda one: one.size)
        return f"the model leaves out a mode near {peak.frequency:.3g} Hz"
    pattern = PHRASES.get(finding.code, finding.code.replace("_", " "))
    return pattern.format(
        signals=" and ".join(finding.signals) or "a signal",
        parameters=", ".join(finding.parameters) or "some parameters",
    )


def _equations(assessment: "Assessment") -> Sequence[EquationResidual]:
    return () if assessment.residuals is None else assessment.residuals.equations


def _step(assessment: "Assessment", own: Sequence[Finding]) -> Step | None:
    return next(_steps(assessment, {f.code: f for f in reversed(own)}), None)


def _steps(assessment: "Assessment", by: Mapping[str, Finding]) -> Iterator[Step]:
    """What might be done about findings by code, the best first."""
    smooth = assessment.estimate.criterion.smoothness > 2
    if "time_unit_doubtful" in by:
        yield Step(
            "State the unit of time in its column's name, as in 'time [ms]', or scale it (--scale)"
        )
    if "unmodelled_mode" in by:
        yield from _mode_steps(assessment)
    if "not_its_derivative" in by and not smooth:
        signal, derivative = by["not_its_derivative"].signals
        yield Step(f"Identify from {signal} alone, without {derivative}", SMOOTH)
    if "window_sensitive" in by and assessment.sweep is not None:
        yield from _window_steps(assessment.sweep, by["window_sensitive"], smooth)
    if "residual_follows_signal" in by:
        signal = " and ".join(by["residual_follows_signal"].signals)
        yield Step(f"Add a term in {signal} to the model, or shift {signal} if it is late")
    if "records_disagree" in by:
        names = by["records_disagree"].parameters
        yield Step("Let it differ between recordings", ("--per-record", ",".join(names)))
    if "noise_dominates" in by:
        yield Step("Compare simulations, which need no derivative", ("--refine", "output-error"))
    if "coarse_sampling" in by and assessment.estimate.criterion.in_closed_form:
        yield Step("Integrate by a higher order", ("--quadrature", "6"))
    if {"few_blocks", "few_effective_windows", "short_record"} & by.keys():
        yield Step("Record for longer, or excite the machine all along")
    weak = [by[c] for c in ("nearly_collinear", "unidentifiable", "ill_conditioned") if c in by]
    if any(is_hidden_name(name) for finding in weak for name in finding.parameters):
        yield Step("Leave out the hidden mode or spring (drop --add-mode, --add-spring)")
    elif weak:
        yield Step("Excite the machine more richly, or hold a parameter (--set NAME=VALUE)")


SMOOTH = ("--test-function", "bump")


def _mode_steps(assessment: "Assessment") -> Iterator[Step]:
    peaked = [one for one in _equations(assessment) if one.peak is not None and one.bodies]
    if not peaked:
        return
    one = max(peaked, key=lambda each: each.peak.size if each.peak else 0.0)
    if not one.carrying:
        yield Step("Find the mode that the model leaves out", ("--add-mode", one.bodies[-1]))
    elif one.dampers:
        words = "Find a spring in series with a damper, which the model leaves out"
        yield Step(words, ("--add-spring", one.dampers[0]))
    elif one.maps:
        added = f"model.with_series_springs(rx.SeriesSpring('{one.maps[0]}'))"
        yield Step(f"Add a spring in series with a damper, in Python: {added}, then rx.refine")


def _window_steps(sweep: WindowSweep, finding: Finding, smooth: bool) -> Iterator[Step]:
    if sweep.noise_share(finding.parameters[0]) > MOST and not smooth:
        yield Step("Take smooth windows, which read positions alone", SMOOTH)
    steady = sweep.steady(finding.parameters)
    if steady is not None:
        low, high = (f"{end:.3g}" for end in steady)
        yield Step("Keep to windows in which all are steady", ("--alpha", low, "--beta", high))
