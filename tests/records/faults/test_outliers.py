"""Spikes found against the noise, and their repair, on motions of known truth."""

import numpy as np
import pytest
from tests.machines import drag_signals as signals

from riecjax.doubts.reading import read_recording
from riecjax.errors import DataError
from riecjax.estimation.identify import identify
from riecjax.models.oscillators import drag_oscillator_equation
from riecjax.records.faults.signals import check_signals
from riecjax.records.faults.spikes import find_spikes, repair_outliers
from riecjax.records.record import Record

CLEAN = signals()
NAMES = ("x", "dx")


def noisy(seed: int, noise: float) -> dict[str, np.ndarray]:
    return {name: values.copy() for name, values in signals(seed, noise).items()}


def size_of(noise: float, name: str) -> float:
    return noise * CLEAN[name].std()


def spiked(values: np.ndarray, size: float, seed: int, share: float = 0.01):
    """With spikes of a size and either sign on a share of the samples; and where."""
    rng = np.random.default_rng(1000 + seed)
    inside = np.arange(8, values.size - 8)
    where = np.sort(rng.choice(inside, round(share * values.size), replace=False))
    values = values.copy()
    values[where] += size * rng.choice([-1, 1], where.size)
    return values, where


@pytest.mark.parametrize("height", [20, 100, 1e6, 1e300])
@pytest.mark.parametrize("noise", [0.01, 0.05])
def test_all_are_found_none_is_false_and_the_repair_is_as_good_as_a_sample(noise, height):
    errors = []
    for seed in range(3):
        for name in NAMES:
            values, where = spiked(
                noisy(seed, noise)[name],
                height * size_of(noise, name) if height < 1e300 else 1e300,
                seed,
            )
            found = find_spikes(values)
            np.testing.assert_array_equal(found.places, where)
            errors.append((found.repaired - CLEAN[name][where]) / size_of(noise, name))
    # A cubic through 16 samples has 0.37 of their noise in its middle.
    assert 0.25 < np.std(np.concatenate(errors)) < 0.5


def test_groups_of_up_to_three_count_and_longer_ones_do_not():
    size = 30 * size_of(0.01, "x")
    for length in (1, 2, 3, 5, 8):
        values = noisy(0, 0.01)["x"]
        values[500 : 500 + length] += size
        expected = np.arange(500, 500 + length) if length <= 3 else []
        np.testing.assert_array_equal(find_spikes(values).places, expected)


@pytest.mark.parametrize("at", [0, 989, 1010, 2000])
def test_the_last_sample_before_an_end_or_a_gap_is_held_against_those_on_its_one_side(at):
    found = []
    for seed in range(20):
        values = noisy(seed, 0.05)["x"]
        values[990:1010] = np.nan
        values[at] += (-1) ** seed * 30 * size_of(0.05, "x")
        found.extend(find_spikes(values).places)
    assert set(found) == {at}
    assert len(found) >= 16


def test_where_the_noise_changes_each_spike_is_held_against_its_own():
    rng = np.random.default_rng(0)
    noise = np.where(np.arange(4000) < 2000, 0.001, 0.02)
    values = np.sin(np.arange(4000) / 60) + noise * rng.normal(size=4000)
    values[[400, 1100, 2500, 3300]] += np.array([0.02, 0.02, 0.02, 0.4])
    np.testing.assert_array_equal(find_spikes(values).places, [400, 1100, 3300])


@pytest.mark.raises_finding("outliers")
def test_a_record_is_told_of_and_repaired():
    values, where = spiked(noisy(0, 0.05)["x"], 20 * size_of(0.05, "x"), 0)
    record = Record.from_samples(noisy(0, 0.05) | {"x": values}, time_step=0.01, units={"x": "m"})
    (finding,) = check_signals(record, ["x", "dx"])
    assert finding.signals == ("x",)
    assert finding.message.startswith(f"x: {where.size} samples are spikes (1 %)")
    assert f"at {', '.join(f'{place / 100:.6g}' for place in where[:3])} s and 17 more" in (
        finding.message
    )
    energy = where.size * (20 * 0.05) ** 2 / values.size
    assert finding.doubt == pytest.approx(energy / (1 + energy), rel=0.1)
    assert finding.remedy == ("--outliers", "repair")
    repaired = repair_outliers(record)
    assert check_signals(repaired, ["x", "dx"]) == []
    assert np.max(np.abs(repaired["x"] - CLEAN["x"])) < 5 * size_of(0.05, "x")
    missing = repair_outliers(record, "x", how="missing")
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(missing.signal("x").with_nan)), where)
    assert repair_outliers(record, how="keep") is record
    with pytest.raises(DataError, match="got 'drop'"):
        repair_outliers(record, how="drop")  # pyright: ignore


def test_more_than_a_twentieth_is_a_fault_and_stays():
    values, _ = spiked(noisy(0, 0.01)["x"], 50 * size_of(0.01, "x"), 0, share=0.08)
    record = Record.from_samples({"x": values}, time_step=0.01)
    (finding,) = check_signals(record, ["x"])
    assert "fault of the channel" in finding.message
    assert not finding.remedy
    assert repair_outliers(record) is record


def write(path, values: np.ndarray, time: np.ndarray):
    table = np.column_stack([time, values, noisy(1, 0.01)["dx"], CLEAN["u"]])
    np.savetxt(path, table, delimiter=",", header="t,x,dx,u", comments="")
    return path


def test_a_file_is_repaired_before_anything_is_made_of_it(tmp_path):
    values = noisy(0, 0.01)["x"]
    values[700] = 1e300
    # A pause, after which stamps count on.
    time = np.arange(values.size) / 100 + 5.0 * (np.arange(values.size) >= 300)
    file = write(tmp_path / "a.csv", values, time)
    read = read_recording(file, derive={"f": "2*x"})
    assert read.steps[1:3] == ("x: 1 outlier repaired", "f: 2*x")
    (finding,) = read.findings
    assert "at 12 s. A poly" in finding.message
    assert finding.signals == ("x", "f")
    assert finding.doubt == 0
    there = int(np.argmin(np.abs(read.record.elapsed - 12)))
    assert read.record["x"][there] == pytest.approx(CLEAN["x"][700], abs=3 * size_of(0.01, "x"))
    assert read.record["f"][there] == 2 * read.record["x"][there]
    assert float(read.record.noise.std("x")) == pytest.approx(size_of(0.01, "x"), rel=0.1)
    kept = read_recording(file, outliers="keep")
    assert kept.record["x"][there] == 1e300
    with pytest.raises(DataError, match=r"a.csv: x is 1e\+300 at 12 s, .*--outliers repair"):
        identify(drag_oscillator_equation(), kept)
    missing = read_recording(file, outliers="missing").record
    np.testing.assert_array_equal(
        np.flatnonzero(np.isnan(missing.signal("x").with_nan)), [300, there]
    )
    even = read_recording(write(tmp_path / "b.csv", values, time), resample=50.0)
    assert float(np.max(np.abs(even.record["x"]))) < 2 * np.max(np.abs(CLEAN["x"]))
