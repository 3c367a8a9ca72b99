"""Sums of less: window lengths together, blocks together, recordings together (not under jit).

Short blocks within a recording tell how errors scatter where there are few recordings. Where there
are many, each is a block that shares nothing with the others, and its sums are all that is needed:
a hundredth of the memory, and compiled functions of one shape for a group of any size.
"""

import dataclasses
import hashlib
from collections.abc import Sequence

import numpy as np

from riecjax.leaves import Leaf
from riecjax.linear_algebra import factor_of_gram, joined_factor
from riecjax.records.noise import Noise
from riecjax.summaries.summary import ROOMS, Summary
from riecjax.summaries.sums import EquationSums, RecordingSums


def together(summary: Summary) -> Summary:
    """The same without bins of window lengths: the sums of those in use, in one."""
    band = slice(*summary.band)

    def of(equation: EquationSums) -> EquationSums:
        by_source = equation.noise_of_source
        one = equation.each(lambda sums: np.asarray(sums)[band].sum(0, keepdims=True))
        if by_source is None:
            return one
        by_source = np.asarray(by_source)[band].sum(0, keepdims=True)
        return dataclasses.replace(one, noise_of_source=by_source)

    return dataclasses.replace(
        summary.of_recordings(one.of_equations(of) for one in summary.recordings),
        edges=None,
        in_law=(0, 1),
        band=(0, 1),
    )


def in_blocks(recording: RecordingSums, most: int) -> RecordingSums:
    """The same in so many blocks of time at most, neighbours added up."""
    held = int(recording.blocks)
    if held <= most:
        return recording
    count = most
    first = -(-np.arange(count) * held // count)

    def of(equation: EquationSums) -> EquationSums:
        return equation.each(lambda sums: np.add.reduceat(np.asarray(sums), first, axis=1))

    seconds = float(recording.blocks) * float(recording.block_seconds)
    return dataclasses.replace(
        recording.of_equations(of),
        blocks=np.asarray(count),
        block_seconds=np.asarray(seconds / count),
    )


def pooled(recordings: Sequence[RecordingSums], each: int = 1) -> RecordingSums:
    """The sums of recordings as those of one, in which each has so many blocks; of more than a
    Summary has room for, neighbours share one.

    Estimates are those of the recordings side by side, to rounding. Of sources of noise with the
    same name the effects add up, and the degrees of freedom: exact for recordings of equal noise.
    """
    every = [in_blocks(one, each) for one in recordings]
    blocks = sum(int(one.blocks) for one in every)
    seconds = sum(float(one.blocks) * float(one.block_seconds) for one in every)
    noise = _noise([one.noise for one in every])
    sources = [one.noise.sources for one in every]
    stages = [
        [
            _pooled([one.stages[i][j] for one in every], sources, noise.sources)
            for j, _ in enumerate(stage)
        ]
        for i, stage in enumerate(every[0].stages)
    ]
    digests = b"".join(np.asarray(one.digest).astype(">u4").tobytes() for one in every)
    joined = RecordingSums(
        tuple(map(tuple, stages)),
        np.asarray(blocks),
        np.asarray(seconds / blocks),
        np.asarray(sum(float(one.offered) for one in every)),
        np.asarray(sum(int(one.samples) for one in every)),
        np.asarray(max(float(one.time_step) for one in every)),
        np.frombuffer(hashlib.sha256(digests).digest(), ">u4").astype(np.uint32),
        noise,
    )
    return in_blocks(joined, ROOMS[-1])


def _noise(every: Sequence[Noise]) -> Noise:
    kernels: dict[str, dict[str, Leaf]] = {}
    freedom: dict[str, Leaf] = {}
    for one in every:
        for signal, of in one.kernels.items():
            kernels[signal] = {**of, **kernels.get(signal, {})}
        for source, degrees in one.freedom.items():
            freedom[source] = np.asarray(freedom.get(source, 0.0) + np.asarray(degrees, float))
    return Noise(kernels, freedom)


def _pooled(
    every: Sequence[EquationSums], had: Sequence[Sequence[str]], sources: Sequence[str]
) -> EquationSums:
    """The sums of one equation side by side, each recording's with the `sources` that it `had`."""
    shape = np.asarray(every[0].moments).shape
    # Of what no noise is known nothing is taken off.
    noise = [np.zeros_like(one.moments) if one.noise is None else one.noise for one in every]
    by_source = np.zeros((shape[0], len(sources), *shape[2:]))
    for one, names in zip(every, had):
        if one.noise_of_source is not None:
            by_source[:, [sources.index(name) for name in names]] += np.asarray(one.noise_of_source)
    known = any(one.noise is not None for one in every)
    constant = [one.constant for one in every]
    constant = None if any(of is None for of in constant) else constant
    return EquationSums(
        moments=np.concatenate([one.moments for one in every], axis=1),
        count=np.concatenate([one.count for one in every], axis=1),
        survey=None,
        factor=_factor(every),
        parameters=every[0].parameters,
        noise=np.concatenate(noise, axis=1) if known else None,
        noise_of_source=by_source if known else None,
        constant=None if constant is None else np.concatenate(constant, axis=1),
    )


def _factor(every: Sequence[EquationSums]) -> np.ndarray | None:
    if all(one.factor is None for one in every):
        return None
    sums = [np.asarray(one.moments).sum((0, 1)) for one in every]
    given = [one.factor for one in every]
    return joined_factor([factor_of_gram(s) if f is None else f for s, f in zip(sums, given)])
