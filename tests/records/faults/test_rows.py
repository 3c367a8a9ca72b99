"""Rows that stand twice, columns that are copies, and rows that are gone."""

import numpy as np
import pytest
from tests.machines import drag_signals as signals

import riecjax as rx
from riecjax.doubts.kinematics import check_kinematics
from riecjax.doubts.reading import align
from riecjax.records import check_signals
from riecjax.records.faults.rows import (
    Repetition,
    cut_rows,
    duplicates,
    refuse_duplicates,
    repetitions,
    without_repetitions,
)
from riecjax.records.record import Record
from riecjax.records.recording import Recording
from riecjax.records.relations import relations

TIME = np.arange(4000) / 200
RNG = np.random.default_rng(3)
X = np.sin(2 * np.pi * 1.7 * TIME) + 0.4 * np.sin(2 * np.pi * 4.1 * TIME + 1)
V = np.gradient(X, TIME)
NOISE = RNG.normal(size=(2, TIME.size))


def copies_in(**signals: np.ndarray) -> list[rx.Finding]:
    record = rx.Record.from_samples(signals, time_step=1 / 200)
    return [f for f in check_signals(record, signals) if f.code == "copied_signal"]


def gappy(values: np.ndarray) -> np.ndarray:
    values = values.copy()
    values[500:700] = np.nan
    return values


@pytest.mark.raises_finding("copied_signal")
@pytest.mark.parametrize(
    "copy",
    [
        lambda x: x,
        lambda x: -35.15 * x,
        lambda x: 1e-300 * x,
        lambda x: 1e300 * x / np.max(np.abs(x)),
        lambda x: 2.5 * x + 70,
        lambda x: np.round(x / x.std(), 3),
        lambda x: x.astype(np.float32).astype(float),
        gappy,
    ],
    ids=["same", "multiple", "tiny", "huge", "offset", "rounded", "single precision", "gap"],
)
@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_a_copy_in_any_unit_and_rounding(copy, noise):
    x = X + noise * NOISE[0]
    (one,) = copies_in(x=x, v=V + 0.01 * NOISE[1], u=copy(x))
    assert one.signals == ("x", "u")
    assert one.doubt == 1


@pytest.mark.no_finding("copied_signal")
@pytest.mark.parametrize("noise", [1e-3, 0.01, 0.05])
def test_two_sensors_of_one_motion_are_no_copies(noise):
    assert not copies_in(x=X + noise * NOISE[0], y=3 * X + 3 * noise * NOISE[1])


@pytest.mark.no_finding("copied_signal")
@pytest.mark.parametrize("damping", [1e-4, 1e-5, 1e-6])
def test_a_slow_force_of_a_spring_is_no_copy(damping):
    assert not copies_in(x=X, v=V, u=40 * X + 40 * damping * V)


MODEL = rx.Equation(
    rx.Term("m", "x", derivative=2, measured=("v",)),
    rx.Term("c", "x", derivative=1, measured=("v",)),
    rx.Term("k", "x"),
    -rx.Term(1.0, "u"),
)


@pytest.mark.slow
def test_a_refusal_names_the_copy_that_is_why():
    record = rx.Record.from_samples({"x": X, "v": X, "u": NOISE[0].cumsum()}, time_step=1 / 200)
    checked = rx.check(MODEL, record, rx.RIEC(rx.AllWindows(0.1, 1.0)))
    assert checked.refusal is not None
    assert (checked.refusal.code, checked.refusal.signals) == ("copied_signal", ("x", "v"))
    with pytest.raises(rx.IdentifiabilityError, match="v holds the samples of x") as refused:
        rx.assess(MODEL, record, rx.RIEC(rx.AllWindows(0.1, 1.0)), refine=None)
    assert refused.value.code == "copied_signal"


def columns(seed: int = 0, noise: float = 0.01) -> np.ndarray:
    return np.stack(list(signals(seed, noise).values()), axis=1)


@pytest.mark.raises_finding("repeated_rows")
@pytest.mark.parametrize("lag", [40, 300])
def test_the_second_copy_counts_as_missing(lag):
    rows = columns()
    rows[800:840] = rows[800 - lag : 840 - lag]
    assert repetitions([*rows.T]) == [Repetition(800 - lag, 800, 40)]
    record = Record.from_samples(dict(zip("uxv", rows.T)), time_step=0.01)
    left, (found,) = without_repetitions(record)
    assert "from 8 s on, for 0.4 s" in found.message
    for name in "uxv":
        np.testing.assert_array_equal(
            np.flatnonzero(np.isnan(left.signal(name).with_nan)), np.arange(800, 840)
        )


def test_missing_samples_are_rows_of_their_own():
    rows = columns()
    rows[[5, 700]], rows[701] = np.nan, 0.0
    assert repetitions([*rows.T]) == []


def test_rows_that_were_written_in_between_move_the_others():
    rows = columns()
    rows = np.concatenate([rows[:900], rows[850:900], rows[900:]])
    assert repetitions([*rows.T]) == [Repetition(850, 900, 50)]


@pytest.mark.no_finding("repeated_rows")
@pytest.mark.parametrize(
    "rows",
    [
        columns(),
        columns(1, 0.0),
        np.round(columns(), 2),
        np.tile(columns()[:500], (4, 1)),
        np.zeros((2000, 3)),
        np.repeat(columns()[:700], 3, axis=0),
        np.where(np.arange(2000)[:, None] > 1200, 0.0, columns()[:2000]),
        np.sin(2 * np.pi * np.arange(2000) / 100)[:, None],
        np.full((100, 2), np.nan),
    ],
)
def test_motions_rest_and_periods_are_none(rows):
    record = Record.from_samples(
        {f"s{i}": c for i, c in enumerate(np.nan_to_num(rows).T)}, time_step=0.01
    )
    assert without_repetitions(record) == (record, [])
    assert repetitions([*rows.T]) == []


