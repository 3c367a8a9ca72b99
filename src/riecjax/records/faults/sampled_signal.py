"""A signal with what is asked of it, and what may be wrong with it: a `Fault`.

Of a signal: which values it takes, the quantum between them, its rest.

Rest is a stretch about zero in which a signal scatters no more than its noise. A motion that passes
through zero, or turns there, is within three standard deviations of the noise for a while too. But
over that stretch it moves, and its mean square is 2.5 to 4 times that of the noise alone.
"""

import functools
import shlex
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from riecjax.findings import Finding
from riecjax.records.record import Record, runs

MOST_OUTLIERS = 0.01
"""Share of samples; more of them are how the signal is."""
ROUNDING = 1e-9
"""Share of a signal's range within which values are one: computed ones differ in last digits."""
FEW_LEVELS = 20
"""Distinct values up to which a signal counts as a command or a relay, not as a sensor's."""


def rounding_of(samples: np.ndarray) -> float:
    """How far computed values may differ that are one: a share of the range without spikes."""
    if not samples.size:
        return 0.0
    whole = float(np.ptp(samples))
    usual = float(np.ptp(np.quantile(samples, [MOST_OUTLIERS, 1 - MOST_OUTLIERS])))
    # What is at rest has no range without its few moves.
    return ROUNDING * (usual or whole)


def size_of(samples: np.ndarray) -> float:
    """The largest size of those that are there, 1 of zeros: squares of other sizes may be none, or
    infinite."""
    return float(np.max(np.abs(samples), where=~np.isnan(samples), initial=0.0)) or 1.0


def spread_of(samples: np.ndarray) -> float:
    """Standard deviation of those that are there, of huge values and of tiny ones too."""
    size = size_of(samples)
    return size * float(np.nanstd(samples / size))


def levels_of(samples: np.ndarray, rounding: float) -> tuple[np.ndarray, np.ndarray]:
    """Distinct values, ascending, and how often each occurs."""
    distinct, counts = np.unique(samples, return_counts=True)
    new = np.diff(distinct, prepend=-np.inf) > rounding
    return distinct[new], np.add.reduceat(counts, np.flatnonzero(new))


def resolution_of(levels: np.ndarray) -> float:
    """The quantum whose multiples lie between neighbouring levels, 0 if there is none."""
    if levels.size < 3:
        return 0.0
    steps = np.diff(levels)
    # The smallest step carries rounding; the mean of all steps of about its size less of it.
    quantum = float(np.mean(steps[steps < 1.5 * np.min(steps)]))
    multiples = steps / quantum
    near = np.abs(multiples - np.round(multiples)) < 0.02 + 1e-3 * multiples
    return quantum if np.mean(near[multiples < 100]) > 0.99 else 0.0


def is_command(values: np.ndarray, levels: np.ndarray, rounding: float) -> bool:
    """Whether few values are taken, or more than half of the samples lie on straight lines, as of
    no sensor's signal."""
    if levels.size <= FEW_LEVELS:
        return True
    bend = np.diff(values, 2)
    inner = np.abs(bend[~np.isin(values[1:-1], levels[[0, -1]]) & ~np.isnan(bend)])
    return not inner.size or bool(np.mean(inner <= rounding) > 0.5)


ENOUGH = 2**12
"""Samples that tell whether one signal follows from others."""
FEWEST_SAMPLES = 50
"""Present samples below which only missing and constant signals are told of."""
LONGEST_REST = 0.5
"""Share of samples at one value past which that is where the signal rests."""


