"""What can be trusted, how far, and what to do about the rest, by stated rules.

Each estimated parameter is `good`, `caution` or `do not use`, by the size of its doubt (see
`riecjax.assessment.doubt`) as a share of its value, and by what rules it out whatever its size.
`python -m benchmarks.calibration verdicts` measures the rules on systems with known truth.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple

from riecjax.assessment.doubt import TRUSTED, Doubt, doubts
from riecjax.criteria.test_functions import AbstractSmoothTestFunction
from riecjax.equations.expressions import constant
from riecjax.findings import CODES, KINDS, PHRASES, Finding, code_of
from riecjax.shows import Shown
from riecjax.validation.sweep import MOST

if TYPE_CHECKING:
    from riecjax.assessment.assessment import Assessment

CONSTANT = "errors share a constant part, as of a sensor's offset"


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


def causes(
    assessment: "Assessment", by_name: Mapping[str, Doubt], widened: Mapping[str, str]
) -> list[Cause]:
    """Of all findings, first what does most to the parameters."""
    grouped, findings, tests = [], assessment.findings(), assessment.equation_residuals
    for kind in KINDS:
        evidence = [f for code in PHRASES[kind] for f in findings if f.code == code]
        if not evidence:
            continue
        concerned = {name for f in evidence for name in assessment.parameters_of(f)}
        some = {name: doubt for name, doubt in by_name.items() if name in concerned}
        share = max((doubt.by_kind(kind) for doubt in some.values()), default=0.0)
        first, step = evidence[0], next(_steps(assessment, evidence), None)
        phrase = code_of(first.code).said(first.signals, first.parameters)
        if first.code == "unmodelled_mode":
            peaks = (test.peak for test in tests if test.peak is not None)
            peak = max(peaks, key=lambda peak: peak.size)
            phrase = f"the model leaves out a mode near {peak.frequency:.3g} Hz"
        elif first.code in ("large_residual", "uneven_errors") and _with_constant_part(assessment):
            phrase = CONSTANT
        # A longer record mends neither a good value nor what a common error widens.
        if kind == "data" and all(
            doubt.by_kind(kind) <= TRUSTED or name in widened for name, doubt in some.items()
        ):
            step = None
        grouped.append(Cause(kind, phrase, tuple(evidence), tuple(some), share, step))
    return sorted(grouped, key=lambda c: (c.kind != "undetermined", not c.voids, -c.share))


def widening(assessment: "Assessment") -> dict[str, str]:
    """Of parameters whose intervals are wide by more than chance, what is known to make them so."""
    common = assessment.answer.table.concerned(_with_constant_part(assessment))
    disagreeing = [f for f in assessment.findings() if f.code == "records_disagree"]
    names = (name for finding in disagreeing for name in finding.parameters)
    return dict.fromkeys(common, CONSTANT) | dict.fromkeys(names, CODES["records_disagree"].phrase)


def _with_constant_part(assessment: "Assessment") -> set[str]:
    """Parameters of equations whose errors share a constant part."""
    some = (test for test in assessment.equation_residuals if test.has_constant_part)
    return {name for test in some for name in test.parameters}


def _steps(assessment: "Assessment", evidence: Sequence[Finding]) -> Iterator[Step]:
    """What might be done about findings of one kind of cause, the best first."""
    by, tests = {f.code: f for f in reversed(evidence)}, assessment.equation_residuals
    weight = getattr(assessment.estimate.criterion, "test_function", None)
    smooth = isinstance(weight, AbstractSmoothTestFunction)
    yield from (Step(f.step, f.remedy) for f in evidence if f.step)
    if "prior_disagrees" in by or "outside_bound" in by:
        said = ("prior_disagrees", "outside_bound")
        names = [f.parameters[0] for f in evidence if f.code in said]
        yield Step(f"Check what you said of {joined(names)}, its unit too, or leave it out")
    yield from (step for code, step in STEPS.items() if code in by)
    if "unmodelled_mode" in by:
        peaked = [e for e in tests if e.peak is not None and e.bodies]
        equation = max(peaked, key=lambda e: e.peak.size if e.peak else 0.0, default=None)
        if equation is not None and not equation.carrying:
            words = "Find the mode that the model leaves out"
            yield Step(words, ("--add-mode", equation.bodies[-1]))
        elif equation is not None and equation.dampers:
            words = "Find a spring in series with a damper, which the model leaves out"
            yield Step(words, ("--add-spring", equation.dampers[0]))
        elif equation is not None and equation.maps:
            added = f"model.with_series_springs(rx.SeriesSpring('{equation.maps[0]}'))"
            words = f"Add a spring in series with a damper, in Python: {added}, then rx.refine"
            yield Step(words)
    if "not_its_derivative" in by and not smooth:
        signal, derivative = by["not_its_derivative"].signals
        yield Step(f"Identify from {signal} alone, without {derivative}", SMOOTH)
    if "uneven_errors" in by:
        # The zero of an input's sensor, where its equation has no constant term yet.
        names = {e.name for e in tests if e.has_constant_part}
        equations = (e for e in assessment.model.equations if e.name in names)
        terms = (e.terms for e in equations if all(t.of is not constant for t in e.terms))
        known = (t for some in terms for t in some if t.signal and not t.parameters)
        for name in (str(term.signal) for term in known if term.derivative == 0):
            yield Step(f"Estimate the zero of the sensor of {name}", ("--unknown-offset", name))
    if "window_sensitive" in by and assessment.sweep is not None:
        drifting = by["window_sensitive"].parameters
        if assessment.sweep.noise_share(drifting[0]) > MOST and not smooth:
            yield Step("Take smooth windows, which read positions alone", SMOOTH)
        if (steady := assessment.sweep.steady(drifting)) is not None:
            low, high = (f"{end:.3g}" for end in steady)
            options = ("--alpha", low, "--beta", high)
            yield Step("Keep to windows in which all are steady", options)
    if "residual_follows_signal" in by:
        signal = " and ".join(by["residual_follows_signal"].signals)
        yield Step(
            f"Find the term in {signal} that is missing (riecjax discover), or shift {signal} if "
            f"it is late"
        )
    if "records_disagree" in by:
        names = [f.parameters[0] for f in evidence if f.code == "records_disagree"]
        options = [word for name in names for word in ("--per-record", name)]
        yield Step(f"Let {joined(names)} differ between recordings", tuple(options))
    if "coarse_sampling" in by and assessment.estimate.criterion.all_windows is not None:
        yield Step("Integrate by a higher order", ("--quadrature", "6"))
    weak = [by[c] for c in ("nearly_collinear", "unidentifiable", "ill_conditioned") if c in by]
    hidden = {row.name for row in assessment.answer.table.rows if row.element is not None}
    if any(name in hidden for finding in weak for name in finding.parameters):
        yield Step("Leave out the hidden mode or spring (drop --add-mode, --add-spring)")
    elif weak:
        yield Step("Excite the machine more richly, or hold a parameter (--set NAME=VALUE)")


SMOOTH = ("--test-function", "bump")
FEW = ("few_blocks", "few_effective_windows", "short_record")
"""Findings that a record is short."""
STEPS = {
    "time_unit_doubtful": Step(
        "State the unit of time in its column's name, as in 'time [ms]', or scale it (--scale)"
    ),
    "noise_dominates": Step(
        "Compare simulations, which need no derivative", ("--refine", "output-error")
    ),
    **dict.fromkeys(FEW, Step("Record for longer, or excite the machine all along")),
}
"""What to do about findings of a code, whatever they say."""


def joined(names: Sequence[str]) -> str:
    """At least one name, the last of several behind an "and"."""
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))


Level = Literal["good", "caution", "do not use"]

WRONG = 0.1
"""Share of a value from which a wrong model rules it out, if scatter is smaller."""
DRIFTS = 0.3
"""Share of its scatter by which such a value drifts with window length, too. What is left may point
away from a parameter's regressor; then its value is the same at every length."""
NAMED = 4
"""Parameters that a sentence names one by one."""
RULED_OUT = (
    "unidentifiable",
    "undetermined",
    "negative_value",
    "interval_wider_than_estimate",
    "mode_not_carried",
    "series_spring_not_carried",
)
"""Findings that rule out the parameters that they name."""


