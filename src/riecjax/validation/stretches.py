"""Stretches of a recording along which a model can be simulated from a state that is known."""

import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from riecjax.errors import DataError
from riecjax.records.record import Record
from riecjax.simulation.system import AbstractSystem

SHORTEST_STRETCH = 20
"""Samples of an unbroken stretch below which it is skipped: it would be all transient."""


def unbroken_stretches(
    system: AbstractSystem,
    measured: Record,
    recorded: Sequence[str],
    sources: Mapping[str, str],
    horizon: float | None,
) -> list[tuple[int, int]]:
    """Unbroken stretches of the inputs, or parts of them, each from where the state is known."""
    present = measured.present(recorded)
    known = np.ones(measured.sample_count, bool) if present is None else np.asarray(present)
    if "differences" in sources.values():
        known = known & np.roll(known, -1) & np.roll(known, -2)
    # Without inputs a pause still breaks the motion: every recorded signal misses its sample there.
    names = system.input_names or tuple(recorded) or tuple(measured.arrays)
    found = []
    for part in _parts(measured, names, horizon):
        starts = np.flatnonzero(known[part])
        if starts.size and part.stop - part.start - starts[0] >= SHORTEST_STRETCH:
            found.append((part.start + int(starts[0]), part.stop))
    if not found:
        raise DataError(
            f"no unbroken stretch of {SHORTEST_STRETCH} samples is left in which "
            f"{', '.join(names)} are recorded."
        )
    return found


def _parts(measured: Record, names: Sequence[str], horizon: float | None) -> list[slice]:
    """Unbroken stretches, cut into parts of a horizon or a little more."""
    whole = measured.segments(names)
    if horizon is None:
        return whole
    samples = max(round(horizon / float(measured.time_step)), SHORTEST_STRETCH)
    found = []
    for part in whole:
        edges = np.linspace(part.start, part.stop, max((part.stop - part.start) // samples, 1) + 1)
        found += [slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]
    return found
