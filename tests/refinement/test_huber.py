"""Huber's loss: its optimum against SciPy, and its standard errors against scatter."""

import numpy as np
import pytest
import scipy.integrate
from tests.machines import DRAG
from tests.machines import DRAG_START as START
from tests.machines import DRAG_TRUTH as TRUTH
from tests.machines import drag_force as force
from tests.machines import drag_oscillator as oscillator
from tests.machines import drag_signals as signals

from riecjax.records.noise_judgement import judged
from riecjax.records.record import Record
from riecjax.refinement.output_error import THRESHOLD, OutputError
from riecjax.refinement.refine import refine
from riecjax.simulation.method import FixedStep

COUNT, RATE = DRAG.shape
NOISE = {name: 0.05 * signals()[name].std() for name in ("x", "dx")}
BY = {"sigma": NOISE, "method": FixedStep(1)}


def measured(seed: int, spikes: float = 20.0) -> dict[str, np.ndarray]:
    """With spikes of so many standard deviations of the noise on a hundredth of the samples."""
    found, rng = signals(seed), np.random.default_rng(seed)
    for name, noise in NOISE.items():
        where = rng.choice(COUNT, COUNT // 100, replace=False)
        found[name][where] += spikes * noise * rng.choice([-1, 1], where.size)
    return found


def record(seed: int, spikes: float = 20.0) -> Record:
    return Record.from_samples(measured(seed, spikes), time_step=1 / RATE)


def huber_costs_by_scipy(data, sizes, points):
    """Twice the loss at several points, simulated side by side by SciPy."""
    m, r, r2, k, x, v = np.transpose(points)

    def derivative(t, s):
        x, v = np.split(s, 2)
        return np.concatenate([v, (force(t) - r * v - r2 * v * abs(v) - k * x) / m])

    t = np.arange(COUNT) / RATE
    start = np.concatenate([x, v])
    run = scipy.integrate.solve_ivp(
        derivative, (0, t[-1]), start, "DOP853", t, rtol=1e-10, atol=1e-12
    )
    total = np.zeros(len(points))
    for states, name in zip(np.split(run.y, 2), ("x", "dx")):
        off = np.abs(states.T - data[name][:, None]) / sizes[name]
        bent = THRESHOLD * (2 * off - THRESHOLD)
        total += np.sum(np.where(off <= THRESHOLD, off**2, bent), axis=0)
    return total


@pytest.mark.slow
def test_the_optimum_is_scipys_and_spikes_hardly_move_it():
    held = record(0)
    found = refine(oscillator(), held, START, OutputError(loss="huber", **BY))
    known = judged(held).noise
    noise = {name: float(known.std(name)) for name in NOISE}
    p = np.concatenate([found.theta, found.initial_states[0]])
    steps = np.diag(np.concatenate([found.standard_errors, [3e-3, 1e-2]]))
    centre, *around = huber_costs_by_scipy(measured(0), noise, [p, *(p - steps), *(p + steps)])
    below, above = np.split(np.array(around), 2)
    vertices = (below - above) / (2 * (below + above - 2 * centre))
    # The loss is no parabola over two standard errors.
    assert np.all(np.abs(vertices) < 0.05)
    assert dict(found.by)["loss"] == "huber"
    plain = refine(oscillator(), held, START, OutputError(**BY))
    truth = np.array(list(TRUTH.values()))
    off = [
        np.abs(np.asarray(each.theta) - truth) / found.standard_errors for each in (found, plain)
    ]
    assert np.max(off[0]) < 3.5
    assert np.all(np.asarray(found.standard_errors) < 0.8 * np.asarray(plain.standard_errors))
