"""Spikes of one to three samples: found against the noise around them, repaired or left out.

Each sample is held against a polynomial through the samples around it, itself left out. Of what is
too far off for noise the furthest in its neighbourhood is taken out, and all is looked at again: a
spike spoils its neighbours' polynomials by less than it is off its own. At last each of those taken
out is judged by the samples that stay, and put back where it is no spike, until no more are. Motion
that no such polynomial follows hides spikes that are no larger than it is off them.

What machines do stays: after a step or a corner the polynomial follows one side, and the other side
is off it for longer than a spike lasts; a pulse among steps of its own size, as of a relay, is one
of them; and of a command that follows straight lines, or takes few values, only what is far beyond
all others is a spike.

The motion may answer to what looks like spikes: blows of a hammer, impacts, short pulses. A force
that acts for a few samples changes a velocity by its impulse over the mass, and the slope of a
position. What goes wrong in one sensor changes nothing in another. So parabolas are put
through the samples before and behind each spike of every other signal: where their levels or slopes
part further than they do elsewhere, the spike acted.
"""

import functools
import hashlib
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

from riecjax.errors import DataError
from riecjax.findings import Finding
from riecjax.records.faults.sampled_signal import (
    ROUNDING,
    Found,
    SampledSignal,
    Signals,
    fault,
    is_command,
    levels_of,
)
from riecjax.records.linear_op import LinearOp, Operations, step
from riecjax.records.record import Record, run_lengths
from riecjax.records.signal import NORMAL, Samples
from riecjax.records.time_base import SHORTEST_PAUSE

SPIKE = 6.0
"""Standard deviations that a spike is off the polynomial at the least."""
LONGEST = 3
"""Neighbouring samples past which it is no spike."""
CLEAR = 6.0
"""Times that a spike is further off the polynomial than all samples around it are (rms)."""
NEIGHBOUR = 4.0
"""The same of the nearest sample on each side, which at a step is off one that spans it."""
RIDGE = 1e-9
"""What keeps a fit through fewer samples than coefficients from a division by zero."""
DEGREES, BESIDE = (3, 5, 7), 8
"""Of the polynomials, and samples to each side that they go through. Of each signal, those that lie
nearest to samples left out: a cubic has 0.37 of the noise in its middle, and bends least."""
OFFSETS = np.arange(-BESIDE, BESIDE + 1)
"""Of a polynomial's samples from the one in its middle."""
FEWEST = 20
"""Samples below which nothing is looked for."""
BLOCK = 128
"""Samples over which noise is taken to be alike."""
BEYOND = 1e3
"""Times the largest other value past which a sample of a command is none that was meant."""
IMPOSSIBLE = 1e30
"""What no command takes in any unit, though all of its other values are zero."""
FEW, TAIL_BLOCK, USUAL_TAIL = 0.03, 1024, 3.0
"""A spike is three times as far off as three in a hundred of all samples nearby are, once spikes
are taken out. In white noise this asks for 6.5 of its standard deviations, and among corners, kicks
or steps for more than is usual there."""
NEARLY = 4.5
"""Standard deviations off a polynomial past which what is left may be steps, or the like."""
PASSES = 12
"""Times that spikes are taken out, once others do not hide them."""
LARGEST = 1e60
"""Robust scales at which values are cut off, so that their squares are numbers."""
MOST = 0.05
"""Share of the samples past which spikes are a fault of the channel, and are not repaired."""
LISTED = 3
"""Times that are named."""
LEVEL = 1e-3
"""Probability by chance, over all signals, below which the motion answers to spikes."""
SIDE, GAP = 8, LONGEST // 2 + 1
"""Samples of each line beside a spike, and to each side of its middle that no line goes through."""
PARTING = 4.0
"""Times the largest parting of lines elsewhere that is no chance."""

Treatment: TypeAlias = Literal["repair", "missing", "keep"]
"""What becomes of spikes: a local polynomial's value takes their place, they are marked as missing,
or they stay."""
DONE = {
    "repair": "A polynomial through the samples around took the place of each; if they really "
    "acted, keep them (--outliers keep).",
    "missing": "They were marked as missing.",
    "keep": "Least squares follow them: repair them ({option}; in Python "
    "rx.records.repair_outliers(record)), unless they really acted.",
}
MOSTLY = (
    f"So many are a fault of the channel and were left as they are: check the sensor, its cable "
    f"and the logger (more than {MOST:.0%} of the samples)."
)


