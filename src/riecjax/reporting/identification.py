"""Results of an identification: JSON document and tables on a terminal.

The answer comes first, then what to do about it, and how it came about.
"""

import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console

from riecjax.assessment.assessment import Assessment, Refinement
from riecjax.assessment.verdict import Cause, Step, Verdict
from riecjax.records.recording import common_steps
from riecjax.reporting.checking import (
    excitation_entries,
    noise_entries,
    noise_in_words,
    recording_entry,
    start_times,
)
from riecjax.reporting.document import Document, ends_of, finite, number, told, versions
from riecjax.reporting.equations import model_in_words
from riecjax.reporting.estimate import (
    estimate_entries,
    intervals_entry,
    parameter_entries,
    parameter_table,
    print_estimate,
)
from riecjax.reporting.tables import in_rich, print_table, say

if TYPE_CHECKING:
    from riecjax.estimation.evidence import ModeEvidence

MOST_STEPS = 3
"""Things to do next that are told."""
WithOptions = Callable[[Sequence[str]], Sequence[str]]
"""Arguments of `riecjax`, those that made a result, with further options in their places."""
STYLES = {"good": "green", "caution": "yellow", "do not use": "bold red"}


def identification_document(
    result: Assessment, command: Sequence[str] = (), with_options: WithOptions | None = None
) -> Document:
    """The document that `--json` prints and results.json holds.

    **Arguments:** `command`: the arguments of `riecjax` that made it, if any did.
    """
    estimate, refinement = result.estimate, result.refinement
    found = estimate_entries(result.model.name, estimate)
    identified, key, sweep, seed = found["parameters"], result.key, result.sweep, None
    if key is not None:
        # The seed that `jax.random.key` makes this key of: its words, the highest first.
        words = jax.random.key_data(key) if jnp.issubdtype(key.dtype, jax.dtypes.prng_key) else key
        seed = int.from_bytes(np.asarray(words).astype(">u4").tobytes(), "big")
    if refinement is not None and refinement.chosen:
        found["parameters"] = parameter_entries(result.answer)
    return {
        **found,
        "equations": model_in_words(result.model),
        "verdict": verdict_entries(result.verdict, with_options),
        "modes": mode_entries(result.modes),
        "excitation": excitation_entries(result.checked),
        "noise": noise_entries(result.recordings, result.checked.signals),
        "correlation": {
            "parameters": list(estimate.parameters),
            "matrix": finite(np.asarray(estimate.correlation)),
        },
        "residual_tests": None if result.residuals is None else result.residuals.describe(),
        "window_choice": None if result.choice is None else result.choice.describe(),
        "window_sweep": None
        if sweep is None
        else {
            **told(sweep, "alpha", "beta"),
            "parameters": {
                name: {
                    "value": finite(sweep.theta[:, j]),
                    "std_error": finite(sweep.standard_errors[:, j]),
                }
                for j, name in enumerate(sweep.parameters)
            },
            "relative_rms": {
                label: finite(sweep.relative_rms[:, i]) for i, label in enumerate(sweep.stage_names)
            },
        },
        "refinement": None if refinement is None else refinement_entries(refinement, identified),
        "validation": [
            {"on": run.recording.name, **run.held.describe()} for run in result.validations
        ],
        "warnings": [finding._asdict() for finding in result.findings()],
        "provenance": {
            "command": as_typed(command) if command else None,
            "seed": seed,
            "records": [recording_entry(recording) for recording in result.recordings],
            "start_times": start_times(result.recordings),
            "preparation": common_steps(result.recordings),
            "converted": {k: u for r in result.recordings for k, u in r.converted.items()},
            "intervals": intervals_entry(estimate),
            "versions": versions(),
        },
    }


def verdict_entries(verdict: Verdict, with_options: WithOptions | None = None) -> Document:
    """The part of the document about the verdict.

    **Arguments:** `with_options` makes arguments of `riecjax` that do what to do next; without,
    there is no command for it.
    """
    return {
        "sentence": verdict.sentence,
        "parameters": {
            name: told(judged, "level", "reason", "doubt", "share")
            for name, judged in verdict.parameters.items()
        },
        "causes": [
            {
                **told(cause, "kind", "phrase", "parameters", "share"),
                "codes": list(dict.fromkeys(finding.code for finding in cause.findings)),
            }
            for cause in verdict.causes
        ],
        "next": list(_next(verdict.causes, with_options)),
    }


