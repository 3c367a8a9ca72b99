import json
import math
import os
import shlex
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest
import scipy.stats
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
UNITS = ("N/m", "kg", "kg", "N/m", "N", "N", "N", "N")
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


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 7])
def test_random_windows_on_the_file_are_those_on_the_simulated_record(
    from_file, drive_record, seed
):
    estimate = identify(
        quarter_car_by_body(),
        drive_record,
        RIEC(RandomWindows(0.05, 0.5, 8000)),
        key=jax.random.key(seed),
        intervals=BlockBootstrap(seed=seed),
    )
    agrees(from_file("--seed", seed, "--windows", 8000, "--no-sweep"), estimate)


def test_by_default_all_windows_of_the_band_are_summed(from_file, drive_record):
    estimate = identify(quarter_car_by_body(), drive_record, RIEC(AllWindows(0.05, 0.5)))
    document = from_file()
    agrees(document, estimate)
    assert document["criterion"]["windows"] == "all"
    # Windows of k = 10 to 100 samples start at 4000 - k of 4000.
    (rows,) = {stage["rows"] for stage in document["residual"]["stages"]}
    assert rows == sum(4000 - k for k in range(10, 101))


@pytest.mark.slow
def test_dols_on_the_file_is_the_library_on_the_simulated_record(from_file, drive_record):
    document = from_file("--criterion", "dols")
    agrees(document, identify(quarter_car_by_body(), drive_record, DOLS()))
    assert document["criterion"] == {"name": "dols"}


@pytest.mark.slow
def test_dols_is_least_squares_at_every_sample(from_file, drive_file):
    table = np.genfromtxt(drive_file, delimiter=",", names=True)
    accelerations = np.column_stack([table["dx3"], table["dx4"]])
    masses = np.linalg.lstsq(accelerations, table["F_t"])[0]
    found = values(from_file("--criterion", "dols"))
    assert [found["M_us"], found["M_s"]] == pytest.approx(masses, rel=1e-8)
    stiffness = table["F_t"] @ table["x1"] / (table["x1"] @ table["x1"])
    assert found["K_t"] == pytest.approx(stiffness, rel=1e-10)


@pytest.mark.slow
def test_wheel_variant_with_other_windows(from_file, drive_record):
    criterion = RIEC(RandomWindows(0.1, 0.3, 2000))
    estimate = identify(quarter_car_by_wheel(), drive_record, criterion, key=jax.random.key(0))
    options = ("--alpha", 0.1, "--beta", 0.3, "--windows", 2000)
    document = from_file(*options, model="quarter-car-wheel")
    agrees(document, estimate)
    assert document["model"] == "quarter-car-wheel"
    assert [s["equation"] for s in document["residual"]["stages"]] == ["tyre", "masses", "wheel"]
    assert document["criterion"] == {
        "name": "riec",
        "alpha": 0.1,
        "beta": 0.3,
        "windows": 2000,
        "test_function": "boxcar",
        "quadrature": 4,
    }


OWN_BAND = """
import riecjax as rx

tyre = rx.Equation(rx.Term("K_t", "x1", unit="N/m"), -rx.Term(1.0, "F_t"), name="tyre", unit="N")
plain = rx.Model("tyre", "a tyre", procedure=lambda: tyre)
slow = rx.Model("tyre", "a tyre", procedure=lambda: tyre, band=(2.0, 4.0))
"""


@pytest.fixture(scope="module")
def tyre_file(tmp_path_factory) -> Path:
    """Models of one equation, which compile in no time."""
    path = tmp_path_factory.mktemp("tyre") / "tyre.py"
    path.write_text(OWN_BAND)
    return path


BANDS = {
    "default": ((), 0.05, 0.5),
    "band": (("--band", 2, 5), 0.1, 0.25),
    "band and alpha": (("--band", 2, 5, "--alpha", 0.02), 0.02, 0.25),
    "band and beta": (("--band", 2, 5, "--beta", 0.4), 0.1, 0.4),
    "beta alone": (("--beta", 0.4), 0.05, 0.4),
}


@pytest.mark.parametrize("case", by_day(BANDS, "default", "band and alpha", "band and beta"))
def test_windows_are_half_periods_of_a_band(from_file, tyre_file, case):
    options, alpha, beta = BANDS[case]
    document = from_file(*options, "--no-sweep", model=f"{tyre_file}:tyre")
    assert document["criterion"]["alpha"] == pytest.approx(alpha)
    assert document["criterion"]["beta"] == pytest.approx(beta)
    choice = document["window_choice"]
    assert choice["seen_best_hz"] == pytest.approx([0.5 / beta, 0.5 / alpha])


