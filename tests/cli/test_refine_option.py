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


def codes(document):
    return [warning["code"] for warning in document["warnings"]]


@pytest.mark.raises_finding("prior_disagrees")
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
