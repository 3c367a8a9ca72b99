"""`riecjax identify`: its numbers are the library's, its files and streams are as promised."""

import json
import os
import shlex
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest
from command_line import call, quarter_car_columns, write_csv

from nightly import by_day, nightly
from riecjax.cli.main import run
from riecjax.cli.simulate import drive
from riecjax.criteria.criterion import DOLS, RIEC
from riecjax.criteria.windows import AllWindows, RandomWindows
from riecjax.estimation.estimate import Estimate
from riecjax.estimation.identify import identify
from riecjax.models.quarter_car.identification import quarter_car_by_body, quarter_car_by_wheel
from riecjax.models.quarter_car.reconstruction import quarter_car_source, reconstructed
from riecjax.records.record import Record
from riecjax.simulation.simulate import simulate
from riecjax.uncertainty.intervals import BlockBootstrap, Naive, Sandwich

PARAMETERS = ("K_t", "M_us", "M_s", "K_s", "F_1", "F_2", "F_3", "F_4")
DURATION = 20.0
PLAIN = ("--refine", "none")


@pytest.fixture(scope="module")
def drive_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("drive") / "drive.csv"
    arguments = ["simulate", "quarter-car-source", "--input", "white-noise"]
    assert run([*arguments, "--duration", str(DURATION), "--seed", "4", "--out", str(path)]) == 0
    return path


@pytest.fixture(scope="module")
def drive_record() -> Record:
    road = drive(
        "white-noise", ("v_r",), duration=DURATION, rate=None, bandwidth=30.0, rms=0.55, seed=4
    )
    return simulate(quarter_car_source(reconstructed()), road).record


@pytest.fixture
def from_file(capsys, drive_file):
    def identify_drive(*options: object, model: str = "quarter-car") -> dict:
        result = call(capsys, "identify", drive_file, "--model", model, *PLAIN, "--json", *options)
        assert result.status == 0, result.err
        return result.document

    return identify_drive


def values(document: dict) -> dict[str, float]:
    return {name: entry["value"] for name, entry in document["parameters"].items()}


def agrees(document: dict, estimate: Estimate) -> None:
    assert list(document["parameters"]) == list(estimate.parameters)
    for name, entry in document["parameters"].items():
        assert entry["value"] == pytest.approx(float(estimate[name]), rel=1e-9)
        error = float(estimate.standard_error(name))
        # A spread of block sums that nearly cancel: fewer digits than the value itself.
        assert entry["std_error"] == pytest.approx(error, rel=1e-7)
        assert entry["interval95"] == pytest.approx(list(estimate.interval(name)), rel=1e-9)
    assert document["condition_number"] == pytest.approx(float(estimate.condition_number))


BY_WHEEL = ("--alpha", 0.1, "--beta", 0.3, "--windows", 2000)
ALL, KNOWN = RIEC(AllWindows(0.05, 0.5)), {"M_s": 300.0, "M_us": 30.0}
SAME = {
    "all windows": ((), ALL, {}),
    "random": (
        ("--seed", 7, "--windows", 8000, "--no-sweep"),
        RIEC(RandomWindows(0.05, 0.5, 8000)),
        {"key": jax.random.key(7), "intervals": BlockBootstrap(seed=7)},
    ),
    "wheel": (BY_WHEEL, RIEC(RandomWindows(0.1, 0.3, 2000)), {"key": jax.random.key(0)}),
    "dols": (("--criterion", "dols"), DOLS(), {}),
    "known": (("--set", "M_s=300", "--set", "M_us=30", "--no-sweep"), ALL, {"known": KNOWN}),
    "sandwich": (("--intervals", "sandwich", "--no-sweep"), ALL, {"intervals": Sandwich()}),
    "naive": (("--intervals", "naive", "--no-sweep"), ALL, {"intervals": Naive()}),
}


@pytest.mark.parametrize("case", by_day(SAME, "all windows"))
def test_the_file_gives_what_the_library_finds_on_the_simulated_record(
    from_file, drive_record, case
):
    options, criterion, settings = SAME[case]
    wheel = case == "wheel"
    document = from_file(*options, model="quarter-car-wheel" if wheel else "quarter-car")
    procedure = quarter_car_by_wheel() if wheel else quarter_car_by_body()
    agrees(document, identify(procedure, drive_record, criterion, **settings))
    if case == "all windows":
        # Windows of k = 10 to 100 samples start at 4000 - k of 4000.
        (rows,) = {stage["rows"] for stage in document["residual"]["stages"]}
        assert rows == sum(4000 - k for k in range(10, 101))
        # The paper's RIEC values stray from the source's by 2 % in M_s and 3 % in K_t.
        assert values(document)["M_s"] == pytest.approx(300, rel=0.03)
        assert values(document)["K_t"] == pytest.approx(180e3, rel=0.05)