class ParameterVerdict(NamedTuple):
    """Whether to trust one parameter.

    **Fields:** `name`, `value`, `unit`; `level`; `reason`, in words; `doubt`, ends of the interval
    that counts what is known to be wrong beside scatter; `share`, its larger half over the value.
    """

    name: str
    value: float
    unit: str
    level: Level
    reason: str
    doubt: tuple[float, float]
    share: float


@dataclass(frozen=True, repr=False)
class Verdict(Shown):
    """Which parameters can be trusted, how far, and what to do about the rest.

    **Fields:** `sentence`; `parameters` by name; `causes`, findings grouped by what lies behind
    them, first what does most to the parameters.
    """

    sentence: str
    parameters: Mapping[str, ParameterVerdict]
    causes: Sequence[Cause]


def verdict(assessment: "Assessment") -> Verdict:
    """The verdict on the answer of an assessment (not under jit)."""
    by_name, widened = doubts(assessment), widening(assessment)
    grouped, table = causes(assessment, by_name, widened), assessment.answer.table
    judged = {
        name: ParameterVerdict(
            *(name, doubt.value, table[name].unit),
            *_judged(name, doubt, grouped, widened.get(name, "")),
            *(doubt.ends, doubt.share(doubt.size)),
        )
        for name, doubt in by_name.items()
    }
    return Verdict(_sentence(judged), judged, grouped)