@pytest.mark.slow
def test_a_model_brings_the_band_of_its_windows(from_file, tyre_file):
    lengths = {}
    for name in ("plain", "slow", "tyre"):
        criterion = from_file("--no-sweep", model=f"{tyre_file}:{name}")["criterion"]
        lengths[name] = [criterion["alpha"], criterion["beta"]]
    assert lengths["plain"] == lengths["tyre"] == pytest.approx([0.05, 0.5])
    assert lengths["slow"] == pytest.approx([0.125, 0.25])
    other = from_file("--no-sweep", "--band", 1, 5, model=f"{tyre_file}:slow")["criterion"]
    assert [other["alpha"], other["beta"]] == pytest.approx([0.1, 0.5])


@pytest.mark.slow
def test_every_kind_of_interval_is_the_library_s(from_file, drive_record):
    criterion = RIEC(AllWindows(0.05, 0.5))
    widths, documents = {}, {}
    for kind, judge in [("bootstrap", None), ("sandwich", Sandwich()), ("naive", Naive())]:
        documents[kind] = from_file("--intervals", kind, "--no-sweep")
        estimate = identify(quarter_car_by_body(), drive_record, criterion, intervals=judge)
        agrees(documents[kind], estimate)
        method = documents[kind]["provenance"]["intervals"]["method"]
        assert {"naive": "as if all windows were independent"}.get(kind, kind) in method
        bounds = {n: e["interval95"] for n, e in documents[kind]["parameters"].items()}
        widths[kind] = {name: high - low for name, (low, high) in bounds.items()}
        # The estimates do not depend on how their uncertainty is judged, but for the last digit of
        # what is compiled together with it.
        assert values(documents[kind]) == pytest.approx(values(documents["bootstrap"]), rel=1e-13)
    for name in PARAMETERS:
        assert widths["naive"][name] < 0.5 * widths["bootstrap"][name]
        assert widths["naive"][name] < 0.5 * widths["sandwich"][name]
        entry = documents["naive"]["parameters"][name]
        # Beside it stands what is unsure of the noise level, here next to nothing.
        assert entry["std_error"] == pytest.approx(entry["naive_std_error"], rel=1e-4)
        assert widths["naive"][name] == pytest.approx(2 * 1.959964 * entry["std_error"], rel=1e-6)
        for kind in ("bootstrap", "sandwich"):
            others = documents[kind]["parameters"][name]
            assert others["naive_std_error"] == pytest.approx(entry["naive_std_error"], rel=1e-9)


@pytest.mark.slow
def test_sandwich_intervals_are_wider_than_the_standard_error_by_students_t(from_file):
    document = from_file("--intervals", "sandwich", "--no-sweep")
    judged = document["provenance"]["intervals"]
    # 20 s leave twenty blocks of twice beta, less what a whole number of short blocks takes.
    assert 15 <= judged["blocks"] <= 20
    # As many degrees of freedom as blocks but one at the most, fewer where few blocks tell most.
    most, least = (scipy.stats.t.isf(0.025, dof) for dof in (judged["blocks"] - 1, 1))
    for entry in document["parameters"].values():
        low, high = entry["interval95"]
        assert (1 - 1e-9) * most <= (high - low) / (2 * entry["std_error"]) < least
        assert (high + low) / 2 == pytest.approx(entry["value"])


def test_correlation_residuals_and_choice_of_windows_are_in_the_document(from_file):
    document = from_file("--no-sweep")
    assert document["correlation"]["parameters"] == list(PARAMETERS)
    matrix = np.array(document["correlation"]["matrix"])
    np.testing.assert_allclose(np.diag(matrix), 1.0)
    np.testing.assert_allclose(matrix, matrix.T)
    assert np.linalg.eigvalsh(matrix)[0] > -1e-9
    assert set(document["residual_tests"]) == {"tyre", "masses", "body"}
    # The engine on its mount, which the model leaves out, rings between 11 and 18 Hz.
    assert 10 < document["residual_tests"]["masses"]["peak"]["frequency"] < 18
    assert "unmodelled_mode" in {warning["code"] for warning in document["warnings"]}
    choice = document["window_choice"]
    low, high = choice["recommended_s"]
    assert 0.02 < low < high < 2
    assert set(choice["equations"]) == {"tyre", "masses", "body"}
    for each in choice["equations"].values():
        assert len(each["error_share"]) == len(choice["length_s"])
        assert each["least_error_share"] == min(each["error_share"])


