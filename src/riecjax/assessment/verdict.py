"""What can be trusted, how far, and what to do about the rest, by stated rules.

Each estimated parameter is `good`, `caution` or `do not use`, by the size of its doubt (see
`riecjax.assessment.doubt`) as a share of its value, and by what rules it out whatever its size.
`python -m benchmarks.calibration verdicts` measures the rules on systems with known truth. What to
do about the rest was tried before (`riecjax.assessment.advice`).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

from riecjax.assessment.advice import steps_of
from riecjax.assessment.doubt import TRUSTED, Doubt, Evidence, doubts
from riecjax.findings import KINDS, Finding, Step, joined
from riecjax.shows import Shown


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


def causes(evidence: Evidence, by_name: Mapping[str, Doubt]) -> list[Cause]:
    """Of all findings, first what does most to the parameters."""
    grouped = []
    ranked = sorted(evidence.findings(), key=lambda finding: finding.importance)
    for kind in KINDS:
        findings = [finding for finding in ranked if finding.about.kind == kind]
        if not findings:
            continue
        concerned = {name for f in findings for name in evidence.parameters_of(f)} & {*by_name}
        scatters = (by_name[name].scatter_share for name in concerned)
        share = max(scatters if kind == "data" else map(_largest, findings), default=0.0)
        told = max(findings, key=_largest)
        phrase = told.about.said(told.signals, told.parameters)
        steps = [evidence.tried_step(step) for f in findings for step in steps_of(f, findings)]
        # A longer record mends no good value.
        if kind == "data" and share <= TRUSTED:
            steps = []
        concerned = tuple(name for name in by_name if name in concerned)
        step = next(filter(None, steps), None)
        grouped.append(Cause(kind, phrase, tuple(findings), concerned, share, step))
    return sorted(
        grouped, key=lambda c: (c.kind != "undetermined", not c.voids, not c.spoils, -c.share)
    )


def _largest(finding: Finding) -> float:
    """The largest share that a finding states."""
    return max([finding.doubt, *finding.doubts.values()])


Level = Literal["good", "caution", "do not use"]

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
    them, first what does most to the parameters; steps of advice that were `followed` before.
    """

    sentence: str
    parameters: Mapping[str, ParameterVerdict]
    causes: Sequence[Cause]
    followed: Sequence[Step] = ()


def verdict(evidence: Evidence) -> Verdict:
    """The verdict on an answer, by all that is known of it (not under jit)."""
    by_name = doubts(evidence)
    # Of parameters whose intervals are wide by more than chance, what makes them so.
    widened: dict[str, str] = {}
    for finding in (finding for finding in evidence.findings() if finding.about.widens):
        phrase = finding.about.said(finding.signals, finding.parameters)
        widened |= dict.fromkeys(finding.parameters, phrase)
    grouped, judged = causes(evidence, by_name), {}
    for name, doubt in by_name.items():
        level, reason = _judged(name, doubt, grouped, widened.get(name, ""))
        unit = evidence.answer.table[name].unit
        judged[name] = ParameterVerdict(
            name, doubt.value, unit, level, reason, doubt.ends, doubt.share
        )
    return Verdict(_sentence(judged), judged, grouped, evidence.followed)


def _judged(name: str, doubt: Doubt, grouped: Sequence[Cause], widened: str) -> tuple[Level, str]:
    """Level and reason: what rules it out, or what `widened` its interval beside chance, or else
    the largest part of its doubt."""
    about = [f for c in grouped for f in c.findings if name in (f.parameters or (name,))]
    known, named = widened, doubt.named
    # What is demanded and can be put right makes scatter as well.
    if named is not None and (
        doubt.wrong > doubt.scatter or (named.remedy and not named.about.assumed)
    ):
        known = named.about.said(named.signals, named.parameters)
    for finding in (finding for finding in about if finding.about.rules_out):
        phrase = finding.about.said(finding.signals, finding.parameters)
        return "do not use", (finding.about.symptom and known) or phrase
    if math.isnan(doubt.size):
        computed = (finding.about for finding in about if finding.about.kind == "computation")
        return "caution", next((one.said((), (name,)) for one in computed), "it has no interval")
    short = any(finding.about.short for finding in about)
    reason = known or ("scatter; the record is short" if short else "scatter")
    if doubt.is_wrong:
        return "do not use", reason
    return "good" if doubt.is_good else "caution", reason


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
