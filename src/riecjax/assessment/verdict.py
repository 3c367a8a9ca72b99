"""What can be trusted, how far, and what to do about the rest, by stated rules.

Each estimated parameter is `good`, `caution` or `do not use`, by the size of its doubt (see
`riecjax.assessment.doubt`) as a share of its value, and by what rules it out whatever its size.
`python -m benchmarks.calibration verdicts` measures the rules on systems with known truth.

What to do about findings of one kind of cause: a finding's own step comes first, then that of its
class, then what the tests of an answer propose.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

from riecjax.assessment.doubt import TRUSTED, Doubt, Evidence, doubts
from riecjax.criteria.test_functions import AbstractSmoothTestFunction
from riecjax.equations.expressions import constant
from riecjax.findings import CODES, KINDS, Finding, joined
from riecjax.shows import Shown
from riecjax.validation.sweep import MOST

CONSTANT = "errors share a constant part, as of a sensor's offset"


@dataclass(frozen=True)
class Step:
    """Something to do next: what for, the options of `riecjax identify` that do it, and the command
    with them, where one is known."""

    words: str
    options: tuple[str, ...] = ()
    command: str | None = None


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
    def spoils(self) -> bool:
        """Whether signals are not what sensors saw, of which all else may be a consequence."""
        spoilt = any(finding.about.holds for finding in self.findings)
        return spoilt and self.share > TRUSTED

    @property
    def voids(self) -> bool:
        """Whether it leaves nothing of an answer, so that it is to be seen to first."""
        return self.kind == "sensors" and self.share >= 1


def causes(
    evidence: Evidence, by_name: Mapping[str, Doubt], widened: Mapping[str, str]
) -> list[Cause]:
    """Of all findings, first what does most to the parameters."""
    grouped, importance = [], {code: place for place, code in enumerate(CODES)}
    ranked = sorted(evidence.findings(), key=lambda f: importance.get(f.code, len(importance)))
    for kind in KINDS:
        findings = [finding for finding in ranked if finding.about.kind == kind]
        if not findings:
            continue
        concerned = {name for f in findings for name in evidence.parameters_of(f)}
        some = {name: doubt for name, doubt in by_name.items() if name in concerned}
        share = max((doubt.by_kind(kind) for doubt in some.values()), default=0.0)
        first, step = findings[0], next_step(evidence, findings)
        phrase = first.about.said(first.signals, first.parameters)
        peaks = [r.peak for r in evidence.equation_residuals if r.peak is not None]
        if first.code == "unmodelled_mode" and (first.remedy or peaks):
            near = max(peaks, key=lambda peak: peak.size).frequency if peaks else 0.0
            hertz = first.remedy[1].partition("=")[2] if first.remedy else f"{near:.3g}"
            phrase = f"the model leaves out a mode near {hertz} Hz"
        elif first.about.of_size and _with_constant_part(evidence):
            phrase = CONSTANT
        # A longer record mends neither a good value nor what a common error widens.
        if kind == "data" and all(
            doubt.by_kind(kind) <= TRUSTED or name in widened for name, doubt in some.items()
        ):
            step = None
        grouped.append(Cause(kind, phrase, tuple(findings), tuple(some), share, step))
    return sorted(
        grouped, key=lambda c: (c.kind != "undetermined", not c.voids, not c.spoils, -c.share)
    )


def _with_constant_part(evidence: Evidence) -> set[str]:
    """Parameters of equations whose errors share a constant part."""
    residuals = (r for r in evidence.equation_residuals if r.has_constant_part)
    return {name for residual in residuals for name in residual.parameters}


Level = Literal["good", "caution", "do not use"]

WRONG = 0.1
"""Share of a value from which a wrong model rules it out, if scatter is smaller."""
DRIFTS = 0.3
"""Share of its scatter by which such a value drifts with window length, too. What is left may point
away from a parameter's regressor; then its value is the same at every length."""
NAMED = 4
"""Parameters that a sentence names one by one."""


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


def verdict(evidence: Evidence) -> Verdict:
    """The verdict on an answer, by all that is known of it (not under jit)."""
    by_name, table = doubts(evidence), evidence.answer.table
    # Of parameters whose intervals are wide by more than chance, what is known to make them so.
    widened = dict.fromkeys(table.concerned(_with_constant_part(evidence)), CONSTANT)
    for finding in (finding for finding in evidence.findings() if finding.about.widens):
        phrase = finding.about.said(finding.signals, finding.parameters)
        widened |= dict.fromkeys(finding.parameters, phrase)
    grouped, judged = causes(evidence, by_name, widened), {}
    for name, doubt in by_name.items():
        level, reason = _judged(name, doubt, grouped, widened.get(name, ""))
        judged[name] = ParameterVerdict(
            name=name,
            value=doubt.value,
            unit=table[name].unit,
            level=level,
            reason=reason,
            doubt=doubt.ends,
            share=doubt.share(doubt.size),
        )
    return Verdict(_sentence(judged), judged, grouped)


