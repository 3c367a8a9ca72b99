"""An identification on a terminal, and in words that the page says too.

The answer comes first, then what to do about it, and how it came about.
"""

import shlex
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

from rich.console import Console

from riecjax.findings import in_percent
from riecjax.reporting import answer as parts
from riecjax.reporting.answer import Answer
from riecjax.reporting.document import number, percents
from riecjax.reporting.parameters import dotted, parameter_table
from riecjax.reporting.tables import in_rich, print_table, say

STYLES = {"good": "green", "caution": "yellow", "do not use": "bold red"}
LEAST_SHOWN = 1e-4
"""Share of a signal's standard deviation below which noise is not worth a line."""


def print_identification(answer: Answer, console: Console) -> None:
    """The verdict, and in a line what the values are."""
    refinement, criterion = answer.refinement, answer.criterion
    how = criterion["name"].upper()
    if "alpha" in criterion:
        how += f" in windows of {criterion['alpha']:.3g} to {criterion['beta']:.3g} s"
    if refinement is not None and refinement.chosen:
        white = refinement.whiteness is not None and refinement.whiteness.white
        by_simulation = refinement.by is None or refinement.by["refine"] == "output-error"
        how = "refined by " + ("simulation" if by_simulation else "impulses of the equation error")
        how += ", which leaves white noise" if white else ""
    said = len(answer.warnings)
    more = f" {said} finding{'s' if said != 1 else ''} and" if said else ""
    print_verdict(answer, console)
    say(console, "")
    if converted := answer.provenance.converted:
        units = ", ".join(f"{name} from {unit}" for name, unit in converted.items())
        say(console, f"Converted to SI: {units}.")
    say(console, f"Values: {how}. Add --verbose for{more} how they were found.")
    say(console, *words_of(answer, "modes", "validation"))


def print_everything(answer: Answer, console: Console) -> None:
    """The verdict, and all there is to say of how it came about."""
    criterion = answer.criterion
    print_verdict(answer, console)
    say(console, "", *answer.equations)
    heading = f"{answer.model}  {criterion['name'].upper()}  {settings_in_words(criterion)}"
    say(console, heading)
    print_table(in_rich(parameter_table(answer)), console)
    say(console, *fits_in_words(answer.residual), *words_of(answer))
    say(console, *(f"prepared: {step}" for step in answer.provenance.preparation))


def print_verdict(answer: Answer, console: Console) -> None:
    """Sentence, table, reasons and what to do next."""
    verdict = answer.verdict
    say(console, verdict.sentence, style="bold")
    say(console, "")
    # The answer with its doubt and level; standard errors are in the full table.
    columns = ("value", "95 % interval", "doubt", "unit", "verdict")
    table = parameter_table(answer, columns, lambda ends: "?" if None in ends else dotted(ends))
    print_table(in_rich(table, columns[:3], STYLES), console)
    say(console, *reasons_in_words(verdict))
    for step in verdict.followed:
        say(console, "", f"Done: {step.said}, by {shlex.join(step.options)}.")
    for step in verdict.next:
        say(console, "", f"{step.said}{':' if step.command else '.'}")
        if step.command:
            # Not wrapped: a command is to be pasted.
            say(console, f"  {step.command}", wrapped=False)


def reasons_in_words(verdict: parts.VerdictPart) -> Iterator[str]:
    """Why what is not good is not, parameters with the same reason together."""
    by_reason: dict[str, list[str]] = {}
    for name, judgement in verdict.parameters.items():
        if judgement.level != "good":
            by_reason.setdefault(judgement.reason, []).append(name)
    for reason, names in by_reason.items():
        yield f"{', '.join(names)}: {reason}"


def criterion_in_words(criterion: parts.Settings) -> str:
    """A criterion's name and settings."""
    settings = {k: f"{v:.6g}" if isinstance(v, float) else v for k, v in criterion.items()}
    name = str(settings.pop("name")).upper()
    listed = ", ".join(f"{key} {value}" for key, value in settings.items())
    return f"{name} ({listed})" if listed else name


def settings_in_words(criterion: parts.Settings) -> str:
    """A criterion's settings, all but its name."""
    return ", ".join(f"{key} {value}" for key, value in criterion.items() if key != "name")


