"""Recordings by which a verdict is easily misled: what is trusted, and what is advised."""

import functools

import numpy as np
import pytest
from benchmarks.calibration import verdict_cases
from benchmarks.calibration.verdict_cases import KINDS, Case
from benchmarks.calibration.verdict_classes import CLASSES, class_cases

import riecjax as rx
from nightly import nightly
from riecjax.assessment.assess import Assessment

SEED = 11
"""None of those that rules were set on."""


@functools.cache
def cases(name: str) -> list[Case]:
    """The first of a class."""
    return class_cases(name, SEED, most=6)


def assessed(case: Case, **settings) -> Assessment:
    return rx.assess(case.model, case.record, case.criterion, **settings)


def error(assessment: Assessment, case: Case, name: str) -> float:
    """Share of the value by which it is off."""
    return abs(case.truth[name] / float(assessment.answer[name]) - 1)


@pytest.mark.parametrize("name", CLASSES)
@pytest.mark.parametrize("number", [0, *nightly([1, 2])])
def test_what_is_trusted_is_right_within_its_doubt(name, number):
    case = cases(name)[number]
    try:
        assessment = assessed(case)
    except rx.IdentifiabilityError:
        return  # refused with a reason
    for parameter, judged in assessment.verdict.parameters.items():
        if judged.level == "good":
            assert error(assessment, case, parameter) <= judged.share, assessment


@pytest.mark.parametrize("number", [1, 3])
def test_a_constant_that_is_missing_of_one_tone_is_no_delay(number):
    """A delay explains nearly as much; undone, it makes right values wrong."""
    case = cases("one tone")[number]
    assert case.fault == "constant missing"
    assessment = assessed(case)
    steps = [cause.step for cause in assessment.verdict.causes if cause.step]
    assert not any("--shift" in step.options for step in steps), assessment
    followed = assessed(case, follow=3)
    assert ("--unknown-offset", "T") in [step.options for step in followed.followed]
    for name, value in case.truth.items():
        assert float(followed.answer[name]) == pytest.approx(value, rel=0.05)


@pytest.mark.raises_finding("stages_disagree")
def test_stages_that_refute_each_other_are_solved_together():
    case = cases("lever arm")[0]
    alone, together = assessed(case), assessed(case, follow=1)
    levels = {name: one.level for name, one in alone.verdict.parameters.items()}
    assert "good" not in levels.values()
    assert "refute" in alone.verdict.sentence
    (step,) = together.followed
    assert step.options == ("--together",)
    assert step.changed is not None
    for name in case.truth:
        assert error(together, case, name) < 0.3 * error(alone, case, name)
        assert step.changed[name] == (alone.answer[name], together.answer[name])


@pytest.mark.no_finding("stages_disagree")
def test_stages_that_agree_refute_nothing():
    """The accelerometer in the mass centre."""
    case = class_cases("lever arm", SEED, most=1, ahead=0.0)[0]
    assessment = assessed(case)
    assert {one.level for one in assessment.verdict.parameters.values()} == {"good"}
    for name, value in case.truth.items():
        assert float(assessment.answer[name]) == pytest.approx(value, rel=0.03)


@pytest.mark.raises_finding("sampled_input")
def test_pulses_of_two_samples_leave_a_gain_in_doubt():
    """Of every blow the same part lies between samples: no scatter shows it."""
    for case in class_cases("short pulses", SEED, most=10, shortest=2.0)[1::2]:
        assessment = assessed(case, refine=None)
        found = [f for f in assessment.findings() if f.code == "sampled_input"]
        assert [finding.signals for finding in found] in ([], [("u",)])
        for name, judged in assessment.verdict.parameters.items():
            assert error(assessment, case, name) < judged.share + 0.01


@pytest.mark.no_finding("sampled_input")
def test_an_input_that_is_slow_beside_its_samples_is_no_doubt():
    time = 0.005 * np.arange(6000)
    rng = np.random.default_rng(0)
    tones = [(w, rng.uniform(0, 6)) for w in (3.0, 11.0, 29.0, 70.0)]
    x = sum(np.sin(w * time + p) / w for w, p in tones)
    v = sum(np.cos(w * time + p) for w, p in tones)
    a = sum(-w * np.sin(w * time + p) for w, p in tones)
    record = rx.Record({"x": x, "v": v, "u": 2.0 * a + 3.0 * v + 90.0 * x}, 0.005)
    assessment = rx.assess(KINDS[0].model, record, refine=None)
    assert "sampled_input" not in {finding.code for finding in assessment.findings()}


def test_accelerations_of_a_right_model_are_trusted_although_long_windows_see_noise_alone():
    for case in cases("accelerations")[:3]:
        for name, judged in assessed(case).verdict.parameters.items():
            assert judged.level != "do not use", name


def test_a_mode_beyond_the_band_of_the_windows_is_not_looked_for():
    """The drive's noise at 202 Hz: to find a mode there takes a minute, and is refused."""
    rate, rng = 1000.0, np.random.default_rng(3)
    time = np.arange(20_000) / rate
    tones = [(w, rng.uniform(0, 6)) for w in (5.0, 13.0, 31.0)]
    x = sum(np.sin(w * time + p) / w for w, p in tones)
    v = sum(np.cos(w * time + p) for w, p in tones)
    a = sum(-w * np.sin(w * time + p) for w, p in tones)
    u = 2.0 * a + 3.0 * v + 90.0 * x
    u += 0.2 * np.std(u) * np.sin(2 * np.pi * 202 * time + 0.3 * np.sin(time))
    assessment = rx.assess(KINDS[0].model, rx.Record({"x": x, "v": v, "u": u}, 1 / rate))
    steps = [cause.step for cause in assessment.verdict.causes if cause.step]
    assert not any("--add-mode" in step.options for step in steps), assessment
    assert {one.level for one in assessment.verdict.parameters.values()} == {"good"}


