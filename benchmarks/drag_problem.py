"""The oscillator with drag that peers were measured on: m x'' + r x' + r2 x'|x'| + k x = u."""

import functools

import jax.numpy as jnp
import numpy as np
import scipy.integrate

from riecjax.models.oscillators import DragOscillator
from riecjax.records.record import Record

TRUTH = {"m": 1.5, "r": 0.8, "r2": 0.5, "k": 20.0}
START = {"m": 1.0, "r": 1.0, "r2": 1.0, "k": 10.0}
RATE, COUNT = 100, 2001
BOUND = {"m": 0.00118, "r": 0.0213, "r2": 0.0105, "k": 0.00113}
"""Cramer-Rao bound at 5 % noise, as a share of the true value; the initial state is unknown too."""


def force(t: np.ndarray) -> np.ndarray:
    phases = np.random.default_rng(0).uniform(0, 2 * np.pi, 7)
    tones = zip([0.1, 0.3, 0.5, 0.7, 0.9, 1.3, 2.0], phases)
    return 14 / np.sqrt(7) * sum(np.sin(2 * np.pi * f * t + p) for f, p in tones)


@functools.cache
def motion() -> tuple[np.ndarray, np.ndarray]:
    """Position and velocity by SciPy at tight tolerance."""
    m, r, r2, k = TRUTH.values()
    run = scipy.integrate.solve_ivp(
        lambda t, s: [s[1], (force(t) - r * s[1] - r2 * s[1] * abs(s[1]) - k * s[0]) / m],
        (0, (COUNT - 1) / RATE),
        [0.0, 0.0],
        t_eval=np.arange(COUNT) / RATE,
        rtol=1e-10,
        atol=1e-12,
    )
    return run.y[0], run.y[1]


def signals(seed: int | None = None, noise: float = 0.05) -> dict[str, np.ndarray]:
    """Force, position and velocity; with a seed, noise of a share of each one's deviation."""
    x, v = motion()
    found = {"u": force(np.arange(COUNT) / RATE), "x": x, "dx": v}
    if seed is not None:
        rng = np.random.default_rng(100 + seed)
        for name in ("x", "dx"):
            found[name] = found[name] + noise * found[name].std() * rng.standard_normal(COUNT)
    return found


def record(seed: int | None = None, noise: float = 0.05, count: int = COUNT) -> Record:
    return Record.from_samples(
        {name: values[:count] for name, values in signals(seed, noise).items()}, time_step=1 / RATE
    )


def oscillator() -> DragOscillator:
    return DragOscillator(*(jnp.asarray(1.0) for _ in TRUTH))
