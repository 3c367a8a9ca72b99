"""`riecjax identify`: windows by bands, draws by seeds."""

from pathlib import Path

import numpy as np
import pytest
from command_line import call, quarter_car_columns, write_csv
from test_job_files import context

from riecjax import settings
from riecjax.cli.main import run
from riecjax.criteria.suited import criterion_for
from riecjax.summaries.summarise import ready

PLAIN = ("--refine", "none")


@pytest.fixture(scope="module")
def drive_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("drive") / "drive.csv"
    arguments = ["simulate", "quarter-car-source", "--input", "white-noise"]
    assert run([*arguments, "--duration", "20", "--seed", "4", "--out", str(path)]) == 0
    return path


@pytest.fixture
def from_file(capsys, drive_file):
    def identify_drive(*options: object, model: str) -> dict:
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


@pytest.mark.parametrize("case", BANDS)
def test_windows_are_half_periods_of_a_band(tyre_file, case):
    name, options, alpha, beta = BANDS[case]
    columns = quarter_car_columns()
    write_csv(Path("drive.csv"), {column: columns[column] for column in ("t", "x1", "F_t")})
    given = context(["drive.csv", "--model", f"{tyre_file}:{name}", *map(str, options)])
    model = given.model()
    records = [recording.record for recording in ready(model, given.recordings(model))]
    windows = criterion_for(given.take(settings.Assess), model, records).windows
    assert windows is not None
    assert (float(windows.alpha), float(windows.beta)) == pytest.approx((alpha, beta))


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
