"""Faults of sensors, converters and loggers, found in the samples alone.

No check fires on what machines do: axes at rest, relays and steps, encoders that show one value for
a while, bumps in a road. The message says what to do about a fault.
"""

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from riecjax.findings import Finding
from riecjax.records.faults.outliers import outliers
from riecjax.records.record import Record, samples_with_nan
from riecjax.records.resolution import MOST_OUTLIERS, levels_of, resolution_of, rounding_of

FEWEST_SAMPLES = 50
"""Present samples below which only missing and constant signals are reported."""
FEW_LEVELS = 20
"""Distinct values up to which a signal counts as a command or a relay, not as a sensor's."""
PILE_UP = 5.0
"""Times more often than at the next four levels that a clipped signal sits at its extreme. The
crest of a quantised signal, a parabola, sits there at most 3.2 times as often."""
REPEATS = 2.5
"""The same for a signal that is not quantised, in which no value comes twice but by a period."""
FEWEST_VISITS = 3
"""Times that a signal must have run into its limits, both together, to count as clipped."""
STEEP = 10.0
"""Quanta by which a steep approach lies off the extreme two samples before, so that rounding does
not hide it. A crest that stays within its last quantum for 3 samples comes from less than 9."""
LONGEST_REST = 0.5
"""Share of samples at one value past which that is where the signal rests."""
STUCK_SAMPLES = 20
"""Samples of one value that may be a stuck sensor."""
STUCK_RATIO = 10.0
"""Times that a stuck run is longer than what is usual (19 of 20 runs) in the signal."""
ABRUPT = 0.1
"""Share of the usual step past which a run begins or ends abruptly. What comes to rest at a finite
deceleration takes a last step far below."""
ABRUPT_QUANTA = 3.0
"""The same in quanta of the signal."""
MOVES = 0.3
"""Share of its usual sample-to-sample change past which another signal moves meanwhile."""
OUTLIER_SCALES = 6.0
"""Robust standard deviations from the running median past which a sample may be an outlier."""
OUTLIER_GAP = 1.5
"""Times that the least outlier stands out further than the most extreme other sample."""
OUTLIER_LOCAL = 1.5
"""Times that an outlier stands out further than its six neighbours range."""
COARSE = 0.01
"""Share of a signal's rms past which its resolution matters."""


# Values too large to be squared are for the fit to refuse; here they only compare as infinite.
@np.errstate(over="ignore", invalid="ignore")
def check_signals(record: Record, names: Iterable[str]) -> list[Finding]:
    """Look for faults of sensors, converters and loggers in these signals.

    Codes: `missing_samples`, `constant_signal`, `clipped`, `stuck_sensor`, `outliers` and
    `quantised`. A signal that is constant, or has fewer than 50 samples, is not looked at further.
    Not under jit.

    **Raises:** `DataError` for a signal that the record lacks.
    """
    signals = {name: _signal(record, name) for name in dict.fromkeys(names)}
    others = {name: _signal(record, name) for name in record.arrays if name not in signals}
    findings = list(_missing_samples(record, signals.values()))
    for name, signal in signals.items():
        if signal.levels.size == 1:
            findings.append(
                signal.finding(
                    "constant_signal",
                    f"never varies from {signal.with_unit(signal.levels[0])}, so nothing can be "
                    f"identified from it. Check that the channel was connected and is the right "
                    f"one.",
                )
            )
        elif signal.sample_count >= FEWEST_SAMPLES:
            rest = [s for key, s in {**signals, **others}.items() if key != name]
            findings += _clipped(signal)
            findings += _stuck(signal, rest)
            findings += outliers(signal.name, signal.values, signal.time, signal.unit)
            findings += _quantised(signal)
    return findings