def _judged(name: str, doubt: Doubt, grouped: Sequence[Cause], widened: str) -> tuple[Level, str]:
    """Level and reason: what rules it out, or else the largest part of its doubt.

    **Arguments:** `widened`: what makes its interval wide beside chance, if something does.
    """
    parts = {kind: doubt.by_kind(kind) for kind in ("model", "sensors", "data")}
    for cause in grouped:
        named = [f.about for f in cause.findings if name in (f.parameters or (name,))]
        if ruling := [about for about in named if about.rules_out]:
            if not all(about.symptom for about in ruling):
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
        told = [f for cause in grouped for f in cause.findings if f.about.short]
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


SMOOTH = ("--test-function", "bump")


def next_step(evidence: Evidence, findings: Sequence[Finding]) -> Step | None:
    """The best thing to do about findings of one kind of cause, the most important first."""
    return next(_steps(evidence, findings), None)


def _steps(evidence: Evidence, findings: Sequence[Finding]) -> Iterator[Step]:
    """What might be done, the best first."""
    yield from (Step(f.step, f.remedy) for f in findings if f.step)
    for about in (f.about for f in findings if f.about.step):
        alike = [finding for finding in findings if finding.about.step == about.step]
        parameters = joined([*dict.fromkeys(name for f in alike for name in f.parameters)])
        signals = joined([*dict.fromkeys(name for f in alike for name in f.signals)])
        yield Step(about.step.format(parameters=parameters, signals=signals), about.options)
    by = {finding.code: finding for finding in reversed(findings)}
    residuals, criterion = evidence.equation_residuals, evidence.estimate.criterion
    smooth = isinstance(getattr(criterion, "test_function", None), AbstractSmoothTestFunction)
    # What is wrong in time or size may leave what looks like a mode: it is put right first.
    undone = (f for f in evidence.findings() if f.about.undo and not f.about.holds)
    is_faulty = any(finding.remedy for finding in undone)
    if "unmodelled_mode" in by and not is_faulty:
        peaked = [e for e in residuals if e.peak is not None and e.bodies]
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
    # Of two that do not move alike; where one is off in size, the position may be the wrong one.
    match by.get("not_its_derivative"):
        case Finding(signals=(signal, derivative), step="") if not smooth:
            yield Step(f"Identify from {signal} alone, without {derivative}", SMOOTH)
    if "uneven_errors" in by:
        # The zero of an input's sensor, where its equation has no constant term yet.
        names = {e.name for e in residuals if e.has_constant_part}
        equations = (e for e in evidence.model.equations if e.name in names)
        terms = (e.terms for e in equations if all(t.of is not constant for t in e.terms))
        known = (t for some in terms for t in some if t.signal and not t.parameters)
        for name in (str(term.signal) for term in known if term.derivative == 0):
            yield Step(f"Estimate the zero of the sensor of {name}", ("--unknown-offset", name))
    if "window_sensitive" in by and (sweep := evidence.test("window_sweep")) is not None:
        drifting = by["window_sensitive"].parameters
        if sweep.noise_share(drifting[0]) > MOST and not smooth:
            yield Step("Take smooth windows, which read positions alone", SMOOTH)
        if (steady := sweep.steady(drifting)) is not None:
            low, high = (f"{end:.3g}" for end in steady)
            yield Step("Keep to windows in which all are steady", ("--alpha", low, "--beta", high))
    if "records_disagree" in by:
        names = [f.parameters[0] for f in findings if f.code == "records_disagree"]
        options = tuple(word for name in names for word in ("--per-record", name))
        yield Step(f"Let {joined(names)} differ between recordings", options)
    if "coarse_sampling" in by and criterion.all_windows is not None:
        yield Step("Integrate by a higher order", ("--quadrature", "6"))
    collinear = [finding for finding in findings if finding.about.collinear]
    hidden = {row.name for row in evidence.answer.table.rows if row.element is not None}
    if any(name in hidden for finding in collinear for name in finding.parameters):
        yield Step("Leave out the hidden mode or spring (drop --add-mode, --add-spring)")
    elif collinear:
        yield Step("Excite the machine more richly, or hold a parameter (--set NAME=VALUE)")
