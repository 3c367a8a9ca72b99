"""From one pass over a recording to the sums that are kept of it."""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from riecjax.criteria.criterion import SHORT_BLOCKS_OF_ROWS, AbstractCriterion
from riecjax.criteria.laws import LagBins
from riecjax.criteria.length_bins import LengthBins, law_in_bins
from riecjax.criteria.windows import AllWindows, power_of_two
from riecjax.equations.equation import Equation, mixing_expressions
from riecjax.equations.procedure import Procedure
from riecjax.errors import ModelError
from riecjax.leaves import Leaf
from riecjax.linear_algebra import compressed, factor_of, gram_condition_limit
from riecjax.records.record import Record
from riecjax.summaries.averages import hat_half
from riecjax.summaries.digest import digest_of
from riecjax.summaries.normal_equations import NormalEquations
from riecjax.summaries.one_pass import (
    FILLED,
    PART,
    Lengths,
    Part,
    Request,
    Surveyed,
    Watched,
    all_rows,
    of_all_windows,
    of_rows,
)
from riecjax.summaries.stage_sums import sum_of_equations
from riecjax.summaries.sums import Averages, EquationSums, RecordingSums, Survey, noise_level

AVERAGED = 1024
"""Averaged rows of a recording, about."""
SURVEYED = 2048
"""Rows of a recording that a survey looks at, about."""
SHOWN = 2000
"""Rows of a recording that a survey keeps at most."""


class _Layout(NamedTuple):
    """Blocks of a recording and how it is cut for one pass.

    **Fields:** `block`, starts to a block as they are summed; `starts` of a part; `filled`, samples
    that each part is filled up to, `None` to leave the record as it is; `request`.
    """

    block: int
    starts: int
    filled: int | None
    request: Request


