"""Recorded derivatives that are late, off in size or zero, filtered, or of another clock.

The motion is a sum of sines, so that its derivative at any time, and what a first-order filter
makes of it, are exact.
"""

import itertools
import re

import numpy as np
import pytest

from riecjax.findings import Finding
from riecjax.records.consistency import check_derivatives
from riecjax.records.derived import derived
from riecjax.records.faults.derivative_pairs import Course, Pair, compare_pair
from riecjax.records.noise import Noise
from riecjax.records.preparation.alignment import set_clocks, shift
from riecjax.records.record import Record

STEP, COUNT = 0.005, 6000
PAIR_CODES = ("late_signal", "low_passed", "wrong_gain", "velocity_offset", "drifting_signal")
COURSE_CODES = ("lost_rows", "two_clocks")
NOISE = (0.0, 0.01, 0.05)


class Motion:
    """Thirty random tones up to `highest` in Hz."""

    def __init__(self, seed: int = 0, highest: float = 4.0):
        rng = np.random.default_rng(seed)
        self.omega = 2 * np.pi * rng.uniform(0.1, highest, 30)
        self.waves = rng.normal(size=30) / self.omega * np.exp(2j * np.pi * rng.uniform(size=30))

    def at(self, time: np.ndarray, order: int = 0, lag: float = 0.0) -> np.ndarray:
        """The motion or a derivative of it, behind a low-pass with this time constant."""
        waves = self.waves * (1j * self.omega) ** order / (1 + 1j * self.omega * lag)
        return np.real(np.exp(1j * np.outer(time, self.omega)) @ waves)


def recorded(
    motion: Motion,
    noise: float = 0.01,
    seed: int = 0,
    *,
    delay: float = 0.0,
    count: int = COUNT,
    lags: tuple[float, float] = (0.0, 0.0),
    gain: float = 1.0,
    offset: float = 0.0,
    drift: float = 0.0,
    x_at: np.ndarray | None = None,
    v_at: np.ndarray | None = None,
) -> Record:
    """A record with the faults asked for; delays and lags in samples, offsets in rms of v."""
    time = STEP * np.arange(count)
    x = motion.at(time if x_at is None else x_at, lag=STEP * lags[0])
    v = motion.at((time if v_at is None else v_at) - STEP * delay, 1, lag=STEP * lags[1])
    rms, rng = v.std(), np.random.default_rng(100 + seed)
    v = gain * v + rms * (offset + drift * (np.arange(count) / count - 0.5))
    x = 3 + x + noise * x.std() * rng.normal(size=count)
    return Record.from_samples(
        {"x": x, "v": v + noise * rms * rng.normal(size=count)}, time_step=STEP
    )


def compared(record: Record) -> Pair:
    pair = compare_pair(record, "x", "v")
    assert pair is not None
    return pair


def only(record: Record) -> Finding:
    (found,) = check_derivatives(record, [("x", "v")])
    return found


@pytest.mark.parametrize("noise", NOISE)
@pytest.mark.no_finding(*PAIR_CODES, *COURSE_CODES, "not_its_derivative")
def test_what_fits_raises_no_alarm(noise):
    for seed, highest, count in itertools.product(range(4), (0.7, 4.0, 30.0), (200, 1500)):
        record = recorded(Motion(seed, highest), noise, seed, count=count)
        assert check_derivatives(record, [("x", "v")]) == []


@pytest.mark.slow
@pytest.mark.parametrize("noise", NOISE)
def test_two_hundred_sound_recordings_raise_no_alarm(noise):
    for seed in range(200):
        assert check_derivatives(recorded(Motion(seed), noise, seed), [("x", "v")]) == []


@pytest.mark.parametrize(("noise", "within"), [(0.0, 1e-4), (0.01, 0.05), (0.05, 0.25)])
@pytest.mark.parametrize("delay", [-1.7, 0.3, 1.0, 12.4])
def test_a_delay_is_found_to_a_part_of_a_sample(noise, within, delay):
    pair = compared(recorded(Motion(1), noise, delay=delay))
    assert pair.fit.delay == pytest.approx(delay, abs=within)
    assert pair.fit.gain == pytest.approx(1, abs=0.01)
    assert pair.is_late
    assert not pair.lagged


