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


@pytest.mark.raises_finding("prior_disagrees")
def test_a_prior_that_the_recording_contradicts_is_the_reason(recording, capsys):
    prior = ("--refine", "integral", "--prior", "m=3.0±0.05", "--json")
    verdict = call(capsys, "identify", str(recording), *IDENTIFY, *prior).document["verdict"]
    assert verdict["parameters"]["m"]["level"] == "do not use"
    assert verdict["parameters"]["m"]["reason"] == "the recordings and the prior of m disagree"
    assert verdict["next"][0]["words"].startswith("Check what you said of m")


@pytest.mark.parametrize("refine", ["auto", "output-error"])
def test_a_bound_holds_of_either_estimate_and_no_search_fails_at_its_start(
    recording, capsys, refine
):
    """The true stiffness is 20 N/m, from which no search may start here."""
    bound = ("--refine", refine, "--bound", "k=0:15", "--json")
    asked = call(capsys, "identify", str(recording), *IDENTIFY, *bound)
    assert asked.status == 0, asked.err
    assert asked.document["parameters"]["k"]["value"] == pytest.approx(15.0, rel=1e-6)
    assert asked.document["verdict"]["parameters"]["k"]["reason"] == "k sits on a bound"
