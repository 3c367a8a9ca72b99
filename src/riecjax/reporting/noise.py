"""The noise on signals in plain data and in words."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from riecjax.records.noise_judgement import judged
from riecjax.records.recording import Recording
from riecjax.reporting.document import Document, finite, number

LEAST_SHOWN = 1e-4
"""Share of a signal's standard deviation below which noise is not worth a line."""


def noise_entries(recordings: Sequence[Recording], signals: Iterable[str]) -> dict[str, Any]:
    """Of each signal, its noise's standard deviation (r.m.s. over recordings), and which share of
    its own that is."""
    entries = {}
    for name in signals:
        having = [r.record.select(name) for r in recordings if name in r.record.signals]
        if not having:
            continue
        noise = np.sqrt(np.mean([np.mean(judged(one).noise.std(name) ** 2) for one in having]))
        size = np.sqrt(np.mean([np.var(np.asarray(one[name])) for one in having]))
        entries[name] = {
            "std": finite(float(noise)),
            "unit": dict(having[0].units).get(name, ""),
            "share": finite(float(noise / size)) if size > 0 else None,
        }
    return entries


def noise_in_words(entries: Document) -> str:
    """One line on all signals that have some."""
    shown = [
        f"{name} {number(100 * entry['share'], 2)} %"
        for name, entry in entries.items()
        if entry["share"] is not None and entry["share"] >= LEAST_SHOWN
    ]
    if not shown:
        return f"noise: below {100 * LEAST_SHOWN:g} % of each signal's standard deviation"
    noun = "their standard deviations" if len(shown) > 1 else "its standard deviation"
    return f"noise: {', '.join(shown)} of {noun}"
