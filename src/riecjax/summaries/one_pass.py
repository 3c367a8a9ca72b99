"""One pass over a recording: cut it into chunks, sum each, put what they say side by side.

Every equation's columns are sampled once, chunk by chunk, and sums over blocks of starts are made
of them: moments of all windows, and, on request, a survey for checks and figures.
"""

# What the signals' noise adds to a row has no formula, since terms may be any expressions of the
# signals. So it is measured: white noise of each signal's level is added to the samples, and the
# columns without it are subtracted. The difference is exact where terms are linear in the signals,
# and right to first order in the noise where they are not.

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Key

from riecjax import arrays as xp
from riecjax.arrays import Array
from riecjax.criteria.criterion import AbstractCriterion
from riecjax.criteria.noise_moments import noise_moments
from riecjax.criteria.windows import (
    CHUNK,
    AllWindows,
    LagBins,
    LengthBins,
    StartBlocks,
    WindowSet,
    chunk_length,
    in_chunks,
    law_in_bins,
    power_of_two,
)
from riecjax.equations.equation import Equation, mixing_expressions
from riecjax.equations.expressions import evaluate
from riecjax.equations.model import Model
from riecjax.equations.noisy_columns import Columns, NoisyColumns, sampled_columns
from riecjax.errors import ModelError
from riecjax.leaves import Leaf
from riecjax.linear_algebra import gram_suffices
from riecjax.records.record import Record
from riecjax.records.signal import Signal
from riecjax.summaries.normal_equations import (
    EquationSums,
    NormalEquations,
    RecordingSums,
    Survey,
    digest_of,
    sum_of_equations,
)

PART = 2**17
"""Starts to a stretch of a long recording at least."""
NOISE = np.random.default_rng(0).standard_normal(2**16)
"""White noise of unit size, which is sent through the equations."""
APART = 9973
"""Samples between where two signals begin to take their noise."""


class Lengths(NamedTuple):
    """Window lengths whose sums are kept apart: bins by the first axis.

    **Fields:** `lags`, the law in each bin; `reach`, no window of them is longer in samples.
    """

    lags: LagBins
    reach: int


class Surveyed(NamedTuple):
    """Rows of some windows: by the criterion, by the finest quadrature, and what noise adds to
    them; where they start; least and largest argument of each basis."""

    rows: Float[np.ndarray, "rows 3 columns"]
    start: Float[np.ndarray, " rows"]
    valid: Bool[np.ndarray, " rows"]
    reach: dict[str, Float[np.ndarray, " 2"]]


