"""Results of an identification: JSON document and tables on a terminal."""

from collections.abc import Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key
from rich.console import Console

from riecjax.assessment.assessment import Assessment
from riecjax.errors import printable
from riecjax.estimation.estimate import Estimate
from riecjax.records.recording import common_steps
from riecjax.reporting.checking import excitation_entries, start_times
from riecjax.reporting.document import Document, finite, versions
from riecjax.reporting.equations import procedure_in_words
from riecjax.reporting.estimate import (
    estimate_entries,
    parameter_entries,
    print_estimate,
)
from riecjax.reporting.hidden_modes import mode_entries, modes_in_words
from riecjax.reporting.noise import noise_entries, noise_in_words
from riecjax.reporting.refinement import (
    choice_in_words,
    refinement_entries,
    refinement_in_words,
)
from riecjax.reporting.verdict import as_typed, print_verdict, verdict_entries
from riecjax.studies.sweep import WindowSweep


def identification_document(result: Assessment, command: Sequence[str] = ()) -> Document:
    """The document that `--json` prints and results.json holds.

    **Arguments:** `command`: the arguments of `riecjax` that made it, if any did.
    """
    estimate, refinement = result.estimate, result.refinement
    found = estimate_entries(result.model.name, estimate)
    identified = found["parameters"]
    if refinement is not None and refinement.chosen:
        found["parameters"] = parameter_entries(result.answer)
    return {
        **found,
        "equations": procedure_in_words(result.procedure),
        "verdict": verdict_entries(result.verdict, command),
        "modes": mode_entries(result.modes),
        "excitation": excitation_entries(result.checked),
        "noise": noise_entries(result.recordings, result.checked.signals),
        "correlation": _correlation(estimate),
        "residual_tests": None if result.residuals is None else result.residuals.describe(),
        "window_choice": None if result.choice is None else result.choice.describe(),
        "window_sweep": None if result.sweep is None else _sweep_entries(result.sweep),
        "refinement": None if refinement is None else refinement_entries(refinement, identified),
        "validation": [
            {"on": run.recording.name, **run.held.describe()} for run in result.validations
        ],
        "warnings": [finding._asdict() for finding in result.findings()],
        "provenance": {
            "command": as_typed(command) if command else None,
            "seed": _seed(result.key),
            "records": [
                {
                    "file": printable(recording.source),
                    "part": recording.part or None,
                    "samples": recording.record.sample_count,
                    "time_step": float(recording.record.time_step),
                }
                for recording in result.recordings
            ],
            "start_times": start_times(result.recordings),
            "preparation": common_steps(result.recordings),
            "converted": {k: u for r in result.recordings for k, u in r.converted.items()},
            "intervals": {
                "method": estimate.uncertainty.label,
                "blocks": int(estimate.block_count),
                "block_seconds": float(estimate.block_length),
            },
            "versions": versions(),
        },
    }


def _seed(key: Key[Array, ""] | None) -> int | None:
    """The seed that `jax.random.key` makes this key of: its words, the highest first."""
    if key is None:
        return None
    words = jax.random.key_data(key) if jnp.issubdtype(key.dtype, jax.dtypes.prng_key) else key
    return int.from_bytes(np.asarray(words).astype(">u4").tobytes(), "big")


def _correlation(estimate: Estimate) -> dict[str, Any]:
    return {
        "parameters": list(estimate.parameters),
        "matrix": [[finite(float(value)) for value in row] for row in estimate.correlation],
    }


def _sweep_entries(sweep: WindowSweep) -> dict[str, Any]:
    return {
        "alpha": [float(value) for value in sweep.alpha],
        "beta": [float(value) for value in sweep.beta],
        "parameters": {
            name: {
                "value": [finite(float(value)) for value in sweep.theta[:, j]],
                "std_error": [finite(float(value)) for value in sweep.standard_errors[:, j]],
            }
            for j, name in enumerate(sweep.parameters)
        },
        "relative_rms": {
            label: [finite(float(value)) for value in sweep.relative_rms[:, i]]
            for i, label in enumerate(sweep.stage_names)
        },
    }


def print_identification(document: Document, console: Console) -> None:
    """The verdict, and in a line what the values are."""
    print_verdict(document, console)
    console.print()
    if converted := document["provenance"]["converted"]:
        said = ", ".join(f"{name} from {unit}" for name, unit in converted.items())
        console.print(f"Converted to SI: {said}.", highlight=False, markup=False)
    for line in (_answer_in_words(document), *modes_in_words(document["modes"])):
        console.print(line, highlight=False, markup=False)
    for validation in document["validation"]:
        line = f"validated on {validation['on']}: {validation['verdict']}"
        console.print(line, highlight=False, markup=False)


def _answer_in_words(document: Document) -> str:
    """Where the values come from, and how much there is to say beside them."""
    refinement, criterion = document["refinement"], document["criterion"]
    how = criterion["name"].upper()
    if "alpha" in criterion:
        how += f" in windows of {criterion['alpha']:.3g} to {criterion['beta']:.3g} s"
    if refinement is not None and refinement["chosen"]:
        left = refinement["whiteness"]
        white = left is not None and left["white"]
        how = f"refined by simulation{', which leaves white noise' if white else ''}"
    said = len(document["warnings"])
    more = f" {said} finding{'s' if said != 1 else ''} and" if said else ""
    return f"Values: {how}. Add --verbose for{more} how they were found."


def print_everything(document: Document, console: Console) -> None:
    """The verdict, and all there is to say of how it came about."""
    print_verdict(document, console)
    console.print()
    for equation in document["equations"]:
        console.print(equation, highlight=False, markup=False)
    print_estimate(document, console)
    refinement = document["refinement"]
    for line in modes_in_words(document["modes"]):
        console.print(line, highlight=False, markup=False)
    if refinement is not None:
        for line in (choice_in_words(refinement), *refinement_in_words(refinement)):
            console.print(line, highlight=False, markup=False)
    for line in windows_in_words(document):
        console.print(line, highlight=False, markup=False)
    for validation in document["validation"]:
        line = f"validated on {validation['on']}: {validation['verdict']}"
        console.print(line, highlight=False, markup=False)
    for step in document["provenance"]["preparation"]:
        console.print(f"prepared: {step}", highlight=False, markup=False)


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
    if document["noise"]:
        yield noise_in_words(document["noise"])
