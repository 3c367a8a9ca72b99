"""Recordings of a fleet of oscillators with drag, simulated side by side: m x'' + r x' + r2 x'|x'|
+ k x = u, driven by tones of random phases."""

import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from riecjax.records.record import Record
from riecjax.records.writing import write_record

TRUTH = {"m": 1.5, "r": 0.8, "r2": 0.5, "k": 20.0}
STEP = 0.005
TONES = np.geomspace(0.1, 3.0, 9)
"""Frequencies of the force in hertz."""
TOGETHER = 500
"""Drives that are simulated side by side."""


def drives(
    count: int, samples: int, seed: int, noise: float = 0.01, **changed: float
) -> list[Record]:
    """Recordings with other parameters, and noise of a share of each signal's deviation."""
    m, r, r2, k = (changed.get(name, value) for name, value in TRUTH.items())
    rng = np.random.default_rng(seed)
    phases = rng.uniform(0, 2 * np.pi, (count, TONES.size, 1))
    half = 2 * np.pi * TONES[:, None] * (0.5 * STEP * np.arange(2 * samples))
    u = 14 / np.sqrt(TONES.size) * np.sin(half + phases).sum(1)
    x, v = np.zeros((2, count, samples))

    def rates(place: int, x: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return v, (u[:, place] - r * v - r2 * v * np.abs(v) - k * x) / m

    for i in range(samples - 1):
        a, b = x[:, i], v[:, i]
        k1 = rates(2 * i, a, b)
        k2 = rates(2 * i + 1, a + 0.5 * STEP * k1[0], b + 0.5 * STEP * k1[1])
        k3 = rates(2 * i + 1, a + 0.5 * STEP * k2[0], b + 0.5 * STEP * k2[1])
        k4 = rates(2 * i + 2, a + STEP * k3[0], b + STEP * k3[1])
        x[:, i + 1], v[:, i + 1] = (
            old + STEP / 6 * (p + 2 * q + 2 * s + t)
            for old, p, q, s, t in zip((a, b), k1, k2, k3, k4)
        )
    signals = {"u": u[:, ::2], "x": x, "dx": v}
    for name in ("x", "dx"):
        size = noise * signals[name].std(axis=1, keepdims=True)
        signals[name] = signals[name] + size * rng.standard_normal((count, samples))
    return [
        Record.from_samples({name: of[i] for name, of in signals.items()}, time_step=STEP)
        for i in range(count)
    ]


def write_fleet(
    folder: Path,
    recordings: int,
    groups: int,
    *,
    samples: Sequence[int] = (4000, 8000, 12000),
    worn: Sequence[int] = (),
    wear: float = 0.15,
    broken: float = 0.01,
    seed: int = 0,
) -> None:
    """Folders `vehicle=00`, ... with recordings of these lengths in turn, as Parquet.

    **Arguments:** `worn`: groups whose dampers have lost the share `wear`; `broken`: share of files
    that are cut off.
    """
    shutil.rmtree(folder, ignore_errors=True)
    rng = np.random.default_rng([seed, 1])
    for group in range(groups):
        place = folder / f"vehicle={group:02}"
        place.mkdir(parents=True)
        own = (1 - wear) if group in worn else 1.0
        damping = {name: own * TRUTH[name] for name in ("r", "r2")}
        count, number = recordings // groups, 0
        for length in samples:
            wanted = count // len(samples) + (length == samples[0]) * (count % len(samples))
            for first in range(0, wanted, TOGETHER):
                some = min(TOGETHER, wanted - first)
                for record in drives(some, length, seed + 1000 * group + number, **damping):
                    file = place / f"{number:05}.parquet"
                    write_record(file, record)
                    if rng.random() < broken:
                        file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
                    number += 1