def _next(causes: Sequence[Cause], with_options: WithOptions | None) -> Iterator[Document]:
    """What to do, with a command that does it; what has one comes first, but for what voids all."""
    urgent = {cause.step: cause.voids for cause in reversed(causes) if cause.step is not None}
    steps = sorted(reversed(urgent), key=lambda step: (not urgent[step], not step.options))
    different: dict[object, Step] = {}
    for step in steps:  # two causes may ask for the same
        different.setdefault(step.options or step.words, step)
    for step in [*different.values()][:MOST_STEPS]:
        proposed = with_options(step.options) if with_options and step.options else None
        yield {
            "words": step.words,
            "options": list(step.options),
            "command": as_typed(proposed) if proposed else None,
        }


def as_typed(arguments: Sequence[str]) -> str:
    """`riecjax` with these arguments, as this system's shell takes it."""
    # To cmd.exe a single quote is a letter like others.
    join = subprocess.list2cmdline if sys.platform == "win32" else shlex.join
    return join(["riecjax", *arguments])


def print_verdict(document: Document, console: Console) -> None:
    """Sentence, table, reasons and what to do next."""
    entries = document["verdict"]
    say(console, entries["sentence"], style="bold")
    say(console, "")
    # The answer with its doubt and level; standard errors are in the full table.
    columns = ("value", "95 % interval", "doubt", "unit", "verdict")
    table = parameter_table(
        document, columns, lambda ends: "?" if None in ends else " .. ".join(ends_of(ends))
    )
    print_table(in_rich(table, columns[:3], STYLES), console)
    say(console, *reasons_in_words(entries))
    for step in entries["next"]:
        say(console, "", f"{step['words']}{':' if step['command'] else '.'}")
        if step["command"]:
            # Not wrapped: a command is to be pasted.
            say(console, f"  {step['command']}", wrapped=False)


def reasons_in_words(entries: Document) -> Iterator[str]:
    """Why what is not good is not, parameters with the same reason together."""
    by_reason: dict[str, list[str]] = {}
    for name, judged in entries["parameters"].items():
        if judged["level"] != "good":
            by_reason.setdefault(judged["reason"], []).append(name)
    for reason, names in by_reason.items():
        yield f"{', '.join(names)}: {reason}"


def print_identification(document: Document, console: Console) -> None:
    """The verdict, and in a line what the values are."""
    refinement, criterion = document["refinement"], document["criterion"]
    how = criterion["name"].upper()
    if "alpha" in criterion:
        how += f" in windows of {criterion['alpha']:.3g} to {criterion['beta']:.3g} s"
    if refinement is not None and refinement["chosen"]:
        white = (refinement["whiteness"] or {}).get("white")
        how = f"refined by simulation{', which leaves white noise' if white else ''}"
    said = len(document["warnings"])
    more = f" {said} finding{'s' if said != 1 else ''} and" if said else ""
    print_verdict(document, console)
    say(console, "")
    if converted := document["provenance"]["converted"]:
        units = ", ".join(f"{name} from {unit}" for name, unit in converted.items())
        say(console, f"Converted to SI: {units}.")
    say(console, f"Values: {how}. Add --verbose for{more} how they were found.")
    say(console, *modes_in_words(document["modes"]), *_validations_in_words(document))


def print_everything(document: Document, console: Console) -> None:
    """The verdict, and all there is to say of how it came about."""
    refinement, prepared = document["refinement"], document["provenance"]["preparation"]
    print_verdict(document, console)
    say(console, "", *document["equations"])
    print_estimate(document, console)
    say(console, *modes_in_words(document["modes"]))
    if refinement is not None:
        # What became of the search, if its values are the answer.
        search = search_in_words(refinement) if refinement["chosen"] else ()
        say(console, choice_in_words(refinement), *search)
    say(console, *windows_in_words(document), *_validations_in_words(document))
    say(console, *(f"prepared: {step}" for step in prepared))


def _validations_in_words(document: Document) -> Iterator[str]:
    return (f"validated on {run['on']}: {run['verdict']}" for run in document["validation"])


