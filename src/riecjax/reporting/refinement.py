"""What became of a refinement, in plain data and in words."""

from collections.abc import Iterator
from typing import Any

from riecjax.assessment.assessment import Refinement
from riecjax.refinement.refine import Refined
from riecjax.reporting.document import Document, finite, number
from riecjax.reporting.estimate import parameter_entries


def refinement_entries(refinement: Refinement, identified: dict[str, Any]) -> Document:
    """The part of the document about the refinement.

    Keys of a search are `null` or empty if none was made.
    """
    refined, left = refinement.refined, refinement.whiteness
    return {
        "chosen": refinement.chosen,
        "declined": refinement.declined or None,
        "chi_squared": None
        if left is None
        else finite(max(left.chi_squared.values(), default=float("nan"))),
        "whiteness": None
        if left is None
        else {
            "white": left.white,
            "vanishing": left.vanishing,
            "largest": finite(left.largest),
            "threshold": left.threshold,
            "channels": {
                name: {
                    "statistic": finite(left.statistics[name]),
                    "chi_squared": finite(left.chi_squared[name]),
                    "share": finite(left.shares[name]),
                }
                for name in left.statistics
            },
        },
        "identified": identified,
        "refined": None if refined is None else parameter_entries(refined),
        **_search(refined),
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


def _search(refined: Refined | None) -> Document:
    if refined is None:
        nothing = dict.fromkeys(("by", "converged", "reason", "steps", "basis"))
        return {**nothing, "left": {}, "intervals": None, "at_bound": []}
    return {
        "by": dict(refined.by),
        "converged": bool(refined.converged),
        "reason": refined.reason,
        "steps": int(refined.steps),
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
    }


def choice_in_words(entries: Document) -> str:
    """Which values are the answer, and what the others are for."""
    left, declined = entries["whiteness"], entries["declined"]
    if entries["refined"] is None:
        return f"not refined: {declined}."
    if declined is not None and not left["white"]:
        return (
            f"refined by output error, but that is not the answer: {declined}. The identified "
            f"values are the physical parameters; the refined ones are for predicting motions like "
            f"these{_predicted(entries)}."
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


def _predicted(entries: Document) -> str:
    said = [
        f"{run['on']} {_worst(run['before'])} -> {_worst(run['after'])} %"
        for run in entries["simulations"]
        if not run["fitted"]
    ]
    return f" (worst fit on {', '.join(said)})" if said else ""


def _worst(described: Document) -> str:
    fits = [s["fit_percent"] for s in described["signals"].values() if s["judged"]]
    known = [fit for fit in fits if fit is not None]
    return f"{min(known):.4g}" if known else "?"


def refinement_in_words(entries: Document) -> Iterator[str]:
    """What was refined, what it left, and what became of predictions, if it is the answer."""
    if entries["refined"] is not None and entries["chosen"]:
        yield from search_in_words(entries)


def search_in_words(entries: Document) -> Iterator[str]:
    """How the search went, whether or not its values are the answer."""
    kind = {"integral": "impulses of the equation error", "output-error": "the output error"}
    yield (
        f"refined by {kind[entries['by']['refine']]}: {entries['reason']} "
        f"({entries['steps']} steps)"
    )
    yield f"left before and after, of {entries['basis']}:"
    for name, left in entries["left"].items():
        yield (
            f"{name}: {_number(left['before'])} before, {_number(left['after'])} {left['unit']} "
            f"r.m.s. after{_in_noise(entries, name)}"
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


def _in_noise(entries: Document, name: str) -> str:
    """What is left beside what the sensor's noise would leave."""
    left = entries["whiteness"]
    if left is None or left["vanishing"]:
        return ""
    power = left["channels"].get(name, {}).get("chi_squared")
    return "" if power is None else f", {number(power**0.5, 3)} times the sensor's noise"


def _fit(described: Document, name: str) -> str:
    signal = described["signals"].get(name)
    return (
        "?" if signal is None or signal["fit_percent"] is None else f"{signal['fit_percent']:.4g}"
    )


def _number(value: float | None) -> str:
    return "?" if value is None else number(value, 4)