class _Signal(NamedTuple):
    """A signal of n samples with what several checks ask of it."""

    name: str
    unit: str
    values: np.ndarray
    """Shape (n,), NaN where missing."""
    time: np.ndarray
    """Seconds from the recording's first sample, shape (n,)."""
    levels: np.ndarray
    """Distinct values, ascending."""
    counts: np.ndarray
    """How often each level occurs."""
    rounding: float
    """Distance within which values are one."""
    resolution: float
    """Distance of values where they are multiples of one, else 0."""
    run_starts: np.ndarray
    """First sample of each run, a stretch of one exact value."""
    run_lengths: np.ndarray
    """Samples in each run."""

    @property
    def sample_count(self) -> int:
        """Samples that are not missing."""
        return int(self.counts.sum())

    @property
    def run_values(self) -> np.ndarray:
        return self.values[self.run_starts]

    def with_unit(self, value: float) -> str:
        return f"{value + 0.0:.4g} {self.unit}".rstrip()

    def finding(self, code: str, message: str, doubt: float = 0.0) -> Finding:
        return Finding(code, f"{self.name}: {message}", (self.name,), doubt=doubt)


def _signal(record: Record, name: str) -> _Signal:
    values = samples_with_nan(record, name)
    known = values[~np.isnan(values)]
    rounding = rounding_of(known)
    levels, counts = levels_of(known, rounding)
    starts = np.flatnonzero(np.concatenate([[True], values[1:] != values[:-1]]))
    return _Signal(
        name,
        dict(record.units).get(name, ""),
        values,
        np.asarray(record.elapsed),
        levels,
        counts,
        rounding,
        resolution_of(levels),
        starts,
        np.diff(starts, append=values.size),
    )


def _missing_samples(record: Record, signals: Iterable[_Signal]) -> Iterator[Finding]:
    """One finding for all signals that lack the same samples, as they do in a logger's pause."""
    alike: dict[bytes, list[_Signal]] = {}
    for signal in signals:
        mask = np.isnan(signal.values)
        if mask.any():
            alike.setdefault(mask.tobytes(), []).append(signal)
    for group in alike.values():
        mask = np.isnan(group[0].values)
        starts = np.flatnonzero(np.diff(mask.astype(np.int8), prepend=0) == 1)
        longest = max((s.stop - s.start for s in record.segments([group[0].name])), default=0)
        seconds = max(longest - 1, 0) * float(record.time_step)
        gaps = "gap" if starts.size == 1 else "gaps"
        names = tuple(signal.name for signal in group)
        yield Finding(
            "missing_samples",
            f"{', '.join(names)}: {_share(mask.sum(), mask.size)} of the samples ({mask.sum()} of "
            f"{mask.size}) are missing in {starts.size} {gaps}, first at "
            f"{group[0].time[starts[0]]:.4g} s; the longest unbroken stretch lasts {seconds:.4g} "
            f"s. Choose windows and filters much shorter than that.",
            names,
        )


class _Visits(NamedTuple):
    """Times that a signal sits at an extreme where it does not just turn round."""

    which: str
    extreme: float
    starts: np.ndarray
    samples: int
    steep: int
    """Visits that came from far off, and left for far off."""


def _clipped(signal: _Signal) -> Iterator[Finding]:
    """Runs into an extreme from far off, which a crest never does, and sits there."""
    if signal.levels.size <= FEW_LEVELS or _is_piecewise_linear(signal):
        return
    sides = [_visits(signal, "maximum", 1.0), _visits(signal, "minimum", -1.0)]
    sides = [side for side in sides if side is not None and side.steep]
    if sum(side.steep for side in sides) < FEWEST_VISITS:
        return
    for side in sides:
        yield signal.finding(
            "clipped",
            f"sits at its {side.which} of {signal.with_unit(side.extreme)} in {side.starts.size} "
            f"place(s), {_share(side.samples, signal.sample_count)} of the samples, first at "
            f"{signal.time[side.starts[0]]:.4g} s, as a converter at the end of its range does. "
            f"Record with a larger range or leave those stretches out, unless the limit is real, "
            f"as of a command or of a wheel that lifts.",
            doubt=side.samples / signal.sample_count,
        )


