"""Estimates at several window lengths: how far they drift, and whether chance explains it.

With an exact model every window length finds the same parameters, up to scatter. What a model
leaves out weighs differently at different lengths, and the estimates drift.
"""

import itertools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int, Key

from riecjax import arrays as xp
from riecjax import tails
from riecjax.arrays import Array
from riecjax.criteria.criterion import RIEC, AbstractCriterion
from riecjax.equations.equation import Equation
from riecjax.equations.model import Model, as_model
from riecjax.errors import DataError, require
from riecjax.estimation.parameters import ParameterTable, plan_parameters
from riecjax.estimation.stages import solve_stages, stages_over_records
from riecjax.findings import SMOOTH, Finding, in_percent
from riecjax.leaves import Leaf, finite, size_of, told
from riecjax.records.record import Record, Records
from riecjax.shows import Drawn
from riecjax.summaries.normal_equations import (
    FEWEST_WINDOWS,
    NormalEquations,
    ShortBlocks,
    blocks_in_use,
)
from riecjax.summaries.summarise import ready, summed, task
from riecjax.summaries.summary import Summary
from riecjax.uncertainty.covariances import block_influence

if TYPE_CHECKING:
    from riecjax.estimation.estimate import Estimate

# How estimates at two lengths are compared. Near the solution an estimate is a sum over blocks of
# time, theta = theta_0 + sum_b d_b with the influence d_b = G^-1 A_b' e_b of each block (G the Gram
# matrix, e_b the block's residuals), and independent blocks give it the variance
# n / (n - 1) sum_b d_b^2: the scores of n blocks sum to zero at the solution, which takes one
# degree of freedom. Two estimates from the same record are far from independent, since they share
# its noise and its motion. But the difference of the two has the influence d_b1 - d_b2, block by
# block, and the variance n / (n - 1) sum_b (d_b1 - d_b2)^2: a paired test, in which whatever both
# share cancels. So a drift is seen that is much smaller than either standard error. Of all pairs of
# lengths the most significant is tested, at the level over the number of pairs (Bonferroni).

LEVEL = 0.05
"""Probability by chance below which a drift is told."""
SMALLEST_DRIFT = 0.005
"""Share of a parameter below which a drift does not matter."""
STEADY = 0.01
"""Share within which estimates at neighbouring lengths are called steady."""
MOST = 0.5
"""Share of what is left from which its noise explains a drift."""
SMALL_NOISE = 0.1
"""Share of what is left below which its noise is not worth a word."""


