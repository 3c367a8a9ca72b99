"""Records filled up behind their end, so that those of many lengths share compiled functions."""

import numpy as np
from jaxtyping import Array

from riecjax.records.record import Record

TO_A_DOUBLING = 4
"""Lengths that [`shared_length`][] has between one power of two and the next."""


def shared_length(samples: int) -> int:
    """How many samples a record is filled up to, to be simulated: a quarter more at most.

    What is simulated behind its end takes its time; to sum takes little, so that what is only
    summed is filled up further.
    """
    step = max(2 ** (samples - 1).bit_length() // (2 * TO_A_DOUBLING), 1)
    return -(-samples // step) * step


def filled_up(record: Record, length: int, begin: int = 0, stop: int | None = None) -> Record:
    """Samples from `begin` to `stop`, and the last of them again and again behind."""
    stop = record.sample_count if stop is None else stop
    behind = length - (stop - begin)

    def filled(values: Array) -> np.ndarray:
        part = np.asarray(values)[begin:stop]
        return np.concatenate([part, np.repeat(part[-1:], behind)]) if behind else part

    stamps = None if record.stamps is None else filled(record.stamps)
    earlier = begin * float(record.time_step)
    if record.stamps is not None:
        earlier = float(record.stamps[begin]) - float(record.stamps[0])
    return Record(
        {name: filled(values) for name, values in record.arrays.items()},
        record.time_step,
        0.0,
        (),
        {name: filled(mask) for name, mask in record.missing.items()},
        stamps,
        earlier,
        record.noise,
    )
