"""What every step of preparation keeps to, whatever it does: gaps, pauses, time, other signals."""

import numpy as np
import pytest
from tests.doubts.test_alignment import motion

import riecjax as rx
from riecjax.records.faults.signals import leave_out
from riecjax.records.faults.spikes import repair_outliers
from riecjax.records.preparation.filtering import remove_line, unfilter, with_local_derivative
from riecjax.records.preparation.resampling import set_clocks, shift, upsample

STEP, COUNT = 0.005, 4000
TAU, PPM = 0.004, 500.0


STEPS = {
    "low_pass": (lambda r: rx.low_pass(r, {"q": 20.0}), 50, motion),
    "unfilter": (lambda r: unfilter(r, {"q": TAU}), 3, lambda t: motion(t) + TAU * motion(t, 1)),
    "remove_line": (
        lambda r: remove_line(r, {"q": 0.3}, {"q": 0.01}),
        0,
        lambda t: motion(t) - 0.3 - 0.01 * t,
    ),
    "shift": (lambda r: shift(r, {"q": 0.37 * STEP}), 1, lambda t: motion(t + 0.37 * STEP)),
    "shift back": (lambda r: shift(r, {"q": -2 * STEP}), 2, lambda t: motion(t - 2 * STEP)),
    "set_clocks": (lambda r: set_clocks(r, {"q": PPM}), 9, lambda t: motion(t + 1e-6 * PPM * t)),
    "upsample": (lambda r: upsample(r, 3), 44, motion),
    "resample": (lambda r: rx.resample(r, 173.3), 31, motion),
    "resample up": (lambda r: rx.resample(r, 333.3), 44, motion),
    "differentiate": (lambda r: rx.differentiate(r, "q", "v"), 0, lambda t: motion(t, 1)),
    "with_local_derivative": (
        lambda r: with_local_derivative(r, "q", "v")[0],
        3,
        lambda t: motion(t, 1),
    ),
    "repair_outliers": (repair_outliers, 0, motion),
    "leave_out": (lambda r: leave_out(r, "q"), 0, motion),
}
"""What a step does, samples that it loses beside an end or a gap, and what it makes of a motion."""


@pytest.mark.parametrize("pause", [0.0, 60.03])
@pytest.mark.parametrize("name", STEPS)
def test_a_step_works_within_stretches_and_keeps_time_and_other_signals(name, pause):
    apply, reach, expected = STEPS[name]
    time = STEP * np.arange(COUNT)
    time[1700:] += pause
    # Each stretch far above the one before: what came across would show.
    gone = slice(1700, 1700 if pause else 1703)
    level = np.where(np.arange(COUNT) < 1700, 0.0, 1e4)
    q = motion(time) + level
    q[gone] = np.nan
    made = apply(rx.Record.from_samples({"q": q, "p": time, "w": np.cos(9 * time)}, time=time))
    elapsed, signal = np.asarray(made.elapsed), "v" if "v" in made.arrays else "q"
    values = made.signal(signal).with_nan
    there, ends = ~np.isnan(values), (time[0], time[1699], time[gone.stop], time[-1])
    lost = reach * STEP + 1e-6
    inside = (elapsed >= ends[0] + lost) & (elapsed <= ends[1] - lost)
    inside |= (elapsed >= ends[2] + lost) & (elapsed <= ends[3] - lost)
    assert there[inside].all()
    assert elapsed[0] <= ends[0] + lost + STEP * 3
    assert elapsed[-1] >= ends[3] - lost - STEP * 3
    lifted = np.where(elapsed < time[gone.stop] - STEP, 0.0, 0.0 if signal == "v" else 1e4)
    # Differences err by w^2 h^2 / 3 at the ends, 0.05 of the fastest.
    atol = 0.1 if name == "differentiate" else 2e-3
    off = values - expected(elapsed) - lifted
    np.testing.assert_allclose(off[there], 0, atol=atol)
    np.testing.assert_allclose(made.time[0] - elapsed[0], 0, atol=1e-9)
    others = made.signal("p").with_nan
    np.testing.assert_allclose((others - elapsed)[~np.isnan(others)], 0, atol=1e-3)


