"""Estimates at several window lengths: the standard test of whether a model is exact enough."""

import itertools
from collections.abc import Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from riecjax.compilation import kept_jit
from riecjax.criteria.criterion import RIEC, AbstractCriterion
from riecjax.equations.equation import Equation
from riecjax.equations.procedure import HasProcedure, Procedure, as_procedure
from riecjax.errors import DataError, renamed, require
from riecjax.estimation.parameters import ParameterPlan, Sharing, plan_parameters
from riecjax.estimation.stages import found_values, solve_stages, stages_over_records
from riecjax.leaves import namespace
from riecjax.records.record import Record, Records
from riecjax.studies.drift import WindowSweep
from riecjax.summaries.blocks import FEWEST_WINDOWS, ShortBlocks, blocks_in_use, merge_blocks
from riecjax.summaries.normal_equations import NormalEquations
from riecjax.summaries.summarise import summed
from riecjax.summaries.summary import Summary
from riecjax.summaries.task import task
from riecjax.uncertainty.block_statistics import block_influence

FEWEST_SAMPLES = 4
"""Samples that the shortest window of a sweep spans at least."""
FEWEST_STRETCHES = 10
"""Longest windows that the records hold at least, end to end."""
SHARE_OF_BLOCKS = 0.5
"""A length with windows in less than this share of the blocks that another has gets no estimate."""
LONGER = 2.0
"""Reach of a sweep beyond beta. Below alpha it has none: windows shorter than those that were asked
for show motions that the model was never meant for, and nearly every model fails there."""


@renamed(own="per_record")
def window_sweep(
    model: Equation | Procedure | HasProcedure,
    records: Records | Summary,
    criterion: AbstractCriterion | None = None,
    *,
    key: Key[Array, ""] | None = None,
    known: Mapping[str, float | Array] | None = None,
    per_record: Sequence[str] = (),
    shortest: float | None = None,
    longest: float | None = None,
    bands: int = 10,
) -> WindowSweep:
    """Estimate a model's parameters again and again, with windows from short to long.

    Not under jit. Each band spans two bins of window lengths, about an octave, and shares one
    with the next. All windows of a band count, also where the criterion draws some.

    **Arguments:** as for [`identify`][], and

    - `records`: or a [`Summary`][] with bins of window lengths, from which no sample is read;
      `criterion` and what follows `per_record` are then those it was made with.
    - `shortest`, `longest`: ends of the sweep in seconds; by default the criterion's alpha, at
      least four samples, to twice its beta, at most a tenth of all records together.
    - `bands`: number of lengths, give or take one.

    **Raises:** as `identify`, and `DataError` if the records are too short for any sweep.
    """
    procedure = as_procedure(model)
    if isinstance(records, Summary):
        summary = records
        summary.require_model(procedure)
    else:
        require(
            "the criterion", criterion, RIEC, "rx.RIEC(rx.AllWindows(0.05, 0.5)), which has windows"
        )
        assert isinstance(criterion, RIEC)
        asked = task(procedure, records, criterion.every, key)
        edges = sweep_edges(
            asked.records, criterion, shortest=shortest, longest=longest, bands=bands
        )
        summary = summed(asked, bins=edges)
    plan = plan_parameters(procedure, len(summary.recordings), known, per_record)
    return _sweep(procedure, summary, plan, _bands(summary, shortest, longest))


def sweep_edges(
    records: Sequence[Record],
    criterion: AbstractCriterion,
    *,
    shortest: float | None = None,
    longest: float | None = None,
    bands: int = 10,
) -> Float[np.ndarray, " edges"]:
    """Edges of bins of window lengths in seconds that serve a sweep and the criterion's own band.

    Alpha and beta are among them: the lengths between them, below and above are each cut in
    equal ratios.

    **Raises:** `DataError` if the records are too short for any sweep.
    """
    lengths = [(float(r.time_step), r.sample_count) for r in records]
    low, high = _reach(lengths, criterion, shortest, longest)
    windows = criterion.windows
    assert windows is not None
    ratio = np.log(high / low) / (bands + 1)
    inner = [v for v in (float(windows.alpha), float(windows.beta)) if low < v < high]
    ends = [low, *inner, high]
    parts = [
        np.geomspace(a, b, max(round(np.log(b / a) / ratio), 1) + 1)
        for a, b in itertools.pairwise(ends)
    ]
    return np.unique(np.concatenate(parts))