class Spikes(NamedTuple):
    """Samples that are spikes.

    **Fields:** `places`, ascending; `repaired`, the local polynomial's values there; `sizes`, how
    far off it they are; `noise`, the standard deviation of what is around them; shapes `(k,)`;
    whether they `acted`, so that they stay.
    """

    places: Int[np.ndarray, " k"]
    repaired: Float[np.ndarray, " k"]
    sizes: Float[np.ndarray, " k"]
    noise: Float[np.ndarray, " k"]
    acted: bool = False

    def treated(self, values: Samples, how: Treatment = "repair") -> Samples:
        """The signal's samples without them."""
        values = values.copy()
        if not self.acted:
            values[self.places] = self.repaired if how == "repair" else np.nan
        return values


KEPT = 2**6
"""Searches whose answers are kept: of the signals of a recording or two."""
_kept: dict[bytes, Spikes] = {}


def find_spikes(values: Samples) -> Spikes:
    """The spikes of a signal, NaN where samples are missing.

    The same samples are searched when they are read, compared with others and checked. Their
    digest, which takes a thousandth of the time that a search takes, says so.
    """
    values = np.asarray(values, float)
    digest = hashlib.sha1(values.tobytes(), usedforsecurity=False).digest()
    found = _kept.get(digest)
    if found is None:
        found = _kept[digest] = _searched(values)
        for oldest in list(_kept)[:-KEPT]:
            _kept.pop(oldest, None)
    return found