def fits_of(residual: parts.ResidualPart) -> Iterator[tuple[str, parts.StageFit | parts.Fit]]:
    """What each stage leaves, and each equation of a stage of several, by name."""
    for stage in residual.stages:
        yield stage.equation, stage
        for name in stage.equations if len(stage.equations) > 1 else ():
            yield name, residual.equations[name]


def fits_in_words(residual: parts.ResidualPart) -> Iterator[str]:
    """A line on what each stage and equation leaves."""
    for name, fit in fits_of(residual):
        told = [f"relative residual {percents(fit.relative_rms)} %"]
        if isinstance(fit, parts.StageFit):
            told.append(f"condition number {number(fit.condition_number, 3)}")
        yield f"{name}: {', '.join(told)}, {fit.rows} rows"


def words_of(answer: Answer, *names: str) -> Iterator[str]:
    """What is said of these parts of an answer, by default of all that something is said of."""
    for name in names or WORDS:
        if part := getattr(answer, name):
            yield from WORDS[name](part)


def modes_in_words(modes: Sequence[parts.ModePart]) -> Iterator[str]:
    """Where each mode is, what it explains, the windows that it was found in, and which modes
    were looked for elsewhere."""
    for mode in modes:
        low, high = mode.window_s
        lengths = f"{low:.3g} s" if low == high else f"{low:.3g} to {high:.3g} s"
        # Less than nothing is left where noise was taken off.
        left = max(mode.held_out.with_mode or 0.0, 0.0)
        frequency = number(mode.frequency_hz, 4), number(mode.frequency_std_error_hz, 2)
        ratio = number(mode.damping_ratio, 4), number(mode.damping_ratio_std_error, 2)
        yield (
            f"hidden mode on {mode.on}: {' +- '.join(frequency)} Hz with the body at rest, "
            f"damping ratio {' +- '.join(ratio)}, in windows of {lengths}, which tell most of it. "
            f"Left of {mode.equation} on stretches that it was not found from: "
            f"{in_percent(left)} with it, {percents(mode.held_out.without, '.2g')} % without."
        )
        for stray in mode.strays:
            yield (
                f"no mode near {stray.asked_hz:.4g} Hz: the search for {stray.parameters[0]} ended "
                f"at {number(stray.found_hz, 3)} Hz."
            )


def choice_in_words(refinement: parts.RefinementPart) -> str:
    """Which values are the answer, and what the others are for."""
    whiteness, declined = refinement.whiteness, refinement.declined
    if refinement.refined is None:
        return f"not refined: {declined}."
    if declined is not None and whiteness is not None and not whiteness.white:
        unseen = [run for run in refinement.simulations if not run.fitted]
        fits = (f"{run.on} {_worst(run.before)} -> {_worst(run.after)} %" for run in unseen)
        predicted = f" (worst fit on {', '.join(fits)})" if unseen else ""
        return (
            f"refined by output error, but that is not the answer: {declined}. The identified "
            f"values are the physical parameters; the refined ones are for predicting motions like "
            f"these{predicted}."
        )
    if declined is not None:
        return f"refined by output error, but that is not the answer: {declined}."
    if whiteness is None:
        return "the refined values are the answer, as was asked for."
    size = f"{_number(whiteness.largest)}, where noise stays below {whiteness.threshold:.2g}"
    if not whiteness.white:
        return (
            f"the refined values are the answer, as was asked for. What they leave is not white "
            f"noise ({size}), as of coloured noise, of noise on a recorded input, or of a model "
            f"that leaves out part of the motion: there the identified values are the physical "
            f"parameters, and these are for predicting motions like this one."
        )
    if whiteness.vanishing:
        most = max(channel.share or 0.0 for channel in whiteness.channels.values())
        return (
            f"the refined values are the answer: the model follows the motion to {_number(most)} "
            f"of its size, so that there is no noise to tell from its errors."
        )
    return (
        f"the refined values are the answer: they are as precise as the sensors allow, since what "
        f"they leave is white noise ({size}). That does not prove the model right."
    )


