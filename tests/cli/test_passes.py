"""How often one command computes an equation's samples: they are read once for all that is summed.

An expression notes each time that it runs with how many samples it is given, and the first of
them, which tells the recording, and whether noise was added to it. Recordings of fewer than 4096
samples are filled up to so many and worked through as one chunk: each pass is one execution.
"""

from collections import Counter
from pathlib import Path

import jax
import pytest
from command_line import call, write_csv
from tests.approved.inputs import cart

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

mass = rx.Term("m", "v", derivative=1, measured=("a",))
damping, force = rx.Term("c", "v"), -rx.Term(1.0, "f")
cart = rx.Equation(mass, damping, rx.Term("k", cube), force, name="cart")
"""
SAMPLES = 3000
PROBE = 64
"""Samples of each recording on which, and on halves of which, expressions that mix any are found.
"""


@pytest.fixture(autouse=True)
def working_folder() -> None:
    Path("model.py").write_text(NOTING)


def test_one_command_sums_a_recording_once(capsys):
    columns = cart()
    write_csv(Path("one.csv"), columns)
    settings = ("--model", "model.py:cart", "--alpha", 0.05, "--beta", 0.5, "--refine", "none")
    result = call(capsys, "identify", "one.csv", *settings, "--out", "results")
    assert result.status == 0, result.err
    jax.effects_barrier()
    for name in ("report.html", "fit.png", "window_sweep.png", "residual_1.png"):
        assert (Path("results") / name).is_file()
    lines = [line.split() for line in Path("executions.txt").read_text().splitlines()]
    ran = Counter(
        ("as recorded" if float(start) == columns["p"][0] else "with noise", int(size))
        for size, start in lines
        if int(size) > PROBE
    )
    assert ran == {
        # The one pass: moments, bins of the sweep, and the check's survey, in which noise is added
        # to values. Then what is left sample by sample, for residual tests.
        ("as recorded", SAMPLES): 3 + 5,
        # Two steps of noise to either side, for curvature; and the rows with noise. What else may
        # be wrong: how the residual changes with a signal, and noise that is put through columns.
        ("with noise", SAMPLES): 5 + 10,
    }