class SampledSignal(NamedTuple):
    """A signal of n samples with what several checks ask of it.

    **Fields:** `values`, shape `(n,)`, NaN in gaps; `time` in seconds from the recording's first
    sample, shape `(n,)`, and the `time_step`; `levels`, distinct values, ascending, and how often
    each occurs, the `counts`; `rounding`, the distance within which values are one; `resolution`,
    their distance where they are multiples of one, else 0; `run_starts`, the first sample of each
    run, a stretch of one exact value, and `run_lengths`, the samples in it; `is_command`, as no
    sensor's signal is.
    """

    name: str
    unit: str
    values: np.ndarray
    time: np.ndarray
    time_step: float
    levels: np.ndarray
    counts: np.ndarray
    rounding: float
    resolution: float
    run_starts: np.ndarray
    run_lengths: np.ndarray
    is_command: bool

    @property
    def sample_count(self) -> int:
        """Samples without those of gaps."""
        return int(self.counts.sum())

    @property
    def run_values(self) -> np.ndarray:
        """The value of each run."""
        return self.values[self.run_starts]

    def with_unit(self, value: float) -> str:
        """A value of the signal in words."""
        return f"{value + 0.0:.4g} {self.unit}".rstrip()


def sampled_signal(record: Record, name: str) -> SampledSignal:
    """A signal of a record.

    **Raises:** `DataError` for a signal that the record lacks.
    """
    signal = record.signal(name)
    values = signal.with_nan
    known = values[~np.isnan(values)]
    rounding = rounding_of(known)
    levels, counts = levels_of(known, rounding)
    starts = np.flatnonzero(np.concatenate([[True], values[1:] != values[:-1]]))
    return SampledSignal(
        name,
        signal.unit,
        values,
        np.asarray(record.elapsed),
        float(record.time_step),
        levels,
        counts,
        rounding,
        resolution_of(levels),
        starts,
        np.diff(starts, append=values.size),
        is_command(values, levels, rounding),
    )


@dataclass(frozen=True)
class Signals:
    """The signals of a record, of which some are looked at.

    **Fields:** `by_name`, all of them; `names` of those that are looked at; `computed`, those that
    no sensor recorded; `pairs` of a signal and its derivative.
    """

    by_name: Mapping[str, SampledSignal]
    names: Sequence[str]
    computed: Collection[str] = ()
    pairs: Sequence[tuple[str, str]] = ()

    @classmethod
    def of(
        cls,
        record: Record,
        names: Iterable[str],
        computed: Collection[str] = (),
        pairs: Iterable[tuple[str, str]] = (),
    ) -> "Signals":
        """Those of a record, these first.

        **Raises:** `DataError` for a signal that the record lacks.
        """
        names = tuple(dict.fromkeys(names))
        every = {n: sampled_signal(record, n) for n in dict.fromkeys([*names, *record.arrays])}
        return cls(every, names, computed, [p for p in pairs if {*p} <= {*every}])

    def beside(self, name: str) -> list[SampledSignal]:
        """All others."""
        return [signal for other, signal in self.by_name.items() if other != name]

    @functools.cached_property
    def recorded(self) -> dict[str, SampledSignal]:
        """Those of sensors, as far as their samples are enough to tell."""
        return {
            name: signal
            for name, signal in self.by_name.items()
            if name not in self.computed and signal.sample_count >= FEWEST_SAMPLES
        }


class Found(NamedTuple):
    """A fault of one signal.

    **Fields:** `said` of it, empty where it is real; `doubt` and `step`, as of a finding; `samples`
    that it spoiled, shape `(n,)`; `value` of the option against it, if that is not the signal's
    name; `advice` in place of the fault's, where no option helps; `signals` that have it together,
    all of which `said` names.
    """

    said: str
    doubt: float = 0.0
    samples: np.ndarray | None = None
    step: str = ""
    value: str = ""
    advice: str = ""
    signals: tuple[str, ...] = ()


