import numpy as np
import pytest

import riecjax as rx
from riecjax.records.faults import rows
from riecjax.records.faults.rows import duplicates, refuse_duplicates
from riecjax.records.recording import Recording


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


def test_others_signals_do_not_matter():
    only_x, only_u = ({name: A[name], "x": A["x"]} for name in "xu")
    assert len(duplicates([recording(only_x), recording({**only_u, "w": A["u"] + 1}, "b")])) == 1
    assert duplicates([recording({"x": A["x"]}), recording({"x": samples(4)["x"]}, "b")]) == []


def test_one_copy_among_two_hundred_is_sought_in_few_of_their_pairs(monkeypatch):
    looked_at = []
    in_common = rows._rows_in_common
    monkeypatch.setattr(
        rows, "_rows_in_common", lambda *given: looked_at.append(1) or in_common(*given)
    )
    runs = [recording(samples(seed, 600), f"{seed}.csv") for seed in range(200)]
    runs.append(recording(cut(samples(17, 600), slice(100, 400)), "copy.csv"))
    (found,) = duplicates(runs)
    assert found.message.startswith("all of copy.csv lies in 17.csv")
    assert len(looked_at) < len(runs) * (len(runs) - 1) / 6
