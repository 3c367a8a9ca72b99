"""Results of an identification: JSON document and tables on a terminal."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from jaxtyping import Array, Key
from rich.console import Console
from rich.table import Table
from rich.text import Text

from riecjax.estimation.check import Check
from riecjax.estimation.estimate import Estimate
from riecjax.estimation.procedure import Procedure
from riecjax.findings import Finding
from riecjax.records.record import Record
from riecjax.reporting.checking import excitation_entries
from riecjax.reporting.output import Document, finite, number, versions
from riecjax.reporting.parameters import parameter_entries
from riecjax.reporting.refinement import (
    Refinement,
    refinement_entries,
    refinement_in_words,
)
from riecjax.studies.seed_scatter import SeedScatter
from riecjax.studies.window_choice import WindowChoice
from riecjax.studies.window_sweep import WindowSweep
from riecjax.validation.held_out import HeldOut
from riecjax.validation.residual_tests import ResidualTests


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
    stages = [
        {
            "equation": name,
            "parameters": list(stage.parameters),
            "relative_rms": float(stage.relative_rms),
            "rms": float(stage.residual_rms),
            "rows": int(stage.count),
            "condition_number": finite(float(stage.solution.condition_number)),
            "rank": int(stage.solution.rank),
        }
        for name, stage in zip(estimate.stage_names, estimate.stages)
    ]
    units = dict(estimate.units)
    identified = _identified(estimate)
    return {
        "schema": 1,
        "model": result.model,
        "criterion": estimate.criterion.describe(),
        "parameters": identified
        if result.refinement is None
        else parameter_entries(result.refinement.refined),
        "known": {
            name: {"value": float(value), "unit": units.get(name, "")}
            for name, value in estimate.known.items()
        },
        "condition_number": finite(float(estimate.condition_number)),
        "rank": int(estimate.rank),
        "residual": {"relative_rms": stages[-1]["relative_rms"], "stages": stages},
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
            "preparation": list(result.steps),
            "intervals": {
                "method": estimate.uncertainty.label,
                "blocks": int(estimate.block_count),
                "block_seconds": float(estimate.block_length),
            },
            "versions": versions(),
        },
    }


def _identified(estimate: Estimate) -> dict[str, Any]:
    """Of each parameter, what only the linear estimate says of its windows too."""
    entries = parameter_entries(estimate)
    for i, name in enumerate(estimate.parameters):
        entries[name] |= {
            "naive_std_error": finite(float(estimate.naive[i])),
            "effective_windows": finite(float(estimate.effective_windows[i])),
        }
    return entries


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
    criterion = document["criterion"]
    settings = ", ".join(f"{k} {v}" for k, v in criterion.items() if k != "name")
    heading = f"{document['model']}  {criterion['name'].upper()}  {settings}"
    console.print(heading, highlight=False, markup=False)
    console.print(_parameter_table(document))
    for stage in document["residual"]["stages"]:
        console.print(
            f"{stage['equation']}: relative residual {100 * stage['relative_rms']:.3g} %, "
            f"condition number {number(stage['condition_number'], 3)}, {stage['rows']} rows",
            highlight=False,
            markup=False,
        )
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


def _parameter_table(document: Document) -> Table:
    identified = (document["refinement"] or {}).get("identified", {})
    before = ["identified"] if identified else []
    table = Table(box=None, padding=(0, 2, 0, 0))
    for column in ("parameter", *before, "value", "std error", "95 % interval", "unit"):
        table.add_column(column, justify="left" if column in ("parameter", "unit") else "right")
    for name, entry in document["parameters"].items():
        start = [number(identified[name]["value"]) for _ in before]
        table.add_row(
            Text(name),
            *start,
            number(entry["value"]),
            number(entry["std_error"], 2),
            " .. ".join(number(end) for end in entry["interval95"]),
            Text(entry["unit"]),
        )
    for name, entry in document["known"].items():
        value = number(entry["value"])
        table.add_row(Text(name), *("" for _ in before), value, "", "known", Text(entry["unit"]))
    return table
