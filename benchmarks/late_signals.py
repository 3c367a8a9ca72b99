"""Is a late force found, by how much, and is nothing else called late?

    python -m benchmarks.late_signals [--systems 4] [--seed 3]

Right and wrong models of `benchmarks.verdict_cases`, forces recorded 0 to 3 samples late or behind
a first-order low-pass, at 0, 1 and 5 % noise. Printed for each kind, fault and noise: how often a
finding names the force, how often as what it is, and the largest error of the delay in samples
where it is named.
"""

import argparse
from collections.abc import Iterator
from typing import NamedTuple

import jax
import numpy as np
import scipy.signal
from jaxtyping import Float

import riecjax as rx
from benchmarks.verdict_cases import (
    KINDS,
    NOISES,
    RATE,
    SAMPLES,
    STEPS,
    TONES,
    Kind,
    draw,
    integrated,
    tones,
)
from riecjax.equations.procedure import as_procedure
from riecjax.records.record import Record
from riecjax.summaries.task import ready
from riecjax.validation.late_signals import late_signals

FINE = 2 * STEPS
"""Values of the force to a sample."""
EDGE = 40
"""Samples at either end that are left out, so that late forces have all theirs."""
FAULTS = {
    "none": (0.0, 0.0),
    "0.5 late": (0.5, 0.0),
    "1 late": (1.0, 0.0),
    "3 late": (3.0, 0.0),
    "1 low-passed": (0.0, 1.0),
    "3 low-passed": (0.0, 3.0),
}
"""Samples of delay and of a low-pass's time constant."""


class Named(NamedTuple):
    """What was said of one record's force: a code, empty if nothing was, and samples."""

    code: str
    samples: float


def force_of(
    force: Float[np.ndarray, " fine"], delay: float, lag: float
) -> Float[np.ndarray, " n"]:
    """The force's samples, late by so many samples, behind a low-pass of so many."""
    if lag:
        keeps = np.exp(-1 / (lag * FINE))
        force = np.asarray(scipy.signal.lfilter(0.5 * (1 - keeps) * np.ones(2), [1, -keeps], force))
    at = np.arange(SAMPLES) * FINE - round(delay * FINE)
    return force[np.clip(at, 0, None)]


def records(kind: Kind, seed: int, systems: int) -> Iterator[tuple[str, float, Record]]:
    """Fault, noise and record, of systems of one kind."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    values = draw(kind, rng, systems)
    hertz = rng.uniform(0.3, 12.0, (systems, TONES))
    phase = rng.uniform(0, 2 * np.pi, (systems, TONES))
    time = np.arange(SAMPLES * FINE + 1) / (RATE * FINE)
    force = np.stack([tones(time, f, p) for f, p in zip(hertz, phase)]) * values["m"][:, None]
    motion = dict(zip(("x", "v", "x2", "v2"), integrated(values, force)))
    names = motion if kind.name == "coupled" else ("x", "v")
    for i in range(systems):
        for fault, (delay, lag) in FAULTS.items():
            for noise in NOISES:
                rows = {name: motion[name][i] for name in names}
                rows["u"] = force_of(force[i], delay, lag)
                rows = {
                    name: row + noise * np.std(row) * rng.standard_normal(row.size)
                    for name, row in rows.items()
                }
                yield fault, noise, Record(rows, 1 / RATE).part(EDGE, SAMPLES - EDGE)


def named(kind: Kind, record: Record) -> Named:
    """What is said of the force."""
    procedure = as_procedure(kind.model)
    plain = [each.record for each in ready(procedure, record)]
    estimate = rx.identify(procedure, plain, intervals=rx.Sandwich())
    for finding in late_signals(procedure, plain, estimate):
        if finding.signals == ("u",):
            return Named(finding.code, float(finding.remedy[1].removeprefix("u=")) * RATE)
        return Named(f"{finding.code} of {' and '.join(finding.signals)}", float("nan"))
    return Named("", float("nan"))


def line(kind: Kind, fault: str, noise: float, said: list[Named]) -> str:
    """A row of the table."""
    delay, lag = FAULTS[fault]
    code = "low_passed" if lag else "late_signal"
    there = [one for one in said if one.code in ("late_signal", "low_passed")]
    rightly = sum(one.code == code for one in there)
    error = max((abs(one.samples - delay - lag) for one in there if one.code == code), default=0.0)
    others = sum(bool(one.code) for one in said) - len(there)
    return (
        f"{kind.name:20s} {fault:13s} {100 * noise:3.0f} %  named {len(there)}/{len(said)}  "
        f"as it is {rightly}/{len(said)}  others named {others}  error {error:.3f} samples"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--systems", type=int, default=4)
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--kinds", default="", help="only kinds whose name has this in it")
    asked = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    for kind in KINDS:
        if asked.kinds not in kind.name:
            continue
        said: dict[tuple[str, float], list[Named]] = {}
        for fault, noise, record in records(kind, asked.seed, asked.systems):
            said.setdefault((fault, noise), []).append(named(kind, record))
        for (fault, noise), of in said.items():
            print(line(kind, fault, noise, of), flush=True)


if __name__ == "__main__":
    main()
