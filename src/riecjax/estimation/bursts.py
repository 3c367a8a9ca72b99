"""How large a term is where it acts, which a mean over all windows does not show."""

from collections.abc import Collection, Mapping, Sequence

import numpy as np
from jaxtyping import Array

from riecjax.estimation.sharing import Sharing
from riecjax.estimation.sums import RecordingSums

STEADY = 3.0
"""Kurtosis of a signal without bursts: a Gaussian's. A sinusoid's is half of it."""


def sizes_in_bursts(
    stage: int,
    sharing: Sharing,
    recordings: Sequence[RecordingSums],
    values: Mapping[str, Array],
    found: Collection[str],
    names: Collection[str],
) -> dict[str, float]:
    """r.m.s. of terms where they act over the target's, sample by sample (not under jit).

    Each sample of a term weighs as much as its energy: 10 times the plain r.m.s. for what acts 1 %
    of the time, and no more than it for what is as steady as noise. A friction that differs just
    before and just after a reversal cancels in windows, and not here. Terms under a derivative are
    left out: differentiated noise comes in bursts as well.

    **Arguments:** `stage`, its place in the procedure; `values` of all parameters; of `found`,
    which this stage finds, those of `names` are asked for.
    """
    powers = dict.fromkeys(names, (0.0, 0.0, 0.0))
    for i, recording in enumerate(recordings):
        for equation in recording.stages[stage]:
            seen = equation.activity
            if seen is None:
                continue
            called = sharing.of_record(equation.parameters, i)
            mix = np.array([1.0, *(0.0 if n in found else -float(values[n]) for n in called)])
            gram = np.asarray(seen.gram, float)
            target = float(mix @ gram @ mix) / max(float(seen.samples), 1.0)
            squares, fourths = np.asarray(seen.square)[1:], np.asarray(seen.fourth)[1:]
            for name, square, fourth in zip(called, squares, fourths):
                if name in powers:
                    before = powers[name]
                    both = before[0] + float(square), before[1] + float(fourth)
                    powers[name] = (*both, max(before[2], target))
    return {
        name: float(np.sqrt(fourth / STEADY / square / target)) if square * target > 0 else 0.0
        for name, (square, fourth, target) in powers.items()
    }
