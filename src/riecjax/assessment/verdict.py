"""What can be trusted, how far, and what to do about the rest, by stated rules.

Each estimated parameter is `good`, `caution` or `do not use`, by the size of its doubt (see
`riecjax.assessment.doubt`) as a share of its value, and by what rules it out whatever its size.
`python -m benchmarks.verdicts` measures the rules on systems with known truth.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple

from riecjax.assessment.causes import Cause, causes, joined, widening
from riecjax.assessment.doubt import TRUSTED, Doubt, doubts
from riecjax.shows import Shown

if TYPE_CHECKING:
    from riecjax.assessment.assessment import Assessment

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

    def of_level(self, level: Level) -> list[ParameterVerdict]:
        """Parameters of one level, the least doubtful first."""
        some = [one for one in self.parameters.values() if one.level == level]
        return sorted(some, key=lambda one: one.share)


def verdict(assessment: "Assessment") -> Verdict:
    """The verdict on the answer of an assessment (not under jit)."""
    found = doubts(assessment)
    grouped = causes(assessment, found)
    answer, units = assessment.answer, dict(assessment.answer.units)
    widened = widening(assessment, names=found)
    judged = {}
    for name, doubt in found.items():
        value = float(answer[name])
        size = max(abs(value), 1e-300)
        level, reason = _judged(name, doubt, size, grouped, widened.get(name, ""))
        share = doubt.size / size
        judged[name] = ParameterVerdict(
            name, value, units.get(name, ""), level, reason, doubt.around(value), share
        )
    return Verdict(_sentence(judged), judged, grouped)


def _judged(
    name: str, doubt: Doubt, size: float, grouped: Sequence[Cause], widened: str
) -> tuple[Level, str]:
    """Level and reason: what rules it out, or else the largest part of its doubt.

    **Arguments:** `widened`: what makes its interval wide beside chance, if something does.
    """
    for cause in grouped:
        own = [f.code for f in cause.findings if name in (f.parameters or (name,))]
        if ruling := [code for code in own if code in RULED_OUT]:
            if set(ruling) != {"interval_wider_than_estimate"}:
                return "do not use", cause.phrase
            faulty = doubt.sensors > TRUSTED * size
            known = widened or (_reason("sensors", name, grouped) if faulty else "")
            return "do not use", known or cause.phrase
    if doubt.sensors >= size:
        return "do not use", _reason("sensors", name, grouped)
    if math.isnan(doubt.size):
        return "caution", _reason("computation", name, grouped)
    level: Level = "good" if doubt.size <= TRUSTED * size else "caution"
    wrong = doubt.drift + doubt.left_out
    if wrong > WRONG * size and wrong > doubt.scatter and doubt.drift > DRIFTS * doubt.scatter:
        level = "do not use"
    parts = {"model": wrong, "sensors": doubt.sensors, "data": doubt.scatter}
    kind = max(parts, key=lambda part: parts[part])
    return level, (widened if kind == "data" else "") or _reason(kind, name, grouped)


def _reason(kind: str, name: str, grouped: Sequence[Cause]) -> str:
    if kind == "data":
        few = ("short_record", "few_blocks", "few_effective_windows")
        found = [f for cause in grouped for f in cause.findings if f.code in few]
        short = any(name in (f.parameters or (name,)) for f in found)
        return "scatter; the record is short" if short else "scatter"
    for cause in grouped:
        if cause.kind == kind and name in cause.parameters:
            return cause.phrase
    return "its equation leaves more than noise"


def _sentence(judged: Mapping[str, ParameterVerdict]) -> str:
    """All levels in one sentence of plain English, with the reason for the worst."""
    by_level = {
        level: sorted(
            (one for one in judged.values() if one.level == level), key=lambda one: one.share
        )
        for level in ("good", "caution", "do not use")
    }
    good, caution, out = by_level.values()
    if not judged:
        return "Nothing was estimated: every parameter is known."
    if not caution and not out:
        if len(good) > NAMED:
            worst = good[-1]
            least = f"{worst.name}, to {percent(worst.share)}"
            return f"Trust all {len(good)} parameters; the least certain is {least}."
        return f"Trust {_listed(good)}."
    clauses = []
    if good:
        clauses.append(f"trust {_listed(good)}")
    if caution:
        clauses.append(f"take {_listed(caution)} with caution")
    if out:
        clauses.append(f"do not use {_names(out)}")
    worst = (out or caution)[-1]
    said = "; ".join(clauses)
    return f"{said[0].upper()}{said[1:]}: {worst.reason}."


def _listed(some: Sequence[ParameterVerdict]) -> str:
    words = [_with_share(one) for one in some[:NAMED]]
    more = len(some) - NAMED
    if more > 0:
        worst = max((one.share for one in some if one.share < 1), default=1.0)
        words.append(f"{more} more{f' to {percent(worst)}' if worst < 1 else ''}")
    return joined(words)


def _names(some: Sequence[ParameterVerdict]) -> str:
    words = [one.name for one in some[:NAMED]]
    more = len(some) - NAMED
    return joined([*words, f"{more} more"] if more > 0 else words)


def _with_share(one: ParameterVerdict) -> str:
    if math.isnan(one.share):
        return one.name
    if one.share >= 1:
        return f"{one.name} (not told from zero)"
    return f"{one.name} to {percent(one.share)}"


def percent(share: float) -> str:
    """Two digits, rounded up: a doubt is not made smaller by printing it."""
    if not share < 1:
        return "over 100 %"
    size = 100 * share
    digits = max(0, 1 - math.floor(math.log10(size))) if size > 0 else 0
    # A hundredth of the last digit is not worth another.
    return f"{math.ceil(size * 10**digits - 0.01) / 10**digits:.{digits}f} %"
