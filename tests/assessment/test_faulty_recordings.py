"""The benchmark of faults: what is named, and what is not, of a recording with a fault."""

import numpy as np
from benchmarks.recovery import judge
from benchmarks.recovery.faults import FAULTS, recorded
from benchmarks.recovery.machines import MACHINES

DRAG = MACHINES["drag"]


def test_a_fault_changes_its_own_signal_alone_and_a_wrong_sign_is_named(tmp_path):
    sound = recorded(DRAG, None, "severe", seed=0, noise=0.01)[0][1]
    for name, fault in FAULTS.items():
        if fault.on and not fault.machines:
            faulty = recorded(DRAG, name, "severe", seed=0, noise=0.01)[0][1]
            changed = {n for n, values in sound.items() if not np.array_equal(faulty[n], values)}
            assert changed == {getattr(DRAG, fault.on)}, name
    outcome, _ = judge.judged("sign of velocity", DRAG, "severe", 0, 0.01, tmp_path)
    assert outcome.harmed
    assert outcome.named
    assert not judge.sound_answer("drag", 0, 0.01, tmp_path).findings


def test_a_delay_that_is_the_damping_of_its_own_velocity_explains_no_part_of_noise(tmp_path):
    """Beside its velocity, what a position's delay has of its own is what sensors add to it."""
    for seed in (1000, 1004):
        codes = [f.code for f in judge.sound_answer("car", seed, 0.01, tmp_path).findings]
        assert "unexplained" not in codes, seed
