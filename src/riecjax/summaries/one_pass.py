"""One pass over a recording: cut it into parts, sum each, reduce what they say to the sums kept."""

# A window belongs to the block of time in which it starts. Blocks divide the starts, parts divide
# the blocks, and a part holds, beside the samples of its own starts, those that windows from them
# reach (and a margin for quadrature of higher order). So each pair of start and length counts once,
# in one block of one part, however the recording is cut, and the blocks' sums add up to the
# recording's. Running sums start anew in each chunk, so that their rounding does not grow with the
# recording.
#
# Shapes decide what is compiled. Short recordings are filled up behind their end, to one of two
# lengths; where they end is a traced number. Longer ones are worked through in parts of one shape.
# So recordings of any length are served by the same few compiled functions.
#
# Moments hold the squares of what rows hold: of a singular value s of scaled rows they keep s^2, to
# eps. Directions with s below sqrt(eps) are lost in them, and theta is known to eps / s^2 where
# rows would give it to eps / s. Windows summed in closed form have no rows. Where a criterion has
# rows (drawn windows, samples), and their moments are that nearly collinear, a triangular factor R
# of the rows is kept beside them: R^T R are the moments, and R has the rows' singular values.

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

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
from riecjax.linear_algebra import factor_of_gram, factor_of_rows, gram_suffices
from riecjax.records.record import Record, filled_up
from riecjax.summaries.averages import hat_half
from riecjax.summaries.digest import digest_of
from riecjax.summaries.normal_equations import NormalEquations
from riecjax.summaries.parts import (
    FILLED,
    PART,
    Lengths,
    Part,
    PartSums,
    Request,
    Surveyed,
    all_rows,
    of_all_windows,
    of_rows,
)
from riecjax.summaries.stage_sums import sum_of_equations
from riecjax.summaries.sums import Averages, EquationSums, RecordingSums, Survey

AVERAGED = 1024
"""Averaged rows of a recording, about."""
SURVEYED = 2048
"""Rows of a recording that a survey looks at, about."""
SHOWN = 2000
"""Rows of a recording that a survey keeps at most."""


def stretch_starts(criterion: AbstractCriterion, time_step: float, wanted: int) -> int:
    """How many starts a stretch of a longer recording has, about as many as wanted.

    Whole parts, so that no start is in two of them, and whole blocks.

    **Raises:** `ModelError` for a criterion whose windows are not all windows of known lengths.
    """
    windows = criterion.windows
    if windows is None or not criterion.in_closed_form:
        raise ModelError(
            "a recording this long is summed stretch by stretch, for which all windows are needed: "
            "use rx.RIEC(rx.AllWindows(alpha, beta)) (on the command line: without --windows)."
        )
    longest = power_of_two(float(windows.beta) / time_step + 2)
    return power_of_two(max(wanted, PART, 4 * longest))


class _Layout(NamedTuple):
    """Blocks of a recording and how it is cut for one pass.

    **Fields:** `block`, starts to a block as they are summed; `starts` of a part; `filled`, samples
    that each part is filled up to, `None` to leave the record as it is; `request`.
    """

    block: int
    starts: int
    filled: int | None
    request: Request


