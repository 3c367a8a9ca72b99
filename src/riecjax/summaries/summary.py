"""All that recordings say to a model, kept as sums: what every estimate is made from."""

import dataclasses
import hashlib
import os
from collections.abc import Iterable, Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from riecjax import arrays as xp
from riecjax.criteria.criterion import PARTS, AbstractCriterion
from riecjax.criteria.windows import MOST_BLOCKS, LengthBins
from riecjax.equations.model import Model
from riecjax.errors import DataError, ModelError, require
from riecjax.leaves import Leaf, PlainMethods
from riecjax.linear_algebra import factor_of_gram, joined_factor
from riecjax.records.signal import Noise
from riecjax.shows import Shown
from riecjax.summaries import summary_files
from riecjax.summaries.normal_equations import (
    EquationSums,
    NormalEquations,
    Outline,
    RecordingSums,
    ShortBlocks,
    Survey,
    stack_normal_equations,
    with_noise_alike,
)
from riecjax.summaries.summary_files import FileKind

UNKNOWN = "0" * 64
"""Digest of a recording that was summed by jit."""


class Summary(PlainMethods, Shown, eqx.Module):
    """What recordings say to a model under a criterion: moments of short blocks of time.

    Sums of recordings, files and machines add up, so that summaries merge, and the samples are not
    needed again: [`estimate`][] finds parameters from a Summary for any known values, any
    intervals, and any part of the recordings or blocks of time. Where moments are kept by bins of
    window lengths, a band of lengths can be chosen afterwards too.

    Its size does not grow with the length of a recording beyond `MOST_BLOCKS` blocks: short blocks
    then pair up. See [`Summary.byte_count`][].

    **Fields:**

    - `recordings`: sums of each, in the order in which a recording's own parameters are numbered.
    - `criterion`: what made the rows, with the band of window lengths in use.
    - `outline`: names of equations and parameters, and units.
    - `edges`: of bins of window lengths in seconds, or `None`; `in_law`, the bins that the
      criterion was given, first and one beyond the last.
    - `band`: the bins in use, first and one beyond the last.
    - `asked`: alpha and beta that were asked for, where the bins' edges are others; else `None`.
    """

    recordings: tuple[RecordingSums, ...]
    criterion: AbstractCriterion
    outline: Outline
    edges: Float[Leaf, " edges"] | None
    in_law: tuple[int, int] = eqx.field(static=True)
    band: tuple[int, int] = eqx.field(static=True)
    asked: tuple[float, float] | None = eqx.field(static=True, default=None)

    @property
    def bins(self) -> LengthBins | None:
        """Bins of window lengths that are kept apart, if any."""
        return None if self.edges is None else LengthBins(np.asarray(self.edges), self.in_law)

    @property
    def byte_count(self) -> int:
        """Bytes of all arrays: for p parameters about `8 bins blocks (1 + p)^2` an equation and
        recording."""
        leaves = jax.tree.leaves(eqx.filter(self.recordings, eqx.is_array))
        return sum(leaf.size * leaf.dtype.itemsize for leaf in leaves)

    @property
    def digests(self) -> tuple[str, ...]:
        """Of each recording's content and of all settings (not of one that was summed by jit)."""
        return tuple(np.asarray(r.digest).astype(">u4").tobytes().hex() for r in self.recordings)

    def merge(self, *others: "Summary") -> "Summary":
        """A Summary of the recordings of all, each once, sorted by digest.

        In whatever order and parts recordings come together, estimates are the same to the bit.

        **Raises:** `ModelError` for summaries of other equations, criteria or bins; for a recording
        that two of them hold differently, scaled or with a stretch left out; and for sums that were
        made under `jit`, which do not tell whose they are.
        """

        def rank(sums: RecordingSums) -> list[Any]:
            leaves = jax.tree.leaves(sums)
            return [-len(leaves), *(np.asarray(leaf).tobytes() for leaf in leaves)]

        every: dict[str, RecordingSums] = {}
        for one in (self, *others):
            require("what is merged", one, Summary, "summary.merge(other): one after the other")
            mine, theirs = (() if s.edges is None else np.asarray(s.edges) for s in (self, one))
            differs = {
                "other equations or parameters": not self.outline.is_of(one.outline),
                "another criterion": one.criterion.describe() != self.criterion.describe(),
                "other bins of window lengths": (one.in_law, one.band) != (self.in_law, self.band)
                or not np.array_equal(mine, theirs),
            }
            if why := [words for words, differ in differs.items() if differ]:
                raise ModelError(f"summaries cannot be merged that were made for {why[0]}.")
            for digest, recording in zip(one.digests, one.recordings):
                if every and UNKNOWN in (digest, *every):
                    raise ModelError(
                        "sums that were made under jax.jit do not tell which recordings they are "
                        "of, so that they cannot be merged: make them by rx.summarise outside it."
                    )
                other = every.setdefault(digest, recording)
                if other is recording:
                    continue
                pair = (recording, other)
                counts = [np.array([e.count for stage in r.stages for e in stage]) for r in pair]
                if counts[0].shape != counts[1].shape or not np.allclose(*counts, rtol=1e-6):
                    raise ModelError(
                        "summaries cannot be merged that hold a recording differently, scaled or "
                        "with a stretch left out: select(...) those that should count from one of "
                        "them."
                    )
                # They may differ by rounding, where other machines made them, and in what only a
                # survey keeps: whatever their order, the same one counts.
                every[digest] = min(other, recording, key=rank)
        return self.of_recordings(every[digest] for digest in sorted(every))

    def of_recordings(self, recordings: Iterable[RecordingSums]) -> "Summary":
        """The same of other recordings."""
        return dataclasses.replace(self, recordings=tuple(recordings))

    def select(self, *indices: int) -> "Summary":
        """A Summary of these recordings only, numbered from zero.

        **Raises:** `ModelError` if there are none of these numbers, or none at all.
        """
        count = len(self.recordings)
        for index in indices:
            require("a recording's number", index, (int, np.integer), "summary.select(0)")
        if not indices or any(not -count <= i < count for i in indices):
            raise ModelError(f"recordings are numbered from 0 to {count - 1}; got {indices}.")
        return self.of_recordings(self.recordings[i] for i in indices)

    def leave_out(self, start: float, stop: float, *, recording: int = 0) -> "Summary":
        """Without the windows that start in blocks touched by a stretch of time, in seconds.

        Whole blocks are left out; windows that start before them may reach into the stretch. What
        remains is as one recording, shorter by them.

        **Raises:** `DataError` if fewer than two blocks remain; `ModelError` if there is no such
        recording, and for a stretch that does not end after it starts.
        """
        if not start < stop:
            raise ModelError(
                f"a stretch to leave out starts before it ends; got {start} to {stop} s."
            )
        (one,) = self.select(recording).recordings
        edges = float(one.block_seconds) * np.arange(int(one.blocks) + 1)
        outside = (edges[1:] <= start) | (edges[:-1] >= stop)
        if outside.sum() < 2:
            raise DataError(
                f"fewer than two blocks of {float(one.block_seconds):.3g} s would remain of "
                f"recording {recording + 1}."
            )
        others = list(self.recordings)
        others[recording] = one.of_blocks(np.flatnonzero(outside))
        return self.of_recordings(others)

    def scale(self, factor: float) -> "Summary":
        """Every sum multiplied: a factor below one forgets, as older recordings may be.

        **Raises:** `ModelError` for a negative factor.
        """
        if xp.is_concrete(factor) and not float(factor) >= 0:
            raise ModelError(f"sums are scaled by a factor of zero or more; got {factor}.")
        return self.of_recordings(one.scaled(factor) for one in self.recordings)

    # Sums of less. Short blocks within a recording tell how errors scatter where there are few
    # recordings. Where there are many, each is a block that shares nothing with the others, and its
    # sums are all that is needed: a hundredth of the memory.

    def merge_length_bins(self) -> "Summary":
        """The same without bins of window lengths: the sums of those in use, in one (not under
        jit)."""
        return self.in_one_bin(one.of_bins(*self.band) for one in self.recordings)

    def in_one_bin(self, recordings: Iterable[RecordingSums]) -> "Summary":
        """The same of other recordings, which have no bins of window lengths."""
        whole = self.of_recordings(recordings)
        return dataclasses.replace(whole, edges=None, in_law=(0, 1), band=(0, 1))

    def coarsen_blocks(self, most: int) -> "Summary":
        """The same with at most so many blocks of time for each recording, neighbours added up (not
        under jit)."""
        return self.of_recordings(one.in_blocks(most) for one in self.recordings)

    def pool_recordings(self, blocks: int = 1) -> "Summary":
        """The sums of all recordings as those of one, in which each has at most so many blocks; of
        more than a Summary has room for, neighbours share one (not under jit).

        Estimates are those of the recordings side by side, to rounding. Of sources of noise with
        the same name the effects add up, and the degrees of freedom: exact for recordings of equal
        noise.
        """
        every = self.coarsen_blocks(blocks).recordings
        count = sum(int(one.blocks) for one in every)
        seconds = sum(float(one.blocks) * float(one.block_seconds) for one in every)
        kernels: dict[str, dict[str, Leaf]] = {}
        freedom: dict[str, Leaf] = {}
        for one in every:
            for signal, of in one.noise.kernels.items():
                kernels[signal] = {**of, **kernels.get(signal, {})}
            for source, degrees in one.noise.freedom.items():
                freedom[source] = np.asarray(freedom.get(source, 0.0) + np.asarray(degrees, float))
        noise = Noise(kernels, freedom)

        def pooled(parts: Sequence[EquationSums]) -> EquationSums:
            """The sums of one equation side by side."""
            sums = with_noise_alike(parts)
            shape = np.asarray(sums[0].moments).shape
            by_source: Any = np.zeros((shape[0], len(noise.sources), *shape[2:]))
            for one, equation in zip(every, sums):
                if equation.noise_of_source is not None:
                    place = [noise.sources.index(name) for name in one.noise.sources]
                    by_source[:, place] += np.asarray(equation.noise_of_source)
            factor = None
            if any(equation.factor is not None for equation in sums):
                grams = [np.asarray(equation.moments).sum((0, 1)) for equation in sums]
                pairs = zip(grams, (e.factor for e in sums))
                factor = joined_factor([factor_of_gram(g) if f is None else f for g, f in pairs])

            names = ("moments", "count", "noise", "constant")
            each = {name: [getattr(equation, name) for equation in sums] for name in names}
            held = {name: of for name, of in each.items() if not any(p is None for p in of)}
            joined: Any = {name: np.concatenate(of, axis=1) for name, of in held.items()}
            return EquationSums(
                parameters=sums[0].parameters,
                noise_of_source=None if sums[0].noise is None else by_source,
                factor=factor,
                **joined,
            )

        stages = zip(*(one.stages for one in every))
        digests = bytes.fromhex("".join(self.digests))
        joined = RecordingSums(
            tuple(tuple(map(pooled, zip(*stage))) for stage in stages),
            np.asarray(count),
            np.asarray(seconds / count),
            np.asarray(sum(float(one.offered) for one in every)),
            np.asarray(sum(int(one.samples) for one in every)),
            np.asarray(max(float(one.time_step) for one in every)),
            np.frombuffer(hashlib.sha256(digests).digest(), ">u4").astype(np.uint32),
            noise,
        )
        return self.of_recordings([joined.in_blocks(MOST_BLOCKS)])

    def between(self, alpha: float, beta: float) -> "Summary":
        """The same for windows of other lengths, from alpha to beta seconds.

        The band snaps to the nearest edges of the bins; what was asked for stays in `asked`.

        **Raises:** `ModelError` unless moments were kept by bins of window lengths.
        """
        bins = self.bins
        if bins is None:
            raise ModelError(
                "this Summary keeps the sums of all window lengths together, so that another band "
                "cannot be chosen: make it with bins, rx.summarise(..., bins=12)."
            )
        band = bins.nearest(alpha, beta)
        asked = (float(alpha), float(beta))

        def is_snapped(one: RecordingSums) -> bool:
            first, last, unit = self._lags(band, one)
            return (first, last) != tuple(max(round(x / unit), 1) for x in asked)

        snapped = any(map(is_snapped, self.recordings))
        return dataclasses.replace(
            self,
            # Lengths that round to the same samples are the same windows: those asked for.
            criterion=self.criterion.between(*(self.lengths_of(band) if snapped else asked)),
            band=band,
            asked=asked if snapped else None,
        )

    def lengths_of(self, band: tuple[int, int]) -> tuple[float, float]:
        """Shortest and longest window in seconds of some bins, first and one beyond the last."""
        coarsest = max(self.recordings, key=lambda one: float(one.time_step))
        first, last, unit = self._lags(band, coarsest)
        return first * unit, last * unit

    def _lags(self, band: tuple[int, int], one: RecordingSums) -> tuple[int, int, float]:
        """Shortest and longest lag of some bins in a recording, and a lag's seconds."""
        assert self.bins is not None
        unit = self.criterion.test_function.length_multiple * float(one.time_step)
        first, last = self.bins.lags(unit, np.iinfo(np.int32).max)
        return int(first[band[0]]), int(last[band[1] - 1]), unit

    @property
    def short_blocks(self) -> ShortBlocks:
        """The blocks of time that moments are kept for."""
        return ShortBlocks(
            xp.stack([xp.asarray(one.blocks) for one in self.recordings]),
            xp.stack([xp.asarray(one.block_seconds) for one in self.recordings]),
            self.criterion.block_length,
        )

    def equations(self, band: tuple[int, int] | None = None) -> list[list[NormalEquations]]:
        """Of each equation of each stage, normal equations with axes `(recordings, blocks)`.

        Of the bins in use, or of others. Where a recording has fewer blocks than another, empty
        ones follow.
        """
        first, last = self.band if band is None else band

        def in_band(recording: RecordingSums, i: int, j: int) -> NormalEquations:
            sums = recording.stages[i][j].of_bins(first, last)
            found = sums.in_blocks(lambda bins: bins[0])
            nothing = np.zeros((len(recording.noise.sources), *found.moments.shape[-2:]))
            by_source = sums.noise_of_source
            return found.with_noise(found.noise, nothing if by_source is None else by_source[0])

        return [
            [
                stack_normal_equations([in_band(one, i, j) for one in self.recordings])
                for j, _ in enumerate(stage)
            ]
            for i, stage in enumerate(self.outline.stages)
        ]

    @property
    def noise_freedom(self) -> Float[Leaf, "recordings sources"]:
        """Degrees of freedom of the variance of each recording's sources of noise."""
        every = [[1.0 * f for f in one.noise.freedom.values()] for one in self.recordings]
        most = max(map(len, every))
        return xp.stack([xp.asarray([*of, *(np.inf,) * (most - len(of))], float) for of in every])

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write to an NPZ file of exactly this name, whole or not at all; see [`load`][].

        **Raises:** `DataError` if the file cannot be written; `ModelError` for a criterion with a
        part that is a function, for sums that are traced or of a batch, or for more than 2 GiB.
        """
        summary_files.save(self._single(), path, KIND)

    def to_bytes(self) -> bytes:
        """What [`Summary.save`][] writes, in memory: the same bytes for the same numbers.

        **Raises:** `ModelError` as `save`.
        """
        return summary_files.to_bytes(self._single(), KIND)

    @classmethod
    def from_bytes(cls, content: bytes) -> "Summary":
        """The Summary that [`Summary.to_bytes`][] made these bytes of.

        **Raises:** `DataError` as [`load`][], which says what must be defined before.
        """
        return summary_files.from_bytes(content, KIND)

    def _single(self) -> "Summary":
        if not xp.is_concrete(self) or any(np.ndim(one.blocks) for one in self.recordings):
            raise ModelError(
                "sums of jax.jit or jax.vmap are saved outside of it, and one by one of a batch."
            )
        return self

    def require_model(self, model: Model) -> None:
        """Raise `ModelError` unless these are sums of the model's equations."""
        if not self.outline.is_of(Outline.of(model.linear)):
            held = self.outline.stages
            named = "; ".join(" + ".join(name for name, _ in stage) for stage in held)
            raise ModelError(
                f"this Summary was made for other equations ({named}): make it anew for this model."
            )


CLASSES = (Summary, RecordingSums, EquationSums, Survey, Outline, Noise, *PARTS)
"""What a Summary is made of, beside arrays and names."""
KIND = FileKind("summary", 6, CLASSES)


def load(path: str | os.PathLike[str]) -> Summary:
    """Read a Summary that [`Summary.save`][] wrote, equal to the bit.

    A test function, or another part of a criterion, that is not this library's must be defined
    before: import its module.

    **Raises:** `DataError`, in one line, for a file that is not there, is no Summary, is damaged,
    was written with another schema, or names a class that is not defined.
    """
    return summary_files.load(path, KIND)


def as_summary(summaries: Summary | Sequence[Summary]) -> Summary:
    """One Summary, or several merged.

    **Raises:** `ModelError` for anything else.
    """
    if isinstance(summaries, Summary):
        return summaries
    write = "rx.summarise(model, record)"
    require("the Summary", summaries, (list, tuple), write)
    for one in summaries:
        require("one of the summaries", one, Summary, write)
    if not summaries:
        raise ModelError("at least one Summary is needed.")
    return summaries[0].merge(*summaries[1:])
