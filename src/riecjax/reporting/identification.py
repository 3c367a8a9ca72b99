"""Results of an identification: JSON document and tables on a terminal."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from jaxtyping import Array, Key
from rich.console import Console

from riecjax.equations.procedure import Procedure
from riecjax.estimation.check import Check
from riecjax.estimation.estimate import Estimate
from riecjax.findings import Finding
from riecjax.records.record import Record
from riecjax.reporting.checking import excitation_entries, start_times
from riecjax.reporting.document import Document, finite, number, versions
from riecjax.reporting.estimate import estimate_entries, parameter_entries, print_estimate
from riecjax.reporting.refinement import (
    Refinement,
    refinement_entries,
    refinement_in_words,
)
from riecjax.studies.choice import WindowChoice
from riecjax.studies.monte_carlo import SeedScatter
from riecjax.studies.sweep import WindowSweep
from riecjax.validation.held_out import HeldOut
from riecjax.validation.residuals import ResidualTests


class ValidationRun(NamedTuple):
    """A simulation of the identified model: on what, the measured record, and the result."""

    on: str
    measured: Record
    held: HeldOut


@dataclass(frozen=True)
class Identification:
    """Everything that one `riecjax identify` found.

    **Fields:** `model`'s name; its `procedure`; `files` and the prepared `records`; `steps` of
    reading and preparation in words; `doubts` about the files; `estimate`; what was `checked`
    before it; window `sweep`, if any; `residuals`, tests of what is left, if they can be made;
    `choice` of windows, for a criterion that has some; scatter over `seeds` of random ones;
    `validations`, of the refined model if there is a `refinement`; `key` and `seed` of the windows.
    """

    model: str
    procedure: Procedure
    files: Sequence[str]
    records: Sequence[Record]
    steps: Sequence[str]
    doubts: Sequence[Finding]
    estimate: Estimate
    checked: Check
    sweep: WindowSweep | None
    residuals: ResidualTests | None
    choice: WindowChoice | None
    seeds: SeedScatter | None
    validations: Sequence[ValidationRun]
    refinement: Refinement | None
    key: Key[Array, ""]
    seed: int

    def findings(self) -> list[Finding]:
        """What a user should know, each thing once."""
        before = [*self.doubts, *self.checked.findings]
        codes = {finding.code for finding in before}
        after = [
            f for f in self.estimate.findings() if f.code != "short_record" or f.code not in codes
        ]
        swept = [] if self.sweep is None else self.sweep.findings()
        validated = [
            Finding("does_not_predict", f"{run.on}: {run.held.verdict}")
            for run in self.validations
            if not run.held.predicts
        ]
        left = [] if self.residuals is None else self.residuals.findings()
        refined = [] if self.refinement is None else self.refinement.findings()
        return [*before, *after, *swept, *left, *refined, *validated]


def identification_document(result: Identification) -> Document:
    """The document that `--json` prints and results.json holds."""
    estimate = result.estimate
    found = estimate_entries(result.model, estimate)
    identified = found["parameters"]
    if result.refinement is not None:
        found["parameters"] = parameter_entries(result.refinement.refined)
    return {
        **found,
        "excitation": excitation_entries(result.checked),
        "correlation": _correlation(estimate),
        "residual_tests": None if result.residuals is None else result.residuals.describe(),
        "window_choice": None if result.choice is None else result.choice.describe(),
        "seed_scatter": None if result.seeds is None else _seed_entries(result.seeds),
        "window_sweep": None if result.sweep is None else _sweep_entries(result.sweep),
        "refinement": None
        if result.refinement is None
        else refinement_entries(result.refinement, identified),
        "validation": [{"on": run.on, **run.held.describe()} for run in result.validations],
        "warnings": [finding._asdict() for finding in result.findings()],
        "provenance": {
            "seed": result.seed,
            "records": [
                {
                    "file": file,
                    "samples": record.sample_count,
                    "time_step": float(record.time_step),
                }
                for file, record in zip(result.files, result.records)
            ],
            "start_times": start_times(result.records),
            "preparation": list(result.steps),
            "intervals": {
                "method": estimate.uncertainty.label,
                "blocks": int(estimate.block_count),
                "block_seconds": float(estimate.block_length),
            },
            "versions": versions(),
        },
    }


def _correlation(estimate: Estimate) -> dict[str, Any]:
    return {
        "parameters": list(estimate.parameters),
        "matrix": [[finite(float(value)) for value in row] for row in estimate.correlation],
    }


def _seed_entries(scatter: SeedScatter) -> dict[str, Any]:
    return {
        "means": "scatter of the sampling of windows, not the parameters' uncertainty",
        "seeds": int(scatter.theta.shape[0]),
        "spread": {
            name: finite(float(value)) for name, value in zip(scatter.parameters, scatter.spread)
        },
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
    """Tables for a reader."""
    print_estimate(document, console)
    print_judgement(document, console)


def print_judgement(document: Document, console: Console) -> None:
    """What was done with the estimate, and what it rests on."""
    if document["refinement"] is not None:
        for line in refinement_in_words(document["refinement"]):
            console.print(line, highlight=False, markup=False)
    for line in windows_in_words(document):
        console.print(line, highlight=False, markup=False)
    for validation in document["validation"]:
        line = f"validated on {validation['on']}: {validation['verdict']}"
        console.print(line, highlight=False, markup=False)
    for step in document["provenance"]["preparation"]:
        console.print(f"prepared: {step}", highlight=False, markup=False)


def windows_in_words(document: Document) -> Iterator[str]:
    """Where intervals come from, what the windows see, and which lengths would serve best."""
    intervals = document["provenance"]["intervals"]
    yield (
        f"intervals: {intervals['method']}, {intervals['blocks']} blocks of "
        f"{intervals['block_seconds']:.3g} s"
    )
    if document["seed_scatter"] is not None:
        spread = document["seed_scatter"]["spread"]
        moved = ", ".join(f"{name} by {number(value, 2)}" for name, value in spread.items())
        yield (
            f"another seed would draw other windows and move {moved} (of the sampling, not of "
            f"the parameters)"
        )
    criterion, choice = document["criterion"], document["window_choice"]
    if choice is not None:
        low, high = 0.5 / criterion["beta"], 0.5 / criterion["alpha"]
        yield (
            f"windows of {criterion['alpha']:.3g} to {criterion['beta']:.3g} s: half periods of "
            f"{high:.3g} to {low:.3g} Hz. {choice['reason']}"
        )