# Values up to the largest number overflow when scaled; they are cut off.
@np.errstate(all="ignore")
def _searched(values: Samples) -> Spikes:
    known = values[~np.isnan(values)]
    if known.size < FEWEST:
        return Spikes(np.zeros(0, int), np.zeros(0), np.zeros(0), np.zeros(0))
    # How widely values spread that are not spikes.
    low, high = (np.quantile(known, side) for side in ([0.1, 0.01, 0.0], [0.9, 0.99, 1.0]))
    scale = float(min(next((s for s in high - low if s > 0), 1.0), np.finfo(float).max))
    centre = np.median(known)
    scaled = np.clip((values - centre) / scale, -LARGEST, LARGEST)
    levels = levels_of(scaled[np.abs(scaled) < BEYOND], ROUNDING)[0]
    if is_command(scaled, levels, ROUNDING):
        # What is far beyond all other values; the value before takes its place.
        ranked = np.sort(np.abs(known))[::-1][: known.size // 10 + 2]
        apart = ranked[:-1] > np.where(ranked[1:] > 0, BEYOND * ranked[1:], IMPOSSIBLE)
        far = np.abs(values) >= np.min(ranked[:-1], where=apart, initial=np.inf)
        far &= run_lengths(far) <= LONGEST
        places, there = np.flatnonzero(far), np.flatnonzero(~far & ~np.isnan(values))
        repaired = values[there[np.maximum(np.searchsorted(there, places) - 1, 0)]]
        noise = np.zeros(values.size)
    else:
        local = min(map(Local.of, DEGREES), key=lambda each: each.error(scaled))
        removed, noise = _taken_out(scaled, local)
        spikes, cleaned = _judged(scaled, removed, noise, local)
        places = np.flatnonzero(spikes)
        repaired = centre + scale * cleaned[places]
    return Spikes(places, repaired, np.abs(values[places] - repaired), scale * noise[places])


def _taken_out(scaled: Samples, local: "Local") -> tuple[Bool[np.ndarray, " n"], Samples]:
    """Samples that may be spikes, the furthest off first, and the noise around each."""
    missing = np.isnan(scaled)
    removed, cleaned, stretch = np.zeros(scaled.size, bool), scaled.copy(), np.cumsum(missing)
    # There polynomials go through what is on one side, each by itself.
    edged = np.pad(missing, BESIDE, constant_values=True)
    ends = np.flatnonzero((np.convolve(edged, np.ones(OFFSETS.size), "valid") > 0) & ~missing)
    noise = np.zeros(scaled.size)
    for _ in range(PASSES):
        off = local.off(cleaned)
        noise = _reached(off, BLOCK, 0.5) / NORMAL
        usual = np.median(noise[noise > 0]) if np.any(noise > 0) else 0.0
        noise = np.where(np.isnan(noise), usual, noise)
        fit, spread, _ = local.fits(np.where(removed, np.nan, scaled), ends, stretch)
        least = np.ones(scaled.size)
        least[ends], off[ends] = spread / local.gain, np.abs(scaled[ends] - fit) / local.gain
        share = np.where(removed | missing, 0.0, np.nan_to_num(off / (SPIKE * noise)))
        # A spike spoils the polynomials of its neighbours: the largest first.
        beside = np.lib.stride_tricks.sliding_window_view(np.pad(share, BESIDE), OFFSETS.size)
        new = (share > least) & (share >= beside.max(axis=1))
        removed |= new
        if not new.any():
            break
        places = np.flatnonzero(removed)
        cleaned[places] = local.fits(np.where(removed, np.nan, scaled), places, stretch)[0]
    return removed, noise


def _judged(
    scaled: Samples, removed: Bool[np.ndarray, " n"], noise: Samples, local: "Local"
) -> tuple[Bool[np.ndarray, " n"], Samples]:
    """Which of the samples that may be spikes are, and the signal without them."""
    spikes, cleaned = _clear(scaled, removed & (run_lengths(removed) <= LONGEST), local)
    off, rest = np.abs(scaled - cleaned), np.nan_to_num(local.off(cleaned))
    spikes &= off > USUAL_TAIL * local.gain * _reached(rest, TAIL_BLOCK, FEW)
    # Where noise changes within a block, the block's own is too small for a part of it.
    edged = np.pad(noise, BLOCK, mode="edge")
    most = np.maximum(noise, np.maximum(edged[: -2 * BLOCK], edged[2 * BLOCK :]))
    # Spikes that are no more often than steps, or whatever else is left, of about that size.
    elsewhere, own = (
        np.searchsorted(ordered, 3 * off) - np.searchsorted(ordered, off / 3)
        for ordered in map(np.sort, (rest[rest > NEARLY * most], off[spikes]))
    )
    return _clear(scaled, spikes & (elsewhere < own), local)


def _clear(
    scaled: Samples, spikes: Bool[np.ndarray, " n"], local: "Local"
) -> tuple[Bool[np.ndarray, " n"], Samples]:
    """Those of these samples that stand clear of all around, and the signal without them."""
    cleaned, stretch, before = scaled, np.cumsum(np.isnan(scaled)), 0
    # What is dropped tells more of those beside it.
    while np.sum(spikes) != before:
        places, before = np.flatnonzero(spikes), np.sum(spikes)
        cleaned = np.where(spikes, np.nan, scaled)
        cleaned[places], _, clear = local.fits(cleaned, places, stretch)
        spikes = spikes.copy()
        spikes[places] = np.abs(scaled - cleaned)[places] > clear
    return spikes, np.where(spikes, cleaned, scaled)


def _reached(sizes: Float[np.ndarray, " n"], length: int, share: float) -> Samples:
    """At each sample what such a share of its block of about this length reaches, but NaN."""
    blocks = max(sizes.size // length, 1)
    size = -(-sizes.size // blocks)
    padded = np.pad(sizes, (0, blocks * size - sizes.size), constant_values=np.nan)
    rows = np.sort(padded.reshape(blocks, size), axis=1)
    place = np.ceil((1 - share) * np.sum(~np.isnan(rows), axis=1)).astype(int) - 1
    return np.repeat(rows[np.arange(blocks), np.maximum(place, 0)], size)[: sizes.size]


class Local(NamedTuple):
    """Polynomials of one degree over the samples of a window, by orthonormal `columns`; `taps` of
    what those through the other samples are off the one in the middle."""

    columns: Float[np.ndarray, "samples coefficients"]
    taps: Float[np.ndarray, " samples"]

    @classmethod
    @functools.cache
    def of(cls, degree: int) -> "Local":
        """Of a degree, over `BESIDE` samples to each side."""
        columns = np.linalg.qr((OFFSETS[:, None] / BESIDE) ** np.arange(degree + 1))[0]
        taps = columns @ columns[BESIDE]
        # A sample is off the one through all by so much less as that follows it.
        return cls(columns, (taps - (OFFSETS == 0)) / (1 - taps[BESIDE]))

    @property
    def gain(self) -> float:
        """Times the noise that a sample is off the one through the others, by noise alone."""
        return float(np.linalg.norm(self.taps))

    def off(self, values: Samples) -> Samples:
        """How far each sample is off the one through the others, over its gain for white noise;
        NaN where its window has gaps or ends."""
        off = np.abs(np.convolve(values, self.taps[::-1], "valid")) / self.gain
        return np.pad(off, BESIDE, constant_values=np.nan)

    def error(self, values: Samples) -> float:
        """How far samples mostly are off the one through the others."""
        return float(self.gain * np.median(np.nan_to_num(self.off(values))))

    def fits(
        self, values: Samples, places: Int[np.ndarray, " k"], stretch: Int[np.ndarray, " n"]
    ) -> tuple[Samples, Samples, Samples]:
        """At some places the polynomial through the other samples of the unbroken stretch, which
        `stretch` numbers.

        **Returns:** its value; the standard deviation off it in that of the noise; and how far a
        spike is off it that stands clear of all others.
        """
        middle, count = self.columns[BESIDE], self.columns.shape[1]
        near = places[:, None] + OFFSETS
        inside = np.clip(near, 0, values.size - 1)
        there = (near == inside) & (stretch[inside] == stretch[places][:, None])
        there &= (OFFSETS != 0) & ~np.isnan(values[inside])
        window = np.where(there, values[inside], 0.0)
        products = (self.columns[:, :, None] * self.columns[:, None, :]).reshape(OFFSETS.size, -1)
        gram = (there @ products).reshape(-1, count, count) + RIDGE * np.eye(count)
        sides = np.stack([window @ self.columns, np.broadcast_to(middle, (places.size, count))], 2)
        fit, reach = np.moveaxis(np.linalg.solve(gram, sides), 2, 0)
        rest = np.where(there, np.abs(window - fit @ self.columns.T), np.nan)
        clear = CLEAR * np.sqrt(np.nansum(rest**2, axis=1) / np.sum(there, axis=1))
        for side in (
            rest[:, BESIDE - LONGEST : BESIDE][:, ::-1],
            rest[:, BESIDE + 1 :][:, :LONGEST],
        ):
            nearest = side[np.arange(len(side)), np.argmax(~np.isnan(side), axis=1)]
            clear = np.fmax(clear, NEIGHBOUR * nearest)
        enough = np.sum(there, axis=1) > count
        spread = np.where(enough, np.sqrt(1 + reach @ middle), np.inf)
        return fit @ middle, spread, clear * spread


def are_answered(places: Int[np.ndarray, " k"], others: Iterable[Samples]) -> bool:
    """Whether some other signal shows that spikes at these samples acted.

    The share of all samples where lines part further is a p-value, and of n of them the sum of
    -log p has a gamma distribution. Few blows are too few for that; they are told by their size, if
    nothing elsewhere comes near it.

    **Arguments:** `places`, ascending; `others` at the same times, without spikes of their own, NaN
    where samples are missing.
    """
    others, near = list(others), 2 * (GAP + SIDE)
    # The middle sample of each group of neighbours.
    groups = np.split(places, np.flatnonzero(np.diff(places) > LONGEST) + 1)
    middles = np.array([g[g.size // 2] for g in groups if g.size], int)
    offsets = np.arange(GAP + 1, GAP + SIDE + 1)
    # Level and slope of parabolas before each sample and behind; before it time runs the other way:
    # there levels are alike, slopes opposite.
    kernels = [
        np.concatenate([sign * taps[::-1], np.zeros(2 * GAP + 1), taps])
        for taps, sign in zip(np.linalg.pinv(np.vander(offsets, 3, increasing=True)), (-1, 1))
    ]
    level = LEVEL / max(len(kernels) * len(others), 1)
    for values in (values for values in others if values.size >= near):
        beside = np.zeros(values.size, bool)
        for place in places:
            beside[max(place - near, 0) : place + near + 1] = True
        for kernel in kernels:
            inside = np.convolve(values, kernel[::-1], "valid")
            parting = np.abs(np.pad(inside, GAP + SIDE, constant_values=np.nan))
            known = ~np.isnan(parting)
            usual, at_spikes = np.sort(parting[known]), parting[middles[known[middles]]]
            if not at_spikes.size:
                continue
            elsewhere = np.max(parting, where=known & ~beside, initial=0.0)
            beyond = usual.size - np.searchsorted(usual, at_spikes)
            total = -float(np.sum(np.log((1 + beyond) / (1 + usual.size))))
            by_chance = scipy.special.gammaincc(at_spikes.size, total)
            if np.median(at_spikes) > PARTING * elsewhere or by_chance < level:
                return True
    return False


def too_many(spikes: Spikes, values: Samples) -> bool:
    """Whether spikes are more than single samples that went wrong."""
    return spikes.places.size > MOST * np.sum(~np.isnan(values))


@fault("outliers", DONE["keep"], "--outliers", computed=True)
def outliers(signal: SampledSignal, signals: Signals) -> Iterator[Found]:
    """Spikes that were kept, unless others show that they acted."""
    spikes = find_spikes(signal.values)
    others = (other.values for other in signals.beside(signal.name))
    if spikes.places.size and not are_answered(spikes.places, others):
        yield _found(spikes, signal.values, signal.time, signal.unit)


def _found(spikes: Spikes, values: Samples, time: Samples, unit: str) -> Found:
    """How many spikes there are, where, and how large.

    What is kept puts parameters in doubt by the spikes' share of the signal's energy.
    """
    count = spikes.places.size
    listed = ", ".join(f"{time[place]:.6g}" for place in spikes.places[:LISTED])
    more = f" s and {count - LISTED} more" if count > LISTED else " s"
    with np.errstate(all="ignore"):
        noises, largest = np.median(spikes.sizes / spikes.noise), np.max(spikes.sizes)
        # Of the signal's energy about its mean, with the spikes.
        own, rest = np.sum((spikes.sizes / largest) ** 2), spikes.treated(values)
        rest = np.nansum(((rest - np.nanmean(rest)) / largest) ** 2)
    against = f", {noises:.3g} times the noise there (median)" if np.isfinite(noises) else ""
    return Found(
        f"{count} {'sample is a spike' if count == 1 else 'samples are spikes'} "
        f"({100 * count / np.sum(~np.isnan(values)):.2g} %), up to "
        f"{f'{largest:.4g} {unit}'.rstrip()} off the samples around{against}, at {listed}{more}.",
        doubt=float(own / (own + rest)),
        value="repair",
        advice=MOSTLY if too_many(spikes, values) else "",
    )


@step
def repair_outliers(record: Record, *signals: str, how: Treatment = "repair") -> Operations:
    """Replace spikes of one to three samples by what the samples around them say.

    A spike is found against the noise around it: it lies 6 standard deviations off a polynomial of
    degree 3, 5 or 7 through the 8 samples to each side, spikes among them left out. Steps, corners
    and pulses of commands stay, and blows to which another signal answers. Of a signal of which
    more than 5 % are spikes nothing is changed: that is a fault of its channel.

    **Arguments:** the signals to repair, all if none is named; `how`: `"repair"`, `"missing"` to
    mark spikes as missing, or `"keep"`.

    **Raises:** `DataError` for a signal that the record lacks, or another treatment.
    """
    columns = {n: record.signal(n).with_nan for n in {**dict.fromkeys(signals), **record.arrays}}
    times = dict.fromkeys(columns, np.asarray(record.elapsed))
    for name, spikes in _treatable(signals or tuple(columns), columns, times, how).items():
        if not spikes.acted:
            values = spikes.treated(columns[name], how)
            yield name, LinearOp.of_values("{}: without outliers", values)


TURNS = (2 * np.pi, 360.0)
"""A turn in radians and in degrees."""
QUICKEST = 0.25
"""Turns from sample to sample past which nothing tells which way it went."""
REGISTERS = (2.0**16, 2.0**32)
"""Numbers that registers count."""


def unwrapped(values: Samples, turns: Iterable[float] = TURNS) -> tuple[Samples, str]:
    """Values that go on where they began anew, and in words what was done; empty if they never did.

    They jump from one end of a turn to the other, and nowhere else. Those of an angle fill a turn.
    Those of a register of signed numbers that was read as unsigned are whole, and count down below
    zero from 2^bits.
    """
    known = np.flatnonzero(~np.isnan(values))
    there = values[known]
    sizes = np.abs(np.diff(there))
    for turn in turns:
        jumps = sizes > turn / 2
        usual = np.max(sizes[~jumps], initial=0.0)
        if not jumps.any() or usual >= QUICKEST * turn:
            continue
        if turn in REGISTERS:
            is_one = np.all((there >= 0) & (there < turn) & (there == np.floor(there)))
            whole = np.where(values >= turn / 2, values - turn, values)
            said = f"signed numbers of {np.log2(turn):g} bits, read as unsigned, put right"
        else:
            fills = turn - 2 * usual <= np.ptp(there) <= turn + usual
            is_one, whole = fills, values.copy()
            whole[known] = np.unwrap(there, period=turn)
            said = f"unwrapped, {jumps.sum()} times"
        if is_one and np.max(np.abs(np.diff(whole[known]))) <= 2 * usual:
            return whole, said
    return values, ""


def treat_all(
    columns: Mapping[str, Samples],
    times: Mapping[str, Samples],
    units: Mapping[str, str],
    time_step: float | None,
    how: Treatment,
    formulas: Mapping[str, str],
) -> tuple[dict[str, np.ndarray], list[str], list[Finding]]:
    """Columns of a file without their spikes, what was done in words, and what is amiss with them.

    Angles that begin anew with each turn go on, or each would be a spike or a jump. A finding
    concerns what is computed from a column too.

    **Arguments:** `times` of those that have stamps, the others are `time_step` apart; `how`, what
    becomes of spikes; `formulas` of signals that are computed of columns.

    **Raises:** `DataError` for another treatment.
    """
    whole = {name: unwrapped(column) for name, column in columns.items()}
    columns = {name: column for name, (column, _) in whole.items()}
    words = [f"{name}: {said}" for name, (_, said) in whole.items() if said]
    every = {n: times.get(n, (time_step or 1.0) * np.arange(v.size)) for n, v in columns.items()}
    treated, findings = dict(columns), []
    for name, spikes in _treatable(tuple(columns), columns, every, how).items():
        count, values = spikes.places.size, columns[name]
        treated[name] = spikes.treated(values, how)
        if spikes.acted:
            words.append(f"{name}: {count} samples of short pulses kept, which other signals show")
            continue
        done = "repaired" if how == "repair" else "marked as missing"
        words.append(f"{name}: {count} outlier{'s' * (count > 1)} {done}")
        used = [k for k, f in formulas.items() if name in re.findall(r"\w+", f)]
        found = _found(spikes, values, every[name] - every[name][0], units.get(name, ""))
        found = outliers.finding(name, found._replace(doubt=0.0, advice=DONE[how]))
        findings.append(found._replace(signals=(name, *used)))
    return treated, words, findings


def _treatable(
    names: Sequence[str],
    columns: Mapping[str, Samples],
    times: Mapping[str, Samples],
    how: Treatment,
) -> dict[str, Spikes]:
    """Spikes of those of these signals that have some, unless there are too many.

    **Raises:** `DataError` for another treatment.
    """
    if how not in DONE:
        raise DataError(f"outliers are for {', '.join(DONE)}; got '{how}'.")
    found: dict[str, Spikes] = {}
    for name in names if how != "keep" else ():
        values, time = columns[name], times[name]
        steps = np.diff(time) if time.size > 1 else np.ones(1)
        # No polynomial reaches across a pause.
        pauses = np.flatnonzero(steps > SHORTEST_PAUSE * np.median(steps)) + 1
        spikes = find_spikes(np.insert(values, pauses, np.nan))
        if spikes.places.size and not too_many(spikes, values):
            places = spikes.places - np.searchsorted(pauses + np.arange(pauses.size), spikes.places)
            found[name] = spikes._replace(places=places)
    without = {n: found[n].treated(v) if n in found else v for n, v in columns.items()}
    for name, spikes in found.items():
        others = (n for n in without if n != name and np.array_equal(times[n], times[name]))
        acted = are_answered(spikes.places, [without[other] for other in others])
        found[name] = spikes._replace(acted=acted)
    return found
