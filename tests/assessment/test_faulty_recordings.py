"""The benchmark of faults: what its faults do to a recording, and how an answer is judged."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[2]))  # for whoever runs `pytest` and not `python -m`

from benchmarks.recovery import judge
from benchmarks.recovery.__main__ import false_alarms, line, shares
from benchmarks.recovery.faults import FAULTS, recorded
from benchmarks.recovery.machines import LEAD, MACHINES, SAMPLES, motion

DRAG = MACHINES["drag"]


def drag(fault: str | None, severity: str = "severe") -> dict[str, np.ndarray]:
    return recorded(DRAG, fault, severity, seed=0, noise=0.01)[0][1]


def test_a_fault_changes_its_own_signal_alone_and_not_the_noise():
    sound = drag(None)
    for name, fault in FAULTS.items():
        if fault.on and not fault.machines:
            faulty = drag(name)
            signal = getattr(DRAG, fault.on)
            assert not np.array_equal(faulty[signal], sound[signal]), name
            for other in set(sound) - {signal}:
                np.testing.assert_array_equal(faulty[other], sound[other], err_msg=name)


def test_delays_and_lost_rows_are_of_the_stated_size():
    sound, late, lost = drag(None), drag("late velocity"), drag("rows lost of velocity")
    noise = 0.01 * np.std(motion("drag", 0)["dx"])
    # Three samples late, and twenty rows lost at two fifths; noises stay where they are.
    assert np.std(late["dx"][3:] - sound["dx"][:-3]) < 2 * noise
    half = SAMPLES // 2
    assert np.std(lost["dx"][half:-20] - sound["dx"][half + 20 :]) < 2 * noise
    np.testing.assert_array_equal(lost["dx"][: half // 2], sound["dx"][: half // 2])


def test_a_filter_is_late_by_its_time_constant():
    fine = motion("drag", 0)["dx"][4 * LEAD :: 4][:SAMPLES]
    slow = recorded(DRAG, "low-passed velocity", "mild", 0, 0.0)[0][1]["dx"]
    rate = np.gradient(fine)
    assert np.sum(rate * (fine - slow)) / np.sum(rate**2) == pytest.approx(0.5, rel=0.03)


def test_what_harms_and_what_counts_as_named():
    sound = judge.Answer({"m": 1.0, "k": 10.0}, {"m": 0.01, "k": 0.01}, ())
    moved = judge.Answer({"m": 1.05, "k": 10.0}, {}, ())
    assert judge.distance(moved, sound) == (pytest.approx(5), "m", True)
    # Four standard errors of k, but less than half a percent of it.
    assert not judge.distance(judge.Answer({"m": 1.0, "k": 10.04}, {}, ()), sound)[2]
    assert judge.distance(judge.Answer({}, {}, ()), sound) == (judge.FAR, "m", True)
    finding = judge.Finding("late_signal", ("u",), (), (), "")
    assert judge.names_the_fault(finding, "late force", DRAG)
    assert not judge.names_the_fault(finding, "late velocity", DRAG)
    assert not judge.names_the_fault(finding._replace(code="clipped"), "late force", DRAG)


def test_shares_count_harmed_cases_alone():
    case = {"harmed": True, "detected": True, "named": False, "after": 2.0}
    some = [case, {**case, "after": 4.0}, {**case, "harmed": False}]
    assert shares(some) == ("2 of 3", "2 of 2", "0 of 2", "1 of 2")
    alarms = false_alarms([("clipped", "clipped"), (), (), ()])
    assert alarms["codes"]["clipped"]["count"] == 1
    assert 0.04 < alarms["codes"]["clipped"]["low"] < 0.25 < alarms["codes"]["clipped"]["high"]


def test_a_velocity_of_the_wrong_sign_is_named_and_a_sound_recording_is_not(tmp_path):
    outcome, _ = judge.judged("sign of velocity", DRAG, "severe", 0, 0.01, tmp_path)
    assert outcome.harmed
    assert outcome.named
    assert "named" in line(outcome._asdict())
    assert not [f for f in judge.sound_answer("drag", 0, 0.01, tmp_path).findings]