def _worst(held: parts.HeldOutPart) -> str:
    fits = [signal.fit_percent for signal in held.signals.values() if signal.judged]
    return _fit(min((fit for fit in fits if fit is not None), default=None))


def _fit(percent: float | None) -> str:
    return "?" if percent is None else f"{percent:.4g}"


def search_in_words(refinement: parts.RefinementPart) -> Iterator[str]:
    """How the search went, whether or not its values are the answer."""
    kind = {"integral": "impulses of the equation error", "output-error": "the output error"}
    whiteness, by, intervals = refinement.whiteness, refinement.by, refinement.intervals
    assert by is not None
    assert intervals is not None
    yield f"refined by {kind[by['refine']]}: {refinement.reason} ({refinement.steps} steps)"
    yield f"left before and after, of {refinement.basis}:"
    channels = {} if whiteness is None or whiteness.vanishing else whiteness.channels
    for name, left in refinement.left.items():
        # Beside what the sensor's noise would leave.
        power = channels[name].chi_squared if name in channels else None
        noise = "" if power is None else f", {number(power**0.5, 3)} times the sensor's noise"
        yield (
            f"{name}: {_number(left.before)} before, {_number(left.after)} {left.unit} "
            f"r.m.s. after{noise}"
        )
    for run in refinement.simulations:
        where = f"{run.on} (fitted)" if run.fitted else run.on
        fits = ", ".join(
            f"{name} {_fit(run.before.fit(name))} -> {_fit(run.after.fit(name))} %"
            for name in run.after.signals
        )
        yield f"simulated on {where}, fit before -> after: {fits} (from the state as recorded)"
    yield f"refined {intervals_in_words(intervals)}; of what was identified:"


def _number(value: float | None) -> str:
    return "?" if value is None else number(value, 4)


def intervals_in_words(intervals: parts.IntervalsPart) -> str:
    """Where intervals come from."""
    return (
        f"intervals: {intervals.method}, {intervals.blocks} blocks of "
        f"{intervals.block_seconds:.3g} s"
    )


def noise_in_words(noise: Mapping[str, parts.NoisePart]) -> Iterator[str]:
    """One line on all signals that have some, if any is known."""
    shares = {name: entry.share or 0.0 for name, entry in noise.items()}
    shown = [f"{n} {number(100 * s, 2)} %" for n, s in shares.items() if s >= LEAST_SHOWN]
    noun = "their standard deviations" if len(shown) > 1 else "its standard deviation"
    if shown:
        yield f"noise: {', '.join(shown)} of {noun}"
    elif noise:
        yield f"noise: below {in_percent(LEAST_SHOWN, 'g')} of each signal's standard deviation"


LISTED = 8
"""Of a test's own values, as many as are written out."""


def plain_in_words(entry: Any) -> str:
    """Plain data in words."""
    if isinstance(entry, dict):
        return ", ".join(f"{name} {plain_in_words(each)}" for name, each in entry.items())
    if isinstance(entry, list) and len(entry) > LISTED:
        return f"{len(entry)} values"
    if isinstance(entry, list):
        return f"[{', '.join(map(plain_in_words, entry))}]"
    return number(entry) if isinstance(entry, float) else str(entry)


WORDS: dict[str, Callable[[Any], Iterable[str]]] = {
    "modes": modes_in_words,
    # What became of a search is told where its values are the answer.
    "refinement": lambda part: [
        choice_in_words(part),
        *(search_in_words(part) if part.chosen else ()),
    ],
    "provenance": lambda part: [intervals_in_words(part.intervals)] if part.intervals else [],
    "noise": noise_in_words,
    "validation": lambda runs: [f"validated on {run.on}: {run.verdict}" for run in runs],
    "tests": lambda tests: [
        f"{name.replace('_', ' ')}: {plain_in_words(entry)}" for name, entry in tests.items()
    ],
}
"""What is said of each part of an answer that has more to say than a number, in this order."""


def evidence_in_words(test: str, entry: Mapping[str, Any]) -> list[str]:
    """What is said of an element's evidence, by the name of its test."""
    if test == "modes":
        return [*modes_in_words([parts.read(parts.ModePart, entry)])]
    return [*WORDS["tests"]({test: entry})]
