"""Results of an identification: JSON document, tables on a terminal, figures."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key
from rich.console import Console
from rich.table import Table
from rich.text import Text

from riecjax.criteria.criterion import RIEC, AbstractCriterion, Rows
from riecjax.estimation.estimate import Estimate
from riecjax.estimation.identify import record_keys
from riecjax.estimation.procedure import Procedure
from riecjax.records.record import Record
from riecjax.reporting.output import Document, require_plots, versions

MOST_POINTS = 3000


def identification_document(
    estimate: Estimate,
    model: str,
    *,
    files: Sequence[Path],
    records: Sequence[Record],
    seed: int,
    steps: list[str],
) -> Document:
    """The document that `--json` prints and results.json holds."""
    units = dict(estimate.units)
    parameters = {}
    for name in estimate.parameters:
        low, high = estimate.interval(name)
        parameters[name] = {
            "value": float(estimate[name]),
            "unit": units.get(name, ""),
            "std_error": _finite(float(estimate.standard_error(name))),
            "interval95": [_finite(low), _finite(high)],
        }
    stages = [
        {
            "equation": name,
            "parameters": list(stage.parameters),
            "relative_rms": float(stage.relative_rms),
            "rms": float(stage.residual_rms),
            "rows": int(stage.count),
            "condition_number": _finite(float(stage.solution.condition_number)),
            "rank": int(stage.solution.rank),
        }
        for name, stage in zip(estimate.stage_names, estimate.stages)
    ]
    return {
        "schema": 1,
        "model": model,
        "criterion": estimate.criterion.describe(),
        "parameters": parameters,
        "known": {
            name: {"value": float(value), "unit": units.get(name, "")}
            for name, value in estimate.known.items()
        },
        "condition_number": _finite(float(estimate.condition_number)),
        "rank": int(estimate.rank),
        "residual": {"relative_rms": stages[-1]["relative_rms"], "stages": stages},
        "warnings": [finding._asdict() for finding in estimate.findings()],
        "provenance": {
            "seed": seed,
            "records": [
                {
                    "file": str(file),
                    "samples": record.sample_count,
                    "time_step": float(record.time_step),
                }
                for file, record in zip(files, records)
            ],
            "preparation": steps,
            "intervals": f"block sandwich over {int(estimate.block_count)} blocks of time",
            "versions": versions(),
        },
    }


def print_identification(document: Document, console: Console) -> None:
    """Tables for a reader."""
    criterion = document["criterion"]
    settings = ", ".join(f"{k} {v}" for k, v in criterion.items() if k != "name")
    heading = f"{document['model']}  {criterion['name'].upper()}  {settings}"
    console.print(heading, highlight=False, markup=False)
    table = Table(box=None, padding=(0, 2, 0, 0))
    for column in ("parameter", "value", "std error", "95 % interval", "unit"):
        table.add_column(column, justify="left" if column in ("parameter", "unit") else "right")
    for name, entry in document["parameters"].items():
        low, high = entry["interval95"]
        table.add_row(
            Text(name),
            _number(entry["value"]),
            _number(entry["std_error"], 2),
            f"{_number(low)} .. {_number(high)}",
            Text(entry["unit"]),
        )
    for name, entry in document["known"].items():
        table.add_row(Text(name), _number(entry["value"]), "", "known", Text(entry["unit"]))
    console.print(table)
    for stage in document["residual"]["stages"]:
        console.print(
            f"{stage['equation']}: relative residual {100 * stage['relative_rms']:.3g} %, "
            f"condition number {_number(stage['condition_number'], 3)}, {stage['rows']} rows",
            highlight=False,
            markup=False,
        )
    for step in document["provenance"]["preparation"]:
        console.print(f"prepared: {step}", highlight=False, markup=False)


def identification_figures(
    estimate: Estimate, procedure: Procedure, records: Sequence[Record], key: Key[Array, ""]
) -> dict[str, Any]:
    """`fit`: each stage's rows, measured against explained, and what is left of them."""
    plt = require_plots()
    stages = [procedure.stages[stage.stage] for stage in estimate.stages]
    figure, axes = plt.subplots(
        2, len(stages), figsize=(3.6 * len(stages) + 0.8, 6.4), squeeze=False, layout="constrained"
    )
    for column, (equations, name) in enumerate(zip(stages, estimate.stage_names)):
        unit = _row_unit(equations[0].unit, estimate.criterion)
        rows = Rows.concatenate(
            [
                _explained(estimate, estimate.criterion.rows(equation, record, record_key))
                for record, record_key in zip(records, record_keys(key, len(records)))
                for equation in equations
            ]
        )
        measured, explained = np.asarray(rows.target), np.asarray(rows.columns[1])
        chosen = np.linspace(0, measured.size - 1, min(measured.size, MOST_POINTS)).astype(int)
        _draw_fit(axes[0, column], explained[chosen], measured[chosen], name, unit)
        _draw_residual(
            axes[1, column],
            np.asarray(rows.position)[chosen] * float(records[0].time_step),
            (measured - explained)[chosen],
            unit,
        )
    return {"fit": figure}


def _explained(estimate: Estimate, rows: Rows) -> Rows:
    """Two columns: what the known terms and parameters give, and what the estimated explain."""
    left = rows.fix(estimate.known)
    # Where no term is known beforehand, an earlier stage found the coefficient that sets the scale.
    if left.parameters and bool(jnp.all(left.target == 0)):
        left = left.fix({left.parameters[0]: estimate[left.parameters[0]]})
    explained = sum(
        (estimate[name] * column for name, column in zip(left.parameters, left.columns[1:])),
        start=jnp.zeros_like(left.target),
    )
    return Rows(jnp.stack([left.target, explained]), rows.position, ("explained",))


def _draw_fit(axes: Any, explained: np.ndarray, measured: np.ndarray, name: str, unit: str) -> None:
    reach = 1.05 * max(np.abs(measured).max(), np.abs(explained).max(), 1e-300)
    axes.plot([-reach, reach], [-reach, reach], color="0.6", linewidth=0.8)
    axes.plot(explained, measured, ".", color="#1f4e79", markersize=2, alpha=0.5)
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), title=name)
    axes.set_xlabel(f"explained by the model{unit}")
    axes.set_ylabel(f"measured{unit}")


def _draw_residual(axes: Any, time: np.ndarray, residual: np.ndarray, unit: str) -> None:
    axes.axhline(0, color="0.6", linewidth=0.8)
    axes.plot(time, residual, ".", color="#9c3d1c", markersize=2, alpha=0.5)
    axes.set_xlabel("time / s")
    axes.set_ylabel(f"residual{unit}")


def _row_unit(unit: str, criterion: AbstractCriterion) -> str:
    """Axis label's unit: an integral criterion's rows are the equation's unit times seconds."""
    if not unit:
        return ""
    return f" / ({unit} s)" if isinstance(criterion, RIEC) else f" / ({unit})"


def _number(value: float | None, digits: int = 6) -> str:
    return "none" if value is None else f"{value:.{digits}g}"


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