def samples(seed: int, count: int = 4000, noise: float = 0.01) -> dict[str, np.ndarray]:
    """The same force each time, and a motion with its own noise, as of repeated runs."""
    t = np.arange(count) / 200
    rng = np.random.default_rng(seed)
    tones = np.arange(1, 12) * 0.37
    return {
        "x": np.sum(np.sin(np.outer(tones, 2 * np.pi * t + 1)), 0) + noise * rng.normal(size=count),
        "u": np.sum(np.cos(np.outer(tones, 2 * np.pi * t + 2)), 0),
    }


def recording(columns: dict[str, np.ndarray], name: str = "a.csv", start: float = 0.0) -> Recording:
    time = start + np.arange(len(columns["x"])) / 200
    return Recording(rx.Record.from_samples(columns, time=time), name)


def cut(columns, part):
    return {name: values[part] for name, values in columns.items()}


A = samples(1)
COPIES = {
    "whole": A,
    "rounded": {name: np.round(v / v.std(), 3) * v.std() for name, v in A.items()},
    "part": cut(A, slice(700, 1500)),
    "begins later": cut(A, slice(1900, 4000)),
    "single precision": {name: np.float32(values).astype(float) for name, values in A.items()},
    "a few samples changed": {
        name: np.where(np.arange(4000) % 500 == 3, 0, v) for name, v in A.items()
    },
}


@pytest.mark.raises_finding("duplicate_recording")
@pytest.mark.parametrize("kind", COPIES)
@pytest.mark.parametrize("swapped", [False, True])
def test_a_recording_given_twice(kind, swapped):
    both = [recording(A), recording(samples(2), "c.csv"), recording(COPIES[kind], "b.csv", 1e9)]
    (found,) = duplicates(both[::-1] if swapped else both)
    assert "b.csv" in found.message
    assert "a.csv" in found.message
    assert "c.csv" not in found.message
    with pytest.raises(rx.DataError, match="--allow-duplicates") as refused:
        refuse_duplicates(both)
    assert refused.value.code == "duplicate_recording"


def test_recordings_that_overlap_say_where():
    first, second = cut(A, slice(0, 3000)), cut(A, slice(2000, 4000))
    (found,) = duplicates([recording(first), recording(second, "b.csv")])
    assert found.message.startswith("5 s of b.csv, from 0 s on, are those of a.csv from 10 s on")


@pytest.mark.no_finding("duplicate_recording")
@pytest.mark.parametrize("noise", [2e-3, 0.01, 0.05])
def test_repeated_runs_of_one_force_are_none(noise):
    runs = [recording(samples(seed, noise=noise), f"{seed}.csv") for seed in range(8)]
    assert duplicates(runs) == []


@pytest.mark.no_finding("duplicate_recording")
def test_steps_rest_and_huge_values_are_none():
    step = np.repeat([0.0, 1.0], 2000)
    rng = np.random.default_rng(0)
    runs = [{"x": 1e300 * step, "u": step + 0.1 * rng.normal(size=4000)} for _ in range(3)]
    assert duplicates([recording(run) for run in runs]) == []


RATE, COUNT, AT = 200, 6000, 2400


def tones(seed: int, noise: float = 0.01) -> dict[str, np.ndarray]:
    """Thirty tones up to 4 Hz, and their exact derivative."""
    rng = np.random.default_rng(seed)
    time = np.arange(COUNT + 400) / RATE
    omega = 2 * np.pi * rng.uniform(0.2, 4, 30)
    phase = rng.uniform(0, 2 * np.pi, 30)
    angle = omega[:, None] * time + phase[:, None]
    found = {"x": np.sin(angle).sum(0), "v": (omega[:, None] * np.cos(angle)).sum(0)}
    return {n: s + noise * np.std(s) * rng.standard_normal(s.size) for n, s in found.items()}


def cut_at(columns: dict[str, np.ndarray], lost: int = 0) -> Record:
    kept = {n: np.delete(s, slice(AT, AT + lost))[:COUNT] for n, s in columns.items()}
    return Record.from_samples(kept, time_step=1 / RATE)


@pytest.mark.raises_finding("lost_rows")
@pytest.mark.parametrize("seed", [9, 14])
def test_lost_rows_are_not_taken_for_a_delay(seed):
    gone = cut_at(tones(seed, 0.0), 100)
    (relation,) = relations([("x", "v")])
    assert [finding.code for finding in check_kinematics(gone, [relation])] == ["lost_rows"]
    assert align(gone, [relation]).record is gone


@pytest.mark.no_finding("lost_rows")
@pytest.mark.parametrize("noise", [0.0, 0.01, 0.05])
def test_whole_records_show_none(noise):
    assert not [s for s in range(60) if cut_rows(cut_at(tones(s, noise)), "x", "v")]


@pytest.mark.no_finding("lost_rows")
def test_gaps_so_near_that_no_two_sides_fit_between_them_are_no_jump():
    columns = tones(1)
    columns["x"][::30] = np.nan
    assert cut_rows(cut_at(columns), "x", "v") is None
