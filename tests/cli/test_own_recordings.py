"""A machine and a logger of one's own: check, preparation, several recordings, validation."""

import json
from pathlib import Path

import numpy as np
import pytest
import scipy.integrate
import scipy.io
from command_line import call, rejected, write_csv

from nightly import nightly

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
TRUTH = {"M": 2.0, "c": 3.0, "k": 80.0}
RATE, COUNT = 200, 6000


def force(t, phase):
    tones = [(3.1, 0.0), (5.7, 1.0), (8.3, 2.0), (13.0, 0.5)]
    return sum(10 * np.sin(w * t + p + phase) for w, p in tones)


def motion(offset=0.0, phase=0.0, count=COUNT):
    """A mass on a spring and damper, by SciPy at tight tolerance; the sensor adds an offset."""
    t = np.arange(count) / RATE
    m, c, k = TRUTH.values()
    run = scipy.integrate.solve_ivp(
        lambda t, s: [s[1], (force(t, phase) - c * s[1] - k * s[0]) / m],
        (0, t[-1]),
        [0.0, 0.0],
        t_eval=t,
        rtol=1e-10,
        atol=1e-12,
    )
    return {"t": t, "q": run.y[0], "F": force(t, phase) + offset}


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("machine.py").write_text(MODEL)


CHECK = ("--model", "machine.py:axis", "--test-function", "hat", "--quadrature", "6")
CHECK += ("--alpha", "0.1", "--beta", "0.5")
IDENTIFY = (*CHECK, "--refine", "none")


def values(document):
    return {name: entry["value"] for name, entry in document["parameters"].items()}


def codes(document):
    return [warning["code"] for warning in document["warnings"]]


def test_position_and_force_in_a_loggers_own_dialect(capsys):
    data = motion(offset=4.0)
    rows = [f"{t:.3f};{1000 * q:.9f};{F:.9f}".replace(".", ",") for t, q, F in zip(*data.values())]
    preamble = ["# rig 7, run 12", "Zeit;Weg;Kraft", "s;mm;N"]
    Path("log.csv").write_text("\n".join([*preamble, *rows]), encoding="latin-1")
    names = ("--map", "t=Zeit", "--map", "q=Weg", "--map", "F=Kraft", "--scale", "q=0.001")
    document = call(capsys, "identify", "log.csv", *IDENTIFY, *names, "--json").document
    for name, value in TRUTH.items():
        assert values(document)[name] == pytest.approx(value, rel=1e-4)
    assert values(document)["offset"] == pytest.approx(4.0, rel=1e-3)
    assert codes(document) == []
    assert any("decimal comma" in step for step in document["provenance"]["preparation"])
    assert "q: column scaled by 0.001" in document["provenance"]["preparation"]


@pytest.mark.slow
def test_recordings_with_offsets_of_their_own(capsys):
    for i, offset in enumerate((4.0, -7.0)):
        write_csv(Path(f"run{i}.csv"), motion(offset, phase=i, count=COUNT - 1000 * i))
    files = ("run0.csv", "run1.csv")
    together = call(
        capsys, "identify", *files, *IDENTIFY, "--no-sweep", "--per-record", "offset", "--json"
    ).document
    assert list(values(together)) == ["M", "c", "k", "offset[1]", "offset[2]"]
    assert values(together)["offset[1]"] == pytest.approx(4.0, rel=1e-3)
    assert values(together)["offset[2]"] == pytest.approx(-7.0, rel=1e-3)
    assert values(together)["k"] == pytest.approx(80.0, rel=1e-4)
    shared = call(capsys, "identify", *files, *IDENTIFY, "--no-sweep", "--json").document
    assert "records_disagree" in codes(shared)


@pytest.mark.raises_finding("residuals_not_tested")
@pytest.mark.slow
def test_recordings_of_two_sampling_rates_lose_only_the_tests_of_the_residual(capsys):
    data = motion(offset=4.0)
    write_csv(Path("fast.csv"), data)
    write_csv(Path("slow.csv"), {name: samples[::2] for name, samples in data.items()})
    document = call(
        capsys, "identify", "fast.csv", "slow.csv", *IDENTIFY, "--no-sweep", "--json", "--out", "r"
    ).document
    assert values(document)["k"] == pytest.approx(80.0, rel=1e-4)
    assert document["residual_tests"] is None
    assert document["window_choice"] is None
    assert "residuals_not_tested" in codes(document)
    assert Path("r/report.html").exists()


