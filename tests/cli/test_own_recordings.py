"""A machine and a logger of one's own: preparation, several recordings, validation, gaps."""

from pathlib import Path

import numpy as np
import pytest
import scipy.integrate
import scipy.io
from command_line import call, write_csv

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
CHECK += ("--alpha", "0.1", "--beta", "0.5", "--json")
IDENTIFY = (*CHECK, "--refine", "none")


def values(document):
    return {name: entry["value"] for name, entry in document["parameters"].items()}


def codes(document):
    return [warning["code"] for warning in document["warnings"]]


def identified(capsys, *arguments):
    return call(capsys, "identify", *arguments, *IDENTIFY).document


def test_position_and_force_in_a_loggers_own_dialect(capsys):
    data = motion(offset=4.0)
    rows = [
        f"{t:.3f};{1000 * q:.9f};{F / 35:.9f}".replace(".", ",") for t, q, F in zip(*data.values())
    ]
    preamble = ["# rig 7, run 12", "Zeit;Weg;Spannung", "s;mm;V"]
    Path("log.csv").write_text("\n".join([*preamble, *rows]), encoding="latin-1")
    names = ("--map", "t=Zeit", "--map", "q=Weg", "--scale", "q=0.001")
    document = identified(capsys, "log.csv", *names, "--derive", "F=35*Spannung")
    for name, value in TRUTH.items():
        assert values(document)[name] == pytest.approx(value, rel=1e-4)
    assert values(document)["offset"] == pytest.approx(4.0, rel=1e-3)
    assert codes(document) == []
    steps = document["provenance"]["preparation"]
    assert {"q: column scaled by 0.001", "F: 35*Spannung"} <= {*steps}
    assert any("decimal comma" in step for step in steps)


@pytest.mark.slow
def test_recordings_with_offsets_of_their_own(capsys):
    for i, offset in enumerate((4.0, -7.0)):
        write_csv(Path(f"run{i}.csv"), motion(offset, phase=i, count=COUNT - 1000 * i))
    files = ("run0.csv", "run1.csv", "--no-sweep")
    together = values(identified(capsys, *files, "--per-record", "offset"))
    assert list(together) == ["M", "c", "k", "offset[1]", "offset[2]"]
    assert together["offset[1]"] == pytest.approx(4.0, rel=1e-3)
    assert together["offset[2]"] == pytest.approx(-7.0, rel=1e-3)
    assert together["k"] == pytest.approx(80.0, rel=1e-4)
    assert "records_disagree" in codes(identified(capsys, *files))


@pytest.mark.raises_finding("residuals_not_tested")
@pytest.mark.slow
def test_recordings_of_two_sampling_rates_lose_only_the_tests_of_the_residual(capsys):
    data = motion(offset=4.0)
    write_csv(Path("fast.csv"), data)
    write_csv(Path("slow.csv"), {name: samples[::2] for name, samples in data.items()})
    document = identified(capsys, "fast.csv", "slow.csv", "--no-sweep", "--out", "r")
    assert values(document)["k"] == pytest.approx(80.0, rel=1e-4)
    assert document["residual_tests"] is None
    assert document["window_choice"] is None
    assert Path("r/report.html").exists()


@pytest.mark.draws
@pytest.mark.parametrize(
    "known",
    [
        "",
        pytest.param(
            "k=20", marks=[pytest.mark.slow, pytest.mark.raises_finding("does_not_predict")]
        ),
    ],
    ids=["right", "wrong"],
)
def test_the_held_out_part_is_simulated_from_the_users_own_equation(capsys, known):
    write_csv(Path("run.csv"), motion(offset=0.0 if known else 4.0))
    options = ("--set", known) if known else ()
    document = identified(capsys, "run.csv", *options, "--hold-out", "0.3", "--out", "result")
    (validation,) = document["validation"]
    assert validation["ran"] is True
    assert validation["predicts"] is not bool(known)
    if known:
        assert {"does_not_predict", "window_sensitive"} <= set(codes(document))
        return
    assert validation["signals"]["q"]["fit_percent"] > 99
    assert document["provenance"]["records"][0]["samples"] == pytest.approx(0.7 * COUNT, abs=1)
    assert Path("result/validation_1.png").stat().st_size > 1000