def _equation_sums(
    criterion: AbstractCriterion,
    noisy: NoisyColumns,
    windows: Lengths | WindowSet,
    blocks: StartBlocks,
    known: bool,
) -> EquationSums:
    """Sums of an equation's rows over windows, and what noise adds to them: over all of some
    lengths; or where a criterion has single rows, each sample's or of windows that are drawn.

    The closed form sums the windows that start in a block from running sums over the block and its
    reach, so that a block shorter than a window costs as much as one as long. Where some lengths
    are longer, neighbouring blocks are summed as one, and the first of them holds the sums: not
    all as one, or nothing could be said of scatter, and none where numbers are traced, since there
    no window is known to be short.

    **Arguments:** `known`, whether numbers are: then products with a constant are summed as well.
    """
    wider, narrow = 1, blocks.number
    counted = windows.lags if isinstance(windows, Lengths) else windows
    if isinstance(windows, Lengths) and known:
        while wider * blocks.size < windows.reach and 2 * wider < narrow:
            wider *= 2
        blocks = blocks._replace(size=wider * blocks.size, number=-(-narrow // wider))

    def products(columns: Columns) -> tuple[Array, Array]:
        if isinstance(windows, Lengths):
            return criterion.test_function.moments(columns, windows.lags, blocks, windows.reach)
        place = xp.clip(windows.start // blocks.size, 0, blocks.number - 1).astype(np.int32)
        rows = criterion.rows_of(columns, windows)
        sums = NormalEquations.of_rows(
            rows,
            block_of_row=place if blocks.number > 1 else None,
            block_count=blocks.number,
        )
        return sums.moments, sums.count

    columns, ones = noisy.columns, None
    if known:
        # A column behind that is 1 at every sample, whose product with itself comes first.
        one = np.zeros_like(columns.values[:, :1])
        one[0] = 1.0
        values = np.concatenate([columns.values, one], axis=1)
        moments, number = products(
            dataclasses.replace(columns, values=values, parameters=(*columns.parameters, ""))
        )
        ones = np.roll(moments[..., -1, :], 1, axis=-1)
        moments = moments[..., :-1, :-1]
    else:
        moments, number = products(columns)
    sums = EquationSums(moments, number, columns.parameters, constant=ones)
    added = noise_moments(
        noisy,
        blocks,
        lambda: criterion.test_function.noise_weights(columns, counted, blocks),
        lambda moved: products(moved)[0],
    )
    if added is not None:
        sums = sums.with_noise(*added)
    if isinstance(windows, WindowSet):  # of which there are no bins of lengths
        sums = jax.tree.map(lambda leaf: leaf[None], sums)
    if wider == 1:
        return sums

    def first_of(leaf: Leaf) -> Leaf:
        apart = xp.expand_dims(leaf, 2)
        behind = [(0, 0)] * 2 + [(0, wider - 1)] + [(0, 0)] * (apart.ndim - 3)
        spread = xp.pad(apart, behind)
        return spread.reshape(leaf.shape[0], -1, *leaf.shape[2:])[:, :narrow]

    return sums.each(first_of)


def _disturbed(record: Record, first: int) -> Record:
    """A stretch of a record, from a sample on, with white noise that is the same in any other."""
    place, names = first + np.arange(record.sample_count), sorted(record.arrays)

    def disturbed(number: int, name: str) -> Signal:
        signal = record.signal(name)
        noise = record.noise.std(name) * NOISE[(place + APART * number) % NOISE.size]
        return dataclasses.replace(signal, values=signal.values + noise)

    return record.with_signals({name: disturbed(i, name) for i, name in enumerate(names)})


def _surveyed(
    criterion: AbstractCriterion,
    equation: Equation,
    noisy: NoisyColumns,
    records: tuple[Record, Record],
    windows: WindowSet,
) -> Surveyed:
    """Rows of windows: of an equation's columns, and of what noise adds to these; of a record
    without and with noise."""
    record, disturbed = records
    clean, smoothness = noisy.columns, criterion.smoothness
    noise = sampled_columns(equation, disturbed, smoothness)
    # Where nothing is curved, the mean's shift is zero.
    plain = sampled_columns(equation, record, smoothness) if noisy.curved else clean

    def rows(by: AbstractCriterion, columns: Columns) -> tuple[Array, Array]:
        found = by.rows_of(columns, windows)
        valid = np.ones(len(found.columns.T), bool) if found.valid is None else found.valid
        return np.where(valid[:, None], found.columns.T, 0.0), valid

    (values, valid), finer = rows(criterion, clean), criterion.finest()
    by_finest = values if finer is criterion else rows(finer, clean)[0]
    every = np.stack([values, by_finest, rows(criterion, noise - plain)[0]], axis=-2)
    reaches = {}
    for term in (term.unweighted for term in equation.terms):
        if term.basis is not None:
            argument = evaluate(term.of, record).values
            reaches[str(term.name)] = np.array([argument.min(), argument.max()])
    start = record.elapsed[np.floor(windows.start).astype(int)]
    return Surveyed(every, start, valid, reaches)


# A window belongs to the block of time in which it starts. Blocks divide the starts, chunks divide
# the blocks, and a chunk holds, beside the samples of its own starts, those that windows from them
# reach (and a margin for quadrature of higher order). So each pair of start and length counts once,
# in one block of one chunk, however the recording is cut, and the blocks' sums add up to the
# recording's. Running sums start anew in each chunk, so that their rounding does not grow with the
# recording, nor does memory.
#
# Moments hold the squares of what rows hold: of a singular value s of scaled rows they keep s^2, to
# eps. Directions with s below sqrt(eps) are lost in them, and theta is known to eps / s^2 where
# rows would give it to eps / s. Windows summed in closed form have no rows. Where a criterion has
# rows (drawn windows, samples), and their moments are that nearly collinear, a triangular factor R
# of the rows is kept beside them: R^T R are the moments, and R has the rows' singular values.

SURVEYED = 2048
"""Rows of a recording that a survey looks at."""
SHOWN = 2000
"""Rows of a recording that a survey keeps at most."""


def stretch_starts(criterion: AbstractCriterion, time_step: float, wanted: int) -> int:
    """How many starts a stretch of a longer recording has, about as many as wanted.

    Whole parts, so that no start is in two of them, and whole blocks.

    **Raises:** `ModelError` for a criterion whose windows are not all windows of known lengths.
    """
    windows = criterion.all_windows
    if windows is None:
        raise ModelError(
            "a recording this long is summed stretch by stretch, for which all windows are needed: "
            "use rx.RIEC(rx.AllWindows(alpha, beta)) (on the command line: without --windows)."
        )
    longest = power_of_two(float(windows.beta) / time_step + 2)
    return power_of_two(max(wanted, PART, 4 * longest))


# What overflows is for the fit to refuse.
@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def recording_sums(
    model: Model,
    record: Record,
    criterion: AbstractCriterion,
    key: Key[Array, ""] | None,
    bins: LengthBins | None = None,
    survey: bool = False,
    starts: tuple[int, int] | None = None,
    apart: bool = False,
    in_blocks: bool = True,
) -> RecordingSums:
    """One recording, summed in one pass; arguments as for [`summarise`][].

    **Arguments:** `starts`, first of the starts that are summed and one beyond the last; all,
    unless others see to the rest: then see [`stretch_starts`][]. `apart`, where numbers are traced:
    windows of each length by themselves, for a test function that asks for that. Without
    `in_blocks` rows that are not summed in closed form make a single block.

    **Raises:** `ModelError` for an expression that mixes samples of a long recording.
    """
    traced = xp.are_traced(model, record, criterion, key)
    n, windows = record.sample_count, criterion.all_windows
    size = criterion.block_samples(record) if in_blocks or windows is not None else n
    begin, end = starts or (0, n)
    blocks = StartBlocks(begin, size, -(-(end - begin) // size))
    every: tuple[Lengths | WindowSet, ...] = ()
    reach, length = 0, n
    if windows is None:
        every = (criterion.draw(record, key),)
    else:
        every = _lengths(criterion, windows, record, None if traced else bins, apart)
        reach = max(of.reach for of in every)
        length = chunk_length(record, size, windows.reach(n))
    if not traced:
        mixing = mixing_expressions(model.equations, record)
        if mixing and length < n:
            raise ModelError(
                f"{mixing[0]} mixes samples (a mean, a difference, a filter), and a record this "
                f"long is worked through in chunks. Compute it beforehand as a signal of the "
                f"record."
            )
        if windows is not None and not mixing:
            # Whole blocks, of as many as are summed as one.
            unit = size
            while unit < reach:
                unit *= 2
            length = -(-max(CHUNK, 4 * reach) // unit) * unit
    drawn: Any = every[0]
    surveyed = survey and not traced
    if windows is not None and surveyed:
        # Of all lengths and from all over the starts; all end within the record.
        multiple = criterion.test_function.length_multiple
        shortest, longest = windows.lags(record, multiple)
        share = np.random.default_rng(1).random((2, SURVEYED))
        lag = multiple * (shortest + (share[1] * (longest - shortest + 1)).astype(int))
        room = np.minimum(size * blocks.number, n - begin - lag)
        start = begin + (share[0] * room).astype(int)
        drawn = WindowSet(start, start + lag)

    def of_equation(noisy: NoisyColumns, blocks: StartBlocks) -> EquationSums:
        sums = [_equation_sums(criterion, noisy, of, blocks, not traced) for of in every]
        return sums[0] if len(sums) == 1 else jax.tree.map(lambda *of: np.concatenate(of), *sums)

    surveys: list[list[Surveyed]] = []

    def of_chunk(here: Record, blocks: StartBlocks, begin: int) -> list[EquationSums]:
        sampled = [criterion.noisy_columns(equation, here) for equation in model.equations]
        there = drawn
        if surveyed and windows is not None:
            # Those of a record's windows that start in the blocks of a stretch of it.
            start, stop = (at - begin for at in drawn)
            inside = (start >= blocks.first) & (start < blocks.first + blocks.size * blocks.number)
            there = WindowSet(start[inside], stop[inside])
        if surveyed and there.start.size:
            records, pairs = (here, _disturbed(here, begin)), zip(model.equations, sampled)
            surveys.append([_surveyed(criterion, *pair, records, there) for pair in pairs])
        return [of_equation(noisy, blocks) for noisy in sampled]

    found = in_chunks(
        record,
        blocks,
        of_chunk,
        reach=reach,
        margin=criterion.test_function.margin,
        length=length,
        beside=(model, criterion, key),
    )

    def side_by_side(chunks: Leaf) -> Leaf:
        by_bin = xp.swapaxes(chunks, 0, 1)
        return by_bin.reshape(len(by_bin), -1, *by_bin.shape[3:])[:, : blocks.number]

    every_sums = [
        sums.each(side_by_side, noise_of_source=lambda of: of.sum(axis=0)) for sums in found
    ]
    for i, parts in enumerate(zip(*surveys)):
        every_sums[i] = dataclasses.replace(every_sums[i], survey=_survey(parts))

    def stages() -> tuple[tuple[EquationSums, ...], ...]:
        of_equations = iter(every_sums)
        return tuple(tuple(itertools.islice(of_equations, len(stage))) for stage in model.stages)

    if windows is None and not traced:
        # Whether some stage's moments lose more digits than its rows would. What is not finite is
        # for the fit to refuse.
        raw = ([e.with_noise(None).flattened().total() for e in stage] for stage in stages())
        grams = [np.asarray(sum_of_equations(stage).gram) for stage in raw]
        if any(np.isfinite(gram).all() and not gram_suffices(gram) for gram in grams):
            for i, equation in enumerate(model.equations):
                rows = np.asarray(criterion.rows(equation, record, key).columns).T
                factor = np.linalg.qr(rows, mode="r")
                every_sums[i] = dataclasses.replace(every_sums[i], factor=factor)
    # Of some starts it is not known how many windows there would be without gaps.
    offered = criterion.row_count(record) if end - begin == n else None
    sums = RecordingSums(
        stages(),
        np.asarray(every_sums[0].count.shape[-1]),
        xp.multiply(criterion.block_samples(record), record.time_step),
        np.asarray(np.nan if offered is None else float(offered)),
        np.asarray(end - begin),
        record.time_step,
        np.zeros(8, np.uint32) if traced else digest_of(model, record, criterion, key, bins),
        record.noise,
    )
    if traced:
        return sums
    # The order of axes in memory is one in which NumPy adds up: it must survive a file.
    return jax.tree.map(lambda leaf: np.asarray(leaf, order="C"), sums)


def stage_normal_equations(
    model: Model,
    record: Record,
    criterion: AbstractCriterion,
    key: Key[Array, ""] | None,
    *,
    blocks: bool = False,
) -> list[NormalEquations]:
    """Normal equations of each stage on one record.

    With `blocks`, the leading axis is one of short blocks of start times, each of
    `criterion.block_samples(record)` samples; without, and unless all windows are summed, it has
    length one.
    """
    sums = recording_sums(model, record, criterion, key, in_blocks=blocks)
    stages = jax.tree.map(lambda bins: bins[0], sums.stages)
    return [sum_of_equations(stage, names) for stage, names in zip(stages, model.stage_parameters)]


def _lengths(
    criterion: AbstractCriterion,
    windows: AllWindows,
    record: Record,
    bins: LengthBins | None,
    apart: bool,
) -> tuple[Lengths, ...]:
    """Window lengths, those longer than the law's apart: they reach further than a block."""
    n, law, reach = record.sample_count, criterion.law(record), windows.reach(record.sample_count)
    if bins is None:
        return (Lengths(LagBins(*(at[:, None] if apart else at[None] for at in law)), reach),)
    step = float(record.time_step)
    multiple = criterion.test_function.length_multiple
    cut = law_in_bins(law, bins, multiple * step, (n - 1) // multiple)
    longest = power_of_two(float(bins.edges[-1]) / step + 2)
    parts = (slice(bins.band[1]), reach), (slice(bins.band[1], None), longest)
    lengths = (Lengths(LagBins(*(leaf[i] for leaf in cut)), far) for i, far in parts)
    return tuple(of for of in lengths if of.lags.first.size)


def _survey(parts: Sequence[Surveyed]) -> Survey:
    """Rows of all chunks, and what they come to."""
    every = np.concatenate([p.rows for p in parts])
    # Each as its own array: in which order products add up depends on how they lie in memory.
    rows, finer, noise = np.ascontiguousarray(np.moveaxis(every, 1, 0))
    valid = np.flatnonzero(np.concatenate([p.valid for p in parts]))
    start = np.concatenate([p.start for p in parts])
    shown = valid[np.linspace(0, max(valid.size - 1, 0), min(valid.size, SHOWN)).astype(int)]
    shown = shown[np.argsort(start[shown], kind="stable")]
    quadrature = np.stack([each.T @ each for each in (rows - finer, finer)])
    reach: dict[str, Leaf] = {}
    for name in parts[0].reach:
        low, high = np.array([p.reach[name] for p in parts]).T
        reach[name] = np.array([low.min(), high.max()])
    covariance = noise.T @ noise / max(valid.size, 1)
    return Survey(covariance, quadrature, rows[shown], start[shown], reach)
