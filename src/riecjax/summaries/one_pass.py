"""One pass over a recording: cut it into parts, sum each, reduce what they say to the sums kept.

Every equation's columns are sampled once, chunk by chunk, and sums over blocks of starts are made
of them: moments of all windows, and, on request, a survey for checks and figures.
"""

# What the signals' noise adds to a row has no formula, since terms may be any expressions of the
# signals. So it is measured: white noise of each signal's level is added to the samples, and the
# columns without it are subtracted. The difference is exact where terms are linear in the signals,
# and right to first order in the noise where they are not.

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key

from riecjax.compilation import kept_jit
from riecjax.criteria.all_windows import Moments
from riecjax.criteria.criterion import SHORT_BLOCKS_OF_ROWS, AbstractCriterion
from riecjax.criteria.windows import (
    AllWindows,
    LagBins,
    LengthBins,
    StartBlocks,
    WindowSet,
    in_chunks,
    law_in_bins,
    power_of_two,
)
from riecjax.equations.dry_friction import InMotion
from riecjax.equations.equation import Equation, mixing_expressions
from riecjax.equations.expressions import evaluate
from riecjax.equations.model import Model
from riecjax.equations.noisy_columns import Columns, NoisyColumns, sampled_columns
from riecjax.errors import ModelError
from riecjax.leaves import Leaf, namespace, on_host
from riecjax.linear_algebra import gram_suffices
from riecjax.records.record import Record, both, filled_up
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
"""Starts to a part of a long recording."""
FILLED = (2**12, 2**15)
"""Samples that shorter recordings are filled up to."""
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


class Request(NamedTuple):
    """What to sum, as far as it is compiled in.

    **Fields:** `lengths` of windows that are summed in closed form, none where a criterion has
    single rows, and the shortest and longest lag of their law; in each block, rows that are
    `surveyed`, none unless a survey is asked for; whether the products with a `constant` are kept
    as well.
    """

    lengths: tuple[Lengths, ...] = ()
    band: tuple[Int[Leaf, ""] | int, Int[Leaf, ""] | int] = (0, 0)
    surveyed: int = 0
    constant: bool = True


class Surveyed(NamedTuple):
    """Rows of some windows in each block: by the criterion, by the finest quadrature, and what
    noise adds to them; where they start; least and largest argument of each basis."""

    rows: Float[Array, "blocks rows 3 columns"]
    start: Float[Array, "blocks rows"]
    valid: Bool[Array, "blocks rows"]
    reach: dict[str, Float[Array, "1 2"]]


PartSums = tuple[tuple[EquationSums, ...], Surveyed | None]
"""What a part says of one equation: sums over windows that reach ever further, with axes `(blocks,
bins)` and of sources `(chunks, bins)`, and a survey."""


@kept_jit
def part_sums(
    part: Record,
    blocks: StartBlocks,
    model: Model,
    criterion: AbstractCriterion,
    key: Key[Array, ""] | None,
    request: Request,
) -> list[list[PartSums]]:
    """What blocks of starts of a part of a recording say of each equation of each stage.

    Their size is traced where blocks are shorter than the longest window, or rows are drawn.
    """
    lengths = request.lengths
    drawn = None if lengths else criterion.draw(part, key, blocks.unpadded)

    def of_chunk(record: Record, blocks: StartBlocks) -> list[list[PartSums]]:
        # Every survey has noisy rows: what they are made of is evaluated once, for all.
        disturbed, windows = record, drawn
        if request.surveyed:
            disturbed = _disturbed(record)
        if request.surveyed and lengths:
            # In each block, at places and of lengths that are drawn once for all.
            share = np.random.default_rng(1).random((2, blocks.number, request.surveyed))
            start = blocks.first + blocks.size * jnp.arange(blocks.number)[:, None]
            start = start + (share[0] * blocks.size).astype(int)
            shortest, longest = request.band
            lag = shortest + (share[1] * (longest - shortest + 1)).astype(int)
            windows = WindowSet(start, start + criterion.test_function.length_multiple * lag)

        def of_equation(equation: Equation) -> PartSums:
            noisy, survey = criterion.noisy_columns(equation, record), None
            if request.surveyed and windows is not None:
                records = record, disturbed
                survey = _surveyed(criterion, equation, noisy.columns, records, blocks, windows)
            every = lengths if drawn is None else (drawn,)
            sums = tuple(_equation_sums(criterion, noisy, w, blocks, request) for w in every)
            return sums, survey

        return [[of_equation(equation) for equation in stage] for stage in model.stages]

    if not isinstance(blocks.size, int):
        return of_chunk(part, blocks)
    reach, margin = lengths[-1].reach, criterion.test_function.margin
    return in_chunks(part, blocks, of_chunk, reach=reach, margin=margin)