@pytest.mark.draws
def test_held_out_part_is_simulated_from_the_users_own_equation(capsys):
    write_csv(Path("run.csv"), motion(offset=4.0))
    run = call(
        capsys, "identify", "run.csv", *IDENTIFY, "--hold-out", "0.3", "--json", "--out", "result"
    )
    (validation,) = run.document["validation"]
    assert validation["ran"] is True
    assert validation["predicts"] is True
    assert validation["signals"]["q"]["fit_percent"] > 99
    assert run.document["provenance"]["records"][0]["samples"] == pytest.approx(0.7 * COUNT, abs=1)
    assert Path("result/validation_1.png").stat().st_size > 1000
    assert Path("result/window_sweep.png").stat().st_size > 1000


@pytest.mark.slow
@pytest.mark.raises_finding("does_not_predict")
def test_a_model_that_does_not_predict_is_called_so(capsys):
    write_csv(Path("run.csv"), motion())
    document = call(
        capsys, "identify", "run.csv", *IDENTIFY, "--set", "k=20", "--hold-out", "0.3", "--json"
    ).document
    assert document["validation"][0]["ran"] is True
    assert document["validation"][0]["predicts"] is False
    assert {"does_not_predict", "window_sensitive"} <= set(codes(document))


@pytest.mark.slow
def test_another_recording_validates(capsys):
    write_csv(Path("one.csv"), motion())
    write_csv(Path("two.csv"), motion(phase=2.0))
    document = call(
        capsys, "identify", "one.csv", *IDENTIFY, "--validate", "two.csv", "--json"
    ).document
    assert [run["on"] for run in document["validation"]] == ["two.csv"]
    assert document["validation"][0]["predicts"] is True


def test_an_exact_model_is_not_window_sensitive_under_noise(capsys):
    rng = np.random.default_rng(3)
    data = motion(offset=4.0)
    data["F"] = data["F"] + rng.normal(size=COUNT)
    write_csv(Path("run.csv"), data)
    document = call(capsys, "identify", "run.csv", *IDENTIFY, "--json").document
    assert codes(document) == []
    assert len(document["window_sweep"]["alpha"]) == len(
        document["window_sweep"]["parameters"]["M"]["value"]
    )
    low, high = document["parameters"]["k"]["interval95"]
    assert low < 80.0 < high


@pytest.mark.slow
def test_a_file_in_other_units_than_the_model_is_converted(capsys):
    data = motion()
    table = "\n".join(f"{t:.3f},{1000 * q:.9f},{F:.9f}" for t, q, F in zip(*data.values()))
    Path("log.csv").write_text("t [s],y [mm],u [N]\n" + table)
    options = ("--model", "duffing", "--test-function", "hat", "--refine", "none", "--no-sweep")
    document = call(capsys, "identify", "log.csv", *options, "--json").document
    assert document["provenance"]["converted"] == {"y": "mm"}
    assert "y: mm to m" in document["provenance"]["preparation"]
    scaled = call(capsys, "identify", "log.csv", *options, "--json", "--scale", "y=0.001").document
    assert scaled["parameters"] == document["parameters"]
    said = call(capsys, "identify", "log.csv", *options).out
    assert said.count("Converted to SI: y from mm.") == 1
    assert document["parameters"]["m"]["value"] == pytest.approx(TRUTH["M"], rel=0.05)


def test_check_says_what_a_record_can_answer(capsys):
    write_csv(Path("run.csv"), motion(offset=4.0))
    result = call(capsys, "check", "run.csv", *CHECK)
    assert result.status == 0
    for word in ("6000 samples at 200 Hz", "own share", "M", "offset", "can answer what the model"):
        assert word in result.out
    assert "3000 samples at 100 Hz" in call(capsys, "check", "run.csv", *CHECK, "--every", 2).out
    document = call(capsys, "check", "run.csv", *CHECK, "--json").document
    assert document["answerable"] is True
    assert document["signals"] == ["q", "F"]
    assert document["warnings"] == []


@pytest.mark.slow
@pytest.mark.raises_finding("unidentifiable")
def test_check_refuses_a_step_with_an_offset_and_names_the_direction(capsys):
    rng = np.random.default_rng(0)
    t = np.arange(COUNT) / RATE
    still = {"t": t, "q": 0.5 + 1e-6 * rng.normal(size=COUNT), "F": np.full(COUNT, 40.0)}
    write_csv(Path("step.csv"), still)
    held = ("--set", "M=2", "--set", "c=3")
    result = call(capsys, "check", "step.csv", *CHECK, *held)
    assert result.status == 1
    assert "cannot answer" in result.out
    assert "0.71 k - 0.71 offset" in result.err
    document = call(capsys, "check", "step.csv", *CHECK, *held, "--json").document
    assert document["answerable"] is False
    assert "unidentifiable" in codes(document)
    # The noise would make a fit possible in numbers; it is refused in the same words.
    fit = call(capsys, "identify", "step.csv", *IDENTIFY, *held, "--json")
    assert fit.status == 1
    assert fit.document == {"schema": 2, "error": document["error"]}
    assert document["error"]["code"] == "constant_target"
    assert fit.err == f"riecjax: {document['error']['message']}\n"


