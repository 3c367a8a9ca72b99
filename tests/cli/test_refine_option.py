"""`riecjax identify --refine`: refined parameters, and predictions before and after."""

from pathlib import Path

import numpy as np
import pytest
from command_line import call, write_csv

TRUTH = {"m": 1.5, "r": 0.8, "r2": 0.5, "k": 20.0}
IDENTIFY = ("--model", "drag-oscillator", "--no-sweep", "--intervals", "sandwich")


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """The oscillator with drag by plain Runge-Kutta, its sensors with 5 % noise."""
    rng = np.random.default_rng(2)
    t = np.arange(0, 20, 0.01)
    phases = rng.uniform(0, 2 * np.pi, 5)

    def force(at):
        return 6 * sum(
            np.sin(2 * np.pi * f * at + p) for f, p in zip((0.3, 0.5, 0.7, 0.9, 1.3), phases)
        )

    def slope(at, s):
        m, r, r2, k = TRUTH.values()
        return np.array([s[1], (force(at) - r * s[1] - r2 * s[1] * abs(s[1]) - k * s[0]) / m])

    states, h = [np.zeros(2)], 0.01
    for at in t[:-1]:
        s = states[-1]
        a = slope(at, s)
        b = slope(at + h / 2, s + h / 2 * a)
        c = slope(at + h / 2, s + h / 2 * b)
        d = slope(at + h, s + h * c)
        states.append(s + h / 6 * (a + 2 * b + 2 * c + d))
    x, dx = np.array(states).T
    noisy = {
        name: values + 0.05 * values.std() * rng.standard_normal(values.size)
        for name, values in (("x", x), ("dx", dx))
    }
    path = tmp_path_factory.mktemp("refine") / "run.csv"
    write_csv(path, {"t": t, "u": np.asarray(force(t)), **noisy})
    return path


def test_output_error_and_what_it_did_to_predictions(recording, capsys, tmp_path):
    out = tmp_path / "result"
    run = call(
        capsys, "identify", str(recording), *IDENTIFY, "--refine", "output-error", "--hold-out",
        "0.3", "--bound", "m=0:", "--json", "--out", str(out),
    )  # fmt: skip
    document = run.document
    assert document["refinement"]["converged"] is True
    for name, true in TRUTH.items():
        entry = document["parameters"][name]
        low, high = entry["interval95"]
        assert low - (high - low) < true < high + (high - low)
        before = document["refinement"]["identified"][name]
        assert entry["std_error"] < before["std_error"]
    left = document["refinement"]["left"]
    assert set(left) == {"x", "dx"}
    assert all(entry["after"] <= entry["before"] for entry in left.values())
    basis = "the whole record, initial states estimated for each, FixedStep(1)"
    assert document["refinement"]["basis"] == basis
    (simulated,) = document["refinement"]["simulations"]
    assert simulated["fitted"] is False
    assert simulated["after"]["signals"]["x"]["fit_percent"] > 90
    assert document["validation"][0]["predicts"] is True
    assert Path(out / "report.html").exists()


def test_integral_refinement_prints_both_values(recording, capsys):
    printed = call(capsys, "identify", str(recording), *IDENTIFY, "--refine", "integral").out
    assert "identified" in printed
    assert "refined by impulses of the equation error: converged" in printed
    assert "run.csv (fitted), fit before -> after" in printed
    assert "left before and after, of impulses over the same windows" in printed
    assert "from the state as recorded" in " ".join(printed.split())


def test_windows_shorter_than_the_recording(recording, capsys):
    document = call(
        capsys, "identify", str(recording), *IDENTIFY, "--refine", "output-error", "--horizon",
        "2", "--channel", "x", "--json",
    ).document  # fmt: skip
    assert document["refinement"]["by"]["seconds"] == 2.0
    assert set(document["refinement"]["left"]) == {"x"}
    assert document["parameters"]["k"]["value"] == pytest.approx(20.0, rel=0.03)