def windows_in_words(document: Document) -> Iterator[str]:
    """Where intervals come from, what windows see and which would serve best, and the noise."""
    intervals = document["provenance"]["intervals"]
    yield (
        f"intervals: {intervals['method']}, {intervals['blocks']} blocks of "
        f"{intervals['block_seconds']:.3g} s"
    )
    criterion, choice = document["criterion"], document["window_choice"]
    if choice is not None:
        low, high = 0.5 / criterion["beta"], 0.5 / criterion["alpha"]
        yield (
            f"windows of {criterion['alpha']:.3g} to {criterion['beta']:.3g} s: half periods of "
            f"{high:.3g} to {low:.3g} Hz. {choice['reason']}"
        )
    yield from noise_in_words(document["noise"])


def mode_entries(modes: "Sequence[ModeEvidence]") -> list[Document]:
    """The part of the document about hidden modes, the last one of each stage."""
    return [
        {
            "on": mode.on,
            "equation": mode.stage,
            "parameters": list(mode.parameters),
            "frequency_hz": finite(mode.frequency[0]),
            "frequency_std_error_hz": finite(mode.frequency[1]),
            "damping_ratio": finite(mode.damping_ratio[0]),
            "damping_ratio_std_error": finite(mode.damping_ratio[1]),
            "window_s": list(mode.lengths),
            "strays": [
                {"parameters": list(names), "asked_hz": asked, "found_hz": finite(found)}
                for names, asked, found in mode.strays
            ],
            **told(mode, "carried", "oscillates", "explained"),
            "held_out": {
                "with": finite(mode.unexplained),
                **told(mode, "without", "gain"),
                "gain_std_error": finite(mode.gain_error),
            },
            "map": {
                "frequency_hz": finite(mode.map.frequency),
                **told(mode.map, "unexplained", "without"),
                "damping_ratio": finite(mode.map.damping),
            },
        }
        for mode in modes
    ]


def modes_in_words(modes: Sequence[Document]) -> Iterator[str]:
    """Where each mode is, what it explains, the windows that it was found in, and which modes
    were looked for elsewhere."""
    for mode in modes:
        low, high = mode["window_s"]
        lengths = f"{low:.3g} s" if low == high else f"{low:.3g} to {high:.3g} s"
        held = mode["held_out"]
        left = max(held["with"], 0.0)  # less than nothing, where noise was taken off
        frequency = number(mode["frequency_hz"], 4), number(mode["frequency_std_error_hz"], 2)
        ratio = number(mode["damping_ratio"], 4), number(mode["damping_ratio_std_error"], 2)
        yield (
            f"hidden mode on {mode['on']}: {' +- '.join(frequency)} Hz with the body at rest, "
            f"damping ratio {' +- '.join(ratio)}, in windows of {lengths}, which tell most of it. "
            f"On time that it was not found from {100 * left:.2g} % of {mode['equation']} is left "
            f"with it and {100 * held['without']:.2g} % without."
        )
        for stray in mode["strays"]:
            yield (
                f"no mode near {stray['asked_hz']:.4g} Hz: the search for "
                f"{stray['parameters'][0]} ended at {number(stray['found_hz'], 3)} Hz."
            )


def refinement_entries(refinement: Refinement, identified: dict[str, Any]) -> Document:
    """The part of the document about the refinement.

    Keys of a search are `null` or empty if none was made.
    """
    refined, left, tests = refinement.refined, refinement.whiteness, None
    if left is not None:
        tests = {
            **told(left, "white", "vanishing", "largest", "threshold"),
            "channels": {
                name: {
                    "statistic": finite(statistic),
                    "chi_squared": finite(left.chi_squared[name]),
                    "share": finite(left.shares[name]),
                }
                for name, statistic in left.statistics.items()
            },
        }
    search: Document = dict.fromkeys(("by", "converged", "reason", "steps", "basis"))
    search |= {"left": {}, "intervals": None, "at_bound": []}
    if refined is not None:
        rms = refined.quantities, refined.rms_before, refined.rms, refined.quantity_units
        search = {
            "by": dict(refined.by),
            **told(refined, "converged", "reason", "steps", "basis"),
            "left": {
                name: {"before": finite(before), "after": finite(after), "unit": unit}
                for name, before, after, unit in zip(*rms)
            },
            "intervals": intervals_entry(refined),
            "at_bound": [
                name for name, there in zip(refined.parameters, refined.at_bound) if there
            ],
        }
    return {
        "chosen": refinement.chosen,
        "declined": refinement.declined or None,
        "chi_squared": left and finite(max(left.chi_squared.values(), default=float("nan"))),
        "whiteness": tests,
        "identified": identified,
        "refined": None if refined is None else parameter_entries(refined),
        **search,
        "simulations": [
            {
                "on": run.recording.name,
                "fitted": refinement.on_fitted,
                "before": run.before.describe(),
                "after": run.after.describe(),
            }
            for run in refinement.simulations
        ],
    }


