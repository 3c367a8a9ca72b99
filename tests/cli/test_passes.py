"""How often one command computes an equation's samples: they are read once for all that is summed.

An expression notes each time that it runs with how many samples it is given, and the first of
them, which tells the recording, and whether noise was added to it. Recordings of fewer than 4096
samples are filled up to so many and worked through as one chunk: each pass is one execution.
"""

from collections import Counter
from pathlib import Path

import jax
import numpy as np
import pytest
from command_line import call, write_csv

SAMPLES, OTHER_SAMPLES, FILLED = 3000, 3500, 4096
NOTING = """
from pathlib import Path
import jax
import riecjax as rx

def note(p):
    with Path("executions.txt").open("a") as file:
        print(p.size, float(p[0]), file=file)

def cube(s):
    jax.debug.callback(note, s["p"])
    return s["p"] ** 3

def position(s):
    jax.debug.callback(note, s["p"])
    return s["p"]

mass = rx.Term("m", "v", derivative=1, measured=("a",))
damping, force = rx.Term("c", "v"), -rx.Term(1.0, "f")
cart = rx.Equation(mass, damping, rx.Term("k", cube), force, name="cart")
curved = rx.Equation(
    mass, damping, rx.Terms("F", rx.roof([-1.2, -0.4, 0.4, 1.2]), position), force, name="curved"
)
"""
PROBE = 64
"""Samples of each recording on which, and on halves of which, expressions that mix any are found.
"""


@pytest.fixture(autouse=True)
def working_folder(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("model.py").write_text(NOTING)


def recording(name: str, samples: int, seed: int) -> float:
    """Write a recording of a cart, and return its first p."""
    rng = np.random.default_rng(seed)
    time = np.arange(samples) / 500 + seed
    p = np.sin(3 * time) + 0.2 * np.sin(11 * time)
    v = 3 * np.cos(3 * time) + 2.2 * np.cos(11 * time)
    a = -9 * np.sin(3 * time) - 24.2 * np.sin(11 * time)
    f = 2.5 * a + 0.75 * v + 40.0 * p**3
    signals = {"p": p, "v": v, "a": a, "f": f}
    noisy = {k: x + 1e-3 * rng.normal(size=samples) for k, x in signals.items()}
    write_csv(Path(name), {"t": time, **noisy})
    return float(noisy["p"][0])


def executions(capsys, model: str, **recordings: float) -> Counter[tuple[str, int]]:
    """How often the model's expression ran in one `identify --out`, but for the probes.

    **Arguments:** `recordings`, the first p of each by its file's name without `.csv`.

    **Returns:** by the recording, or "with noise" added to one, and how many samples were given.
    """
    files = [f"{name}.csv" for name in recordings]
    settings = (
        "--model",
        f"model.py:{model}",
        "--alpha",
        "0.05",
        "--beta",
        "0.5",
        "--refine",
        "none",
    )
    result = call(capsys, "identify", *files, *settings, "--out", "results")
    assert result.status == 0, result.err
    jax.effects_barrier()
    for name in ("report.html", "fit.png", "window_sweep.png", "residual_1.png"):
        assert (Path("results") / name).is_file()
    lines = [line.split() for line in Path("executions.txt").read_text().splitlines()]
    which = {first: name for name, first in recordings.items()}
    return Counter(
        (which.get(float(first), "with noise"), int(size))
        for size, first in lines
        if int(size) > PROBE
    )


def test_one_command_sums_a_recording_once(capsys):
    assert executions(capsys, "cart", one=recording("one.csv", SAMPLES, seed=0)) == {
        # The one pass: moments, bins of the sweep, averaged rows, activity and the check's survey.
        # In it values, and those that noise is added to, for averaged and surveyed rows alike.
        ("one", FILLED): 2,
        # Two steps of noise to either side, for curvature; and the rows with noise. Then seven
        # delays at which the force might fit better, each a pass over what is shifted by it.
        ("with noise", FILLED): 5 + 7 * 5,
        # What is left sample by sample, which residual tests and the choice of windows share.
        ("one", SAMPLES): 1,
    }


@pytest.mark.slow
def test_each_of_two_recordings_is_summed_once(capsys):
    first, second = recording("one.csv", SAMPLES, 0), recording("two.csv", OTHER_SAMPLES, 1)
    assert executions(capsys, "cart", one=first, two=second) == {
        # As for one recording; each delay is that of both.
        ("one", FILLED): 2,
        ("two", FILLED): 2,
        ("with noise", FILLED): 2 * (5 + 7 * 5),
        ("one", SAMPLES): 1,
        ("two", OTHER_SAMPLES): 1,
    }


@pytest.mark.slow
def test_a_curve_is_drawn_over_samples_that_are_computed_for_it(capsys):
    assert executions(capsys, "curved", one=recording("one.csv", SAMPLES, seed=0)) == {
        # The one pass, and in it the reach of the curve's variable, which the survey keeps. Noise
        # moves the variable along its slope, and steps to either side are taken in the roofs alone.
        ("one", FILLED): 5,
        # And the delays, of which some are looked at twice.
        ("with noise", FILLED): 1 + 9 * 4,
        # What is left; for the figure, the curve's variable, and the equation at each sample.
        ("one", SAMPLES): 3,
    }
    assert Path("results/curves.png").is_file()