class OnePass:
    """One recording, to be summed in one pass (not under jit); arguments as for [`summarise`][].

    `averaged`, whether rows averaged by hats are kept: columns of high derivatives have none.
    `starts`, first of the starts that are summed and one beyond the last; all, unless others see
    to the rest: then see [`stretch_starts`][].
    """

    def __init__(
        self,
        procedure: Procedure,
        record: Record,
        criterion: AbstractCriterion,
        key: Key[Array, ""] | None,
        bins: LengthBins | None,
        survey: bool,
        averaged: bool = True,
        starts: tuple[int, int] | None = None,
    ):
        self.procedure, self.criterion, self.key, self.bins = procedure, criterion, key, bins
        self.record, self.survey, self.averaged = record, survey, averaged
        self.step, self.count = float(record.time_step), record.sample_count
        self.first, self.last = starts or (0, self.count)
        self.half = int(hat_half(criterion, self.count, np.asarray(self.step)))
        # Hats of four means to a side at the least.
        self.thin = next((by for by in (16, 4) if self.half >= 4 * by), 1)

    # What overflows is for the fit to refuse.
    @np.errstate(over="ignore", invalid="ignore", divide="ignore")
    def sums(self) -> RecordingSums:
        """All sums of the recording.

        **Raises:** `ModelError` for an expression that mixes samples of a long recording.
        """
        equations = [e for stage in self.procedure.stages for e in stage]
        mixing = mixing_expressions(equations, self.record)
        if mixing and (self.count > PART or self.criterion.in_chunks(self.record)):
            raise ModelError(
                f"{mixing[0]} mixes samples (a mean, a difference, a filter), and a record this "
                f"long is worked through in chunks. Compute it beforehand as a signal of the "
                f"record."
            )
        closed = self.criterion.in_closed_form
        # What mixes samples would mix those that the record is filled up with.
        block, stages = (self._all_windows if closed else self._rows)(not mixing)
        whole = self.last - self.first == self.count
        # Of some starts it is not known how many windows there would be without gaps.
        offered = self.criterion.row_count(self.record) if whole else None
        sums = RecordingSums(
            tuple(tuple(stage) for stage in stages),
            np.asarray(stages[0][0].count.shape[-1]),
            np.asarray(block * self.step),
            np.asarray(np.nan if offered is None else float(offered)),
            np.asarray(self.last - self.first),
            np.asarray(self.step),
            digest_of(self.procedure, self.record, self.criterion, self.key, self.bins),
            self.record.noise,
        )
        # The order of axes in memory is one in which NumPy adds up: it must survive a file.
        return jax.tree.map(lambda leaf: np.asarray(leaf, order="C"), sums)

    def _all_windows(self, fill: bool) -> tuple[int, list[list[EquationSums]]]:
        """Starts to a block, and sums over all windows."""
        windows = self.criterion.windows
        assert windows is not None
        windows = windows.every
        lengths = self._lengths(windows)
        reach = lengths[-1].reach
        layout = self._layout(windows, reach, fill)
        lags = windows.lags(
            self.count, self.record.time_step, self.criterion.test_function.length_multiple
        )
        band = jnp.asarray(lags[0]), jnp.asarray(lags[1])
        half, request = jnp.asarray(self.half), layout.request
        given = (self.procedure, self.criterion)
        parts = [
            jax.tree.map(np.asarray, of_all_windows(*given, part, lengths, half, band, request))
            for part in self._parts(layout, reach)
        ]
        grouped = windows.block(self.count) // layout.block
        return layout.block * grouped, self._stages(parts, layout.block, grouped)

    def _stages(
        self, parts: list[list[list[PartSums]]], block: int, grouped: int
    ) -> list[list[EquationSums]]:
        """Sums of all equations from those of each part, with so many blocks to one."""
        count = -(-(self.last - self.first) // block)

        def of_equation(i: int, j: int) -> EquationSums:
            every = [part[i][j] for part in parts]

            def joined(of: str) -> np.ndarray | None:
                """Sums by blocks of all parts and bins, the bins first."""
                groups = list(zip(*(part.moments for part in every)))
                if getattr(groups[0][0], of) is None:
                    return None
                in_groups = [np.concatenate([getattr(p, of) for p in group]) for group in groups]
                in_bins = np.moveaxis(np.concatenate(in_groups, axis=1)[:count], 1, 0)
                return _sum_of_groups(in_bins, grouped)

            def of_sources() -> np.ndarray | None:
                groups = zip(*(part.moments for part in every))
                sums = [
                    [p.of_source.sum(0) for p in group if p.of_source is not None]
                    for group in groups
                ]
                return (
                    np.concatenate([sum(each[1:], start=each[0]) for each in sums])
                    if sums[0]
                    else None
                )

            names = {"moments": "moments", "count": "number", "noise": "noise"}
            sums = {name: joined(of) for name, of in names.items()}
            equation = self.procedure.stages[i][j]
            return self._equation(equation, every, **sums, noise_of_source=of_sources())

        shape = [len(stage) for stage in self.procedure.stages]
        return [[of_equation(i, j) for j in range(n)] for i, n in enumerate(shape)]

    def _lengths(self, windows: AllWindows) -> tuple[Lengths, ...]:
        """Window lengths, those longer than the law's apart: they reach further than a block."""
        law = self.criterion.law(self.record)
        every = LagBins(np.asarray(law.first), np.asarray(law.last), np.asarray(law.weight))
        reach = windows.reach(self.count)
        if self.bins is None:
            return (Lengths(_each(every, None), reach),)
        multiple = self.criterion.test_function.length_multiple
        cut = law_in_bins(every, self.bins, multiple * self.step, (self.count - 1) // multiple)
        beyond = self.bins.band[1]
        if beyond == self.bins.edges.size - 1:
            return (Lengths(cut, reach),)
        longest = power_of_two(float(self.bins.edges[-1]) / self.step + 2)
        within, longer = _each(cut, slice(beyond)), _each(cut, slice(beyond, None))
        return Lengths(within, reach), Lengths(longer, longest)

    def _layout(self, windows: AllWindows, reach: int, fill: bool) -> _Layout:
        n = self.count
        longest = windows.reach(n)
        if (block := windows.block(n)) < longest:
            averaged, surveyed = self.averaged * AVERAGED // 2, self.survey * SURVEYED // 2
            request = Request(jnp.asarray(block), 2, self.thin, averaged, surveyed)
            return _Layout(block, n, _filled(n) if fill else None, request)
        starts = max(PART, 4 * longest)
        filled = starts + reach + 2 * self.criterion.test_function.margin
        if not fill:
            starts, filled = n, None
        elif n <= FILLED[-1]:
            starts = filled = _filled(n)
        blocks = -(-starts // longest)
        size = (n if filled is None else filled) // (1 if starts <= FILLED[0] else 4)
        averaged, surveyed = (max(k * longest // size, 1) for k in (AVERAGED, SURVEYED))
        averaged, surveyed = averaged * self.averaged, surveyed * self.survey
        request = Request(longest, blocks, self.thin, averaged, surveyed)
        return _Layout(longest, starts, filled, request)

    def _parts(self, layout: _Layout, reach: int) -> Iterator[Part]:
        """The recording cut into parts, each with what its windows reach beyond it."""
        if layout.filled is None:
            record = dataclasses.replace(self.record, skipped=np.zeros(()))
            yield Part(record, 0, None)
            return
        margin = self.criterion.test_function.margin
        for start in range(self.first, self.last, layout.starts):
            begin = max(start - margin, 0)
            stop = min(start + layout.starts + reach + margin, self.count)
            yield Part(
                filled_up(self.record, layout.filled, begin, stop),
                jnp.asarray(start - begin),
                jnp.asarray(stop - begin),
            )

    def _rows(self, fill: bool) -> tuple[int, list[list[EquationSums]]]:
        """Starts to a block, and sums over rows: samples, or windows that are drawn."""
        n = self.count
        block = self.criterion.block_samples(self.record)
        request = Request(
            jnp.asarray(block),
            SHORT_BLOCKS_OF_ROWS,
            self.thin,
            AVERAGED // SHORT_BLOCKS_OF_ROWS,
            int(self.survey),
        )
        layout = _Layout(block, n, _filled(n) if fill else None, request)
        (part,) = self._parts(layout, 0)
        given = (self.procedure, self.criterion, part, self.key)
        found = jax.tree.map(np.asarray, of_rows(*given, jnp.asarray(self.half), request))
        stages = self._stages([found], block, 1)
        if not self._moments_suffice(stages):
            rows = all_rows(*given)
            stages = [
                [
                    dataclasses.replace(e, factor=np.linalg.qr(np.asarray(r.columns).T, mode="r"))
                    for e, r in zip(*pair)
                ]
                for pair in zip(stages, rows)
            ]
        return block, stages

    def _moments_suffice(self, stages: list[list[EquationSums]]) -> bool:
        """Whether no stage's moments lose more digits than its rows would."""
        for stage, names in zip(stages, self.procedure.stage_parameters):
            apart = [NormalEquations(e.moments.sum(1), e.count.sum(1), e.parameters) for e in stage]
            total = np.asarray(sum_of_equations(apart, names).total().gram)
            # What is not finite is for the fit to refuse.
            if np.isfinite(total).all() and not gram_suffices(total):
                return False
        return True

    def _equation(self, equation: Equation, parts: list[PartSums], **sums: Any) -> EquationSums:
        rows = np.concatenate([p.averaged.reshape(-1, p.averaged.shape[-1]) for p in parts])
        # Some chunks tell of noise; their sum is brought to the number of all rows.
        noise, valid = np.sum([p.noise.sum(0) for p in parts], axis=0), rows[:, 0] > 0
        share = float(np.sum(rows[:, 0])) / noise[0, 0] if noise[0, 0] > 0 else 0.0
        averages = None
        if self.averaged:
            averages = Averages(
                factor_of_rows(rows[:, 1:], valid),
                factor_of_gram(noise * share),
                np.asarray(self.count / max(2 * self.half, 1)),
            )
        active = [jax.tree.map(lambda leaf: leaf.sum(0), p.activity) for p in parts]
        surveys = [p.survey for p in parts if p.survey is not None]
        return EquationSums(
            averages=averages,
            activity=jax.tree.map(lambda *leaves: np.sum(leaves, axis=0), *active),
            survey=_survey(surveys, float(self.record.skipped)) if surveys else None,
            factor=None,
            parameters=equation.parameters,
            **sums,
        )


def _each(law: LagBins, index: slice | None) -> LagBins:
    """Some bins of a law; of `None`, all of it as one bin."""
    return LagBins(law.first[index], law.last[index], law.weight[index])


def _filled(samples: int) -> int:
    """How many samples a record is filled up to."""
    return next((length for length in FILLED if length >= samples), power_of_two(samples))


def _sum_of_groups(values: np.ndarray, size: int) -> np.ndarray:
    """Sums over groups of so many blocks that follow one another."""
    if size == 1:
        return values
    count = -(-values.shape[1] // size)
    behind = [(0, 0), (0, count * size - values.shape[1])] + [(0, 0)] * (values.ndim - 2)
    filled = np.pad(values, behind)
    return filled.reshape(values.shape[0], count, size, *values.shape[2:]).sum(2)


def _survey(parts: Sequence[Surveyed], skipped: float) -> Survey:
    """Rows of all parts, the first sample at `skipped` seconds, and what they come to."""

    def flat(of: str) -> Float[np.ndarray, "rows columns"]:
        return np.concatenate([getattr(p, of).reshape(-1, p.rows.shape[-1]) for p in parts])

    valid = np.flatnonzero(np.concatenate([p.valid.ravel() for p in parts]))
    rows, finer, noise = flat("rows"), flat("finer"), flat("noise")
    start = skipped + np.concatenate([p.start.ravel() for p in parts])
    shown = valid[np.linspace(0, max(valid.size - 1, 0), min(valid.size, SHOWN)).astype(int)]
    shown = shown[np.argsort(start[shown], kind="stable")]
    quadrature = np.stack([each.T @ each for each in (rows - finer, finer)])
    ends = {name: np.concatenate([p.reach[name] for p in parts]) for name in parts[0].reach}
    reach: dict[str, Leaf] = {
        name: np.array([own[:, 0].min(), own[:, 1].max()]) for name, own in ends.items()
    }
    covariance = noise.T @ noise / max(valid.size, 1)
    return Survey(covariance, quadrature, rows[shown], start[shown], reach)
