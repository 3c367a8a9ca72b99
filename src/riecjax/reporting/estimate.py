"""An estimate in plain data, and as tables on a terminal."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Array
from rich.console import Console

from riecjax.estimation.estimate import AbstractEstimate, Estimate
from riecjax.refinement.refine import Refined
from riecjax.reporting.document import SCHEMA, Document, ends_of, finite, number
from riecjax.reporting.tables import Table, in_rich, print_table, say


def estimate_entries(model: str, estimate: Estimate) -> Document:
    """What is known as soon as a model is identified: the first part of the document.

    Numbers of a batch are nested lists of its shape.
    """
    stages = [
        {
            "equation": name,
            "parameters": list(stage.parameters),
            "relative_rms": finite(stage.relative_rms),
            "rms": finite(stage.residual_rms),
            "rows": _whole(stage.count),
            "condition_number": finite(stage.solution.condition_number),
            "rank": _whole(stage.solution.rank),
            "equations": list(names),
        }
        for name, names, stage in zip(
            estimate.stage_names, estimate.equation_names, estimate.stages
        )
    ]
    parameters = parameter_entries(estimate)
    # Of each parameter, what only the linear estimate says of its windows too.
    for i, name in enumerate(estimate.parameters):
        parameters[name] |= {
            "naive_std_error": finite(estimate.naive[..., i]),
            "effective_windows": finite(estimate.effective_windows[..., i]),
        }
    return {
        "schema": SCHEMA,
        "model": model,
        "criterion": estimate.criterion.describe(),
        "parameters": parameters,
        "known": known_entries(estimate),
        "condition_number": finite(estimate.condition_number),
        "rank": _whole(estimate.rank),
        "residual": {
            "relative_rms": stages[-1]["relative_rms"],
            "stages": stages,
            "equations": {
                name: {
                    "relative_rms": finite(fit.relative_rms),
                    "rms": finite(fit.residual_rms),
                    "rows": _whole(fit.count),
                }
                for name, fit in estimate.equations.items()
            },
        },
    }


def _whole(number: Array) -> Any:
    return np.asarray(number).astype(int).tolist()


def print_estimate(document: Document, console: Console) -> None:
    """Parameters, refined ones where there are, and what each equation leaves."""
    criterion = document["criterion"]
    settings = ", ".join(f"{k} {v}" for k, v in criterion.items() if k != "name")
    heading = f"{document['model']}  {criterion['name'].upper()}  {settings}"
    say(console, heading)
    print_table(in_rich(parameter_table(document)), console)
    # What each stage leaves, and each equation of a stage of several.
    for stage in document["residual"]["stages"]:
        say(
            console,
            f"{stage['equation']}: relative residual {100 * stage['relative_rms']:.3g} %, "
            f"condition number {number(stage['condition_number'], 3)}, {stage['rows']} rows",
        )
        for name in several(stage):
            left = document["residual"]["equations"][name]
            share = f"{100 * left['relative_rms']:.3g} %"
            say(console, f"{name}: relative residual {share}, {left['rows']} rows")


def several(stage: Document) -> list[str]:
    """Names of the equations of a stage that has more than one."""
    return stage["equations"] if len(stage["equations"]) > 1 else []


def parameter_table(document: Mapping[str, Any], interval: str = "{} .. {}") -> Table:
    """Value, standard error and interval of each parameter of a document.

    If a refinement was made, identified and refined values stand side by side; standard errors and
    intervals are of the answer.
    """
    refinement = document.get("refinement") or {}
    refined, chosen = refinement.get("refined"), refinement.get("chosen")
    beside = refinement["identified"] if chosen else refined
    header = ["parameter", "value", "std error", "95 % interval", "unit"]
    rows = [
        [
            name,
            number(entry["value"]),
            number(entry["std_error"], 2),
            interval.format(*ends_of(entry["interval95"])),
            entry["unit"],
        ]
        for name, entry in document["parameters"].items()
    ]
    rows += [
        [name, number(entry["value"]), "", "known", entry["unit"]]
        for name, entry in document["known"].items()
    ]
    if beside is not None:
        place = 1 if chosen else len(header) - 1
        header.insert(place, "identified" if chosen else "refined")
        for row in rows:
            row.insert(place, number(beside[row[0]]["value"]) if row[0] in beside else "")
    return Table(header, rows)


def known_entries(estimate: AbstractEstimate) -> dict[str, Any]:
    """Value and unit of each parameter that was not estimated; lists of a batch."""
    units = dict(estimate.units)
    return {n: {"value": finite(estimate[n]), "unit": units[n]} for n in estimate.known}


def intervals_entry(estimate: Estimate | Refined) -> Document:
    """Where the intervals of one estimate come from."""
    return {
        "method": estimate.uncertainty.label,
        "blocks": int(estimate.block_count),
        "block_seconds": float(estimate.block_length),
    }


def parameter_entries(estimate: AbstractEstimate) -> dict[str, Any]:
    """Value, unit, standard error and interval of each estimated parameter; lists of a batch."""
    entries = {}
    for name, (low, high) in estimate.interval_by_name().items():
        entries[name] = {
            "value": finite(estimate[name]),
            "unit": estimate.table[name].unit,
            "std_error": finite(estimate.standard_error(name)),
            "interval95": [finite(low), finite(high)],
        }
    return entries
