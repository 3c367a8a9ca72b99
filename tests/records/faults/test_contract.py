"""Every fault of one signal is named alone, in any unit, and its remedy undoes it."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest
from benchmarks.recovery.faults import recorded
from benchmarks.recovery.machines import MACHINES
from tests.machines import JOINT_SENSORS, Shape, joint, joint_record, noisy, waves

from riecjax.doubts.reading import read_recording
from riecjax.findings import Finding
from riecjax.records.faults.signals import FAULTS, check_signals
from riecjax.records.record import Record
from riecjax.settings import Reading

STEP, COUNT = 0.005, 4000
TIME = STEP * np.arange(COUNT)


def sound(seed: int = 0) -> dict[str, np.ndarray]:
    """Position, velocity and force: tones up to 4 Hz, with noise of 1 % on each."""
    x, v, a = waves(TIME, seed, 1.0, (0.2, 4.0))
    return noisy({"x": x, "v": v, "u": a + 3 * v + 200 * x}, 0.01, seed)


class Acted(NamedTuple):
    """A fault of the force: its code and what it does."""

    code: str
    act: Callable[[np.ndarray, dict[str, np.ndarray]], np.ndarray]


def at(value: float | None, *stretches: slice) -> Callable:
    """A value, or that of the first sample, in these stretches."""

    def act(u: np.ndarray, others: dict[str, np.ndarray]) -> np.ndarray:
        u = u.copy()
        for stretch in stretches:
            u[stretch] = u[stretch.start] if value is None else value
        return u

    return act


def spiked(u: np.ndarray, others: dict[str, np.ndarray]) -> np.ndarray:
    return u + 2 * u.std() * np.isin(np.arange(COUNT), [500, 1501, 1502, 3003])


# The row of the last message, each of which comes up to one row early or late.
SENT = 10 * np.arange(COUNT // 10) + np.random.default_rng(0).integers(-1, 2, COUNT // 10)
HELD = SENT.clip(0)[np.searchsorted(SENT.clip(0), np.arange(COUNT), "right") - 1]
HOLES = [slice(k, k + 6) for k in range(150, 3900, 379)]
ACTED = {
    "clipped": Acted("clipped", lambda u, _: np.clip(u, -1.5 * u.std(), 1.5 * u.std())),
    "clipped above": Acted("clipped", lambda u, _: np.minimum(u, 1.7 * u.std())),
    "clipped at a crest": Acted("clipped", lambda u, _: np.minimum(u, 0.9 * u.max())),
    "stuck": Acted("stuck_sensor", at(None, slice(1000, 1400))),
    "drops to zero": Acted("stuck_sensor", at(0.0, slice(1000, 1400))),
    "drops out": Acted("stuck_sensor", at(-9.99, *HOLES)),
    "repeats the last": Acted("stuck_sensor", at(None, *HOLES)),
    "held twice": Acted("held_signal", lambda u, _: np.repeat(u[::2], 2)),
    "held": Acted("held_signal", lambda u, _: np.repeat(u[::10], 10)),
    "held unevenly": Acted("held_signal", lambda u, _: u[HELD]),
    "held and rounded": Acted(
        "held_signal",
        lambda u, _: 0.01 * u.std() * np.round(np.repeat(u[::10], 10) / u.std() * 100),
    ),
    "spikes": Acted("outliers", spiked),
    "coarse": Acted("quantised", lambda u, _: 0.1 * u.std() * np.round(10 * u / u.std())),
    "gap": Acted("missing_samples", at(np.nan, slice(1000, 1100))),
    "constant": Acted("constant_signal", lambda u, _: np.full(COUNT, u[0])),
    "copied": Acted("copied_signal", lambda _, others: -2.5 * others["x"]),
    "hum": Acted("hum", lambda u, _: u + 0.1 * u.std() * np.sin(2 * np.pi * 50.02 * TIME)),
}
PAIRS = [("x", "v")]


def checked(signals: dict[str, np.ndarray]) -> list:
    return check_signals(Record.from_samples(signals, time_step=STEP), signals, pairs=PAIRS)


def mended(path, signals: dict[str, np.ndarray], findings: list[Finding]) -> Record:
    """What the program reads of a file with these signals, and with what findings propose."""
    table = np.column_stack([TIME, *signals.values()])
    np.savetxt(path, table, delimiter=",", header=",".join(["t", *signals]), comments="")
    options = {option.flag: (name, option) for name, option in Reading.options().items()}
    asked: dict[str, Any] = {"outliers": "keep", "align": "none"}
    for flag, value in {found.remedy for found in findings}:
        name, option = options[flag]
        asked[name] = option.parsed(value)
    return read_recording(path, **asked).record


CODES = ("clipped", "stuck_sensor", "held_signal", "outliers", "quantised", "missing_samples")


def test_each_fault_has_a_test_here():
    assert {fault.code for fault in FAULTS} == {acted.code for acted in ACTED.values()}


@pytest.mark.no_finding(*CODES, "copied_signal", "constant_signal", "hum")
@pytest.mark.parametrize("seed", range(8))
def test_a_sound_record_shows_none(seed):
    assert checked(sound(seed)) == []


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.001, 0.01, 0.05])
@pytest.mark.parametrize("name", MACHINES)
def test_sound_machines_show_none(name, noise):
    for seed in range(3):
        assert checked(recorded(MACHINES[name], None, "severe", seed, noise)[0][1]) == []


@pytest.mark.raises_finding("held_signal")
@pytest.mark.parametrize("every", [2, 5, 8, 16])
def test_a_message_in_fast_rows_is_told_with_how_seldom_it_comes(every):
    signals = sound()
    (finding,) = checked(signals | {"u": np.repeat(signals["u"][::every], every)})
    assert finding.remedy == ("--every", f"{every}")
    assert f"each value for {every} samples" in finding.message
    assert f"it is {STEP * (every - 1):.4g} s old" in finding.message


@pytest.mark.no_finding("held_signal", "stuck_sensor")
@pytest.mark.parametrize("case", JOINT_SENSORS)
def test_an_axis_that_sticks_is_neither_stuck_nor_held(case):
    record = joint_record(joint(3, Shape(10_001, 500)), case, 3)
    found = {f.code for f in check_signals(record, record.arrays)}
    assert not found & {"held_signal", "stuck_sensor", "clipped"}


@pytest.mark.no_finding("held_signal")
@pytest.mark.parametrize("speed", [0.05, 0.1, 0.24])
def test_an_encoder_at_an_even_speed_is_not_held(speed):
    signals = sound() | {"u": np.round(speed * np.arange(COUNT))}
    assert "held_signal" not in {f.code for f in checked(signals)}


@pytest.mark.no_finding("held_signal")
def test_steps_of_a_command_are_not_held():
    steps = np.repeat(np.random.default_rng(0).normal(size=COUNT // 20), 20)
    assert "held_signal" not in {f.code for f in checked(sound() | {"u": steps})}


@pytest.mark.parametrize(
    ("name", "seed"),
    [
        pytest.param(name, seed, marks=pytest.mark.raises_finding(acted.code))
        for name, acted in ACTED.items()
        for seed in range(3)
    ],
)
def test_a_fault_is_named_alone_and_its_remedy_undoes_it(name, seed, tmp_path):
    acted, signals = ACTED[name], sound(seed)
    faulty = signals | {"u": acted.act(signals["u"], signals)}
    # A limit is told of at either end.
    findings = checked(faulty)
    assert {found.code for found in findings} == {acted.code}
    assert "u" in findings[0].signals
    assert findings[0].message.split()[0].rstrip(":,") in findings[0].signals
    (option,) = (fault.option for fault in FAULTS if fault.code == acted.code)
    assert option == next(iter(findings[0].remedy), "")
    assert bool(option) == bool(findings[0].doubt) or acted.code == "copied_signal"
    if not option:
        return
    record = mended(tmp_path / "a.csv", faulty, findings)
    after = [f.code for f in check_signals(record, faulty, pairs=PAIRS)]
    left = record.signal("u").with_nan
    if option == "--leave-out":
        # Samples that say something else than the motion are gone, and no other.
        assert after == ["missing_samples"]
        changed = np.flatnonzero(faulty["u"] != signals["u"])
        assert {*changed} <= {*np.flatnonzero(np.isnan(left))}
        assert np.isnan(left).sum() <= changed.size + len(HOLES)
        return
    assert after == []
    if option == "--every":
        times = np.rint(np.asarray(record.elapsed) / STEP).astype(int)
        np.testing.assert_array_equal(left, faulty["u"][times])
    else:
        np.testing.assert_allclose(left, signals["u"], atol=0.06 * signals["u"].std())


@pytest.mark.parametrize(("factor", "offset"), [(-1.0, 0.0), (1e-150, 0.0), (1e140, 0.0), (3, 7)])
@pytest.mark.parametrize("name", ACTED)
def test_unit_sign_and_offset_do_not_matter(name, factor, offset):
    signals = sound()
    u = ACTED[name].act(signals["u"], signals)
    changed = {"x": signals["x"], "v": signals["v"], "u": factor * u + offset * u[0]}
    assert {f.code for f in checked(changed)} == {ACTED[name].code}


@pytest.mark.parametrize("name", ACTED)
def test_a_gap_elsewhere_hides_no_fault(name):
    signals = sound()
    u = ACTED[name].act(signals["u"], signals)
    u[2000:2020] = np.nan
    found = {f.code for f in checked(signals | {"u": u})}
    assert found == {ACTED[name].code, "missing_samples"}