def choice_in_words(entries: Document) -> str:
    """Which values are the answer, and what the others are for."""
    left, declined = entries["whiteness"], entries["declined"]
    if entries["refined"] is None:
        return f"not refined: {declined}."
    if declined is not None and not left["white"]:
        unseen = [run for run in entries["simulations"] if not run["fitted"]]
        fits = (f"{r['on']} {_worst(r['before'])} -> {_worst(r['after'])} %" for r in unseen)
        predicted = f" (worst fit on {', '.join(fits)})" if unseen else ""
        return (
            f"refined by output error, but that is not the answer: {declined}. The identified "
            f"values are the physical parameters; the refined ones are for predicting motions like "
            f"these{predicted}."
        )
    if declined is not None:
        return f"refined by output error, but that is not the answer: {declined}."
    if left is None:
        return "the refined values are the answer, as was asked for."
    size = f"{_number(left['largest'])}, where noise stays below {left['threshold']:.2g}"
    if not left["white"]:
        return (
            f"the refined values are the answer, as was asked for. What they leave is not white "
            f"noise ({size}), as of coloured noise, of noise on a recorded input, or of a model "
            f"that leaves out part of the motion: there the identified values are the physical "
            f"parameters, and these are for predicting motions like this one."
        )
    if left["vanishing"]:
        most = max(channel["share"] for channel in left["channels"].values())
        return (
            f"the refined values are the answer: the model follows the motion to {_number(most)} "
            f"of its size, so that there is no noise to tell from its errors."
        )
    return (
        f"the refined values are the answer: they are as precise as the sensors allow, since what "
        f"they leave is white noise ({size}). That does not prove the model right."
    )


def _worst(described: Document) -> str:
    fits = [s["fit_percent"] for s in described["signals"].values() if s["judged"]]
    known = [fit for fit in fits if fit is not None]
    return f"{min(known):.4g}" if known else "?"


def search_in_words(entries: Document) -> Iterator[str]:
    """How the search went, whether or not its values are the answer."""
    kind = {"integral": "impulses of the equation error", "output-error": "the output error"}
    yield (
        f"refined by {kind[entries['by']['refine']]}: {entries['reason']} "
        f"({entries['steps']} steps)"
    )
    yield f"left before and after, of {entries['basis']}:"
    whiteness = entries["whiteness"]
    channels = {} if whiteness is None or whiteness["vanishing"] else whiteness["channels"]
    for name, left in entries["left"].items():
        # Beside what the sensor's noise would leave.
        power = channels.get(name, {}).get("chi_squared")
        noise = "" if power is None else f", {number(power**0.5, 3)} times the sensor's noise"
        yield (
            f"{name}: {_number(left['before'])} before, {_number(left['after'])} {left['unit']} "
            f"r.m.s. after{noise}"
        )
    for run in entries["simulations"]:
        where = f"{run['on']} (fitted)" if run["fitted"] else run["on"]
        fits = ", ".join(
            f"{name} {_fit(run['before'], name)} -> {_fit(run['after'], name)} %"
            for name in run["after"]["signals"]
        )
        yield f"simulated on {where}, fit before -> after: {fits} (from the state as recorded)"
    intervals = entries["intervals"]
    yield (
        f"refined intervals: {intervals['method']}, {intervals['blocks']} blocks of "
        f"{intervals['block_seconds']:.3g} s; of what was identified:"
    )


def _fit(described: Document, name: str) -> str:
    fit = described["signals"].get(name, {}).get("fit_percent")
    return "?" if fit is None else f"{fit:.4g}"


def _number(value: float | None) -> str:
    return "?" if value is None else number(value, 4)
