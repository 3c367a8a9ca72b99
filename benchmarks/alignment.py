"""Delays between a signal and its derivative: `python -m benchmarks.alignment [--seeds N]`.

Of four machines with known motion (the quarter car records no signal with its derivative): false
alarms on sound recordings, errors of the delay that is found, and how often the damping of the
oscillator with drag lies within its interval of 95 % after the derivative was brought forward, and
without.
"""

import argparse
import itertools
from collections import Counter

import numpy as np
from scipy.interpolate import CubicSpline

import riecjax as rx
from benchmarks.faults.machines import FINE, LEAD, MACHINES, RATE, SAMPLES, motion
from riecjax.models.catalogue import find_model
from riecjax.records import align
from riecjax.records.consistency import check_derivatives
from riecjax.records.faults.derivative_pairs import compare
from riecjax.records.faults.relations import Relation
from riecjax.runtime import start_jax

NAMES = tuple(name for name in MACHINES if name != "car")
DELAYS = (-1.0, -0.1, 0.1, 0.3, 1.0, 2.0)
NOISE = (0.0, 0.001, 0.01, 0.05)


def recorded(name: str, seed: int, noise: float, delay: float = 0.0) -> rx.Record:
    """A machine's record whose velocity is so many samples late."""
    machine, fine = MACHINES[name], motion(name, seed)
    at = FINE * (LEAD + np.arange(SAMPLES))
    signals = {signal: values[at] for signal, values in fine.items()}
    if delay:
        late = CubicSpline(np.arange(fine[machine.velocity].size), fine[machine.velocity])
        signals[machine.velocity] = late(at - FINE * delay)
    rng = np.random.default_rng([seed, 7])
    return rx.Record.from_samples(
        {k: v + noise * v.std() * rng.standard_normal(v.size) for k, v in signals.items()},
        time_step=1 / RATE,
    )


def pair_of(name: str) -> tuple[str, str]:
    return MACHINES[name].position, MACHINES[name].velocity


def false_alarms(seeds: int) -> None:
    """Codes found on sound recordings."""
    print(f"{'noise':>6}  false alarms on {seeds} sound recordings of each machine")
    for noise in NOISE:
        codes = Counter(
            f"{finding.code} ({name})"
            for name, seed in itertools.product(NAMES, range(seeds))
            for finding in check_derivatives(recorded(name, seed, noise), [pair_of(name)])
        )
        print(f"{noise:6.1%}  {dict(codes) or 'none'}", flush=True)


def errors(seeds: int) -> None:
    """Of the delay that is found, in samples."""
    print(f"{'machine':<9}{'noise':>6}{'bias':>9}{'sd':>9}{'worst':>9}{'in 95 %':>9}{'named':>7}")
    for name, noise in itertools.product(NAMES, NOISE):
        off, within, named = [], 0, 0
        for delay, seed in itertools.product(DELAYS, range(seeds)):
            signal, derivative = pair_of(name)
            relation = Relation(signal, ((derivative, 1.0),))
            pair = compare(recorded(name, seed, noise, delay), relation)
            if pair is None:
                continue
            off.append(pair.fit.delay + pair.fit.lag - delay)
            within += abs(off[-1]) < 1.96 * pair.fit.errors[0]
            named += pair.is_late and not pair.lagged
        found = np.array(off) if off else np.full(1, np.nan)
        print(
            f"{name:<9}{noise:6.1%}{found.mean():9.4f}{found.std():9.4f}"
            f"{np.abs(found).max():9.4f}{within / found.size:9.0%}"
            f"{named / len(DELAYS) / seeds:7.0%}",
            flush=True,
        )


def coverage(seeds: int, delay: float = 1.0) -> None:
    """Of the damping of the oscillator with drag, its velocity late, with and without align."""
    model = find_model("drag-oscillator")
    truth = MACHINES["drag"].truth["r"]
    print(f"{'noise':>6}  r of drag, one sample late: covered and off by, aligned | as it is")
    for noise in NOISE[1:]:
        said = []
        for how in ("auto", "none"):
            held, off = 0, []
            for seed in range(seeds):
                record = align(recorded("drag", seed, noise, delay), [pair_of("drag")], how).record
                found = rx.identify(model, record)
                low, high = (float(end) for end in found.interval("r"))
                held += low <= truth <= high
                off.append(float(found["r"]) / truth - 1)
            said.append(f"{held / seeds:4.0%} {np.mean(off):+8.2%}")
        print(f"{noise:6.1%}  {' | '.join(said)}", flush=True)


if __name__ == "__main__":
    start_jax()
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=40, help="of each machine")
    seeds = parser.parse_args().seeds
    false_alarms(seeds)
    errors(max(seeds // 4, 1))
    coverage(seeds)
