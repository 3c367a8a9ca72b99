"""Silverbox, a measured electronic Duffing oscillator, on the official split.

Scores are simulation errors in mV; the first 50 samples of each slice do not count.
"""

from pathlib import Path

import jax
import numpy as np
import scipy.io

import riecjax as rx
from riecjax.criteria.test_functions import AbstractTestFunction
from riecjax.models.catalogue import built_in_model
from riecjax.models.oscillators import duffing_equation

STEP = 2**14 / 1e7
TRAIN = (40650, 105712)
SLICES = {"arrow": (100, 40575), "no extrapolation": (100, 32100), "multisine": (105712, 127400)}
FACTOR = 8
WINDOWS = rx.RandomWindows(0.006, 0.026, 20000)


def load_silverbox(folder: Path) -> rx.Record:
    data = scipy.io.loadmat(folder / "SNLS80mV.mat")
    u, y = data["V1"].ravel(), data["V2"].ravel()
    return rx.Record.from_samples({"u": u - u.mean(), "y": y - y.mean()}, time_step=STEP)


def estimate_from(train: rx.Record, test_function: AbstractTestFunction) -> rx.Estimate:
    return rx.identify(
        duffing_equation(), train, rx.RIEC(WINDOWS, test_function), key=jax.random.key(0)
    )


def score(estimate: rx.Estimate, fine: rx.Record, first: int, last: int) -> float:
    """Simulation error in mV on the samples of a slice, its input band-limited between them."""
    lost = round(float(fine.start_time) / STEP)
    part = fine.part((first - lost) * FACTOR, (last - 1 - lost) * FACTOR + 1)
    y = np.asarray(part["y"])
    start = {"y": y[0], "dy": (y[1] - y[0]) / float(part.time_step)}
    system = built_in_model("duffing").build_system(dict(estimate.values))
    # One step between samples of the finer record is four or more per sample of the recorded one.
    run = rx.simulate(
        system, part.select("u"), method=rx.FixedStep(1), initial_state=start
    ).checked()
    error = (np.asarray(run.record["y"]) - y)[::FACTOR]
    return 1e3 * float(np.sqrt(np.mean(error[50:] ** 2)))