@pytest.mark.slow
def test_a_pointwise_fit_has_no_windows_to_choose(from_file):
    pointwise = from_file("--criterion", "dols")
    assert pointwise["window_choice"] is None
    assert set(pointwise["residual_tests"]) == {"tyre", "masses", "body"}


def test_parameters_are_near_those_of_the_source_model(from_file):
    found = values(from_file())
    # The paper's RIEC values stray from the source's by 2 % in M_s and 3 % in K_t.
    assert found["M_s"] == pytest.approx(300, rel=0.03)
    assert found["K_t"] == pytest.approx(180e3, rel=0.05)


@pytest.mark.slow
def test_same_seed_same_answer_other_seed_other_answer(from_file, tyre_file):
    options = ("--windows", 8000, "--no-sweep", "--seed")
    first, again, other = (
        from_file(*options, seed, model=f"{tyre_file}:tyre") for seed in (3, 3, 4)
    )
    assert first == again
    assert values(first) != values(other)
    assert first["provenance"]["seed"] == 3
    for name, value in values(other).items():
        # Another draw of windows is no other machine: well within the intervals.
        low, high = first["parameters"][name]["interval95"]
        assert abs(value - values(first)[name]) < 0.5 * (high - low)


def test_of_all_windows_a_seed_moves_the_bootstrap_only(from_file):
    first, other = (from_file("--no-sweep", "--seed", seed) for seed in (3, 4))
    assert values(first) == values(other)
    for name in PARAMETERS:
        one, two = (document["parameters"][name] for document in (first, other))
        assert one["std_error"] == two["std_error"]
        assert one["interval95"] != two["interval95"]
        ends = np.array([one["interval95"], two["interval95"]])
        # A percent or two of the width, as BlockBootstrap says, times five.
        assert np.ptp(ends, axis=0).max() < 0.1 * np.ptp(ends[0])


@pytest.mark.slow
def test_set_moves_parameters_to_known(from_file, drive_record):
    document = from_file("--set", "M_s=300", "--set", "M_us=30", "--no-sweep")
    assert document["known"] == {
        "M_s": {"value": 300.0, "unit": "kg"},
        "M_us": {"value": 30.0, "unit": "kg"},
    }
    assert list(document["parameters"]) == ["K_t", "K_s", "F_1", "F_2", "F_3", "F_4"]
    assert document["rank"] == 6
    assert [s["equation"] for s in document["residual"]["stages"]] == ["tyre", "body"]
    estimate = identify(
        quarter_car_by_body(),
        drive_record,
        RIEC(AllWindows(0.05, 0.5)),
        known={"M_s": 300.0, "M_us": 30.0},
    )
    agrees(document, estimate)


@pytest.mark.slow
def test_the_body_scales_with_the_mass_that_is_set(from_file):
    # M_s x4' = K_s x2 + ...: twice the mass, twice the forces.
    light, heavy = (
        values(from_file("--set", f"M_s={mass}", "--set", "M_us=30", "--no-sweep"))
        for mass in (150, 300)
    )
    for name in ("K_s", "F_1", "F_2", "F_3", "F_4"):
        assert heavy[name] == pytest.approx(2 * light[name], rel=1e-9)


