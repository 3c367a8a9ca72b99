"""What is missing and no term: a signal that comes late, a mode that the equations leave out."""

import io
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from rich.console import Console
from tests.machines import BODY, LAG_TRUTH, LATE, OTHERS, PROBLEMS, STANDARD, body_with_lag
from tests.machines import MODE_TRUTH as TRUTH
from tests.machines import body_with_mode as motion

import riecjax as rx
from nightly import nightly
from riecjax.discovery.discover import discover, model_source
from riecjax.equations.model import as_model
from riecjax.models.catalogue import find_model
from riecjax.reporting.discovery import (
    discovery_document,
    discovery_figures,
    discovery_page,
    print_discovery,
    sentence,
)

QUICK = {"intervals": rx.Naive(), "resamples": 0}
DRAG = PROBLEMS["drag"]


def carrying(noise: float = 0.0) -> rx.Record:
    rng = np.random.default_rng(3)
    clean = motion(True)
    return rx.Record(
        {n: s + noise * np.std(s) * rng.standard_normal(s.size) for n, s in clean.items()},
        STANDARD.step,
    )


def test_a_spring_in_series_is_found_instead_of_a_mode_of_negative_mass(tmp_path):
    """Terms and a mode, whose mass is then below zero, make up for a damper's lag."""
    record = rx.Record.from_samples(body_with_lag(8000), time_step=STANDARD.step)
    found = discover(rx.staged(BODY), record, **QUICK)
    assert found.names == ("spring",)
    for name, value in LAG_TRUTH.items():
        assert float(found.estimate[name]) == pytest.approx(value, rel=0.01)
    (tmp_path / "body.py").write_text("import riecjax as rx\n")
    text = model_source(found, "body.py:BODY", tmp_path)
    assert 'rx.SeriesSpring("c")' in text
    assert "a spring in series with c" in sentence(found)


@pytest.fixture(scope="module")
def late() -> rx.Record:
    return OTHERS["late_force"].record(0.01, 1, drive=1)


@pytest.mark.slow
@pytest.mark.raises_finding("late_signal")
def test_terms_are_found_once_what_comes_late_is_in_time(late):
    found = discover(DRAG.start, late, **QUICK)
    assert {*found.names} == OTHERS["late_force"].missing
    # With 1 % noise delays scatter by 0.45 ms (five seeds).
    assert found.delays["u"] == pytest.approx(LATE, rel=0.02)
    assert float(found.estimate["viscous"]) == pytest.approx(0.8, rel=0.03)
    assert ("late_signal", ("u",)) in [(one.code, one.signals) for one in found.findings]
    assert discovery_document(found)["delays"] == {"u": pytest.approx(LATE, rel=0.02)}
    said = sentence(found)
    assert f"u comes {1e3 * found.delays['u']:.3g} ms late" in said
    assert "identify with --shift u=0.03" in said
    assert "mend that first" not in said


@pytest.mark.slow
@pytest.mark.raises_finding("late_signal")
def test_of_a_right_model_only_the_delay_is_found(late):
    """Hysteresis and a harder spring stand for it where it is not taken off."""
    found = discover(DRAG.model, late, **QUICK)
    assert found.names == ("delay",)
    assert sentence(found).startswith("No term is missing")


@pytest.mark.parametrize("noise", [*nightly([0.0]), 0.02])
def test_a_mode_is_found_instead_of_terms_that_stand_for_it(noise):
    found = discover(BODY, carrying(noise), **QUICK)
    assert found.names == ("mode",)
    assert found.element is not None
    assert found.element.place == "v"
    for name in ("M_mode", "K_mode"):
        assert float(found.estimate[name]) == pytest.approx(TRUTH[name], rel=0.1)
    document = discovery_document(found)
    assert document["chosen"] == ["mode"]
    assert document["terms"]["mode"]["parameters"] == ["M_mode", "K_mode", "B_mode"]
    first, last = (step["unexplained"] for step in document["path"])
    assert 0 < last < 0.1 * first
    assert sentence(found).startswith("mode (a hidden mode on v near ")
    # What has no error or chance is printed without.
    console = Console(width=200, record=True, file=io.StringIO())
    print_discovery(found, None, console)
    assert "+ mode" in console.export_text()
    assert discovery_page(found).sections
    assert discovery_figures(found)["path"].rows


@pytest.mark.slow
def test_the_file_of_a_model_with_a_mode_is_identified_and_simulated(tmp_path):
    found = discover(BODY, carrying(), **QUICK)
    (tmp_path / "body.py").write_text(
        "import sys\n"
        f"sys.path.insert(0, {str(Path(__file__).parents[2])!r})\n"
        "from tests.machines import BODY\n"
    )
    source = model_source(found, str(tmp_path / "body.py:BODY"), tmp_path)
    (tmp_path / "model.py").write_text(source)
    read = find_model(str(tmp_path / "model.py"))
    again = rx.identify(read, carrying())
    assert float(again["M_mode"]) == pytest.approx(float(found.estimate["M_mode"]), rel=1e-6)
    assert {q.name: q.default for q in read.simulation_parameters}["M_mode"] is not None


@pytest.mark.raises_finding("not_offered")
def test_hysteresis_that_cannot_be_offered_is_called_no_mode():
    """Its velocity has no name: what it leaves rings, and a mode explains nearly all of it."""
    inertia, spring = rx.Term("m", "x", derivative=2), rx.Term("k", "x")
    nameless = as_model(rx.Equation(inertia, spring, -rx.Term(1.0, "u"), name="mass", unit="N"))
    record = PROBLEMS["hysteresis"].record(0.01, 0).select("x", "u")
    found = discover(nameless, record, **QUICK)
    assert found.leaves_more
    assert found.element is None
    assert [warning["code"] for warning in discovery_document(found)["warnings"]] == ["not_offered"]
    moded = rx.identify(nameless.with_elements(rx.HiddenMode("x")), record, intervals=rx.Naive())
    left = (float(one.equations["mass"].model_rms) for one in (moded, found.estimate))
    assert next(left) < 0.3 * next(left)


def test_a_body_without_a_mode_is_given_none():
    found = discover(BODY, rx.Record(motion(False), STANDARD.step), **QUICK)
    assert found.names == ()


@pytest.mark.raises_finding("late_signal")
@pytest.mark.slow
def test_a_velocity_that_is_late_is_not_the_forces_fault():
    clean = DRAG.record(0.01, 4, drive=1)
    late = clean.with_signals({"dx": jnp.roll(clean["dx"], 1)}).part(1, 4000)
    found = discover(DRAG.start, late, **QUICK)
    assert found.delays == {}
    assert ("late_signal", ("dx",)) in [(one.code, one.signals) for one in found.findings]
    assert "mend that first (--shift dx=0.0" in sentence(found)