@pytest.mark.parametrize("name", ["unfilter", "shift", "shift back", "set_clocks"])
def test_noise_goes_on_with_its_size(name):
    white = np.random.default_rng(0).normal(size=40_000)
    noisy = rx.Record({"q": white}, STEP).with_noise(rx.Noise.given({"q": 1.0}))
    made = STEPS[name][0](noisy)
    assert float(made.noise.std("q")) == pytest.approx(np.std(np.asarray(made["q"])), rel=0.04)


@pytest.mark.parametrize(("by", "period"), [(0.05, 20), (-0.4, 20), (0.5, 10), (2.7, 10)])
def test_a_shift_loses_what_it_advances_by_and_errs_little_at_the_ends(by, period):
    time = np.arange(3000) / period
    record = rx.Record({"q": np.sin(2 * np.pi * time + 0.3), "t": time}, STEP)
    for part in (record, record.part(0, 40)):
        shifted = shift(part, {"q": by * STEP})
        off = np.sin(2 * np.pi * (shifted["t"] + by / period) + 0.3) - shifted["q"]
        assert part.sample_count - shifted.sample_count == np.ceil(abs(by))
        assert np.max(np.abs(off)) < {10: 3e-3, 20: 1e-4}[period]
        assert np.max(np.abs(off[4:-4])) < {10: 3e-5, 20: 2e-7}[period]


SHORT = rx.Record.from_samples({"q": [0.0, 1.0, np.nan, 3.0, np.nan, 5.0]}, time_step=STEP)


@pytest.mark.parametrize("name", [n for n, (_, reach, _) in STEPS.items() if reach > 2])
def test_stretches_too_short_for_a_step_are_refused_in_one_line(name):
    with pytest.raises(rx.DataError, match=r"too short|long enough|half the record|in succession"):
        STEPS[name][0](SHORT)


@pytest.mark.parametrize(
    "apply",
    [
        *(
            apply
            for name, (apply, *_) in STEPS.items()
            if "sample" not in name and "repair" not in name
        ),
        lambda r: rx.remove_offset(r, "q"),
        lambda r: rx.remove_drift(r, "q"),
        lambda r: repair_outliers(r, "q"),
    ],
)
def test_a_signal_that_is_not_there_is_named(apply):
    with pytest.raises(rx.DataError, match="no signal 'q'"):
        apply(rx.Record({"p": motion(STEP * np.arange(COUNT))}, STEP))


@pytest.mark.parametrize("step", [rx.remove_offset, rx.remove_drift, leave_out])
def test_a_step_of_no_signal_lists_those_there_are(step):
    with pytest.raises(rx.DataError, match=r"name the signals.*there are: q"):
        step(SHORT)


@pytest.mark.parametrize("value", [0.0, -3.0, np.nan, np.inf, 1e9])
@pytest.mark.parametrize(
    ("apply", "match"),
    [
        (lambda r, v: rx.low_pass(r, {"q": v}), "between 0 and half the sampling rate"),
        (lambda r, v: unfilter(r, {"q": v}), "must be positive"),
        (lambda r, v: shift(r, {"q": v or 9.0}), "half the record"),
        (lambda r, v: set_clocks(r, {"q": 1e6 * (v or 1)}), "no clock"),
        (rx.resample, "positive number|would make"),
        (lambda r, v: upsample(r, min(v, 0.5)), "whole number"),  # pyright: ignore
    ],
)
def test_impossible_settings_are_refused(apply, match, value):
    with pytest.raises(rx.DataError, match=match):
        apply(rx.Record({"q": motion(STEP * np.arange(300))}, STEP), value)