def _judged(name: str, doubt: Doubt, grouped: Sequence[Cause], widened: str) -> tuple[Level, str]:
    """Level and reason: what rules it out, or else the largest part of its doubt.

    **Arguments:** `widened`: what makes its interval wide beside chance, if something does.
    """
    parts = {kind: doubt.by_kind(kind) for kind in ("model", "sensors", "data")}
    for cause in grouped:
        named = [f.code for f in cause.findings if name in (f.parameters or (name,))]
        if ruling := {*named} & {*RULED_OUT}:
            if ruling != {"interval_wider_than_estimate"}:
                return "do not use", cause.phrase
            faulty = parts["sensors"] > TRUSTED
            known = widened or (_reason("sensors", name, grouped) if faulty else "")
            return "do not use", known or cause.phrase
    if parts["sensors"] >= 1:
        return "do not use", _reason("sensors", name, grouped)
    if math.isnan(doubt.size):
        return "caution", _reason("computation", name, grouped)
    level: Level = "good" if doubt.share(doubt.size) <= TRUSTED else "caution"
    drifts = doubt.drift > DRIFTS * doubt.scatter
    if parts["model"] > WRONG and parts["model"] > parts["data"] and drifts:
        level = "do not use"
    kind = max(parts, key=lambda part: parts[part])
    return level, (widened if kind == "data" else "") or _reason(kind, name, grouped)


def _reason(kind: str, name: str, grouped: Sequence[Cause]) -> str:
    if kind == "data":
        told = [f for cause in grouped for f in cause.findings if f.code in FEW]
        short = any(name in (f.parameters or (name,)) for f in told)
        return "scatter; the record is short" if short else "scatter"
    for cause in grouped:
        if cause.kind == kind and name in cause.parameters:
            return cause.phrase
    return "its equation leaves more than noise"


def _sentence(judged: Mapping[str, ParameterVerdict]) -> str:
    """All levels in one sentence of plain English, with the reason for the worst."""
    good, caution, out = (
        sorted((one for one in judged.values() if one.level == level), key=lambda one: one.share)
        for level in ("good", "caution", "do not use")
    )
    if not judged:
        return "Nothing was estimated: every parameter is known."
    if len(good) == len(judged) > NAMED:
        least = f"{good[-1].name}, to {percent(good[-1].share)}"
        return f"Trust all {len(good)} parameters; the least certain is {least}."
    clauses = (
        f"trust {_listed(good)}" if good else "",
        f"take {_listed(caution)} with caution" if caution else "",
        f"do not use {_listed(out, shares=False)}" if out else "",
    )
    because = f": {(out or caution)[-1].reason}" if caution or out else ""
    words = "; ".join(filter(None, clauses))
    return f"{words[0].upper()}{words[1:]}{because}."


def _listed(some: Sequence[ParameterVerdict], shares: bool = True) -> str:
    """Each with how far it is to be trusted, if that is asked for."""
    reaches = (
        ""
        if not shares or math.isnan(judged.share)
        else f" to {percent(judged.share)}"
        if judged.share < 1
        else " (not told from zero)"
        for judged in some
    )
    words = [f"{judged.name}{reach}" for judged, reach in zip(some[:NAMED], reaches)]
    if (more := len(some) - NAMED) > 0:
        worst = max((one.share for one in some if shares and one.share < 1), default=1.0)
        words.append(f"{more} more{f' to {percent(worst)}' if worst < 1 else ''}")
    return joined(words)


def percent(share: float) -> str:
    """Two digits, rounded up: a doubt is not made smaller by printing it."""
    if not share < 1:
        return "over 100 %"
    size = 100 * share
    digits = max(0, 1 - math.floor(math.log10(size))) if size > 0 else 0
    # A hundredth of the last digit is not worth another.
    return f"{math.ceil(size * 10**digits - 0.01) / 10**digits:.{digits}f} %"
