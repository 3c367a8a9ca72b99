"""Samples that are spikes: what is said of them."""

from collections.abc import Iterable
from typing import Literal, TypeAlias

import numpy as np
from jaxtyping import Float

from riecjax.findings import Finding
from riecjax.records.faults.answered import are_answered
from riecjax.records.faults.sampled_signal import SampledSignal
from riecjax.records.faults.spikes import Spikes, find_spikes

MOST = 0.05
"""Share of the samples past which spikes are a fault of the channel, and are not repaired."""
LISTED = 3
"""Times that are named."""

Treatment: TypeAlias = Literal["repair", "missing", "keep"]
"""What becomes of spikes: a local polynomial's value takes their place, they are marked as missing,
or they stay."""
DONE = {
    "repair": "A polynomial through the samples around took the place of each; if they really "
    "acted, keep them (--outliers keep)",
    "missing": "They were marked as missing",
    "keep": "Least squares follow them: repair them (--outliers repair; in Python "
    "rx.records.repair_outliers(record)), unless they really acted",
}


def too_many(spikes: Spikes, values: Float[np.ndarray, " n"]) -> bool:
    """Whether spikes are more than single samples that went wrong."""
    return spikes.places.size > MOST * np.sum(~np.isnan(values))


def outliers(signal: SampledSignal, others: Iterable[SampledSignal] = ()) -> list[Finding]:
    """The finding of a signal whose spikes were kept, unless others show that they acted."""
    name, values, time, unit = signal.name, signal.values, signal.time, signal.unit
    spikes = find_spikes(values)
    if not spikes.places.size or are_answered(spikes.places, (one.values for one in others)):
        return []
    return [finding_of(name, spikes, values, time, unit)]


def finding_of(
    name: str,
    spikes: Spikes,
    values: Float[np.ndarray, " n"],
    time: Float[np.ndarray, " n"],
    unit: str = "",
    done: Treatment = "keep",
) -> Finding:
    """How many spikes there are, where, how large, and what was done.

    What was kept puts parameters in doubt by the spikes' share of the signal's energy.
    """
    count, present = spikes.places.size, int(np.sum(~np.isnan(values)))
    listed = ", ".join(f"{time[place]:.6g}" for place in spikes.places[:LISTED])
    more = f" s and {count - LISTED} more" if count > LISTED else " s"
    with np.errstate(all="ignore"):
        noises = np.median(spikes.sizes / spikes.noise)
    against = f", {noises:.3g} times the noise there (median)" if np.isfinite(noises) else ""
    kept = too_many(spikes, values) or done == "keep"
    doubt = _share_of_energy(spikes, values) if kept else 0.0
    said = (
        f"So many are a fault of the channel and were left as they are: check the sensor, its "
        f"cable and the logger (more than {MOST:.0%} of the samples)"
        if too_many(spikes, values)
        else DONE[done]
    )
    message = (
        f"{name}: {count} {'sample is a spike' if count == 1 else 'samples are spikes'} "
        f"({100 * count / present:.2g} %), up to {f'{np.max(spikes.sizes):.4g} {unit}'.rstrip()} "
        f"off the samples around{against}, at {listed}{more}. {said}."
    )
    remedy = ("--outliers", "repair") if kept and not too_many(spikes, values) else ()
    return Finding("outliers", message, (name,), doubt=doubt, remedy=remedy)


def _share_of_energy(spikes: Spikes, values: Float[np.ndarray, " n"]) -> float:
    """Of the signal's energy about its mean, with the spikes."""
    with np.errstate(all="ignore"):
        largest = np.max(spikes.sizes)
        own = np.sum((spikes.sizes / largest) ** 2)
        rest = values.copy()
        rest[spikes.places] = spikes.repaired
        rest = np.nansum(((rest - np.nanmean(rest)) / largest) ** 2)
        return float(own / (own + rest))
