"""Files that hold several recordings: which these are, and how one is chosen."""

import h5py
import numpy as np
import pytest
import scipy.io

import riecjax as rx
from riecjax.errors import DataError
from riecjax.records.reading.channels import Channels
from riecjax.records.reading.selection import recordings_in

TIME = np.arange(80) * 0.05
RUNS = [
    {"t": TIME[:n], "x": k * np.sin(TIME[:n]), "F": np.cos(3 * TIME[:n])}
    for k, n in ((1, 80), (2, 50), (3, 70))
]


def as_structures(path):
    kind = [(name, object) for name in RUNS[0]]
    runs = np.array([tuple(run.values()) for run in RUNS], dtype=kind)
    scipy.io.savemat(path, {"runs": runs, "remark": "a Tuesday"})


def as_numbered_structures(path):
    scipy.io.savemat(path, {f"run{i + 1}": run for i, run in enumerate(RUNS)})


MADE = {
    "array of structures": (as_structures, ["runs(1)", "runs(2)", "runs(3)"]),
    "numbered structures": (as_numbered_structures, ["run1", "run2", "run3"]),
}


@pytest.mark.parametrize("case", MADE)
def test_matlab_files_with_several_recordings(tmp_path, case):
    write, ends = MADE[case]
    write(tmp_path / "a.mat")
    read = rx.read_recordings(tmp_path / "a.mat")
    assert [one.part.endswith(end) for one, end in zip(read, ends, strict=True)] == [True] * 3
    for one, run in zip(read, RUNS, strict=True):
        np.testing.assert_allclose(one.record["x"], run["x"], rtol=1e-15)
        np.testing.assert_allclose(one.record["F"], run["F"], rtol=1e-15)
    alone = rx.read_record(tmp_path / "a.mat", part=read[1].part)
    np.testing.assert_array_equal(alone["x"], read[1].record["x"])
    with pytest.raises(DataError, match=r"^a\.mat: it holds 3 recordings: .*--part NAME"):
        rx.read_record(tmp_path / "a.mat")
    with pytest.raises(DataError, match=r"there is no part 'run9'; there are: "):
        rx.read_record(tmp_path / "a.mat", part="run9")


def test_groups_stand_in_the_order_of_their_numbers(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for i in range(1, 12):
            for name, values in RUNS[i % 3].items():
                file[f"run{i}/{name}"] = values + (i if name == "x" else 0)
    read = rx.read_recordings(tmp_path / "a.h5")
    assert [one.part for one in read] == [f"run{i}" for i in range(1, 12)]
    np.testing.assert_allclose(read[9].record["x"], RUNS[1]["x"] + 10)


@pytest.mark.raises_finding("part_left_out")
def test_a_broken_part_is_left_out_and_said(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for i, run in enumerate(RUNS):
            for name, values in run.items():
                if (i, name) != (1, "F"):
                    file[f"run{i + 1}/{name}"] = values
    read = rx.read_recordings(tmp_path / "a.h5")
    assert [one.part for one in read] == ["run1", "run3"]
    (said,) = [f for f in read[0].findings if f.code == "part_left_out"]
    assert said.message == "a.h5: part 'run2' is left out: it lacks F."


def sensors():
    """Channels of one recording whose names look like parts."""
    # Simulink's structures with time, one for each signal.
    scopes = {f"Scope{n}.{k}": TIME for n in (1, 2) for k in ("time", "signals.values")}
    yield Channels(scopes, nested=True)
    # Two sensors of other rates in one test.
    yield Channels(
        {"fast/time": TIME, "fast/x": TIME, "slow/time": TIME[::2], "slow/F": TIME[::2]},
        nested=True,
    )
    # Wheels of one car.
    wheels = {f"wheel{i}/{n}": TIME for i in (1, 2) for n in ("x", "v")}
    yield Channels({"time": TIME, **wheels}, nested=True)


@pytest.mark.parametrize("channels", list(sensors()))
def test_sensors_of_one_recording_are_no_parts(channels):
    assert recordings_in(channels).held == {"": channels}