class Reading:
    """One recording, to be read once (not under jit); arguments as for [`summarise`][]."""

    def __init__(
        self,
        procedure: Procedure,
        record: Record,
        criterion: AbstractCriterion,
        key: Key[Array, ""] | None,
        bins: LengthBins | None,
        survey: bool,
    ):
        self.procedure, self.criterion, self.key, self.bins = procedure, criterion, key, bins
        self.record, self.survey = record, survey
        self.step, self.count = float(record.time_step), record.sample_count
        with np.errstate(over="ignore", invalid="ignore"):
            self.levels = {k: noise_level(np.asarray(v)) for k, v in record.arrays.items()}
        self.half = int(hat_half(criterion, self.count, np.asarray(self.step)))
        # Hats of four means to a side at the least.
        self.thin = next((by for by in (16, 4) if self.half >= 4 * by), 1)

    # What overflows is for the fit to refuse.
    @np.errstate(over="ignore", invalid="ignore", divide="ignore")
    def sums(self) -> RecordingSums:
        """Everything that is kept of it."""
        equations = [e for stage in self.procedure.stages for e in stage]
        mixing = mixing_expressions(equations, self.record)
        if mixing and (self.count > PART or self.criterion.in_chunks(self.record)):
            raise ModelError(
                f"{mixing[0]} mixes samples (a mean, a difference, a filter), and a record this "
                f"long is worked through in chunks. Compute it beforehand as a signal of the "
                f"record."
            )
        closed = self.criterion.in_closed_form
        block, stages = (self._all_windows if closed else self._rows)(not mixing)
        blocks = stages[0][0].count.shape[-1]
        offered = self.criterion.row_count(self.record)
        sums = RecordingSums(
            tuple(tuple(stage) for stage in stages),
            np.asarray(blocks),
            np.asarray(block * self.step),
            np.asarray(np.nan if offered is None else float(offered)),
            np.asarray(self.count),
            np.asarray(self.step),
            digest_of(self.procedure, self.record, self.criterion, self.key, self.bins),
        )
        # The order of axes in memory is one in which NumPy adds up: it must survive a file.
        return jax.tree.map(lambda leaf: np.asarray(leaf, order="C"), sums)

    def _all_windows(self, fill: bool) -> tuple[int, list[list[EquationSums]]]:
        windows = self._windows()
        lengths = self._lengths(windows)
        layout = self._layout(windows, lengths[-1].reach, fill)
        shortest, longest = windows.lags(
            self.count, self.record.time_step, self.criterion.test_function.length_multiple
        )
        band = jnp.asarray(shortest), jnp.asarray(longest)
        found = [
            jax.tree.map(
                np.asarray,
                of_all_windows(
                    self.procedure,
                    self.criterion,
                    part,
                    lengths,
                    jnp.asarray(self.half),
                    band,
                    layout.request,
                ),
            )
            for part in self._parts(layout, lengths[-1].reach)
        ]
        pairs = windows.block(self.count) // layout.block
        return layout.block * pairs, self._stages(found, layout.block, pairs)

    def _stages(
        self, found: list[list[list[Watched]]], block: int, pairs: int
    ) -> list[list[EquationSums]]:
        """Sums of all equations from what is found in each part, so many blocks put together."""
        count = -(-self.count // block)

        def of_equation(i: int, j: int) -> EquationSums:
            parts = [one[i][j] for one in found]

            def kept(of: int) -> np.ndarray:
                """Sums, or numbers, of all parts and bins, the bins first."""
                groups = zip(*(p.moments for p in parts))
                every = [np.concatenate([part[of] for part in group]) for group in groups]
                in_bins = np.moveaxis(np.concatenate(every, axis=1)[:count], 1, 0)
                return _together(in_bins, pairs)

            return self._equation(self.procedure.stages[i][j], kept(0), kept(1), parts)

        shape = [len(stage) for stage in self.procedure.stages]
        return [[of_equation(i, j) for j in range(n)] for i, n in enumerate(shape)]

    def _windows(self) -> AllWindows:
        windows = self.criterion.windows
        assert windows is not None
        return windows.every

    def _lengths(self, windows: AllWindows) -> tuple[Lengths, ...]:
        """Window lengths, those longer than the law's apart: they reach further than a block."""
        law = self.criterion.law(self.record)
        law = _arrays(law, lambda leaf: np.asarray(leaf))
        reach = windows.reach(self.count)
        if self.bins is None:
            return (Lengths(_arrays(law, lambda leaf: leaf[None]), reach),)
        multiple = self.criterion.test_function.length_multiple
        cut = law_in_bins(law, self.bins, multiple * self.step, (self.count - 1) // multiple)
        beyond = self.bins.band[1]
        if beyond == self.bins.edges.size - 1:
            return (Lengths(cut, reach),)
        within = _arrays(cut, lambda leaf: leaf[:beyond])
        longer = _arrays(cut, lambda leaf: leaf[beyond:])
        longest = float(self.bins.edges[-1]) / self.step + 2
        return Lengths(within, reach), Lengths(longer, power_of_two(longest))

    def _layout(self, windows: AllWindows, reach: int, fill: bool) -> _Layout:
        n = self.count
        longest = windows.reach(n)
        if (block := windows.block(n)) < longest:
            averaged, surveyed = AVERAGED // 2, self.survey * SURVEYED // 2
            request = Request(jnp.asarray(block), 2, self.thin, averaged, surveyed)
            return _Layout(block, n, self._filled(n) if fill else None, request)
        starts = max(PART, 4 * longest)
        filled = starts + reach + 2 * self.criterion.test_function.margin
        if not fill:
            starts, filled = n, None
        elif n <= FILLED[-1]:
            starts = filled = self._filled(n)
        blocks = -(-starts // longest)
        size = (n if filled is None else filled) // (1 if starts <= FILLED[0] else 4)
        averaged, surveyed = (max(k * longest // size, 1) for k in (AVERAGED, SURVEYED))
        request = Request(longest, blocks, self.thin, averaged, surveyed if self.survey else 0)
        return _Layout(longest, starts, filled, request)

    def _filled(self, samples: int) -> int:
        longer = [length for length in FILLED if length >= samples]
        return longer[0] if longer else power_of_two(samples)

    def _parts(self, layout: _Layout, reach: int) -> Iterator[Part]:
        """The recording cut into parts, each with what its windows reach beyond it."""
        if layout.filled is None:
            record = dataclasses.replace(self.record, skipped=np.zeros(()))
            yield Part(record, 0, None, self.levels)
            return
        margin = self.criterion.test_function.margin
        for start in range(0, self.count, layout.starts):
            begin = max(start - margin, 0)
            stop = min(start + layout.starts + reach + margin, self.count)
            yield Part(
                _filled_up(self.record, begin, stop, layout.filled),
                jnp.asarray(start - begin),
                jnp.asarray(stop - begin),
                self.levels,
            )

    def _rows(self, fill: bool) -> tuple[int, list[list[EquationSums]]]:
        n = self.count
        block = self.criterion.block_samples(self.record)
        request = Request(
            jnp.asarray(block),
            SHORT_BLOCKS_OF_ROWS,
            self.thin,
            AVERAGED // SHORT_BLOCKS_OF_ROWS,
            int(self.survey),
        )
        layout = _Layout(block, n, self._filled(n) if fill else None, request)
        (part,) = self._parts(layout, 0)
        given = (self.procedure, self.criterion, part, self.key)
        found = jax.tree.map(np.asarray, of_rows(*given, jnp.asarray(self.half), request))
        stages = self._stages([found], block, 1)
        if self._nearly_collinear(stages):
            rows = all_rows(*given)
            factors = [
                [np.linalg.qr(np.asarray(e.columns).T, mode="r") for e in stage] for stage in rows
            ]
            stages = [
                [dataclasses.replace(e, factor=factor) for e, factor in zip(*stage)]
                for stage in zip(stages, factors)
            ]
        return block, stages

    def _nearly_collinear(self, stages: list[list[EquationSums]]) -> bool:
        """Whether moments of some stage may lose more digits than rows would."""
        for stage, names in zip(stages, self.procedure.stage_parameters):
            apart = [NormalEquations(e.moments.sum(1), e.count.sum(1), e.parameters) for e in stage]
            total = np.asarray(sum_of_equations(apart, names).total().gram)
            if not np.isfinite(total).all():
                continue  # for the fit to refuse
            size = np.diagonal(total)
            scale = np.where(size > 0, 1 / np.sqrt(np.where(size > 0, size, 1.0)), 0.0)
            squares = np.linalg.eigvalsh(total * np.outer(scale, scale))
            if not squares[0] * gram_condition_limit(total.dtype) ** 2 > squares[-1]:
                return True
        return False

    def _equation(
        self,
        equation: Equation,
        moments: np.ndarray,
        count: np.ndarray,
        parts: list[Watched],
    ) -> EquationSums:
        rows = np.concatenate([p.averaged.reshape(-1, p.averaged.shape[-1]) for p in parts])
        noise = np.sum([np.asarray(p.noise).sum(0) for p in parts], axis=0)
        averages = Averages(
            compressed(rows[:, 1:], rows[:, 0] > 0),
            _noise_factor(noise, float(np.sum(rows[:, 0]))),
            np.asarray(self.count / max(2 * self.half, 1)),
        )
        active = [jax.tree.map(lambda leaf: leaf.sum(0), p.activity) for p in parts]
        surveys = [p.survey for p in parts if p.survey is not None]
        return EquationSums(
            moments,
            count,
            averages,
            jax.tree.map(lambda *leaves: np.sum(leaves, axis=0), *active),
            _survey(surveys, float(self.record.skipped)) if surveys else None,
            None,
            equation.parameters,
        )


def _noise_factor(gram: np.ndarray, rows: float) -> np.ndarray:
    """The factor of what noise adds to so many rows, by those that tell of it."""
    return factor_of(gram * (rows / gram[0, 0] if gram[0, 0] > 0 else 0.0))


def _arrays(law: LagBins, of: Callable[[np.ndarray], np.ndarray]) -> LagBins:
    """A law without its edges, with something made of each array."""
    first, last, weight = (of(np.asarray(leaf)) for leaf in (law.first, law.last, law.weight))
    return LagBins(first, last, weight)


def _filled_up(record: Record, begin: int, stop: int, length: int) -> Record:
    """Samples from `begin` to `stop`, and the last of them again and again behind."""
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
    )


def _together(values: np.ndarray, pairs: int) -> np.ndarray:
    """Sums over so many blocks that follow one another."""
    if pairs == 1:
        return values
    count = -(-values.shape[1] // pairs)
    behind = [(0, 0), (0, count * pairs - values.shape[1])] + [(0, 0)] * (values.ndim - 2)
    filled = np.pad(values, behind)
    return filled.reshape(values.shape[0], count, pairs, *values.shape[2:]).sum(2)


def _survey(parts: Sequence[Surveyed], skipped: float) -> Survey:
    """Rows of all parts, the first sample at `skipped` seconds, and what they come to."""

    def flat(of: str) -> Float[np.ndarray, "rows columns"]:
        return np.concatenate([getattr(p, of).reshape(-1, p.rows.shape[-1]) for p in parts])

    kept = np.flatnonzero(np.concatenate([p.kept.ravel() for p in parts]))
    rows, finer, noise = flat("rows"), flat("finer"), flat("noise")
    start = skipped + np.concatenate([p.start.ravel() for p in parts])
    shown = kept[np.linspace(0, max(kept.size - 1, 0), min(kept.size, SHOWN)).astype(int)]
    shown = shown[np.argsort(start[shown], kind="stable")]
    quadrature = np.stack([np.sum((rows - finer) ** 2, 0), np.sum(finer**2, 0)])
    ends = {name: np.concatenate([p.reach[name] for p in parts]) for name in parts[0].reach}
    reach: dict[str, Leaf] = {
        name: np.array([own[:, 0].min(), own[:, 1].max()]) for name, own in ends.items()
    }
    return Survey(noise.T @ noise / max(kept.size, 1), quadrature, rows[shown], start[shown], reach)
