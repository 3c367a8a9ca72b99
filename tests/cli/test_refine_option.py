"""`riecjax identify --refine`: refined parameters, and predictions before and after."""

import pytest
from command_line import call, write_csv
from tests.machines import DRAG

IDENTIFY = ("--model", "drag-oscillator", "--no-sweep", "--intervals", "sandwich")


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """The oscillator with drag, its sensors with 5 % noise."""
    signals = DRAG.signals(0.05, 2)
    path = tmp_path_factory.mktemp("refine") / "run.csv"
    return write_csv(path, {"t": DRAG.shape.times, **signals})


def test_a_horizon_is_of_what_is_simulated(recording, capsys):
    file = str(recording)
    held_out = ("--refine", "none", "--horizon", "2", "--hold-out", "0.3", "--json")
    found = call(capsys, "identify", file, *IDENTIFY, *held_out)
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