@pytest.mark.slow
def test_what_only_noise_tells_apart_is_refused_without_a_refinement(capsys):
    data = motion()
    data["q2"] = data["q"] + 1e-4 * np.random.default_rng(1).normal(size=COUNT)
    second = '    rx.Term("k2", "q2"),\n    rx.Term("offset"'
    Path("machine.py").write_text(MODEL.replace('    rx.Term("offset"', second))
    write_csv(Path("run.csv"), data)
    checked = call(capsys, "check", "run.csv", *CHECK, "--json")
    fit = call(capsys, "identify", "run.csv", *IDENTIFY, "--json")
    assert fit.status == 1
    assert fit.document["error"]["code"] == "unidentifiable"
    # k of the position, which has no noise, is told by the whole motion; k2 only to be next to 0.
    assert checked.status == 0
    assert codes(checked.document) == ["unidentifiable"]
    assert checked.document["by_refinement"]["k"] < 1e-3
    answer = call(capsys, "identify", "run.csv", *CHECK, "--json").document["refinement"]
    low, high = answer["refined"]["k"]["interval95"]
    assert low < 80 < high
    assert high - low < 0.1


def test_check_names_a_silent_parameter(capsys):
    data = motion()
    data["q"] = np.zeros(COUNT)
    write_csv(Path("run.csv"), data)
    document = call(capsys, "check", "run.csv", *CHECK, "--json").document
    assert {"constant_signal", "not_excited"} <= set(codes(document))
    assert any("nothing in the record tells of M" in w["message"] for w in document["warnings"])


@pytest.mark.parametrize(
    ("windows", "expected"),
    [
        ("all", {"missing_samples"}),
        *nightly([(8000, {"missing_samples", "rows_left_out"})]),
    ],
    ids=["all", "random"],
)
def test_gaps_are_reported_and_do_not_spoil_the_answer(capsys, windows, expected):
    data = motion(offset=4.0)
    data["q"][3000:3050] = np.nan
    kept = np.r_[0:1000, 1200:COUNT]
    write_csv(Path("run.csv"), {name: column[kept] for name, column in data.items()})
    options = (*IDENTIFY, "--windows", windows, "--no-sweep", "--json")
    document = call(capsys, "identify", "run.csv", *options).document
    assert expected <= set(codes(document))
    for name, value in TRUTH.items():
        assert values(document)[name] == pytest.approx(value, rel=1e-4)


def test_a_formula_makes_the_signal_that_was_not_recorded(capsys):
    data = motion()
    write_csv(Path("run.csv"), {"t": data["t"], "q": data["q"], "volt": data["F"] / 35.0})
    document = call(
        capsys, "identify", "run.csv", *IDENTIFY, "--no-sweep", "--derive", "F=35*volt", "--json"
    ).document
    assert values(document)["M"] == pytest.approx(2.0, rel=1e-4)
    assert "F: 35*volt" in document["provenance"]["preparation"]


@pytest.mark.slow
def test_the_report_holds_everything_that_was_found(capsys):
    write_csv(Path("run.csv"), motion(offset=4.0))
    call(capsys, "identify", "run.csv", *IDENTIFY, "--hold-out", "0.2", "--out", "result")
    page = Path("result/report.html").read_text(encoding="utf-8")
    for word in ("axis", "validated on run.csv", "window_sweep", "validation_1", "provenance"):
        assert word in page or word == "provenance"
    stored = json.loads(Path("result/results.json").read_text())
    assert stored["excitation"]["M"]["own_share"] > 0.3


