"""Whether a signal is late against an equation: a delay estimated as a parameter, from sums.

A signal recorded tau late shows z(t) = s(t - tau), so that s(t) = z(t + tau): the equation holds of
the recording with that signal advanced by tau, and least squares leave least there. Sums over
windows are made anew with the signal advanced by k - 1, k and k + 1 samples. Between these every
moment is smooth in tau, a parabola to the accuracy of the motion's sampling,

    M(tau) = M(k - 1) tau (tau - 1) / 2 + M(k) (1 - tau^2) + M(k + 1) tau (tau + 1) / 2,

so that the estimate theta(tau) and what it leaves follow without another pass: tau is where it
leaves least, found to a small part of a sample. Its scatter is that of estimates without each block
of time in turn. Noise is taken off the moments as ever, which tau does not change.

**Late, or something else.** A mode that was left out, friction or a wrong stiffness make some delay
significant as well. They are no delay: with one, what was left beyond noise hardly becomes less.
Only a delay that explains nearly all of it is told.
"""

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from riecjax import tails
from riecjax.equations.hidden_modes import accelerated
from riecjax.equations.procedure import Procedure
from riecjax.estimation.estimate import Estimate
from riecjax.findings import Finding
from riecjax.records.record import Record
from riecjax.summaries.summarise import summed
from riecjax.summaries.summary import Summary
from riecjax.summaries.task import Task, record_keys, signals_read

LEVEL = 1e-3
"""Probability by chance, over all signals, below which a delay is told."""
SMALLEST = 0.02
"""Samples below which a delay is the quadrature's, which has no more accuracy."""
UNEXPLAINED = 0.1
"""Share of the energy left beyond noise that a delay leaves at most if it is the cause."""
OF_NOISE = 0.02
"""The same as a share of what noise leaves: no closer is known how much that is."""
MOVES = 1.0
"""Standard errors by which it moves some parameter at the least."""
LONGEST = 32
"""Samples of the longest delay that is looked for."""
LONGEST_SHARE = 20
"""It is at most this part of a record."""
MOST_SAMPLES = 2**17
"""Samples of each record that are looked at: a delay needs no more."""
GROUPS = 32
"""Blocks of time that are left out in turn at most."""
FEWEST_GROUPS = 6
LOST = 0.03
"""Energy left, as a share, from which a delay may be too long to be found by going downhill."""
COARSE = 3
"""Samples between the shifts that are then tried."""
STEPS = 5
"""Times that the middle of the three shifts is moved to where least is left."""
Blocks = Float[np.ndarray, "blocks q q"]


class SignalDelay(NamedTuple):
    """How late signals are against the equations that read them.

    **Fields:**

    - `signals`, which one clock samples: a motion and its derivatives go together.
    - `seconds` that they are late; negative if all others are. `error`: its standard error;
      `reach`, half an interval of level 1 - `LEVEL`.
    - `time_step` in seconds.
    - `left` and `left_as_recorded`: what the fit leaves beyond noise, rms over the target's, with
      the signals advanced by `seconds` and as they are; `noise`, what noise leaves.
    - `moved`: how much larger each parameter is with the signals advanced, over its value as it is.
    """

    signals: tuple[str, ...]
    seconds: float
    error: float
    reach: float
    time_step: float
    left: float
    left_as_recorded: float
    noise: float
    moved: Mapping[str, float]

    @property
    def samples(self) -> float:
        """The delay in samples."""
        return self.seconds / self.time_step

    @property
    def significant(self) -> bool:
        """Whether it is more than chance and quadrature make."""
        return abs(self.seconds) > self.reach and abs(self.samples) > SMALLEST

    @property
    def explains(self) -> bool:
        """Whether the fit leaves hardly more than noise with the signals advanced."""
        most = max(UNEXPLAINED * self.left_as_recorded**2, OF_NOISE * self.noise**2)
        return self.left**2 <= most


