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


@pytest.mark.slow
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
    options = ("--refine", "integral", "--verbose")
    printed = call(capsys, "identify", str(recording), *IDENTIFY, *options).out
    assert "identified" in printed
    assert "refined by impulses of the equation error: converged" in printed
    assert "run.csv (fitted), fit before -> after" in printed
    assert "left before and after, of impulses over the same windows" in printed
    assert "from the state as recorded" in " ".join(printed.split())


@pytest.mark.slow
def test_windows_shorter_than_the_recording(recording, capsys):
    document = call(
        capsys, "identify", str(recording), *IDENTIFY, "--refine", "output-error", "--horizon",
        "2", "--channel", "x", "--json",
    ).document  # fmt: skip
    assert document["refinement"]["by"]["seconds"] == 2.0
    assert set(document["refinement"]["left"]) == {"x"}
    assert document["parameters"]["k"]["value"] == pytest.approx(20.0, rel=0.03)


def test_by_default_the_answer_is_refined_where_white_noise_is_left(recording, capsys):
    printed = call(capsys, "identify", str(recording), *IDENTIFY)
    assert printed.status == 0
    assert "refined by simulation, which leaves white noise" in " ".join(printed.out.split())
    told = " ".join(call(capsys, "identify", str(recording), *IDENTIFY, "--verbose").out.split())
    answer, both, said = (
        told.index(part)
        for part in ("parameter value", "parameter identified", "the refined values are the answer")
    )
    assert answer < both < said
    assert "does not prove the model right" in told
    document = call(capsys, "identify", str(recording), *IDENTIFY, "--json").document
    refinement = document["refinement"]
    assert refinement["chosen"] is True
    assert refinement["whiteness"]["largest"] < refinement["whiteness"]["threshold"]
    assert refinement["chi_squared"] == pytest.approx(1.0, abs=0.2)
    assert document["parameters"] == refinement["refined"]
    for name, true in TRUTH.items():
        entry = document["parameters"][name]
        low, high = entry["interval95"]
        assert low - (high - low) < true < high + (high - low)


@pytest.mark.slow
def test_of_another_model_the_identified_values_stay_with_one_table(recording, capsys, tmp_path):
    """The oscillator without its drag."""
    model = tmp_path / "linear.py"
    model.write_text(
        "import riecjax as rx\n"
        "axis = rx.Equation(rx.Term('m', 'x', derivative=2, measured=('dx', 'ddx')),\n"
        "    rx.Term('r', 'x', derivative=1, measured=('dx',)), rx.Term('k', 'x'),\n"
        "    -rx.Term(1.0, 'u'), name='axis')\n"
    )
    arguments = (
        "identify",
        str(recording),
        "--model",
        str(model),
        *IDENTIFY[2:],
        "--hold-out",
        "0.3",
    )
    assert call(capsys, *arguments).out.count("parameter ") == 1
    words = " ".join(call(capsys, *arguments, "--verbose").out.split())
    assert "that is not the answer: what it leaves of" in words
    assert "are the physical parameters" in words
    assert "worst fit on run.csv, last part" in words
    assert "95 % interval refined unit" in words


def test_a_horizon_needs_something_to_simulate(recording, capsys):
    file = str(recording)
    horizon = ("--refine", "none", "--horizon", "2")
    refused = call(capsys, "identify", file, *IDENTIFY, *horizon)
    assert refused.status == 2
    assert "--hold-out" in refused.err
    found = call(capsys, "identify", file, *IDENTIFY, *horizon, "--hold-out", "0.3", "--json")
    assert found.document["validation"][0]["horizon_s"] == 2.0
    assert found.document["refinement"] is None


@pytest.mark.slow
@pytest.mark.raises_finding("prior_disagrees")
def test_a_prior_counts_as_one_more_observation(recording, capsys):
    """Of two normal distributions: weighed by their inverse variances."""

    def refined(*options):
        asked = ("identify", str(recording), *IDENTIFY, "--refine", "integral", "--json", *options)
        return call(capsys, *asked).document

    without = refined()["parameters"]["k"]
    mean, std = without["value"] + without["std_error"], 0.5 * without["std_error"]
    document = refined("--prior", f"k={mean}±{std}")
    weights = without["std_error"] ** -2, std**-2
    expected = (weights[0] * without["value"] + weights[1] * mean) / sum(weights)
    moved = document["parameters"]["k"]["value"] - without["value"]
    assert moved == pytest.approx(expected - without["value"], rel=0.5)
    assert "prior_disagrees" not in codes(document)
    wrong = refined("--prior", f"k={2 * without['value']}+-{std}")
    assert "prior_disagrees" in codes(wrong)
    assert document["job"]["prior"] == {"k": f"{mean}±{std}"}


def codes(document):
    return [warning["code"] for warning in document["warnings"]]


def test_a_prior_that_the_recording_contradicts_is_the_reason(recording, capsys):
    prior = ("--refine", "integral", "--prior", "m=3.0±0.05", "--json")
    verdict = call(capsys, "identify", str(recording), *IDENTIFY, *prior).document["verdict"]
    assert verdict["parameters"]["m"]["level"] == "do not use"
    assert verdict["parameters"]["m"]["reason"] == "the recordings and the prior of m disagree"
    assert verdict["next"][0]["words"].startswith("Check what you said of m")


@pytest.mark.raises_finding("outside_bound")
def test_a_linear_value_out_of_its_bounds_is_said_and_no_search_fails_at_its_start(
    recording, capsys
):
    """The true stiffness is 20 N/m, from which neither search may start here."""
    bound = ("--bound", "k=0:15", "--json")
    free = call(capsys, "identify", str(recording), *IDENTIFY, *bound).document
    assert "outside_bound" in codes(free)
    verdict = free["verdict"]["parameters"]["k"]
    assert free["parameters"]["k"]["value"] == pytest.approx(20.0, rel=0.03)
    # 15 is a quarter of 20 away.
    assert verdict["share"] > 0.2
    assert verdict["reason"] == "k lies outside its bounds"
    asked = call(capsys, "identify", str(recording), *IDENTIFY, "--refine", "output-error", *bound)
    assert asked.status == 0, asked.err
    verdict = asked.document["verdict"]
    assert asked.document["parameters"]["k"]["value"] == pytest.approx(15.0, rel=1e-6)
    assert "outside_bound" not in codes(asked.document)
    assert verdict["parameters"]["k"]["reason"] == "k sits on a bound"
