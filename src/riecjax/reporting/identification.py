"""Results of an identification: JSON document and tables on a terminal."""

from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key
from rich.console import Console

from riecjax.assessment.assessment import Assessment, Refinement
from riecjax.estimation.estimate import Estimate
from riecjax.records.recording import common_steps
from riecjax.reporting.checking import excitation_entries, start_times
from riecjax.reporting.document import Document, finite, number, versions
from riecjax.reporting.estimate import estimate_entries, parameter_entries, print_estimate
from riecjax.studies.monte_carlo import SeedScatter
from riecjax.studies.sweep import WindowSweep


def identification_document(result: Assessment) -> Document:
    """The document that `--json` prints and results.json holds."""
    estimate = result.estimate
    found = estimate_entries(result.model.name, estimate)
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
        "validation": [
            {"on": run.recording.name, **run.held.describe()} for run in result.validations
        ],
        "warnings": [finding._asdict() for finding in result.findings()],
        "provenance": {
            "seed": _seed(result.key),
            "records": [
                {
                    "file": recording.source,
                    "samples": recording.record.sample_count,
                    "time_step": float(recording.record.time_step),
                }
                for recording in result.recordings
            ],
            "start_times": start_times(result.recordings),
            "preparation": common_steps(result.recordings),
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


def refinement_entries(refinement: Refinement, identified: dict[str, Any]) -> Document:
    """The part of the document about the refinement."""
    refined = refinement.refined
    return {
        "by": dict(refined.by),
        "converged": bool(refined.converged),
        "reason": refined.reason,
        "steps": int(refined.steps),
        "identified": identified,
        "basis": refined.basis,
        "left": {
            name: {"before": finite(float(before)), "after": finite(float(after)), "unit": unit}
            for name, before, after, unit in zip(
                refined.quantities, refined.rms_before, refined.rms, refined.quantity_units
            )
        },
        "intervals": {
            "method": refined.uncertainty.label,
            "blocks": int(refined.block_count),
            "block_seconds": float(refined.block_length),
        },
        "at_bound": [n for n, there in zip(refined.parameters, refined.at_bound) if bool(there)],
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


def refinement_in_words(entries: Document) -> Iterator[str]:
    """What was refined, what it left, and what became of predictions."""
    kind = {"integral": "impulses of the equation error", "output-error": "the output error"}
    yield (
        f"refined by {kind[entries['by']['refine']]}: {entries['reason']} "
        f"({entries['steps']} steps)"
    )
    yield f"left before and after, of {entries['basis']}:"
    for name, left in entries["left"].items():
        yield (
            f"{name}: {_number(left['before'])} before, {_number(left['after'])} {left['unit']} "
            f"r.m.s. after"
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
    signal = described["signals"].get(name)
    return (
        "?" if signal is None or signal["fit_percent"] is None else f"{signal['fit_percent']:.4g}"
    )


def _number(value: float | None) -> str:
    return "?" if value is None else number(value, 4)


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
