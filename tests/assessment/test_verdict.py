"""Verdicts on systems whose truth is known, and the rules that they are composed by."""

import numpy as np
import pytest
from tests.machines import BODY, STANDARD
from tests.machines import MODE_TRUTH as TRUTH
from tests.machines import body_with_mode as motion

import riecjax as rx
from riecjax.reporting.answer import next_steps
from riecjax.reporting.result_page import write_report

RIEC = rx.RIEC(rx.AllWindows(0.05, 0.5))
OF_BODY = {name: TRUTH[name] for name in ("m", "c", "k")}


def assessed(signals: dict[str, np.ndarray], share: float = 0.0, **settings) -> rx.Assessment:
    rng = np.random.default_rng(5)
    noisy = {n: s + share * np.std(s) * rng.standard_normal(s.size) for n, s in signals.items()}
    return rx.assess(BODY, rx.Record(noisy, STANDARD.step), RIEC, refine=None, **settings)


@pytest.fixture(scope="module")
def wrong() -> rx.Assessment:
    """A body that carries a mode which its model leaves out."""
    return assessed(motion(True))


@pytest.fixture(scope="module")
def right() -> rx.Assessment:
    return assessed(motion(False), 0.02)


def test_a_right_model_is_trusted_within_its_doubt(right):
    verdict = right.verdict
    assert [one.level for one in verdict.parameters.values()] == ["good"] * 3
    for name, value in OF_BODY.items():
        low, high = verdict.parameters[name].doubt
        assert low < value < high
    assert verdict.sentence.startswith("Trust ")
    assert verdict.causes == []


@pytest.mark.slow
def test_noise_of_the_sensors_is_not_held_against_the_model():
    clean = motion(False)
    known = {name: 0.05 * float(np.std(signal)) for name, signal in clean.items()}
    (bare,) = assessed(clean, sweep=False, noise="none").estimate.equations.values()
    (fit,) = assessed(clean, 0.05, sweep=False, noise=known).estimate.equations.values()
    # Energies of noise, and of what integrals over samples leave, add up.
    both = np.hypot(float(fit.noise_rms), float(bare.relative_rms))
    assert both == pytest.approx(float(fit.relative_rms), rel=0.05)
    assert float(fit.model_rms) < 0.5 * float(fit.relative_rms)


def test_a_mode_left_out_is_named_with_what_to_do_about_it(wrong):
    verdict = wrong.verdict
    mass = verdict.parameters["m"]
    # Slow motion carries both masses, 26 kg, and the interval leaves them out.
    assert wrong.answer.interval("m")[1] < 26.0 < mass.doubt[1]
    assert verdict.causes[0].kind == "model"
    steps = [cause.step for cause in verdict.causes if cause.step is not None]
    option, place = steps[0].options
    assert option == "--add-mode"
    signal, hertz = place.split("=")
    ringing = np.sqrt(TRUTH["K_mode"] / TRUTH["M_mode"]) / (2 * np.pi)
    assert signal == "v"
    assert float(hertz) == pytest.approx(ringing, rel=0.05)
    assert "mode" in verdict.causes[0].phrase


def test_findings_with_one_cause_are_one_cause(wrong):
    kinds = [cause.kind for cause in wrong.verdict.causes]
    assert len(kinds) == len(set(kinds))
    grouped = [finding for cause in wrong.verdict.causes for finding in cause.findings]
    assert sorted(grouped) == sorted(wrong.findings())
    assert sum(finding.code == "window_sensitive" for finding in grouped) <= 1


@pytest.mark.slow
def test_what_voids_an_answer_is_its_reason_and_the_first_thing_to_do():
    """A record of 5 s steps, taken for seconds, drifts with window length as well."""
    doubtful = rx.Finding("time_unit_doubtful", "nothing states the unit of time", doubt=1.0)
    record = rx.Record(motion(True), STANDARD.step)
    recording = rx.Recording(record, "run.csv", findings=(doubtful,))
    verdict = rx.assess(BODY, recording, RIEC, refine=None).verdict
    assert {one.level for one in verdict.parameters.values()} == {"do not use"}
    assert verdict.sentence.endswith(": time may be in another unit than seconds.")
    assert len(verdict.causes) > 1
    assert next(next_steps(verdict.causes)).words.startswith("State the unit of time")


@pytest.mark.slow
def test_parameters_of_each_recording_are_judged_one_by_one():
    whole = rx.Record(motion(False), STANDARD.step)
    model = rx.Equation(*BODY.terms, rx.Term("offset", rx.constant, unit="N"), name="body")
    parts = [whole.part(0, 2500), whole.part(2500, 6000)]
    found = rx.assess(model, parts, RIEC, refine=None, per_record=("offset",))
    assert set(found.verdict.parameters) == {"m", "c", "k", "offset[1]", "offset[2]"}
    of_offset = rx.Finding("at_bound", "", parameters=("offset",))
    assert found.parameters_of(of_offset) == {"offset[1]", "offset[2]"}
    assert found.parameters_of(rx.Finding("clipped", "", signals=("F",))) == set(
        found.answer.parameters
    )
    assert found.parameters_of(rx.Finding("clipped", "", signals=("G",))) == set()


ORDINARY = rx.Equation(
    rx.Term("M_mode", "v", derivative=1, unit="kg"),
    rx.Term("x@3", "v", unit="N s/m"),
    rx.Term("K_series", "x", unit="N/m"),
    rx.Term("offset[2]", rx.constant, unit="N"),
    -rx.Term(1.0, "F"),
    name="body",
)
"""Parameters of a user's own, called as hidden elements', recordings' own and widths are."""


@pytest.mark.slow
def test_a_parameter_is_what_the_model_says_whatever_it_is_called(tmp_path):
    record = rx.Record(motion(False), STANDARD.step)
    quick = {"refine": None, "sweep": False, "intervals": rx.Sandwich()}
    found = rx.assess(ORDINARY, record, RIEC, **quick)
    for name, value in zip(ORDINARY.parameters, (*OF_BODY.values(), 0.0)):
        assert float(found.estimate[name]) == pytest.approx(value, rel=5e-3, abs=0.1)
        assert found.verdict.parameters[name].level == ("caution" if value == 0 else "good")
    assert "series_spring_not_carried" not in {finding.code for finding in found.findings()}
    with pytest.raises(rx.ModelError, match="bounds are given for 'offset'"):
        rx.identify(ORDINARY, record, RIEC, bounds={"offset": (1.0, 2.0)})
    bounded = rx.identify(ORDINARY, record, RIEC, bounds={"offset[2]": (1.0, 2.0)})
    assert bounded.findings()[0].parameters == ("offset[2]",)
    assert found.parameters_of(rx.Finding("at_bound", "", parameters=("offset",))) == set()
    write_report(found, tmp_path)
    assert set(rx.load(tmp_path).parameters) == {*ORDINARY.parameters}
    assert "offset[2]" in (tmp_path / "report.html").read_text()
    still = record.with_signals({"x": np.zeros(record.sample_count)})
    with pytest.raises(rx.IdentifiabilityError, match=r"--set K_series=VALUE"):
        rx.identify(ORDINARY, still, RIEC)
    # Beside a hidden element, its name is taken.
    for taken in (
        rx.staged(ORDINARY).with_elements(rx.HiddenMode("v")),
        rx.staged(ORDINARY).with_elements(rx.SeriesSpring("x@3")),
    ):
        with pytest.raises(rx.ModelError, match="Rename"):
            rx.identify(taken, record)