def test_an_exact_model_is_not_window_sensitive_under_noise(capsys):
    data = motion(offset=4.0)
    data["F"] = data["F"] + np.random.default_rng(3).normal(size=COUNT)
    write_csv(Path("run.csv"), data)
    document = identified(capsys, "run.csv")
    assert codes(document) == []
    low, high = document["parameters"]["k"]["interval95"]
    assert low < 80.0 < high


@pytest.mark.slow
@pytest.mark.raises_finding("unidentifiable")
def test_check_refuses_a_step_with_an_offset_and_names_the_direction(capsys):
    rng = np.random.default_rng(0)
    t = np.arange(COUNT) / RATE
    still = {"t": t, "q": 0.5 + 1e-6 * rng.normal(size=COUNT), "F": np.full(COUNT, 40.0)}
    write_csv(Path("step.csv"), still)
    held = ("--set", "M=2", "--set", "c=3")
    checked = call(capsys, "check", "step.csv", *CHECK, *held)
    assert checked.status == 1
    assert "0.71 k - 0.71 offset" in checked.err
    assert checked.document["answerable"] is False
    assert "unidentifiable" in codes(checked.document)
    # The noise would make a fit possible in numbers; it is refused in the same words.
    fit = call(capsys, "identify", "step.csv", *IDENTIFY, *held)
    assert fit.status == 1
    assert fit.document["error"] == checked.document["error"]
    assert fit.document["error"]["code"] == "constant_target"


@pytest.mark.slow
def test_what_only_noise_tells_apart_is_refused_without_a_refinement(capsys):
    data = motion()
    data["q2"] = data["q"] + 1e-4 * np.random.default_rng(1).normal(size=COUNT)
    second = '    rx.Term("k2", "q2"),\n    rx.Term("offset"'
    Path("machine.py").write_text(MODEL.replace('    rx.Term("offset"', second))
    write_csv(Path("run.csv"), data)
    checked = call(capsys, "check", "run.csv", *CHECK)
    fit = call(capsys, "identify", "run.csv", *IDENTIFY)
    assert fit.status == 1
    assert fit.document["error"]["code"] == "unidentifiable"
    # k of the position, which has no noise, is told by the whole motion; k2 only to be next to 0.
    assert checked.status == 0
    assert codes(checked.document) == ["unidentifiable"]
    assert checked.document["by_refinement"]["k"] < 1e-3
    answer = call(capsys, "identify", "run.csv", *CHECK).document["refinement"]
    low, high = answer["refined"]["k"]["interval95"]
    assert low < 80 < high
    assert high - low < 0.1


@pytest.mark.parametrize("windows", ["all", *nightly([8000])])
def test_gaps_are_reported_and_do_not_spoil_the_answer(capsys, windows):
    data = motion(offset=4.0)
    data["q"][3000:3050] = np.nan
    kept = np.r_[0:1000, 1200:COUNT]
    write_csv(Path("run.csv"), {name: column[kept] for name, column in data.items()})
    document = identified(capsys, "run.csv", "--windows", windows, "--no-sweep")
    expected = {"missing_samples"} if windows == "all" else {"missing_samples", "rows_left_out"}
    assert expected <= set(codes(document))
    for name, value in TRUTH.items():
        assert values(document)[name] == pytest.approx(value, rel=1e-4)


@pytest.mark.slow
def test_times_are_seconds_from_the_first_sample_whatever_the_stamps(capsys):
    data = motion(offset=4.0)
    data["q"][[1400, 3000]] += 3.0
    data["q"][4000:4050] = np.nan
    said = {}
    for start in (0.0, 1.7e9):
        write_csv(Path("run.csv"), {**data, "t": start + data["t"]})
        document = identified(capsys, "run.csv", "--from", "6", "--to", "900", "--no-sweep")
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