def check_schema(document: dict) -> None:
    assert set(document) == {
        "schema",
        "model",
        "criterion",
        "parameters",
        "known",
        "condition_number",
        "rank",
        "residual",
        "modes",
        "equations",
        "verdict",
        "excitation",
        "noise",
        "correlation",
        "residual_tests",
        "window_choice",
        "window_sweep",
        "refinement",
        "validation",
        "warnings",
        "provenance",
        "job",
        "checksum",
    }
    assert document["schema"] == 2
    for entry in document["parameters"].values():
        assert set(entry) == {
            "value",
            "unit",
            "std_error",
            "interval95",
            "naive_std_error",
            "effective_windows",
        }
        low, high = entry["interval95"]
        assert all(map(math.isfinite, (low, high, entry["value"], entry["std_error"])))
        assert low < entry["value"] < high
        assert 0 < entry["naive_std_error"] < entry["std_error"]
        rows = max(stage["rows"] for stage in document["residual"]["stages"])
        assert 0 < entry["effective_windows"] < rows
    assert document["condition_number"] >= 1
    assert document["rank"] == len(document["parameters"])
    assert 0 < document["residual"]["relative_rms"] < 1
    for stage in document["residual"]["stages"]:
        assert 0 <= stage["relative_rms"] < 1
        assert stage["rms"] >= 0
        assert stage["rows"] > 0
    for warning in document["warnings"]:
        told = {"code", "message", "signals", "parameters", "doubt", "doubts", "remedy", "step"}
        assert set(warning) == told
    provenance = document["provenance"]
    assert isinstance(provenance["seed"], int)
    assert {"riecjax", "jax", "numpy", "python"} <= set(provenance["versions"])


@pytest.mark.parametrize("criterion", ["riec", *nightly(["dols"])])
def test_document(from_file, drive_file, criterion):
    document = from_file("--criterion", criterion)
    check_schema(document)
    assert document["model"] == "quarter-car"
    assert tuple(document["parameters"]) == PARAMETERS
    assert tuple(entry["unit"] for entry in document["parameters"].values()) == UNITS
    assert document["provenance"]["records"] == [
        {
            "file": str(drive_file),
            "part": None,
            "samples": 4000,
            "time_step": pytest.approx(0.005),
        }
    ]


@pytest.mark.slow
def test_a_hidden_mode_is_added_and_shown(capsys, drive_file):
    result = call(
        capsys, "identify", drive_file, "--model", "quarter-car", "--add-mode", "x4=10", *PLAIN
    )
    assert result.status == 0
    table = " ".join(result.out.split())
    assert "hidden mode on x4: 1" in table
    assert "M_mode" in table
    # The sentence names it first, then the table.
    found = float(table.split("parameter value")[1].split("M_us")[1].split()[0])
    assert found == pytest.approx(30.0, rel=0.01)


@pytest.mark.parametrize("wrong", ["=3", "x4=", "x4=-1", "x4=fast"])
def test_a_mode_is_a_signal_and_perhaps_a_frequency(capsys, drive_file, wrong):
    result = call(capsys, "identify", drive_file, "--model", "quarter-car", "--add-mode", wrong)
    assert result.status == 2
    assert "--add-mode" in result.err


@pytest.mark.slow
def test_table_on_a_terminal(capsys, drive_file):
    options = ("--set", "M_s=300", "--set", "M_us=30", "--no-sweep")
    result = call(capsys, "identify", drive_file, "--model", "quarter-car", *PLAIN, *options)
    assert result.status == 0
    for word in (*PARAMETERS, *set(UNITS), "known", "95 %", "RIEC", "0.05", "--verbose"):
        assert word in result.out
    lines = result.out.splitlines()
    assert len(lines) <= 35
    # What is to be pasted is not broken.
    assert max(len(line) for line in lines if not line.startswith("  riecjax")) <= 80
    assert result.err == ""


@pytest.mark.slow
def test_the_first_lines_answer_and_commands_can_be_pasted(capsys, drive_file):
    result = call(capsys, "identify", drive_file, "--model", "quarter-car", *PLAIN)
    answer = " ".join(result.out.splitlines()[:5])
    assert any(name in answer for name in PARAMETERS)
    assert any(word in answer for word in ("with caution", "do not use"))
    (command,) = [x for x in result.out.splitlines() if x.startswith("  riecjax identify")][:1]
    again = call(capsys, *shlex.split(command)[1:])
    assert again.status == 0
    assert "M_mode" in again.out


def test_verbose_tells_everything(capsys, drive_file):
    options = (
        "--set",
        "M_s=300",
        "--set",
        "M_us=30",
        "--low-pass",
        "x2=80",
        "--verbose",
        "--no-sweep",
    )
    result = call(capsys, "identify", drive_file, "--model", "quarter-car", *PLAIN, *options)
    assert result.status == 0
    for word in ("condition number", "std error", "low-pass: x2 at 80 Hz", "intervals:"):
        assert word in result.out
    assert "warning [" in result.err