def signal_delays(
    procedure: Procedure, records: Sequence[Record], estimate: Estimate
) -> list[SignalDelay]:
    """The delay of each input, and of each motion against the first (not under jit).

    None are looked for in models with hidden elements or parameters of each recording, with windows
    drawn at random, and in records too short for their blocks to scatter.

    **Raises:** as `summarise`.
    """
    criterion, step = estimate.criterion, float(records[0].time_step)
    own = any(name.endswith("]") for name in estimate.parameters)
    if procedure.has_hidden or own or not criterion.in_closed_form or estimate.summary is None:
        return []
    records = [each.part(0, min(each.sample_count, MOST_SAMPLES)) for each in records]
    reach = min(LONGEST, min(each.sample_count for each in records) // LONGEST_SHARE)
    read = {n for each in records for n in signals_read(procedure, each, criterion)}
    groups = _clocks(procedure, read)
    if reach < 2 or int(estimate.block_count) < FEWEST_GROUPS or not groups:
        return []
    level = LEVEL / len(groups)
    found = (_Search(procedure, records, estimate, g, reach).delay(level, step) for g in groups)
    return [one for one in found if one is not None]


def late_signals(
    procedure: Procedure, records: Sequence[Record], estimate: Estimate
) -> Iterator[Finding]:
    """`late_signal` of the delay that explains most, if one explains what the fit leaves.

    **Raises:** as [`signal_delays`][].
    """
    delays = signal_delays(procedure, records, estimate)
    causes = [one for one in delays if one.significant and one.explains and _matters(one, estimate)]
    if not causes:
        return
    one = min(causes, key=lambda each: each.left)
    names, late = " and ".join(one.signals), one.seconds > 0
    most = max(one.moved, key=lambda name: abs(one.moved[name]))
    shift = tuple(w for n in one.signals for w in ("--shift", f"{n}={one.seconds:.4g}"))
    yield Finding(
        "late_signal",
        f"{names} {'come' if len(one.signals) > 1 else 'comes'} {1e3 * abs(one.seconds):.3g} ms "
        f"({abs(one.samples):.3g} samples, +-{1e3 * one.reach:.2g} ms) "
        f"{'later' if late else 'earlier'} than the equation says: "
        f"{'late, or low-passed' if late else 'all others are late, or low-passed'}. With that "
        f"taken off, the model leaves {100 * one.left:.2g} % of the target beyond noise instead of "
        f"{100 * one.left_as_recorded:.2g} %, and {most} changes by {100 * one.moved[most]:+.2g} "
        f"%. Shift it (on the command line: {' '.join(shift)}), or record all by one clock.",
        one.signals,
        tuple(one.moved),
        doubts={name: abs(share) for name, share in one.moved.items()},
        remedy=shift,
        step=f"Advance {names} by {1e3 * one.seconds:.3g} ms"
        if late
        else f"Delay {names} by {-1e3 * one.seconds:.3g} ms",
    )


def _matters(one: SignalDelay, estimate: Estimate) -> bool:
    errors = dict(zip(estimate.parameters, np.asarray(estimate.standard_errors, float)))
    return any(
        abs(share * float(estimate[name])) > MOVES * errors[name]
        for name, share in one.moved.items()
    )


def _clocks(procedure: Procedure, read: set[str]) -> list[tuple[str, ...]]:
    """Signals that are shifted together: inputs one by one, a motion with its derivatives.

    All at once cannot be late against an equation, so that the first body's motion is left out, or
    the first signal.
    """
    groups: list[set[str]] = [{name} for name in sorted(read)]
    for equation in procedure.equations:
        for pair in equation.derivatives:
            one = set().union(*(g for g in groups if g & {*pair}))
            groups = [g for g in groups if not g & {*pair}] + ([one] if one else [])
    bodies = [name for e in procedure.equations for name in accelerated(e)]
    groups.sort(key=lambda g: (not g & {*bodies[:1]}, sorted(g)))
    return [tuple(sorted(g)) for g in groups[1:]]


class _Stage(NamedTuple):
    """Sums of a stage by block of time, less noise; and those of noise."""

    names: tuple[str, ...]
    clean: Blocks
    noise: Blocks


class _Solved(NamedTuple):
    values: dict[str, float]
    left: float
    noise: float


@dataclasses.dataclass
class _Search:
    """The search for the delay of some signals."""

    procedure: Procedure
    records: Sequence[Record]
    estimate: Estimate
    signals: tuple[str, ...]
    reach: int

    def __post_init__(self) -> None:
        self.kept: dict[int, list[_Stage]] = {}
        zero, one = self.sums(0), self.sums(1)
        differ = (np.any(a.clean != b.clean) for a, b in zip(zero, one))
        self.reading = [i for i, other in enumerate(differ) if other]
        rows = zero[0].clean[:, 0, 0]
        count = min(int(self.estimate.block_count), GROUPS)
        self.groups = np.array_split(np.flatnonzero(rows != 0), count)

    def sums(self, shift: int) -> list[_Stage]:
        """Of the records with the signals advanced by so many samples."""
        if shift not in self.kept:
            records = [advanced(each, self.signals, shift, self.reach) for each in self.records]
            self.kept[shift] = _stages(sums_like(self.procedure, records, self.estimate))
        return self.kept[shift]

    # Values too large to be squared leave no finite sum, and no delay.
    @np.errstate(over="ignore", invalid="ignore")
    def delay(self, level: float, step: float) -> SignalDelay | None:
        """The delay, if one is found."""
        before = self.solved(0, 0.0)
        middle, moved = self.descended(0)
        after = self.solved(middle, moved)
        if before.left > LOST and not after.left < UNEXPLAINED * before.left:
            every = range(1 - self.reach, self.reach, COARSE)
            middle, moved = self.descended(min(every, key=lambda k: self.solved(k, 0.0).left))
            after = self.solved(middle, moved)
        if not np.isfinite(after.left):
            return None
        without = np.array([self.lowest(middle, group, moved) for group in self.groups])
        count = without.size
        error = np.sqrt((count - 1) / count * np.sum((without - without.mean()) ** 2))
        return SignalDelay(
            self.signals,
            (middle + moved) * step,
            error * step,
            float(tails.student(level / 2, count - 1)) * error * step,
            step,
            float(after.left**0.5),
            float(before.left**0.5),
            after.noise**0.5,
            {
                name: after.values[name] / value - 1
                for name, value in before.values.items()
                if name in self.estimate.parameters and value
            },
        )

    def descended(self, middle: int) -> tuple[int, float]:
        """The nearest shift where least is left, as whole samples and a part; NaN if not found."""
        moved = float("nan")
        for _ in range(STEPS):
            moved = self.lowest(middle)
            if not np.isfinite(moved) or abs(moved) <= 0.75:
                break
            middle = round(np.clip(middle + moved, 1 - self.reach, self.reach - 1))
        return middle, moved if abs(moved) <= 1 else float("nan")

    def lowest(self, middle: int, left_out: np.ndarray | None = None, near: float = 0.0) -> float:
        """Samples from the middle shift to where the fit leaves least; NaN if it has no minimum."""
        every = self.around(middle, left_out)
        at, steps = near, (1.0, 0.3, 0.1) if left_out is None else (0.1, 0.1)
        for h in steps:
            low, here, high = (self.solve(every, at + k * h).left for k in (-1, 0, 1))
            bend = low - 2 * here + high
            if not bend > 0:
                return float("nan")
            at = float(np.clip(at + h / 2 * (low - high) / bend, -self.reach, self.reach))
            if abs(at) > 1.5:
                break  # a parabola through the three reaches no further
        return at

    def around(self, middle: int, left_out: np.ndarray | None = None) -> list[list[_Stage]]:
        """Sums over all blocks, but some, at a shift and one sample to either side of it."""
        every = (self.sums(middle + k) for k in (-1, 0, 1))
        return [[_total(stage, left_out) for stage in stages] for stages in every]

    def solve(self, three: Sequence[Sequence[_Stage]], at: float) -> _Solved:
        return _solve(_between(three, at), self.estimate.known, self.reading)

    def solved(self, middle: int, at: float) -> _Solved:
        """Values and what is left, as energy that is not below zero."""
        found = self.solve(self.around(middle), at)
        return found._replace(left=np.maximum(found.left, 0.0), noise=max(found.noise, 0.0))


def advanced(record: Record, signals: Sequence[str], shift: int, reach: int) -> Record:
    """A record without `reach` samples at either end, some signals advanced by whole samples."""
    n = record.sample_count
    here, there = slice(reach, n - reach), slice(reach + shift, n - reach + shift)
    inner = record.part(here.start, here.stop)
    moved = {name: record.arrays[name][there] for name in signals}
    missing = {n: record.missing[n][there] for n in signals if n in record.missing}
    return inner.with_signals(moved, missing=missing, noise=record.noise.of(*signals))


def sums_like(procedure: Procedure, records: list[Record], estimate: Estimate) -> Summary:
    """A Summary of other records, made by the functions that were compiled for an estimate's."""
    made, criterion = estimate.summary, estimate.criterion
    assert made is not None
    windows = criterion.windows
    own = None
    if windows is not None:
        own = criterion.test_function.edges(float(windows.alpha), float(windows.beta))
    bins = None if own is not None or made.edges is None else np.asarray(made.edges)
    surveyed = made.recordings[0].stages[0][0].survey is not None
    task = Task(procedure, records, criterion, record_keys(None, len(records)))
    return summed(task, bins=bins, survey=surveyed)


def _stages(summary: Summary) -> list[_Stage]:
    found = []
    for stage in summary.equations():
        names = tuple(dict.fromkeys(name for e in stage for name in e.parameters))
        size, blocks = 1 + len(names), stage[0].count.size
        clean, noise = np.zeros((2, blocks, size, size))
        for equation in stage:
            place = [0, *(1 + names.index(name) for name in equation.parameters)]
            among = np.ix_(range(blocks), place, place)
            shape = (blocks, len(place), len(place))
            clean[among] += np.asarray(equation.clean).reshape(shape)
            if equation.noise is not None:
                noise[among] += np.asarray(equation.noise).reshape(shape)
        found.append(_Stage(names, clean, noise))
    return found


def _total(stage: _Stage, left_out: np.ndarray | None = None) -> _Stage:
    def of(blocks: Blocks) -> Blocks:
        total = blocks.sum(0)
        return total if left_out is None else total - blocks[left_out].sum(0)

    return _Stage(stage.names, of(stage.clean), of(stage.noise))


def _between(parts: Sequence[Sequence[_Stage]], at: float) -> list[_Stage]:
    """Sums at a shift between three."""
    shares = at * (at - 1) / 2, 1 - at**2, at * (at + 1) / 2

    def mixed(of: Callable[[_Stage], np.ndarray], stages: Sequence[_Stage]) -> np.ndarray:
        return sum((w * of(s) for w, s in zip(shares, stages)), np.zeros(()))

    return [
        _Stage(three[0].names, mixed(lambda s: s.clean, three), mixed(lambda s: s.noise, three))
        for three in zip(*parts)
    ]


def _solve(stages: Sequence[_Stage], known: Mapping, reading: Sequence[int]) -> _Solved:
    """Values of all stages in turn, and what those that read the signals leave, as energy."""
    values, left, noise = {n: float(v) for n, v in known.items()}, 0.0, 0.0
    for i, (names, clean, noisy) in enumerate(stages):
        free = [name for name in names if name not in values]
        mix = np.zeros((1 + len(free), 1 + len(names)))
        mix[0] = [1.0, *(-values.get(name, 0.0) for name in names)]
        for row, name in enumerate(free, 1):
            mix[row, 1 + names.index(name)] = 1.0
        moments = mix @ clean @ mix.T
        if not np.isfinite(moments).all():
            return _Solved(values, float("nan"), 0.0)
        scale = 1 / np.sqrt(np.maximum(np.diagonal(moments), np.finfo(float).tiny))
        scaled = moments * scale[:, None] * scale
        theta = np.linalg.lstsq(scaled[1:, 1:], scaled[1:, 0], rcond=1e-12)[0]
        theta = theta * scale[1:] / scale[0]
        values |= dict(zip(free, theta.tolist()))
        if i in reading and free:
            row = np.array([1.0, *-theta]) @ mix
            target = (mix[0] @ (clean + noisy) @ mix[0]) or 1.0
            left += float(row @ clean @ row / target)
            noise += float(row @ noisy @ row / target)
    return _Solved(values, left, noise)