def _equation_sums(
    criterion: AbstractCriterion,
    noisy: NoisyColumns,
    windows: Lengths | WindowSet,
    blocks: StartBlocks,
    request: Request,
) -> EquationSums:
    """Sums of an equation's rows over windows, and what noise adds to them: over all of some
    lengths; or where a criterion has single rows, each sample's or of windows that are drawn.

    The closed form sums the windows that start in a block from running sums over the block and its
    reach, so that a block shorter than a window costs as much as one as long. Where some lengths
    are longer, neighbouring blocks are summed as one, and the first of them holds the sums.
    """
    wider = 1
    if isinstance(windows, WindowSet):
        place = jnp.clip((windows.start / blocks.size).astype(jnp.int32), 0, blocks.number - 1)
        block_of_row, counted = (place if blocks.number > 1 else None), windows

        def products(columns: Columns) -> Moments:
            rows = criterion.rows_of(columns, windows, blocks.unpadded)
            sums = NormalEquations.of_rows(
                rows, block_of_row=block_of_row, block_count=blocks.number
            )
            return sums.moments, sums.count

    else:
        size, counted = blocks.size, windows.lags
        if isinstance(size, int) and windows is not request.lengths[0]:
            while wider * size < windows.reach and blocks.number % (2 * wider) == 0:
                wider *= 2
            blocks = blocks._replace(size=wider * size, number=blocks.number // wider)

        def products(columns: Columns) -> Moments:
            return criterion.test_function.moments(columns, windows.lags, blocks, windows.reach)

    columns, constant = noisy.columns, None
    if request.constant:
        # A column behind that is 1 at every sample, whose product with itself comes first.
        ones = jnp.zeros_like(columns.values[:, :1]).at[0].set(1.0)
        values = jnp.concatenate([columns.values, ones], axis=1)
        names = (*columns.parameters, "")
        moments, number = products(dataclasses.replace(columns, values=values, parameters=names))
        constant = jnp.roll(moments[..., -1, :], 1, axis=-1)
        moments = moments[..., :-1, :-1]
    else:
        moments, number = products(columns)
    sums = EquationSums(moments, number, columns.parameters, constant=constant)
    added = criterion.noise_of(noisy, counted, blocks, lambda moved: products(moved)[0])
    if added is not None:
        sums = sums.with_noise(*added)
    if isinstance(windows, WindowSet):  # of which there are no bins of lengths
        sums = jax.tree.map(lambda leaf: leaf[None], sums)

    def blocks_first(leaf: Leaf) -> Leaf:
        apart = jnp.swapaxes(leaf, 0, 1)[:, None]
        behind = [(0, 0), (0, wider - 1)] + [(0, 0)] * (apart.ndim - 2)
        return jnp.pad(apart, behind).reshape(-1, *apart.shape[2:])

    return sums.each(blocks_first, noise_of_source=lambda sources: sources[None])


def _disturbed(record: Record) -> Record:
    """The record with white noise of its size on each signal; any stretch has the same."""
    first = jnp.round(record.skipped / record.time_step).astype(int)
    place, names = first + jnp.arange(record.sample_count), sorted(record.arrays)
    white = jnp.asarray(NOISE, record.time_step.dtype)

    def disturbed(number: int, name: str) -> Signal:
        signal = record.signal(name)
        noise = record.noise.std(name) * white[(place + APART * number) % NOISE.size]
        return dataclasses.replace(signal, values=signal.values + noise)

    return record.with_signals({name: disturbed(i, name) for i, name in enumerate(names)})


def _surveyed(
    criterion: AbstractCriterion,
    equation: Equation,
    clean: Columns,
    records: tuple[Record, Record],
    blocks: StartBlocks,
    windows: WindowSet,
) -> Surveyed:
    """Rows of windows: of an equation's columns, and of what noise adds to these; of a record
    without and with noise."""
    record, disturbed = records
    noise, plain = (sampled_columns(equation, r, criterion.smoothness) for r in (disturbed, record))
    last = clean.sample_count - 1
    windows = WindowSet(*(at.reshape(-1, at.shape[-1]) for at in windows))
    shape = windows.start.shape
    inside = (windows.stop < blocks.unpadded).ravel()
    flat = WindowSet(*(jnp.minimum(jnp.maximum(at, 0), last).ravel() for at in windows))

    def rows(by: AbstractCriterion, columns: Columns) -> tuple[Array, Array]:
        found = by.rows_of(columns, flat, blocks.unpadded)
        valid: Any = both(inside, found.valid)
        return jnp.where(valid[:, None], found.columns.T, 0.0), valid.reshape(shape)

    (values, valid), finer = rows(criterion, clean), criterion.finest()
    by_finest = values if finer is criterion else rows(finer, clean)[0]
    every = jnp.stack([values, by_finest, rows(criterion, noise - plain)[0]], axis=-2)
    reaches = {}
    real = jnp.arange(record.sample_count) < blocks.unpadded
    for term in equation.terms:
        term = term.term if isinstance(term, InMotion) else term
        if term.basis is not None:
            argument = evaluate(term.of, record).values
            low = jnp.min(argument, where=real, initial=jnp.inf)
            high = jnp.max(argument, where=real, initial=-jnp.inf)
            reaches[str(term.name)] = jnp.stack([low, high])[None]
    at = jnp.clip(jnp.floor(flat.start).astype(int), 0, last)
    start = record.elapsed[at].reshape(shape)
    return Surveyed(every.reshape(*shape, *every.shape[1:]), start, valid, reaches)


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

SURVEYED = 2048
"""Rows of a recording that a survey looks at, about."""
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


def traced_sums(
    model: Model,
    record: Record,
    criterion: AbstractCriterion,
    key: Key[Array, ""] | None,
    *,
    apart: bool = False,
    blocks: bool = True,
) -> RecordingSums:
    """Moments of one record, for code that is traced: shapes are those of the record.

    **Arguments:** `apart`, windows of each length by themselves, where the test function asks for
    that; `blocks`, of starts, where rows are not summed in one.
    """
    n, windows = record.sample_count, criterion.all_windows
    size = criterion.block_samples(record) if blocks or windows is not None else n
    number = -(-n // size)
    if windows is not None:
        law = jax.tree.map(
            lambda lags: lags[:, None] if apart else lags[None], criterion.law(record)
        )
        request = Request((Lengths(law, windows.reach(n)),), constant=False)
    else:
        size, request = jnp.asarray(size), Request(constant=False)
    starts = StartBlocks(0, size, number, n)

    def bins_first(blocks: Leaf) -> Leaf:
        return jnp.swapaxes(blocks, 0, 1)

    stages = [
        [
            sums.each(bins_first, noise_of_source=lambda chunks: chunks.sum(0))
            for (sums,), _ in stage
        ]
        for stage in part_sums(record, starts, model, criterion, key, request)
    ]
    return _of_recording(stages, record, criterion, n, record.time_step, np.zeros(8, np.uint32))


@eqx.filter_jit
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
    sums = traced_sums(model, record, criterion, key, blocks=blocks)
    stages = jax.tree.map(lambda bins: bins[0], sums.stages)
    return [sum_of_equations(stage, names) for stage, names in zip(stages, model.stage_parameters)]


def _of_recording(
    stages: Sequence[Sequence[EquationSums]],
    record: Record,
    criterion: AbstractCriterion,
    samples: int,
    step: Leaf,
    digest: np.ndarray,
) -> RecordingSums:
    """The sums of so many of a record's samples, `step` seconds apart."""
    # Of some starts it is not known how many windows there would be without gaps.
    offered = criterion.row_count(record) if samples == record.sample_count else None
    return RecordingSums(
        tuple(map(tuple, stages)),
        np.asarray(stages[0][0].count.shape[-1]),
        namespace(step).multiply(criterion.block_samples(record), step),
        np.asarray(np.nan if offered is None else float(offered)),
        np.asarray(samples),
        step,
        digest,
        record.noise,
    )


# What overflows is for the fit to refuse.
@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def recording_sums(
    model: Model,
    record: Record,
    criterion: AbstractCriterion,
    key: Key[Array, ""] | None,
    bins: LengthBins | None,
    survey: bool = False,
    starts: tuple[int, int] | None = None,
) -> RecordingSums:
    """One recording, summed in one pass (not under jit); arguments as for [`summarise`][].

    `starts`, first of the starts that are summed and one beyond the last; all, unless others see
    to the rest: then see [`stretch_starts`][].

    **Raises:** `ModelError` for an expression that mixes samples of a long recording.
    """
    n, step = record.sample_count, float(record.time_step)
    mixing = mixing_expressions(model.equations, record)
    windows = criterion.all_windows
    if mixing and (n > PART or (windows is not None and windows.in_chunks(record))):
        raise ModelError(
            f"{mixing[0]} mixes samples (a mean, a difference, a filter), and a record this "
            f"long is worked through in chunks. Compute it beforehand as a signal of the "
            f"record."
        )
    begin, end = starts or (0, n)
    block = unit = criterion.block_samples(record)
    # What mixes samples would mix those that the record is filled up with. Starts of a part, and
    # samples that it is filled up to; `None` to leave the record as it is.
    width, filled = n, None
    if not mixing:
        filled = next((length for length in FILLED if length >= n), power_of_two(n))
    reach = 0
    if windows is not None:
        weight = criterion.test_function
        lengths = _lengths(criterion, windows, record, bins)
        reach, longest = lengths[-1].reach, windows.reach(n)
        lags = windows.lags(n, record.time_step, weight.length_multiple)
        of_windows = lengths, (jnp.asarray(lags[0]), jnp.asarray(lags[1]))
        if block < longest:
            size, number = jnp.asarray(block), 2
            request = Request(*of_windows, survey * SURVEYED // 2)
        else:
            unit = longest
            if filled is not None and n > FILLED[-1]:
                width = max(PART, 4 * longest)
                filled = width + reach + 2 * weight.margin
            elif filled is not None:
                width = filled
            looked_at = (n if filled is None else filled) // (1 if width <= FILLED[0] else 4)
            size, number = longest, -(-width // longest)
            request = Request(*of_windows, survey * max(SURVEYED * longest // looked_at, 1))
    else:
        size, number = jnp.asarray(block), SHORT_BLOCKS_OF_ROWS
        request = Request(surveyed=int(survey))

    def parts() -> Iterator[tuple[Record, StartBlocks]]:
        """The recording cut into parts, each with what its windows reach beyond it."""
        if filled is None:
            whole = dataclasses.replace(record, skipped=np.zeros(()))
            yield whole, StartBlocks(0, size, number, n)
            return
        margin = criterion.test_function.margin
        for start in range(begin, end, width):
            first = max(start - margin, 0)
            stop = min(start + width + reach + margin, n)
            samples = filled_up(record, filled, first, stop)
            ends = jnp.asarray(start - first), jnp.asarray(stop - first)
            yield samples, StartBlocks(ends[0], size, number, ends[1])

    given = model, criterion, key if windows is None else None, request
    found = [jax.tree.map(np.asarray, part_sums(*part, *given)) for part in parts()]
    count, grouped = -(-(end - begin) // unit), block // unit

    def in_bins(blocks: Leaf) -> Leaf:
        bins_first = np.moveaxis(np.asarray(blocks)[:count], 1, 0)
        return np.add.reduceat(bins_first, np.arange(0, count, grouped), axis=1)

    def joined(of_parts: Sequence[PartSums]) -> EquationSums:
        """An equation's sums: blocks, or chunks, of all parts one after the other; then bins of all
        lengths."""
        lengths = [
            jax.tree.map(lambda *leaves: np.concatenate(leaves), *group)
            for group in zip(*(sums for sums, _ in of_parts))
        ]
        sums: EquationSums = jax.tree.map(lambda *of: np.concatenate(of, axis=1), *lengths)
        surveys = [rows for _, rows in of_parts if rows is not None]
        surveyed = _survey(surveys, float(record.skipped)) if surveys else None
        sums = sums.each(in_bins, noise_of_source=lambda chunks: chunks.sum(0))
        return dataclasses.replace(sums, survey=surveyed)

    stages = [[joined(equation) for equation in zip(*stage)] for stage in zip(*found)]
    if windows is None:
        # Whether some stage's moments lose more digits than its rows would. What is not finite is
        # for the fit to refuse.
        raw = ([e.with_noise(None).flattened().total() for e in stage] for stage in stages)
        grams = [np.asarray(sum_of_equations(stage).gram) for stage in raw]
        if any(np.isfinite(gram).all() and not gram_suffices(gram) for gram in grams):
            rows_of = eqx.filter_jit(criterion.rows)
            for stage, equations in zip(stages, model.stages):
                rows = (np.asarray(rows_of(e, record, key).columns).T for e in equations)
                stage[:] = [
                    dataclasses.replace(sums, factor=np.linalg.qr(columns, mode="r"))
                    for sums, columns in zip(stage, rows)
                ]
    digest = digest_of(model, record, criterion, key, bins)
    sums = _of_recording(stages, record, criterion, end - begin, np.asarray(step), digest)
    # The order of axes in memory is one in which NumPy adds up: it must survive a file.
    return jax.tree.map(lambda leaf: np.asarray(leaf, order="C"), sums)


def _lengths(
    criterion: AbstractCriterion, windows: AllWindows, record: Record, bins: LengthBins | None
) -> tuple[Lengths, ...]:
    """Window lengths, those longer than the law's apart: they reach further than a block."""
    n, step = record.sample_count, float(record.time_step)
    law, reach = on_host(criterion.law(record)), windows.reach(n)
    if bins is None:
        return (Lengths(jax.tree.map(lambda leaf: leaf[None], law), reach),)
    multiple = criterion.test_function.length_multiple
    cut = law_in_bins(law, bins, multiple * step, (n - 1) // multiple)
    beyond = bins.band[1]
    if beyond == bins.edges.size - 1:
        return (Lengths(cut, reach),)
    longest = power_of_two(float(bins.edges[-1]) / step + 2)
    parts = (slice(beyond), reach), (slice(beyond, None), longest)
    return tuple(
        Lengths(jax.tree.map(lambda leaf, i=i: leaf[i], cut), farthest) for i, farthest in parts
    )


def _survey(parts: Sequence[Surveyed], skipped: float) -> Survey:
    """Rows of all parts, the first sample at `skipped` seconds, and what they come to."""
    every = np.concatenate([p.rows.reshape(-1, *p.rows.shape[-2:]) for p in parts])
    # Each as its own array: in which order products add up depends on how they lie in memory.
    rows, finer, noise = np.ascontiguousarray(np.moveaxis(every, 1, 0))
    valid = np.flatnonzero(np.concatenate([p.valid.ravel() for p in parts]))
    start = skipped + np.concatenate([p.start.ravel() for p in parts])
    shown = valid[np.linspace(0, max(valid.size - 1, 0), min(valid.size, SHOWN)).astype(int)]
    shown = shown[np.argsort(start[shown], kind="stable")]
    quadrature = np.stack([each.T @ each for each in (rows - finer, finer)])
    reach: dict[str, Leaf] = {}
    for name in parts[0].reach:
        low, high = np.concatenate([p.reach[name] for p in parts]).T
        reach[name] = np.array([low.min(), high.max()])
    covariance = noise.T @ noise / max(valid.size, 1)
    return Survey(covariance, quadrature, rows[shown], start[shown], reach)