@pytest.mark.slow
def test_times_are_seconds_from_the_first_sample_whatever_the_stamps(capsys):
    data = motion(offset=4.0)
    data["q"][[1400, 3000]] += 3.0
    data["q"][4000:4050] = np.nan
    said = {}
    for start in (0.0, 1.7e9):
        write_csv(Path("run.csv"), {**data, "t": start + data["t"]})
        options = ("--from", "6", "--to", "900", "--no-sweep", "--json")
        document = call(capsys, "identify", "run.csv", *IDENTIFY, *options).document
        assert document["provenance"]["start_times"] == [start]
        said[start] = {w["code"]: w["message"] for w in document["warnings"]}
        steps = ["q: 2 outliers repaired", "cut from 6 s to the end"]
        assert document["provenance"]["preparation"] == steps
        assert "at 7, 15 s. A poly" in said[start]["outliers"]
        assert "first at 20 s" in said[start]["missing_samples"]
        assert "up to 900 s removes nothing" in said[start]["nothing_cut"]
    assert set(said[0.0]) == set(said[1.7e9])
    cut = said[1.7e9]["nothing_cut"]
    assert cut.replace(", stamped 1700000000", "") == said[0.0]["nothing_cut"]


def test_a_cut_by_absolute_stamps_says_where_the_clock_begins(capsys):
    data = motion(count=600)
    write_csv(Path("run.csv"), {**data, "t": 1.7e9 + data["t"]})
    result = call(capsys, "identify", "run.csv", *IDENTIFY, "--from", "1700000001")
    assert result.status == 1
    assert (
        "lasts from 0 to 2.995 s, counted from its first sample, stamped 1700000000." in result.err
    )


def test_noise_is_judged_and_written_down(capsys):
    samples = motion()
    samples["q"] = samples["q"] + 0.02 * np.random.default_rng(0).normal(size=COUNT)
    write_csv(Path("noisy.csv"), samples)
    check = ("check", "noisy.csv", *CHECK, "--json")
    judged = call(capsys, *check).document["noise"]
    assert judged["q"]["std"] == pytest.approx(0.02, rel=0.05)
    assert judged["q"]["share"] == pytest.approx(0.02 / np.std(samples["q"]), rel=0.05)


@pytest.mark.slow
def test_noise_is_what_is_given_or_none(capsys):
    write_csv(Path("run.csv"), motion())
    check = ("check", "run.csv", *CHECK, "--json")
    given = call(capsys, *check, "--noise", "q=0.5", "--noise", "F=0").document["noise"]
    assert (given["q"]["std"], given["F"]["std"]) == (0.5, 0.0)
    assert call(capsys, *check, "--noise", "none").document["noise"]["q"]["std"] == 0.0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--noise", "z=1"), "there is no such signal; there are: "),
        (("--noise", "q=-1"), "give a standard deviation from 0 on"),
        (("--noise", "q=1", "--noise", "q=2"), "'q' is given twice"),
        (("--noise", "none", "--noise", "q=2"), "'none' is for all signals"),
        (("--noise", "some"), "auto|none|SIGNAL=SD"),
    ],
)
def test_impossible_noise(capsys, options, message):
    write_csv(Path("rig.csv"), motion(count=500))
    status = 1 if "z=1" in options else 2
    refused = rejected(capsys, status, "check", "rig.csv", "--model", "machine.py:axis", *options)
    assert message in refused


@pytest.mark.slow
@pytest.mark.raises_finding("validated_on_fitted")
def test_several_parts_are_read_and_what_was_fitted_is_no_validation(capsys):
    """Three runs in one file, of which two are named."""
    runs = [motion(offset=0.5, phase=p, count=2000) for p in (0.0, 1.0, 2.0)]
    held = {f"run{i}": run for i, run in enumerate(runs)}
    scipy.io.savemat("runs.mat", held)
    parts = ("--part", "run0", "--part", "run2")
    checked = call(capsys, "check", "runs.mat", *CHECK, *parts)
    assert "runs.mat, run0: 2000 samples" in checked.out
    assert "runs.mat, run2: 2000 samples" in checked.out
    options = (*parts, "--validate", "runs.mat", "--no-sweep", "--json")
    found = call(capsys, "identify", "runs.mat", *IDENTIFY, *options).document
    assert [record["part"] for record in found["provenance"]["records"]] == ["run0", "run2"]
    assert found["job"]["part"] == ["run0", "run2"]
    assert "validated_on_fitted" in [each["code"] for each in found["warnings"]]


def test_time_in_another_unit_is_scaled_by_the_name_that_messages_give_it(capsys):
    run = motion(count=2000)
    write_csv(Path("ms.csv"), {"time": 1000 * run["t"], "q": run["q"], "F": run["F"]})
    refused = call(capsys, "check", "ms.csv", *CHECK)
    assert "--scale t=0.001" in refused.err
    for option in (("--scale", "t=0.001"), ("--unit", "t=ms")):
        checked = call(capsys, "check", "ms.csv", *CHECK, *option, "--json")
        assert checked.document["records"][0]["time_step"] == pytest.approx(1 / RATE)
