"""A body with an oscillator on it that its model does not know, solved by SciPy."""

import numpy as np
import scipy.signal

import riecjax as rx

STEP, FINER = 0.005, 8
TRUTH = {"m": 20.0, "c": 60.0, "k": 4000.0, "M_mode": 6.0, "K_mode": 21000.0, "B_mode": 120.0}
BODY = rx.Equation(
    rx.Term("m", "v", derivative=1, unit="kg"),
    rx.Term("c", "v", unit="N s/m"),
    rx.Term("k", "x", unit="N/m"),
    -rx.Term(1.0, "F"),
    name="body",
    unit="N",
)


def motion(mode: bool, count: int = 6000) -> dict[str, np.ndarray]:
    """Position, velocity and force of the body, whose force is band-limited noise."""
    m, c, k, heavy, stiff, loss = TRUTH.values()
    if not mode:
        heavy, stiff, loss = 1.0, 0.0, 0.0
    a = np.array(
        [
            [0, 1, 0, 0],
            [-(k + stiff) / m, -(c + loss) / m, stiff / m, loss / m],
            [0, 0, 0, 1],
            [stiff / heavy, loss / heavy, -stiff / heavy, -loss / heavy],
        ]
    )
    return driven(a, count)


def driven(a: np.ndarray, count: int, seed: int = 3) -> dict[str, np.ndarray]:
    """Position, velocity and force of a body of this state matrix, x and v first."""
    b = np.zeros((len(a), 1))
    b[1] = 1 / TRUTH["m"]
    rng = np.random.default_rng(seed)
    sharp = scipy.signal.butter(6, 40.0, fs=FINER / STEP, output="sos")
    force = 300 * np.asarray(scipy.signal.sosfilt(sharp, rng.standard_normal(count * FINER)))
    times = np.arange(force.size) * STEP / FINER
    _, states, _ = scipy.signal.lsim((a, b, np.eye(len(a)), np.zeros_like(b)), force, times)
    return {"x": states[::FINER, 0], "v": states[::FINER, 1], "F": force[::FINER]}


MODEL = rx.staged(BODY).with_modes(rx.HiddenMode("v"))