@pytest.mark.slow
def test_several_records(capsys, drive_file, tmp_path):
    again = tmp_path / "again.csv"
    again.write_bytes(drive_file.read_bytes())
    options = ("--model", "quarter-car", "--criterion", "dols", "--json")
    one = call(capsys, "identify", drive_file, *PLAIN, *options).document
    options = (*options, "--allow-duplicates")
    two = call(capsys, "identify", drive_file, again, *PLAIN, *options).document
    # The same samples twice: the same answer from twice as many rows.
    assert values(two) == pytest.approx(values(one), rel=1e-9)
    assert [s["rows"] for s in two["residual"]["stages"]] == [8000] * 3
    assert [Path(r["file"]).name for r in two["provenance"]["records"]] == [
        "drive.csv",
        "again.csv",
    ]


@pytest.mark.parametrize("ending", [".npz", *nightly([".mat"])])
def test_other_files_of_the_same_recording_give_the_same(from_file, capsys, tmp_path, ending):
    path = tmp_path / f"drive{ending}"
    arguments = ("simulate", "quarter-car-source", "--input", "white-noise", "--duration", DURATION)
    assert call(capsys, *arguments, "--seed", 4, "--out", path).status == 0
    document = call(capsys, "identify", path, "--model", "quarter-car", *PLAIN, "--json").document
    assert values(document) == pytest.approx(values(from_file()), rel=1e-12)


def test_map_and_scale(from_file, capsys, drive_file, tmp_path):
    text = drive_file.read_text()
    header, rest = text.split("\n", 1)
    (tmp_path / "logged.csv").write_text(
        header.replace("F_t", "load").replace("t,", "s,", 1) + "\n" + rest
    )
    options = ("--map", "F_t=load", "--map", "t=s", "--scale", "load=0.5")
    arguments = (
        "identify",
        tmp_path / "logged.csv",
        "--model",
        "quarter-car",
        *PLAIN,
        *options,
        "--json",
    )
    halved = values(call(capsys, *arguments).document)
    expected = {name: 0.5 * value for name, value in values(from_file()).items()}
    assert halved == pytest.approx(expected, rel=1e-9)


@pytest.mark.draws
def test_out_folder(capsys, drive_file, tmp_path):
    out = tmp_path / "deep" / "results"
    arguments = ("identify", drive_file, "--model", "quarter-car", *PLAIN, "--out", out, "--json")
    result = call(capsys, *arguments)
    assert result.status == 0
    assert sorted(path.name for path in out.iterdir()) == [
        "correlation.png",
        "curves.png",
        "fit.png",
        "report.html",
        "residual_1.png",
        "residual_2.png",
        "residual_3.png",
        "results.json",
        "window_choice.png",
        "window_sweep.png",
    ]
    assert [path.name for path in out.parent.iterdir()] == ["results"]
    assert json.loads((out / "results.json").read_text()) == result.document
    assert (out / "fit.png").read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
    page = (out / "report.html").read_text(encoding="utf-8")
    for word in ("quarter-car", "drive.csv", *PARAMETERS, "data:image/png;base64,", "versions"):
        assert word in page


def test_out_into_an_existing_folder_replaces_its_own_files_only(capsys, drive_file, tmp_path):
    out = tmp_path / "results"
    out.mkdir()
    (out / "notes.txt").write_text("mine")
    (out / "results.json").write_text("old")
    result = call(capsys, "identify", drive_file, "--model", "quarter-car", *PLAIN, "--out", out)
    assert result.status == 0
    assert str(out) in result.out
    assert (out / "notes.txt").read_text() == "mine"
    assert json.loads((out / "results.json").read_text())["model"] == "quarter-car"
    assert sorted(p.name for p in out.iterdir()) == [
        "correlation.png",
        "curves.png",
        "fit.png",
        "notes.txt",
        "report.html",
        "residual_1.png",
        "residual_2.png",
        "residual_3.png",
        "results.json",
        "window_choice.png",
        "window_sweep.png",
    ]


def test_warnings_are_in_the_document_and_on_standard_error(capsys, drive_file):
    result = call(capsys, "identify", drive_file, "--model", "quarter-car", *PLAIN, "--json")
    assert result.status == 0
    codes = [warning["code"] for warning in result.document["warnings"]]
    assert "unmodelled_mode" in codes
    assert result.err.count("\n") == len(codes)
    for warning in result.document["warnings"]:
        assert f"warning [{warning['code']}]: {warning['message']}" in result.err


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
