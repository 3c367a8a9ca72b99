"""Results of a refinement: its part of the JSON document, and its lines on a terminal."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from riecjax.findings import Finding
from riecjax.refinement.refined import Refined
from riecjax.reporting.document import Document, finite, number
from riecjax.validation.held_out import HeldOut


@dataclass(frozen=True)
class BeforeAfter:
    """Simulations of one recording with the start of a refinement and with its result."""

    on: str
    before: HeldOut
    after: HeldOut


@dataclass(frozen=True)
class Refinement:
    """A refinement, and what it did to predictions.

    **Fields:** `refined`; `simulations`, before and after, on held-out parts and further
    recordings, or if there are none on those that were fitted (`on_fitted`).
    """

    refined: Refined
    simulations: Sequence[BeforeAfter]
    on_fitted: bool

    def findings(self) -> list[Finding]:
        """What a user should know."""
        worse = [
            Finding("refined_predicts_worse", f"{run.on}: {_change(run)}")
            for run in self.simulations
            if _worst(run.after) < _worst(run.before) - 1 and not self.on_fitted
        ]
        return [*self.refined.findings(), *worse]


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
                "on": run.on,
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


def _change(run: BeforeAfter) -> str:
    return (
        f"the refined model predicts worse than the identified one (worst fit "
        f"{_worst(run.before):.1f} % before, {_worst(run.after):.1f} % after): it was bent to the "
        f"recording that it was fitted to. Use shorter windows (--horizon), or keep the estimate."
    )


def _worst(held: HeldOut) -> float:
    if not held.ran:
        return -float("inf")
    fits = [float(held.signals[name].fit) for name in held.judged]
    return min((fit for fit in fits if fit == fit), default=-float("inf"))


def _fit(described: Document, name: str) -> str:
    signal = described["signals"].get(name)
    return (
        "?" if signal is None or signal["fit_percent"] is None else f"{signal['fit_percent']:.4g}"
    )


def _number(value: float | None) -> str:
    return "?" if value is None else number(value, 4)