def test_errors_are_what_delays_and_gains_scatter_by():
    pairs = [compared(recorded(Motion(2), 0.05, seed, delay=0.4, count=2000)) for seed in range(40)]
    for values, truth, which in (
        ([pair.fit.delay for pair in pairs], 0.4, 0),
        ([pair.fit.gain for pair in pairs], 1.0, 1),
        ([pair.fit.offset for pair in pairs], 0.0, 2),
    ):
        errors = np.array([pair.fit.errors[which] for pair in pairs])
        scores = (np.array(values) - truth) / errors
        assert 0.7 < np.sqrt(np.mean(scores**2)) < 1.3
        assert abs(np.mean(scores)) < 0.5


@pytest.mark.raises_finding("late_signal")
@pytest.mark.parametrize(("delay", "late", "other"), [(1.0, "v", "x"), (-1.0, "x", "v")])
def test_the_later_one_is_named_and_brought_forward(delay, late, other):
    found = only(recorded(Motion(3), delay=delay))
    assert found.code == "late_signal"
    assert found.signals == (late,)
    assert f"late against {other}" in found.message
    option, advance = found.remedy
    name, _, seconds = advance.partition("=")
    assert (option, name) == ("--shift", late)
    assert float(seconds) == pytest.approx(STEP, rel=0.05)
    assert 0 < found.doubt < 0.2


@pytest.mark.raises_finding("low_passed")
@pytest.mark.parametrize("noise", [0.0, 0.01])
@pytest.mark.parametrize(("lags", "late"), [((0.0, 4.0), "v"), ((4.0, 0.0), "x")])
def test_a_filter_is_told_from_a_delay(noise, lags, late):
    record = recorded(Motion(4, highest=8.0), noise, lags=lags)
    assert abs(compared(record).fit.lag) == pytest.approx(4, abs=0.1)
    found = only(record)
    assert found.code == "low_passed"
    assert found.message.startswith(late)
    assert found.remedy[1].startswith(f"{late}=0.0")


@pytest.mark.raises_finding("wrong_gain")
@pytest.mark.no_finding("late_signal", "velocity_offset", "drifting_signal", *COURSE_CODES)
@pytest.mark.parametrize("noise", NOISE)
@pytest.mark.parametrize("gain", [0.98, 1.02, 1.08])
def test_gains_from_two_percent_on(noise, gain):
    found = only(recorded(Motion(5), noise, gain=gain))
    assert found.code == "wrong_gain"
    assert float(found.remedy[1].partition("=")[2]) == pytest.approx(1 / gain, abs=0.005)


@pytest.mark.raises_finding("velocity_offset", "drifting_signal")
@pytest.mark.no_finding("late_signal", "wrong_gain", "low_passed", *COURSE_CODES)
@pytest.mark.parametrize("noise", NOISE)
def test_offsets_and_drifts(noise):
    offset = recorded(Motion(6), noise, offset=0.02)
    assert only(offset).code == "velocity_offset"
    rms = Motion(6).at(STEP * np.arange(COUNT), 1).std()
    assert compared(offset).offset == pytest.approx(0.02 * rms, rel=0.3)
    drift = recorded(Motion(6), noise, drift=-0.05)
    assert only(drift).code == "drifting_signal"
    assert compared(drift).drift == pytest.approx(-0.05 * rms, rel=0.3)
    for record in (offset, drift):
        option, formula = only(record).remedy
        columns = {"v": np.asarray(record["v"]), "t": np.asarray(record.time)}
        mended = derived(formula.removeprefix("v="), columns)
        assert option == "--derive"
        off = mended - np.asarray(recorded(Motion(6), noise)["v"])
        assert np.abs(off).max() < 0.004 * rms


