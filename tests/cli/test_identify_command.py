"""`riecjax identify`: windows by bands, draws by seeds, commands to paste."""

import shlex
from pathlib import Path

import numpy as np
import pytest
from command_line import call

from nightly import by_day
from riecjax.cli.main import run

PLAIN = ("--refine", "none")


@pytest.fixture(scope="module")
def drive_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("drive") / "drive.csv"
    arguments = ["simulate", "quarter-car-source", "--input", "white-noise"]
    assert run([*arguments, "--duration", "20", "--seed", "4", "--out", str(path)]) == 0
    return path


@pytest.fixture
def from_file(capsys, drive_file):
    def identify_drive(*options: object, model: str = "quarter-car") -> dict:
        result = call(capsys, "identify", drive_file, "--model", model, *PLAIN, "--json", *options)
        assert result.status == 0, result.err
        return result.document

    return identify_drive


def values(document: dict) -> dict[str, float]:
    return {name: entry["value"] for name, entry in document["parameters"].items()}


OWN_BAND = """
import riecjax as rx

tyre = rx.Equation(rx.Term("K_t", "x1", unit="N/m"), -rx.Term(1.0, "F_t"), name="tyre", unit="N")
slow = rx.Model("tyre", "a tyre", stages=tyre, band=(2.0, 4.0))
"""


@pytest.fixture(scope="module")
def tyre_file(tmp_path_factory) -> Path:
    """Models of one equation, which compile in no time."""
    path = tmp_path_factory.mktemp("tyre") / "tyre.py"
    path.write_text(OWN_BAND)
    return path


BANDS = {
    "default": ("tyre", (), 0.05, 0.5),
    "band and alpha": ("tyre", ("--band", 2, 5, "--alpha", 0.02), 0.02, 0.25),
    "band and beta": ("tyre", ("--band", 2, 5, "--beta", 0.4), 0.1, 0.4),
    "beta alone": ("tyre", ("--beta", 0.4), 0.05, 0.4),
    "of the model": ("slow", (), 0.125, 0.25),
    "beside the model's": ("slow", ("--band", 1, 5), 0.1, 0.5),
}


@pytest.mark.parametrize("case", by_day(BANDS, "default", "band and alpha", "of the model"))
def test_windows_are_half_periods_of_a_band(from_file, tyre_file, case):
    model, options, alpha, beta = BANDS[case]
    document = from_file(*options, "--no-sweep", model=f"{tyre_file}:{model}")
    assert document["criterion"]["alpha"] == pytest.approx(alpha)
    assert document["criterion"]["beta"] == pytest.approx(beta)
    choice = document["window_choice"]
    assert choice["seen_best_hz"] == pytest.approx([0.5 / beta, 0.5 / alpha])


@pytest.mark.slow
def test_a_seed_draws_windows_and_of_all_windows_moves_the_bootstrap_only(from_file, tyre_file):
    model = f"{tyre_file}:tyre"
    drawn = [
        from_file("--windows", 8000, "--no-sweep", "--seed", seed, model=model)
        for seed in (3, 3, 4)
    ]
    assert drawn[0] == drawn[1]
    low, high = drawn[0]["parameters"]["K_t"]["interval95"]
    # Another draw of windows is no other machine: well within the intervals.
    assert 0 < abs(values(drawn[0])["K_t"] - values(drawn[2])["K_t"]) < 0.5 * (high - low)
    first, other = (
        from_file("--no-sweep", "--seed", seed, model=model)["parameters"]["K_t"] for seed in (3, 4)
    )
    assert (first["value"], first["std_error"]) == (other["value"], other["std_error"])
    ends = np.array([first["interval95"], other["interval95"]])
    # A percent or two of the width, as BlockBootstrap says, times five.
    assert 0 < np.ptp(ends, axis=0).max() < 0.1 * np.ptp(ends[0])


@pytest.mark.slow
def test_a_proposed_command_can_be_pasted(capsys, drive_file):
    result = call(capsys, "identify", drive_file, "--model", "quarter-car", *PLAIN)
    lines = result.out.splitlines()
    # What is to be pasted is not broken.
    assert max(len(line) for line in lines if not line.startswith("  riecjax")) <= 80
    (command,) = [line for line in lines if line.startswith("  riecjax identify")][:1]
    again = call(capsys, *shlex.split(command)[1:])
    assert again.status == 0
    # The wheel of the source weighs 30 kg.
    table = " ".join(again.out.split())
    wheel = float(table.split("parameter value")[1].split("M_us")[1].split()[0])
    assert wheel == pytest.approx(30.0, rel=0.01)