def _reach(
    records: list[tuple[float, int]],
    criterion: AbstractCriterion,
    shortest: float | None,
    longest: float | None,
) -> tuple[float, float]:
    """Ends of a sweep in seconds, for records of a time step in seconds and a number of samples."""
    windows = criterion.windows
    assert windows is not None
    coarsest = max(step for step, _ in records)
    durations = [step * (samples - 1) for step, samples in records]
    low = max(float(windows.alpha), criterion.smoothness * FEWEST_SAMPLES * coarsest)
    high = min(LONGER * float(windows.beta), sum(durations) / FEWEST_STRETCHES, min(durations) / 2)
    low = low if shortest is None else shortest
    high = high if longest is None else longest
    if not 0 < low < high / 2:
        raise DataError(
            f"too short for a sweep over window lengths: from {low:.3g} to {high:.3g} s there are "
            f"not two bands. Record for longer, or choose a larger beta."
        )
    return low, high


def _bands(
    summary: Summary, shortest: float | None, longest: float | None
) -> list[tuple[int, int]]:
    """Pairs of neighbouring bins of a Summary within the reach of a sweep."""
    bins = summary.bins
    if bins is None:
        raise DataError(
            "this Summary keeps the sums of all window lengths together: make it with bins, "
            "rx.summarise(..., bins=12)."
        )
    lengths = [(float(r.time_step), int(r.samples)) for r in summary.recordings]
    law = summary.criterion.between(bins.edges[bins.band[0]], bins.edges[bins.band[1]])
    low, high = _reach(lengths, law, shortest, longest)
    inside = (bins.edges[:-1] > low * (1 - 1e-9)) & (bins.edges[1:] < high * (1 + 1e-9))
    found = [(i, i + 2) for i in range(inside.size - 1) if inside[i] and inside[i + 1]]
    if len(found) < 2:
        raise DataError(
            f"the Summary's bins of window lengths make fewer than two bands from {low:.3g} to "
            f"{high:.3g} s: make it anew with more of them."
        )
    return found


def _sweep(
    procedure: Procedure, summary: Summary, plan: ParameterPlan, bands: list[tuple[int, int]]
) -> WindowSweep:
    ends = np.array([summary.lengths_of(band) for band in bands])
    short = summary.short_blocks
    # Blocks are those of the longest windows at every length, so that estimates compare pairwise.
    used = blocks_in_use(short, np.asarray(FEWEST_WINDOWS * ends[-1, 1]))
    every = [summary.equations(band) for band in bands]
    equations = jax.tree.map(lambda *leaves: np.stack(leaves), *every)
    theta, influence, residual, noise = _estimates(equations, plan.given, short, used, plan.sharing)
    stages = [(label, names) for label, names in plan.stages if names]
    return WindowSweep(
        alpha=ends[:, 0],
        beta=ends[:, 1],
        theta=theta,
        influence=influence,
        relative_rms=residual,
        noise_rms=noise,
        block_count=namespace(used).sum(used),
        parameters=tuple(name for _, names in stages for name in names),
        units=tuple(plan.sharing.values(procedure.units).items()),
        stage_names=tuple(label for label, _ in stages),
    )


@kept_jit
def _estimates(
    equations: list[list[NormalEquations]],
    given: Mapping[str, Array],
    short: ShortBlocks,
    used: Int[Array, " records"],
    sharing: Sharing,
) -> tuple[Array, Array, Array, Array]:
    """What a `WindowSweep` holds: theta, influence, relative r.m.s. and the noise's."""

    def at_length(own: list[list[NormalEquations]]) -> tuple[Array, ...]:
        shared, _ = stages_over_records(own, sharing)
        stages = [merge_blocks(stage, short, used) for stage in shared]
        solutions = solve_stages(stages, given)
        return (
            jnp.concatenate([stage.solution.theta for stage in solutions]),
            block_influence(stages, given, found_values(solutions, given)),
            jnp.stack([stage.relative_rms for stage in solutions]),
            jnp.stack([stage.equations[0].noise_rms for stage in solutions]),
            jnp.min(jnp.stack([jnp.sum(stage.count > 0) for stage in stages])),
        )

    theta, influence, residual, noise, held = jax.lax.map(at_length, equations)
    known = (held >= SHARE_OF_BLOCKS * jnp.max(held)) & (held > 0)
    return (
        jnp.where(known[:, None], theta, jnp.nan),
        jnp.where(known[:, None, None], influence, jnp.nan),
        jnp.where(known[:, None], residual, jnp.nan),
        jnp.where(known[:, None], noise, jnp.nan),
    )
