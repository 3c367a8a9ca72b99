"""Is a joint that sticks identified? Coverage of nominal 95 % intervals over seeds.

    python -m benchmarks.sticking [--seeds 100] [--case clean|velocity|encoder] [--at-rest keep]

J q'' + d q' + (Fc + Fs e^-(q'/vs)^2) sign(q') + mgl sin(q) = tau, driven by twelve tones from 0.3
to 1.6 Hz with phases by seed: it sticks for 4 % of the time. 40 s at 500 Hz, of steps of 0.2 ms
that stop where the velocity does. `encoder`: positions in steps of 1e-4 rad, 5 % noise on the
torque, and no sensor of the velocity. `velocity`: the same and a velocity with 1 % noise. `clean`:
neither noise nor steps.
"""

import argparse
import math
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

import riecjax as rx
from riecjax.records.signals import Signals

TRUE = {"J": 0.8, "d": 1.2, "Fc": 2.0, "Fs": 1.5, "mgl": 6.0}
VS = 0.15
DRIVE, TONES, LOWEST, HIGHEST = 9.0, 12, 0.3, 1.6
TIME_STEP, SUBSTEPS, SECONDS = 0.002, 10, 40.0
ENCODER, TORQUE_NOISE, VELOCITY_NOISE = 1e-4, 0.05, 0.01
CASES = ("clean", "velocity", "encoder")


def _direction(signals: Signals) -> Array:
    return jnp.sign(signals["dq"])


def _stribeck(signals: Signals) -> Array:
    return jnp.sign(signals["dq"]) * jnp.exp(-((signals["dq"] / VS) ** 2))


def _gravity(signals: Signals) -> Array:
    return jnp.sin(signals["q"])


JOINT = rx.Equation(
    rx.Term("J", "q", derivative=2, measured=("dq",), unit="kg m^2"),
    rx.Term("d", "q", derivative=1, measured=("dq",), unit="N m s"),
    rx.Term("Fc", _direction, unit="N m"),
    rx.Term("Fs", _stribeck, unit="N m"),
    rx.Term("mgl", _gravity, unit="N m"),
    -rx.Term(1.0, "tau"),
    name="joint",
    unit="N m",
)


class Motion(NamedTuple):
    """Position in rad, velocity in rad/s and torque in N m, each of shape `(n,)`."""

    q: np.ndarray
    dq: np.ndarray
    tau: np.ndarray


def joint_motion(seed: int, seconds: float = SECONDS) -> Motion:
    """How the joint moves, by midpoint steps which end where it stops."""
    rng, h = np.random.default_rng(seed), TIME_STEP / SUBSTEPS
    steps = round(seconds / h)
    hertz = np.linspace(LOWEST, HIGHEST, TONES) + rng.uniform(-0.05, 0.05, TONES)
    phases, halves = rng.uniform(0, 2 * np.pi, TONES), 0.5 * h * np.arange(2 * steps + 2)
    tau = sum(np.sin(2 * np.pi * f * halves + p) for f, p in zip(hertz, phases))
    torque = (DRIVE * np.sqrt(2 / TONES) * np.asarray(tau)).tolist()
    inertia, viscous, coulomb, rise, weight = TRUE.values()
    q = v = 0.0
    path = np.empty((steps + 1, 2))
    for i in range(steps + 1):
        path[i] = q, v
        free = torque[2 * i] - weight * math.sin(q)
        side = math.copysign(1.0, v if v != 0 else free)
        if v == 0 and abs(free) <= coulomb + rise:
            continue
        friction = side * (coulomb + rise * math.exp(-((v / VS) ** 2)))
        middle = v + 0.5 * h * (free - viscous * v - friction) / inertia
        friction = side * (coulomb + rise * math.exp(-((middle / VS) ** 2)))
        free = torque[2 * i + 1] - weight * math.sin(q + 0.5 * h * v)
        after = v + h * (free - viscous * middle - friction) / inertia
        if after * side < 0:
            q, v = q + 0.5 * h * v * v / (v - after), 0.0
        else:
            q, v = q + h * middle, after
    positions, velocities = path[::SUBSTEPS].T
    return Motion(positions, velocities, np.array(torque[:: 2 * SUBSTEPS]))


def recorded(motion: Motion, case: str, seed: int) -> rx.Record:
    """What sensors make of a motion; see the module for the cases."""
    rng, (q, dq, tau) = np.random.default_rng((seed, 1)), motion
    if case != "clean":
        tau = tau + TORQUE_NOISE * tau.std() * rng.normal(size=tau.size)
        q = ENCODER * np.round(q / ENCODER)
        dq = dq + VELOCITY_NOISE * dq.std() * rng.normal(size=dq.size)
    signals = {"q": q, "tau": tau} | ({} if case == "encoder" else {"dq": dq})
    return rx.Record.from_samples(signals, time_step=TIME_STEP)


def fits(
    case: str, seeds: Iterable[int], **settings: Any
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Of each seed the relative error of each parameter, and whether its interval holds it."""
    for seed in seeds:
        record = recorded(joint_motion(seed), case, seed)
        # As `identify` does, which estimates twice to say what is done at rest.
        found = rx.estimate(JOINT, rx.summarise(JOINT, record, **settings)).to_dict()
        truth = [(found[name], true) for name, true in TRUE.items()]
        yield (
            np.array([one["value"] / true - 1 for one, true in truth]),
            np.array([one["interval"][0] <= true <= one["interval"][1] for one, true in truth]),
        )


def main() -> None:
    """Print, for each case, mean error and spread in percent, and the share covered."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--case", choices=CASES, action="append")
    parser.add_argument("--at-rest", choices=["mask", "keep"], default="mask")
    asked = parser.parse_args()
    from riecjax.runtime import start_jax

    start_jax()
    print(f"{'case':10}{'':10}", *(f"{name:>8}" for name in TRUE))
    for case in asked.case or CASES:
        errors, covered = map(np.array, zip(*fits(case, range(asked.seeds), at_rest=asked.at_rest)))
        rows = {
            "mean %": 100 * errors.mean(0),
            "spread %": 100 * errors.std(0),
            "covered %": 100 * covered.mean(0),
        }
        for label, row in rows.items():
            print(f"{case:10}{label:10}", *(f"{value:8.2f}" for value in row), flush=True)


if __name__ == "__main__":
    main()
