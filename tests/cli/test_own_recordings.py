"""A machine and a logger of one's own: preparation, several recordings, validation, gaps."""

from pathlib import Path

import numpy as np
import pytest
import scipy.io
from command_line import call, write_csv
from tests.machines import waves

MODEL = """
import riecjax as rx

axis = rx.Equation(
    rx.Term("M", "q", derivative=2, measured=("dq", "ddq"), unit="kg"),
    rx.Term("c", "q", derivative=1, measured=("dq",), unit="N s/m"),
    rx.Term("k", "q", unit="N/m"),
    rx.Term("offset", rx.constant, unit="N"),
    -rx.Term(1.0, "F"),
    name="axis",
    unit="N",
)
"""
RATE, COUNT = 200, 6000


def motion(offset: float = 0.0, phase: float = 0.0, count: int = COUNT) -> dict[str, np.ndarray]:
    """A mass of 2 kg on a spring of 80 N/m and a damper, in closed form; the force has an offset.

    **Arguments:** `phase` tells motions apart.
    """
    t = np.arange(count) / RATE
    q, dq, ddq = waves(t, int(phase), 0.3, (0.3, 2.5))
    return {"t": t, "q": q, "F": 2.0 * ddq + 3.0 * dq + 80.0 * q + offset}


@pytest.fixture(autouse=True)
def here():
    Path("machine.py").write_text(MODEL)


CHECK = ("--model", "machine.py:axis", "--test-function", "hat", "--quadrature", "6")
CHECK += ("--alpha", "0.1", "--beta", "0.5", "--json")
IDENTIFY = (*CHECK, "--refine", "none", "--intervals", "sandwich")


def values(document):
    return {name: entry["value"] for name, entry in document["parameters"].items()}


def identified(capsys, *arguments):
    return call(capsys, "identify", *arguments, *IDENTIFY).document


@pytest.mark.raises_finding("residuals_not_tested")
@pytest.mark.slow
def test_recordings_of_two_sampling_rates_lose_only_the_tests_of_the_residual(capsys):
    data = motion(offset=4.0)
    write_csv(Path("fast.csv"), data)
    write_csv(Path("slow.csv"), {name: samples[::2] for name, samples in data.items()})
    document = identified(capsys, "fast.csv", "slow.csv", "--no-sweep", "--out", "r")
    assert values(document)["k"] == pytest.approx(80.0, rel=1e-4)
    assert document["residual_tests"] is None
    assert Path("r/report.html").exists()


def test_a_cut_by_absolute_stamps_says_where_the_clock_begins(capsys):
    data = motion(count=600)
    write_csv(Path("run.csv"), {**data, "t": 1.7e9 + data["t"]})
    result = call(capsys, "identify", "run.csv", *IDENTIFY, "--from", "1700000001")
    assert result.status == 1
    assert "from 0 to 2.995 s, counted from its first sample, stamped 1700000000." in result.err


@pytest.mark.slow
@pytest.mark.raises_finding("validated_on_fitted")
def test_several_parts_are_read_and_what_was_fitted_is_no_validation(capsys):
    """Three runs in one file, of which two are named."""
    runs = [motion(offset=0.5, phase=p, count=2000) for p in (0.0, 1.0, 2.0)]
    scipy.io.savemat("runs.mat", {f"run{i}": run for i, run in enumerate(runs)})
    parts = ("--part", "run0", "--part", "run2")
    found = identified(capsys, "runs.mat", *parts, "--validate", "runs.mat", "--no-sweep")
    assert [record["part"] for record in found["provenance"]["records"]] == ["run0", "run2"]
    assert found["job"]["part"] == ["run0", "run2"]


def test_time_in_another_unit_is_scaled_by_the_name_that_messages_give_it(capsys):
    run = motion(count=2000)
    write_csv(Path("ms.csv"), {"time": 1000 * run["t"], "q": run["q"], "F": run["F"]})
    assert "--scale t=0.001" in call(capsys, "check", "ms.csv", *CHECK).err
    for option in (("--scale", "t=0.001"), ("--unit", "t=ms")):
        checked = call(capsys, "check", "ms.csv", *CHECK, *option)
        assert checked.document["records"][0]["time_step"] == pytest.approx(1 / RATE)
