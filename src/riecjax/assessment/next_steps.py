"""What to do next about findings that have one kind of cause.

A finding's own step comes first, then that of its class, then what the tests of an answer propose.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from riecjax.assessment.doubt import Evidence
from riecjax.criteria.test_functions import AbstractSmoothTestFunction
from riecjax.equations.expressions import constant
from riecjax.findings import Finding
from riecjax.validation.sweep import MOST

SMOOTH = ("--test-function", "bump")


@dataclass(frozen=True)
class Step:
    """Something to do next: what for, the options of `riecjax identify` that do it, and the command
    with them, where one is known."""

    words: str
    options: tuple[str, ...] = ()
    command: str | None = None


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
    if "unmodelled_mode" in by:
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
    if "not_its_derivative" in by and not smooth:
        signal, derivative = by["not_its_derivative"].signals
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
    if "residual_follows_signal" in by:
        signal = " and ".join(by["residual_follows_signal"].signals)
        yield Step(
            f"Find the term in {signal} that is missing (riecjax discover), or shift {signal} if "
            f"it is late"
        )
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


def joined(names: Sequence[str]) -> str:
    """Names, the last of several behind an "and"."""
    return " and ".join(filter(None, (", ".join(names[:-1]), *names[-1:])))