class WindowSweep(Drawn, eqx.Module):
    """Estimates at several window lengths, from the same records.

    **Fields:**

    - `alpha`, `beta`: shortest and longest window of each band in seconds, shape `(bands,)`.
    - `theta`: estimates, shape `(bands, p)`; NaN at lengths that hardly fit between the record's
      gaps.
    - `influence`: how far each block of time moves each estimate, shape `(bands, blocks, p)`; the
      blocks are the same at every length, so that estimates can be compared pairwise.
    - `relative_rms`: residual of each stage, and `noise_rms`, what of it the sensors' known noise
      makes, shape `(bands, stages)`.
    - `block_count`: blocks that hold rows.
    - `table`, `stage_names`: as in an estimate.
    - `answer`: values in windows of all lengths in use, by parameter.
    """

    name = "window_sweep"
    alpha: Float[Leaf, " bands"]
    beta: Float[Leaf, " bands"]
    theta: Float[Array, "bands p"]
    influence: Float[Array, "bands blocks p"]
    relative_rms: Float[Array, "bands stages"]
    noise_rms: Float[Array, "bands stages"]
    block_count: Int[Array, ""]
    table: ParameterTable
    stage_names: tuple[str, ...] = eqx.field(static=True)
    answer: Mapping[str, float]

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of those that are estimated."""
        return self.table.free

    @property
    def standard_errors(self) -> Float[Array, "bands p"]:
        """Standard error of each estimate."""
        return self._scatter(xp.moveaxis(self.influence, 1, -1))

    def _scatter(self, influence: Float[Leaf, "*n blocks"]) -> Float[Array, "*n"]:
        """Standard deviation of what blocks move by so much each."""
        factor = xp.divide(self.block_count, xp.maximum(self.block_count - 1, 1))
        return xp.sqrt(factor * xp.sum(xp.square(influence), axis=-1))

    def _limit(self, tests: float) -> float:
        """Standard deviations that the largest of so many independent ones seldom exceeds."""
        dof = max(int(self.block_count) - 1, 1)
        return float(tails.student(LEVEL / (2 * tests), dof))

    def _course(
        self, name: str
    ) -> tuple[Float[np.ndarray, " bands"], Float[np.ndarray, "bands blocks"]]:
        """Estimates of one parameter, and how far each block moves them."""
        j = self.parameters.index(name)
        return np.asarray(self.theta[:, j]), np.asarray(self.influence[:, :, j])

    def drift(self, name: str) -> tuple[int, int, float, float]:
        """The two lengths between which a parameter differs most significantly (not under jit).

        Lengths without an estimate are skipped.

        **Returns:** their indices, the difference of the estimates, and its standard error, in
        which what is common to both lengths cancels.
        """
        theta, influence = self._course(name)
        difference = theta[None, :] - theta[:, None]
        error = self._scatter(influence[None, :, :] - influence[:, None, :])
        significance = np.where(error > 0, np.abs(difference) / np.where(error > 0, error, 1), 0)
        largest = np.max(np.abs(theta), where=np.isfinite(theta), initial=0.0)
        relevant = np.abs(difference) > SMALLEST_DRIFT * largest
        first, last = np.unravel_index(np.argmax(significance * relevant), difference.shape)
        first, last = sorted((int(first), int(last)))
        return first, last, float(difference[first, last]), float(error[first, last])

    def away(self, name: str, value: float) -> float:
        """How far estimates lie from a value at most, beyond scatter (not under jit).

        Scatter is that of the difference from the length whose estimate is nearest to the value.
        """
        theta, influence = self._course(name)
        if not np.isfinite(theta).any():
            return 0.0
        nearest = int(np.nanargmin(np.abs(theta - value)))
        beyond = self._limit(max(theta.size - 1, 1)) * self._scatter(influence - influence[nearest])
        return float(np.nanmax(np.maximum(np.abs(theta - value) - beyond, 0.0)))

    def findings(self) -> list[Finding]:
        """`window_sensitive`, once, if parameters drift by more than their uncertainty.

        A paired test at the 5 % level, corrected for the number of pairs (Bonferroni), of a drift
        of at least half a percent.
        """
        bands = self.theta.shape[0]
        limit = self._limit(bands * (bands - 1) / 2)
        shares = {}
        for name in self.parameters:
            _, _, difference, error = self.drift(name)
            if abs(difference) > limit * error and error > 0:
                shares[name] = self._range(name)[2]
        if not shares:
            return []
        names = sorted(shares, key=lambda name: -shares[name])
        first, *others = names
        low, high = sorted(self._range(first)[:2])
        theta, unit = self.theta[:, self.parameters.index(first)], self.table[first].unit
        course = (
            f"{first} goes from {float(theta[low]):.4g} with windows of {self._band(low)} to "
            f"{float(theta[high]):.4g}{f' {unit}' if unit else ''} with {self._band(high)}"
        )
        listed = ", ".join(f"{name} by {in_percent(shares[name])}" for name in others)
        if others:
            course += f"; so do{'es' if len(others) == 1 else ''} {listed}"
        steadiness = f"At no two lengths do estimates agree to {in_percent(STEADY, 'g')}"
        if (steady := self.steady(names)) is not None:
            shortest, longest = steady
            steadiness = (
                f"In windows of {shortest:.3g} to {longest:.3g} s all are steady to "
                f"{in_percent(STEADY, 'g')}"
            )
        share = self.noise_share(first)
        cause = f"Noise makes {in_percent(share, '.0f')} of what the shorter ones leave"
        if share <= MOST:
            makes = f"{cause}: the" if share > SMALL_NOISE else "The"
            cause = f"{makes} model leaves something out"
        message = f"{course}. {steadiness}. {cause}."
        values = {name: self.answer[name] for name in names}
        doubts = {name: self.away(name, value) / size_of(value) for name, value in values.items()}
        found = Finding("window_sensitive", message, parameters=tuple(names), doubts=doubts)
        if share > MOST:
            step = "Take smooth windows, which read positions alone"
            found = found._replace(remedy=SMOOTH, step=step)
        return [found]

    def entry(self) -> dict[str, Any]:
        """Windows, estimates and what is left at each length, as plain data for JSON."""
        return {
            **told(self, "alpha", "beta"),
            "parameters": {
                name: {
                    "value": finite(self.theta[:, j]),
                    "std_error": finite(self.standard_errors[:, j]),
                }
                for j, name in enumerate(self.parameters)
            },
            "relative_rms": {
                label: finite(self.relative_rms[:, i]) for i, label in enumerate(self.stage_names)
            },
        }

    def _range(self, name: str) -> tuple[int, int, float]:
        """Lengths with the least and the largest estimate, and their distance as a share."""
        theta, _ = self._course(name)
        low, high = int(np.nanargmin(theta)), int(np.nanargmax(theta))
        return low, high, float((theta[high] - theta[low]) / np.nanmax(np.abs(theta)))

    def steady(self, names: Sequence[str]) -> tuple[float, float] | None:
        """The most neighbouring lengths at which parameters stay within a percent, in seconds.

        `None` where no two do. Of ranges of as many lengths the later one: long windows are what a
        reduced model is for.
        """
        theta = np.asarray(self.theta[:, [self.parameters.index(name) for name in names]])
        scale = np.nanmax(np.abs(theta), axis=0)
        runs = [
            (i, j)
            for i in range(len(theta))
            for j in range(i + 1, len(theta))
            if np.all(np.ptp(theta[i : j + 1], axis=0) <= STEADY * scale)
        ]
        if not runs:
            return None
        first, last = max(runs, key=lambda run: (run[1] - run[0], run[0]))
        return float(self.alpha[first]), float(self.beta[last])

    def noise_share(self, name: str) -> float:
        """How much of what windows leave is the sensors' noise, as energy.

        At the shorter of the two lengths between which a parameter goes farthest.
        """
        band = min(self._range(name)[:2])
        left, noise = np.asarray(self.relative_rms[band]), np.asarray(self.noise_rms[band])
        return min(float(np.sum(noise**2)) / size_of(np.sum(left**2)), 1.0)

    def _band(self, index: int) -> str:
        return f"{float(self.alpha[index]):.3g} to {float(self.beta[index]):.3g} s"


def unlike_windows(estimate: "Estimate", over_windows: "Estimate") -> list[Finding]:
    """`window_sensitive`, of an estimate without windows that differs from one over windows by more
    than chance makes both."""
    doubts = {}
    for name, share in estimate.moves_to(over_windows).items():
        value, other = float(estimate[name]), float(over_windows[name])
        errors = (float(each.standard_error(name)) for each in (estimate, over_windows))
        error = float(np.linalg.norm([*errors]))
        if abs(value - other) > float(tails.normal(LEVEL / 2)) * error:
            doubts[name] = share
    if not doubts:
        return []
    most = max(doubts, key=lambda name: doubts[name])
    single, other = (f"{float(each[most]):.4g}" for each in (estimate, over_windows))
    message = (
        f"{most} is {single} at single samples and {other} over windows, in which what the model "
        f"leaves out averages out: take windows (--criterion riec)."
    )
    step = "Integrate over windows"
    options = ("--criterion", "riec")
    return [
        Finding(
            "window_sensitive", message, (), tuple(doubts), doubts=doubts, remedy=options, step=step
        )
    ]


FEWEST_SAMPLES = 4
"""Samples that the shortest window spans at least."""
FEWEST_STRETCHES = 10
"""Longest windows that the records hold at least, end to end."""
LONGER = 2.0
"""Reach of a sweep beyond beta. Below alpha it has none: windows shorter than those that were asked
for show motions that the model was never meant for, and nearly every model fails there."""


def window_sweep(
    model: Equation | Model,
    records: Records | Summary,
    criterion: AbstractCriterion | None = None,
    *,
    key: Key[Array, ""] | None = None,
    known: Mapping[str, float | Array] | None = None,
    per_record: Sequence[str] = (),
    bands: int = 10,
) -> WindowSweep:
    """Estimate a model's parameters again and again, with windows from short to long.

    From the criterion's alpha, at least four samples, to twice its beta, at most a tenth of all
    records together. Not under jit. Each band spans two bins of window lengths, about an octave,
    and shares one with the next. All windows of a band count, also where the criterion draws some.

    **Arguments:** as for [`identify`][], and

    - `records`: or a [`Summary`][] with bins of window lengths, from which no sample is read;
      `criterion` and `bands` are then those it was made with.
    - `bands`: number of lengths, give or take one.

    **Raises:** as `identify`, and `DataError` if the records are too short for any sweep.
    """
    model = as_model(model)
    if isinstance(records, Summary):
        summary = records
        summary.require_model(model)
    else:
        require(
            "the criterion", criterion, RIEC, "rx.RIEC(rx.AllWindows(0.05, 0.5)), which has windows"
        )
        assert isinstance(criterion, RIEC)
        asked = task(model, ready(model, records), criterion.every, key)
        summary = summed(asked, bins=sweep_edges(asked.records, criterion, bands=bands))
    table = plan_parameters(model, len(summary.recordings), known, per_record)
    return sweep_of_sums(summary, table)


def sweep_of_sums(summary: Summary, table: ParameterTable) -> WindowSweep:
    """[`window_sweep`][] of what a table of parameters says, from sums in bins of window lengths.

    **Raises:** as it does.
    """
    # Bands are pairs of neighbouring bins of a Summary within the reach of the sweep.
    bins = summary.bins
    if bins is None:
        raise DataError(
            "this Summary keeps the sums of all window lengths together: make it with bins, "
            "rx.summarise(..., bins=12)."
        )
    lengths = [(float(r.time_step), int(r.samples)) for r in summary.recordings]
    law = summary.criterion.between(bins.edges[bins.band[0]], bins.edges[bins.band[1]])
    low, high = _reach(lengths, law)
    slack = 1 + 1e-9
    inside = (bins.edges[:-1] * slack > low) & (bins.edges[1:] < high * slack)
    pairs = [(i, i + 2) for i in range(inside.size - 1) if inside[i] and inside[i + 1]]
    if len(pairs) < 2:
        raise DataError(
            f"the Summary's bins of window lengths make fewer than two bands from {low:.3g} to "
            f"{high:.3g} s: make it anew with more of them."
        )
    ends = np.array([summary.lengths_of(pair) for pair in pairs])
    short = summary.short_blocks
    # Blocks are those of the longest windows at every length, so that estimates compare pairwise.
    used = blocks_in_use(short, np.asarray(FEWEST_WINDOWS * ends[-1, 1]))
    every = [_estimates(summary.equations(pair), table, short, used) for pair in pairs]
    *found, held = map(np.stack, zip(*every))
    # By the pass of all lengths in use.
    whole = _estimates(summary.equations(), table, short, used)[0]
    known = held > 0
    return WindowSweep(
        ends[:, 0],
        ends[:, 1],
        *(np.where(known.reshape(-1, *(1,) * (of.ndim - 1)), of, np.nan) for of in found),
        block_count=xp.sum(used),
        table=table,
        stage_names=tuple(label for label, names in table.stages if names),
        answer=dict(zip(table.free, np.asarray(whole, float).tolist())),
    )


def sweep_edges(
    records: Sequence[Record],
    criterion: AbstractCriterion,
    *,
    longest: float | None = None,
    bands: int = 10,
) -> Float[np.ndarray, " edges"]:
    """Edges of bins of window lengths in seconds that serve a sweep and the criterion's own band.

    Alpha and beta are among them: the lengths between them, below and above are each cut in
    equal ratios, up to the `longest` if that is given.

    **Raises:** `DataError` if the records are too short for any sweep.
    """
    lengths = [(float(r.time_step), r.sample_count) for r in records]
    low, high = _reach(lengths, criterion, longest)
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
    longest: float | None = None,
) -> tuple[float, float]:
    """Ends of a sweep in seconds, for records of a time step in seconds and a number of samples."""
    windows = criterion.windows
    assert windows is not None
    coarsest = max(step for step, _ in records)
    durations = [step * (samples - 1) for step, samples in records]
    low = max(float(windows.alpha), criterion.smoothness * FEWEST_SAMPLES * coarsest)
    high = min(LONGER * float(windows.beta), sum(durations) / FEWEST_STRETCHES, min(durations) / 2)
    high = high if longest is None else longest
    if not 0 < low < high / 2:
        raise DataError(
            f"too short for a sweep over window lengths: from {low:.3g} to {high:.3g} s there are "
            f"not two bands. Record for longer, or choose a larger beta."
        )
    return low, high


@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def _estimates(
    equations: list[list[NormalEquations]],
    table: ParameterTable,
    short: ShortBlocks,
    used: Int[Array, " records"],
) -> tuple[np.ndarray, ...]:
    """What a `WindowSweep` holds of one length, theta, influence, relative r.m.s. and the noise's,
    and in how many blocks each stage has windows."""
    shared, _ = stages_over_records(equations, table)
    stages = [stage.merged(short, used) for stage in shared]
    solutions, values = solve_stages(stages, table.known)
    return (
        np.concatenate([stage.solution.theta for stage in solutions]),
        block_influence(stages, table.known, values),
        np.array([stage.relative_rms for stage in solutions]),
        np.array([stage.noise_rms for stage in solutions]),
        np.min([np.sum(stage.count > 0) for stage in stages]),
    )