def test_a_late_velocity_of_step_tests_leaves_what_it_does_not_touch():
    late = [case for case in class_cases("step tests", SEED, most=9) if "mean" in case.fault]
    for case in late[:3]:
        verdict = assessed(case, refine=None).verdict
        right = [
            n for n in ("kV", "kG") if abs(verdict.parameters[n].value / case.truth[n] - 1) < 0.01
        ]
        assert any(verdict.parameters[name].level == "good" for name in right), verdict


@pytest.mark.raises_finding("window_sensitive")
def test_values_at_single_samples_are_held_against_windows():
    """20 kg that carry 6 kg on a spring of 25 Hz, which the model leaves out: they count as 26 when
    they move slowly. No block test shows what they do at single samples."""
    rng, time = np.random.default_rng(1), 0.005 * np.arange(12_000)
    x, v, a, u = np.zeros((4, time.size))
    for w in 2 * np.pi * np.exp(rng.uniform(np.log(0.3), np.log(45), 80)):
        s, hidden = 1j * w, 2 * np.pi * 25
        carried = (2 * 0.05 * hidden * s + hidden**2) / (s**2 + 2 * 0.05 * hidden * s + hidden**2)
        one = np.exp(1j * (w * time + rng.uniform(0, 6.3))) / w
        x, v, a = x + one.real, v + (s * one).real, a + (s**2 * one).real
        u = u + ((20 + 6 * carried) * s**2 * one + 200 * s * one + 5000 * one).real
    body = rx.Equation(
        rx.Term("m", "x", derivative=2, measured=("v", "a"), unit="kg"),
        rx.Term("c", "x", derivative=1, measured=("v",), unit="N s/m"),
        rx.Term("k", "x", unit="N/m"),
        -rx.Term(1.0, "u"),
    )
    record = rx.Record({"x": x, "v": v, "a": a, "u": u}, 0.005)
    assessment = rx.assess(body, record, rx.DOLS(), refine=None)
    judged = assessment.verdict.parameters["m"]
    assert abs(judged.value - 26) > 2
    assert judged.level != "good"
    assert judged.doubt[0] <= 26 <= judged.doubt[1]


@pytest.mark.raises_finding("unexplained")
def test_what_nothing_explains_alone_counts_by_what_explains_a_part():
    """Dry friction that the model lacks, and a force that is late as well."""
    kind = next(kind for kind in KINDS if kind.name == "friction left out")
    case = verdict_cases.cases(kind, "late force", 3, 3)[2]
    assessment = rx.assess(case.model, case.record, refine=None)
    (finding,) = [one for one in assessment.findings() if one.code == "unexplained"]
    assert "Coulomb friction" in finding.message
    assert "delay of u" in finding.message
    judged = assessment.verdict.parameters["c"]
    assert judged.level == "do not use"
    assert judged.reason == "the model leaves more than noise"
    assert judged.doubt[0] <= case.truth["c"] <= judged.doubt[1]
    assert case.truth["c"] != pytest.approx(judged.value, rel=0.3)


@pytest.mark.no_finding("unexplained")
def test_nothing_is_left_unexplained_of_sound_recordings():
    for kind in KINDS[:2]:
        for case in verdict_cases.cases(kind, "none", 3, 3):
            assessment = rx.assess(case.model, case.record, refine=None)
            assert "unexplained" not in {finding.code for finding in assessment.findings()}


def test_no_step_is_told_that_the_next_run_refuses():
    """Whatever is proposed is accepted, and was tried."""
    for name in CLASSES:
        case = cases(name)[1]
        try:
            assessment = assessed(case)
        except rx.IdentifiabilityError:
            continue
        for cause in assessment.verdict.causes:
            if cause.step is not None and cause.step.options:
                assert assessment.tried is not None
                assert cause.step.options in assessment.tried
                assert cause.step.changed


@pytest.mark.parametrize("follow", [0, 1, 3])
def test_no_more_steps_are_followed_than_were_asked_for(follow):
    assessment = assessed(cases("one tone")[1], follow=follow)
    assert len(assessment.followed) <= follow
    before = assessment
    for _ in assessment.followed:
        assert before.before is not None
        before = before.before
    assert before.before is None
    assert before.followed == ()


def test_values_of_equations_in_stages_and_together_agree_with_numpy():
    """Together is one least-squares problem of all equations' windows."""
    case = class_cases("lever arm", SEED, most=1, ahead=0.0)[0]
    model = case.model.solved_together()
    assert len(model.stages) == 1
    assert model.parameter_names == case.model.parameter_names
    staged = rx.simultaneous(*(e for stage in case.model.stages for e in stage))
    both = (rx.identify(one, case.record, intervals="naive") for one in (model, staged))
    one, other = both
    for name in case.truth:
        assert float(one[name]) == pytest.approx(float(other[name]), rel=1e-12)