def _visits(signal: _Signal, which: str, sign: float) -> _Visits | None:
    """Visits to one extreme; `None` where it is a crest, or where the signal rests."""
    order = np.argsort(-sign * signal.levels)[:5]
    extreme, samples = signal.levels[order[0]], int(signal.counts[order[0]])
    ratio = PILE_UP if signal.resolution else REPEATS
    piles_up = samples > ratio * np.mean(signal.counts[order[1:]])
    if not piles_up or samples > LONGEST_REST * signal.sample_count:
        return None
    visits = np.abs(signal.run_values - extreme) <= signal.rounding
    starts, lengths = signal.run_starts[visits], signal.run_lengths[visits]
    quantum = max(signal.resolution, signal.rounding)
    steep = np.ones(starts.size, bool)
    inside = np.pad(sign * (extreme - signal.values), 4, constant_values=np.nan)
    for edges, outward in ((starts, -1), (starts + lengths - 1, 1)):
        near, far = (inside[4 + edges + k * outward] for k in (2, 4))
        steep &= (near > STEEP * quantum) & ~_comes_to_rest(near, far, quantum)
    return _Visits(which, float(extreme), starts, samples, int(steep.sum()))


def _comes_to_rest(near: np.ndarray, far: np.ndarray, quantum: float) -> np.ndarray:
    """Whether an approach to an extreme, 2 and 4 samples before it, may end there as a parabola.

    At a deceleration a, k samples before the extreme seems reached, the distance is
    a (k + s)^2 / 2, where the last quantum q = a s^2 / 2 hides the end for s samples. Hence
    sqrt(far / near) = (4 + s) / (2 + s) = 2 - sqrt(q / near), and more where the deceleration
    falls. On a straight approach far / near is 2 to 3.
    """
    hidden = np.sqrt(np.minimum(quantum / np.maximum(near, quantum), 1.0))
    return near * (2 - hidden) ** 2 <= far


def _is_piecewise_linear(signal: _Signal) -> bool:
    """Whether more than half of the samples lie on straight lines, as only commands do."""
    bend = np.diff(signal.values, 2)
    extreme = np.isin(signal.values[1:-1], signal.levels[[0, -1]])
    inner = np.abs(bend[~extreme & ~np.isnan(bend)])
    return not inner.size or bool(np.mean(inner <= signal.rounding) > 0.5)


def _stuck(signal: _Signal, others: list[_Signal]) -> Iterator[Finding]:
    """A long run of one value, begun or left by a jump, while another signal moves on."""
    starts, lengths, values = signal.run_starts, signal.run_lengths, signal.run_values
    usual = float(np.quantile(lengths, 0.95))
    long = np.flatnonzero(lengths >= max(STUCK_SAMPLES, STUCK_RATIO * usual))
    if not long.size or signal.levels.size <= FEW_LEVELS or _is_piecewise_linear(signal):
        return
    steps = np.abs(np.diff(signal.values))
    elsewhere = np.ones(steps.size, bool)
    for run in long:
        elsewhere[starts[run] : starts[run] + lengths[run] - 1] = False
    moving = steps[elsewhere & ~np.isnan(steps)]
    if not moving.size or np.mean(moving == 0) > LONGEST_REST:
        return
    least = max(ABRUPT * float(np.median(moving[moving > 0])), ABRUPT_QUANTA * signal.resolution)
    # The larger one of the steps into and out of each run.
    padded = np.pad(steps, 1, constant_values=np.nan)
    edges = np.fmax(padded[starts], padded[starts + lengths])
    # A machine comes to rest and leaves it gently, and rests in the same place more than once.
    stuck = [
        run
        for run in long
        if np.sum(values[long] == values[run]) == 1
        and edges[run] > least
        and _rest_of_record(others, starts[run], lengths[run])
    ]
    if not stuck:
        return
    samples, first = int(lengths[stuck].sum()), stuck[0]
    yield signal.finding(
        "stuck_sensor",
        f"stays at exactly {signal.with_unit(values[first])} for {lengths[first]} samples from "
        f"{signal.time[starts[first]]:.4g} s on while the rest of the record "
        f"{_rest_of_record(others, starts[first], lengths[first])} ({samples} samples in "
        f"{len(stuck)} place(s), {_share(samples, signal.sample_count)}). Leave that stretch out "
        f"and check the sensor, its cable and the logger.",
    )