@dataclass(frozen=True)
class Fault:
    """What may be wrong with one signal by itself: how it is found, said, and undone.

    **Fields:** `code` of its finding; `find`, where a signal has it; `advice`, what to do about it,
    with a place for the `option` that undoes it; and whether signals are looked at that were
    `computed`, or are constant or `short`.
    """

    code: str
    find: "Find"
    advice: str
    option: str = ""
    computed: bool = False
    short: bool = False

    def findings(self, name: str, signals: Signals) -> Iterator[Finding]:
        """What is said of one of the signals."""
        signal = signals.by_name[name]
        enough = signal.levels.size > 1 and signal.sample_count >= FEWEST_SAMPLES
        if (self.computed or name not in signals.computed) and (self.short or enough):
            every = self.find(signal, signals)
            yield from (self.finding(name, found) for found in every if found.said)

    def finding(self, name: str, found: Found) -> Finding:
        """What is said of a signal that has it."""
        helps = self.option and not found.advice
        remedy = (self.option, found.value or name) if helps else ()
        said = found.said if found.signals else f"{name}: {found.said}"
        advice = found.advice or self.advice.format(option=shlex.join(remedy))
        signals = found.signals or (name,)
        step = found.step.format(name)
        return Finding(
            self.code, f"{said} {advice}", signals, doubt=found.doubt, remedy=remedy, step=step
        )


Find = Callable[[SampledSignal, Signals], Iterator[Found]]


def fault(code: str, advice: str, option: str = "", **more: bool) -> Callable[[Find], Fault]:
    """A fault of what finds it; arguments are its fields."""
    return lambda find: Fault(code, find, advice, option, **more)


def percent(part: float, whole: float) -> str:
    """A share in words."""
    if not abs(whole) > 0:
        return "all"
    return f"{100 * part / whole:.3g} %"


NOISES, MOVES = 3.0, 1.0
"""What is about zero: so many standard deviations of noise, or usual changes over a sample."""
FEWEST = 6
"""Samples of a rest at the least, and twice the quanta that motion takes meanwhile."""
STILL = 1.5
"""Mean square of a rest at the most, in that of the noise."""
LEAST = 0.005
"""Share of a record that counts as rest at the least."""
COARSE = 0.03
"""The same where motion that turns near zero stays there, by counts that it seldom changes."""
OF_SLOW = 0.3
"""The same of all that is about zero: of what passes through slowly, a fifth looks still."""
REACH = (6.0, 4.0)
"""Widths of what is to be left out of it, in noise and in changes over a sample."""


class Rest(NamedTuple):
    """Rest in a signal.

    **Fields:** `share` of the samples; `width`, in the signal's unit, about zero within which rest,
    noise and what a sample holds cannot be told apart.
    """

    share: float
    width: float


def rest_of(record: Record, name: str) -> Rest | None:
    """Rest in a signal, `None` where there is none, or nothing else (not under jit)."""
    values = record.signal(name).with_nan
    with np.errstate(all="ignore"):
        change = np.abs(np.diff(values))
        if not (change > 0).any():
            return None
        noise, usual = float(record.noise.std(name)), float(np.median(change[change > 0]))
        # Of what changes by single quanta, none is about zero but zero. Steps are multiples of
        # them, so that where some are far smaller than usual there is nothing to be sorted.
        quantum = 0.0
        if usual <= 2 * float(np.min(change[change > 0])):
            known = values[~np.isnan(values)]
            quantum = resolution_of(levels_of(known, rounding_of(known))[0])
        is_coarse = usual <= 2 * quantum
        near = max(NOISES * noise, 0.5 * quantum if is_coarse else MOVES * usual)
        fewest = max(FEWEST, FEWEST * quantum / (2 * float(np.nanmean(change))))
        about = np.where(np.abs(values) <= near, values / near, np.nan)
    if not np.isfinite(near) or np.isnan(about).mean() > 1 - LEAST:
        return None
    starts, stops = runs(~np.isnan(about))
    lengths = stops - starts
    # Of these stretches those that hold noise at the most. Between them all is zero, so that sums
    # from one start to the next are theirs.
    energy = np.add.reduceat(np.nan_to_num(NOISES * about) ** 2, starts)
    still = (lengths >= fewest) & (energy <= STILL * lengths)
    share = lengths[still].sum() / values.size
    if not max(COARSE if is_coarse else LEAST, OF_SLOW * lengths.sum() / values.size) < share < 1:
        return None
    return Rest(float(share), max(REACH[0] * noise, REACH[1] * usual))