@pytest.mark.raises_finding("drifting_signal")
def test_the_drift_of_a_later_part_is_taken_off_at_its_rate():
    whole = recorded(Motion(6), 0.01, drift=-0.2)
    part = whole.part(COUNT // 2, COUNT)
    option, formula = only(part).remedy
    assert option == "--derive"
    columns = {"v": np.asarray(part["v"]), "t": np.asarray(part.time)}
    off = derived(formula.removeprefix("v="), columns) - np.asarray(
        recorded(Motion(6), 0.01).part(COUNT // 2, COUNT)["v"]
    )
    rms = Motion(6).at(STEP * np.arange(COUNT), 1).std()
    assert np.abs(off).max() < 0.02 * rms
    assert f"over {float(part.elapsed[-1] - part.elapsed[0]):.4g} s" in only(part).message


@pytest.mark.raises_finding("lost_rows")
@pytest.mark.no_finding("late_signal", "two_clocks", "wrong_gain")
@pytest.mark.parametrize(("lost", "whose"), [(1, "v"), (5, "v"), (3, "x")])
def test_rows_lost_from_one_channel(lost, whose):
    kept = np.delete(np.arange(COUNT + lost), np.arange(2600, 2600 + lost)) * STEP
    record = recorded(Motion(7), v_at=kept) if whose == "v" else recorded(Motion(7), x_at=kept)
    found = only(record)
    assert found.code == "lost_rows"
    assert f"samples: {whose} has lost" in found.message.replace(" s: ", " samples: ")
    course = compared(record).course
    assert abs(course.change) == pytest.approx(lost, abs=0.15)
    assert course.place[0] <= 2600 <= course.place[1]
    option, seconds = found.remedy
    assert option == "--to"
    assert 10.0 < float(seconds) <= 2600 * STEP


@pytest.mark.raises_finding("two_clocks")
@pytest.mark.no_finding("late_signal", "lost_rows", "wrong_gain")
def test_clocks_that_differ():
    slow = STEP * np.arange(COUNT) * (1 - 100e-6)
    record = recorded(Motion(8), v_at=slow)
    found = only(record)
    assert found.code == "two_clocks"
    assert compared(record).course.change == pytest.approx(0.6, abs=0.15)
    option, clock = found.remedy[-2:]
    assert option == "--clock"
    name, ppm = clock.split("=")
    assert (name, float(ppm)) == ("v", pytest.approx(100, rel=0.25))


@pytest.mark.raises_finding("two_clocks")
def test_what_parted_early_is_advanced_as_well():
    slow = STEP * (np.arange(COUNT) * (1 - 200e-6) - 2.0)
    record = recorded(Motion(8), v_at=slow)
    shift_, seconds, clock, ppm = only(record).remedy
    assert (shift_, clock) == ("--shift", "--clock")
    late = {name: float(value) for name, value in (seconds.split("="),)}
    mended = set_clocks(shift(record, late), {"v": float(ppm.removeprefix("v="))})
    assert compared(mended).course.kind == "steady"
    assert abs(compared(mended).fit.delay) < 0.1


def test_clocks_count_from_the_recordings_first_sample():
    course = Course("clocks", 4.0, 0.01, (0, 4000), 2.02)
    # Of 1000 ppm, 10 s after the recording began: all of the delay there is the clock's.
    assert course.by_one_clock(["v"], 1000.0, 0.005, 10.0) == ("--clock", "v=1000")
    assert course.by_one_clock(["v"], 1000.0, 0.005, 0.0)[:2] == ("--shift", "v=0.0101")


@pytest.mark.raises_finding("two_clocks")
def test_a_clock_that_runs_fast_gets_ahead_and_either_may_be_off():
    fast = STEP * np.arange(COUNT) * (1 + 200e-6)
    found = only(recorded(Motion(8), v_at=fast))
    assert "v gets ahead of x evenly" in found.message
    other = float(re.findall(r"--clock x=([\d.]+)", found.message)[0])
    assert other == pytest.approx(200, rel=0.15)


def test_gaps_and_spikes_hide_no_delay():
    record = recorded(Motion(9), delay=0.5)
    x, v = (np.array(record[name]) for name in "xv")
    x[::97] = np.nan
    v[1000:1300] = np.nan
    v[[50, 3000, 3001]] = 1e9, -1e300, -1e300
    x[4000] = 1e15
    holed = Record.from_samples({"x": x, "v": v}, time_step=STEP)
    assert compared(holed).fit.delay == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize(
    ("x", "v"),
    [
        (np.ones(500), np.zeros(500)),
        (np.r_[np.full(400, np.nan), np.ones(100)], np.ones(500)),
        (1e300 * np.sin(0.1 * np.arange(500)), 1e300 * np.cos(0.1 * np.arange(500))),
        (1e-300 * np.sin(0.1 * np.arange(500)), 1e-300 * np.cos(0.1 * np.arange(500))),
        (np.sin(0.1 * np.arange(500)), np.full(500, 1e308)),
        (np.arange(20.0), np.ones(20)),
        (np.arange(500.0), np.ones(500)),
    ],
)
def test_nothing_breaks_it(x, v):
    check_derivatives(
        Record.from_samples({"x": x, "v": v}, time_step=STEP), [("x", "v"), ("v", "x")]
    )


def test_what_was_computed_from_the_signal_is_not_compared():
    record = recorded(Motion(3), delay=1.0)
    one = Noise({"x": {"x": np.ones(1)}, "v": {"x": np.array([0.5, 0.0, -0.5])}})
    assert check_derivatives(record.with_noise(one), [("x", "v")]) == []