def _rest_of_record(others: list[_Signal], start: int, length: int) -> str:
    """What the other sensors do during a run, if it suggests a fault; else empty.

    Either one of them changes from sample to sample, or every one shows one value to the last
    digit, as when a logger writes one row again and again. Quiet sensors suggest no fault.
    """
    sensors = [s for s in others if s.levels.size > FEW_LEVELS]
    still = []
    for other in sensors:
        steps = np.diff(other.values)
        meanwhile = steps[start : start + length - 1]
        if np.isnan(meanwhile).all():
            continue
        if np.nanstd(meanwhile) > MOVES * np.nanstd(steps):
            return "moves"
        still.append(not np.nanmax(np.abs(meanwhile)))
    if not sensors:
        return "moves"
    return "stands as still" if still and all(still) else ""


def _outliers(signal: _Signal) -> Iterator[Finding]:
    """One or two samples that leave their surroundings further than any other sample does."""
    values = signal.values
    if signal.levels.size <= FEW_LEVELS:
        return
    windows = np.lib.stride_tricks.sliding_window_view(values, 5)
    off = np.full(values.size, np.nan)
    off[2:-2] = np.abs(values[2:-2] - np.median(windows, axis=1))
    known = off[~np.isnan(off)]
    if not known.size:
        return
    # Past the steps of its converter, past what is usual, and past the widest gap in between.
    least = max(
        OUTLIER_SCALES * 1.4826 * float(np.median(known)),
        2.0 * float(np.quantile(known, 1 - MOST_OUTLIERS)),
        2.0 * float(np.nanquantile(np.abs(np.diff(values)), 1 - 2 * MOST_OUTLIERS)),
        5.0 * signal.resolution,
    )
    ranked = np.sort(known)[::-1][: int(MOST_OUTLIERS * known.size) + 2]
    gap = (ranked[:-1] > least) & (ranked[:-1] > OUTLIER_GAP * ranked[1:])
    if not gap.any():
        return
    limit = ranked[np.flatnonzero(gap)[-1]]
    far = np.flatnonzero(off >= limit)
    groups = np.split(far, np.flatnonzero(np.diff(far) > 1) + 1)
    if not all(_is_isolated(values, off, group) for group in groups):
        return
    yield signal.finding(
        "outliers",
        f"{far.size} sample(s) stand out from their neighbours by up to "
        f"{signal.with_unit(float(np.max(off[far])))}, where no other sample does by more than "
        f"{signal.with_unit(float(np.max(known[known < limit])))}, first at "
        f"{signal.time[far[0]]:.4g} s. Unless they really acted, mark them as missing (NaN): least "
        f"squares follow them.",
    )


def _is_isolated(values: np.ndarray, off: np.ndarray, group: np.ndarray) -> bool:
    """Up to two samples, between neighbours that agree with each other."""
    if group.size > 2:
        return False
    near = np.concatenate([values[group[0] - 3 : group[0]], values[group[-1] + 1 :][:3]])
    return bool(np.min(off[group]) > OUTLIER_LOCAL * np.ptp(near[~np.isnan(near)]))


def _quantised(signal: _Signal) -> Iterator[Finding]:
    """A resolution that is coarse against the signal's rms."""
    rms = float(np.nanstd(signal.values))
    steps = np.abs(np.diff(signal.values))
    steps = steps[~np.isnan(steps)]
    # Few levels that are held for long are a command's.
    held = signal.levels.size <= FEW_LEVELS and np.mean(steps == 0) > 0.95
    if signal.levels.size < 5 or held or signal.resolution <= COARSE * rms:
        return
    change = float(np.sqrt(np.mean(steps**2))) / signal.resolution
    yield signal.finding(
        "quantised",
        f"its resolution of {signal.with_unit(signal.resolution)} is "
        f"{_share(signal.resolution, rms)} of its rms, and it changes by {change:.2g} such steps "
        f"from sample to sample (rms). Do not differentiate it without a low-pass, and prefer "
        f"longer windows or a finer range.",
    )


def _share(part: float, whole: float) -> str:
    return f"{100 * part / whole:.3g} %"
