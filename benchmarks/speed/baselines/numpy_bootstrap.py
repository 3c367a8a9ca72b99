"""Block bootstrap of the three stages in NumPy, every replicate refitted from its rows."""

import numpy as np
from jaxtyping import Float

from benchmarks.speed.baselines.numpy_stages import staged_by_body, window_table
from benchmarks.speed.baselines.numpy_windows import Signals, random_windows


def replicates(
    signals: Signals,
    step: float,
    count: int = 2000,
    seed: int = 0,
    *,
    windows: int = 8000,
    shortest: int = 10,
    longest: int = 100,
    block: int = 400,
) -> Float[np.ndarray, "replicates 8"]:
    """Parameters in the order of `PARAMETERS`, from blocks of start times drawn with replacement.

    Windows are drawn once. Lengths of windows and blocks are in samples.
    """
    rng = np.random.default_rng(seed)
    samples = signals["x1"].size
    start, stop = random_windows(rng, samples, windows, shortest, longest)
    order = np.argsort(start)
    start, stop = start[order], stop[order]
    edges = np.searchsorted(start, np.arange(block, samples, block))
    blocks = np.split(window_table(signals, step, start, stop), edges)
    found = np.empty((count, 8))
    for row in found:
        drawn = rng.integers(0, len(blocks), len(blocks))
        row[:] = staged_by_body(np.concatenate([blocks[i] for i in drawn]))
    return found