OWN_BAND = """
import riecjax as rx

tyre = rx.Equation(rx.Term("K_t", "x1", unit="N/m"), -rx.Term(1.0, "F_t"), name="tyre", unit="N")
slow = rx.Model("tyre", "a tyre", procedure=lambda: tyre, band=(2.0, 4.0))
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
    first, other = (from_file("--no-sweep", "--seed", seed) for seed in (3, 4))
    assert values(first) == values(other)
    for name in PARAMETERS:
        one, two = (document["parameters"][name] for document in (first, other))
        assert one["std_error"] == two["std_error"]
        ends = np.array([one["interval95"], two["interval95"]])
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


@pytest.mark.slow
def test_the_same_samples_twice_are_twice_as_many_rows(capsys, drive_file, tmp_path):
    again = tmp_path / "again.csv"
    again.write_bytes(drive_file.read_bytes())
    options = ("--model", "quarter-car", "--criterion", "dols", "--json", "--allow-duplicates")
    one = call(capsys, "identify", drive_file, *PLAIN, *options).document
    two = call(capsys, "identify", drive_file, again, *PLAIN, *options).document
    assert values(two) == pytest.approx(values(one), rel=1e-9)
    assert [s["rows"] for s in two["residual"]["stages"]] == [8000] * 3


@pytest.mark.parametrize("ending", [".npz", *nightly([".mat"])])
def test_other_files_of_the_same_recording_give_the_same(from_file, capsys, tmp_path, ending):
    path = tmp_path / f"drive{ending}"
    arguments = ("simulate", "quarter-car-source", "--input", "white-noise", "--duration", DURATION)
    assert call(capsys, *arguments, "--seed", 4, "--out", path).status == 0
    document = call(capsys, "identify", path, "--model", "quarter-car", *PLAIN, "--json").document
    assert values(document) == pytest.approx(values(from_file()), rel=1e-12)


def test_map_and_scale(from_file, capsys, drive_file, tmp_path):
    header, rest = drive_file.read_text().split("\n", 1)
    header = header.replace("F_t", "load").replace("t,", "s,", 1)
    (tmp_path / "logged.csv").write_text(f"{header}\n{rest}")
    names = ("--map", "F_t=load", "--map", "t=s", "--scale", "load=0.5")
    file = tmp_path / "logged.csv"
    halved = call(capsys, "identify", file, "--model", "quarter-car", *PLAIN, *names, "--json")
    expected = {name: 0.5 * value for name, value in values(from_file()).items()}
    assert values(halved.document) == pytest.approx(expected, rel=1e-9)


@pytest.mark.draws
def test_out_replaces_its_own_files_only(capsys, drive_file, tmp_path):
    out = tmp_path / "deep" / "results"
    out.mkdir(parents=True)
    (out / "notes.txt").write_text("mine")
    (out / "results.json").write_text("old")
    arguments = ("identify", drive_file, "--model", "quarter-car", *PLAIN, "--out", out, "--json")
    result = call(capsys, *arguments)
    assert result.status == 0
    assert [path.name for path in out.parent.iterdir()] == ["results"]
    assert (out / "notes.txt").read_text() == "mine"
    assert json.loads((out / "results.json").read_text()) == result.document
    assert (out / "fit.png").read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
    page = (out / "report.html").read_text(encoding="utf-8")
    for word in ("quarter-car", "drive.csv", *PARAMETERS, "data:image/png;base64,", "versions"):
        assert word in page
    # What a document warns of stands on standard error, a line each.
    warnings = [f"warning [{w['code']}]: {w['message']}" for w in result.document["warnings"]]
    assert warnings
    assert set(warnings) <= set(result.err.splitlines())


@pytest.mark.slow
def test_process_prints_pure_json_and_warnings_apart(tmp_path):
    path = write_csv(tmp_path / "short.csv", quarter_car_columns())
    arguments = ["identify", str(path), "--model", "quarter-car", *PLAIN, "--json"]
    done = subprocess.run(
        [sys.executable, "-c", "from riecjax.cli.main import main; main()", *arguments],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "JAX_ENABLE_X64": "0"},
    )
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert "warning [short_record]" in done.stderr
    assert "Traceback" not in done.stderr
    # The command line turns 64-bit on by itself.
    assert "single_precision" not in done.stderr
    # Force is exactly 180e3 x1 in this file.
    assert document["parameters"]["K_t"]["value"] == pytest.approx(180e3, rel=1e-10)
