"""Nothing that a recording holds beside its motion switches doubts off, and advice goes on."""

import numpy as np
import pytest
from benchmarks.calibration.verdict_cases import KINDS

import riecjax as rx

MODEL = KINDS[0].model
TRUTH = {"m": 2.0, "c": 3.0, "k": 180.0}


def motion(seed: int, step: float = 0.005, noise: float = 0.005, **force) -> dict[str, np.ndarray]:
    """A free choice of motion, and the force that it takes: that of an oscillator, of `friction`,
    `drag` and an `offset`, and of another mass."""
    rng, time = np.random.default_rng(seed), step * np.arange(round(30 / step))
    x, v, a = np.zeros((3, time.size))
    for w in 2 * np.pi * np.exp(rng.uniform(np.log(0.3), np.log(6), 30)):
        one = np.exp(1j * (w * time + rng.uniform(0, 6.3))) / w**1.5
        x, v, a = x + one.real, v + (1j * w * one).real, a - w**2 * one.real
    u = force.get("m", TRUTH["m"]) * a + TRUTH["c"] * v + TRUTH["k"] * x
    u += force.get("friction", 0.0) * np.sign(v) + force.get("drag", 0.0) * v * abs(v)
    signals = {"x": x, "v": v, "u": u}
    noisy = {n: s + noise * np.std(s) * rng.standard_normal(s.size) for n, s in signals.items()}
    return noisy | {"u": noisy["u"] + force.get("offset", 0.0)}


def record(seed: int, step: float = 0.005, **force) -> rx.Record:
    return rx.Record(motion(seed, step, **force), step)


def late(signals: dict[str, np.ndarray], samples: int) -> dict[str, np.ndarray]:
    """The force comes so many samples later than the motion."""
    cut = {n: s[samples:] for n, s in signals.items()}
    return cut | {"u": signals["u"][:-samples]}


def codes(assessment) -> set[str]:
    return {finding.code for finding in assessment.findings()}


def right_or_not_good(assessment, truth=TRUTH) -> None:
    for name, judged in assessment.verdict.parameters.items():
        if judged.level == "good":
            assert judged.doubt[0] <= truth[name] <= judged.doubt[1], assessment.verdict


@pytest.mark.raises_finding("missing_term", "residuals_not_tested")
def test_causes_are_weighed_over_recordings_of_unequal_time_steps():
    some = [record(1, 0.005, friction=4.0), record(2, 0.008, friction=4.0)]
    assessment = rx.assess(MODEL, some, refine=None)
    assert {"missing_term", "residuals_not_tested"} <= codes(assessment)
    assert assessment.verdict.parameters["c"].level == "do not use"
    right_or_not_good(assessment)


@pytest.mark.raises_finding("not_weighed")
def test_what_cannot_be_weighed_goes_into_the_doubt():
    """Parameters of each recording."""
    some = [record(1, friction=4.0), record(2, friction=4.0)]
    assessment = rx.assess(MODEL, some, refine=None, per_record=["k"])
    assert "not_weighed" in codes(assessment)
    judged = assessment.verdict.parameters["c"]
    assert abs(judged.value / TRUTH["c"] - 1) > 0.2
    assert judged.level != "good"


@pytest.mark.no_finding("not_weighed")
def test_little_is_left_of_a_right_model_that_cannot_be_weighed():
    some = [record(1), record(2)]
    assessment = rx.assess(MODEL, some, refine=None, per_record=["k"])
    assert {one.level for one in assessment.verdict.parameters.values()} == {"good"}


def test_a_column_that_nobody_reads_takes_no_samples_of_the_others():
    """The number of a lap, written once."""
    signals = late(motion(1), 3)
    lap = np.full(signals["x"].size, np.nan)
    lap[700] = 1.0
    for beside in ({}, {"lap": lap}, {"every_other": np.where(np.arange(lap.size) % 2, 1, lap)}):
        assessment = rx.assess(MODEL, rx.Record(signals | beside, 0.005), refine=None)
        (finding,) = [f for f in assessment.findings() if f.code == "late_signal"]
        assert finding.signals == ("u",)


def test_zeros_that_differ_between_recordings_are_undone_each():
    """Of one signal and one kind, in both."""
    some = [motion(1), motion(2)]
    for signals, zero in zip(some, (0.2, 0.5)):
        signals["v"] = signals["v"] + zero
    assessment = rx.assess(MODEL, [rx.Record(each, 0.005) for each in some], refine=None)
    assert "velocity_offset" in codes(assessment)
    right_or_not_good(assessment)


def test_advice_is_carried_out_on_what_is_validated_on_as_well():
    fitted, other = (rx.Record(late(motion(seed), 6), 0.005) for seed in (1, 2))
    assessment = rx.assess(MODEL, fitted, refine=None, validate_on=[other], follow=1)
    (step,) = assessment.followed
    assert "--shift" in step.options
    (run,) = assessment.test("validation").runs
    assert run.held.worst_fit > 98, run.held.verdict


def test_a_parameter_on_its_bound_does_not_keep_advice_back():
    assessment = rx.assess(MODEL, record(1, offset=6.0), refine=None, bounds={"c": (0.0, 2.0)})
    assert any(cause.step and cause.step.options for cause in assessment.verdict.causes)


@pytest.mark.raises_finding("reversed_input")
def test_a_force_of_the_opposite_sign_leaves_no_value_good_and_is_turned():
    signals = motion(1)
    turned = rx.Record(signals | {"u": -signals["u"]}, 0.005)
    assessment = rx.assess(MODEL, turned, refine=None)
    assert {one.level for one in assessment.verdict.parameters.values()} == {"do not use"}
    followed = rx.assess(MODEL, turned, refine=None, follow=1)
    assert followed.followed[0].options == ("--scale", "u=-1")
    assert {one.level for one in followed.verdict.parameters.values()} == {"good"}
    right_or_not_good(followed)


@pytest.mark.raises_finding("records_disagree")
def test_what_differs_between_machines_is_let_differ():
    some = [record(1), record(2, m=2.4), record(3, m=2.4)]
    followed = rx.assess(MODEL, some, refine=None, follow=1)
    assert followed.followed[0].options == ("--per-record", "m")
    for name, value in {"m[1]": 2.0, "m[2]": 2.4, "m[3]": 2.4}.items():
        assert float(followed.answer[name]) == pytest.approx(value, rel=0.01)


@pytest.mark.raises_finding("wrong_zero", "unexplained")
def test_what_a_cause_leaves_is_weighed_again():
    """Drag that the model lacks, beside a larger zero of the force."""
    assessment = rx.assess(MODEL, record(1, drag=2.0, offset=60.0), refine=None)
    assert {"wrong_zero", "unexplained"} <= codes(assessment)
    judged = assessment.verdict.parameters["c"]
    assert judged.doubt[0] <= TRUTH["c"] <= judged.doubt[1]


def test_a_model_may_load_another_file_of_its_name(tmp_path):
    """As the one does that `riecjax discover` writes."""
    (tmp_path / "found").mkdir()
    (tmp_path / "model.py").write_text(
        "import riecjax as rx\n"
        "model = rx.Equation(rx.Term('m', 'x', derivative=2), -rx.Term(1.0, 'u'))\n"
    )
    (tmp_path / "found" / "model.py").write_text(
        f"import riecjax as rx\nmodel = rx.find_model({str(tmp_path / 'model.py:model')!r})\n"
    )
    assert rx.find_model(str(tmp_path / "found" / "model.py:model")).parameter_names == ("m",)
