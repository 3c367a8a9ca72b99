import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from riecjax.errors import DataError
from riecjax.records.frames import from_dataframe, from_dataset

N = 30
TIME = np.arange(N) * 0.05
X = np.sin(TIME)
INDICES = {
    "float": pd.Index(TIME + 3.0, name="seconds"),
    "dates": pd.date_range("2024-05-01", periods=N, freq="50ms"),
    "dates with a zone": pd.date_range("2024-05-01", periods=N, freq="50ms", tz="Europe/Berlin"),
    "dates in ns": pd.date_range("2024-05-01", periods=N, freq="50ms", unit="ns", name="when"),
    "durations": pd.timedelta_range("3s", periods=N, freq="50ms"),
}


@pytest.mark.parametrize("case", INDICES)
def test_an_index_of_time(case):
    record = from_dataframe(pd.DataFrame({"x": X, "y": range(N)}, index=INDICES[case]))
    np.testing.assert_array_equal(record["x"], X)
    np.testing.assert_allclose(record.time_step, 0.05, rtol=1e-9)
    np.testing.assert_allclose(record.start_time, 0.0 if "dates" in case else 3.0)


@pytest.mark.parametrize("case", INDICES)
def test_a_column_of_time(case):
    frame = pd.DataFrame({"x": X, "clock": INDICES[case], "time": -TIME})
    record = from_dataframe(frame, time="clock")
    assert set(record.arrays) == {"x", "time"}
    np.testing.assert_allclose(record.time_step, 0.05, rtol=1e-9)
    record = from_dataframe(frame.rename(columns={"clock": "t"}))
    np.testing.assert_allclose(record.time_step, 0.05, rtol=1e-9)


def test_an_index_of_counts_is_no_time():
    frame = pd.DataFrame({"x": X, "y": 2 * X})
    with pytest.raises(DataError, match="no time column"):
        from_dataframe(frame)
    assert float(from_dataframe(frame, time_step=0.5).time_step) == 0.5


def test_frames_with_all_kinds_of_columns():
    frame = pd.DataFrame({"t": TIME, "x (mm)": 1e3 * X, "flag": [True] * N, "text": ["a"] * N})
    frame["count"] = pd.array([None, *range(N - 1)], dtype="Int64")
    frame["arrow"] = pd.array([*range(N - 1), None], dtype="Float64")
    record = from_dataframe(
        frame, rename={"x": "x (mm)"}, scale={"x": 1e-3}, derive={"y": "2 * x"}, units={"y": "m"}
    )
    assert set(record.arrays) == {"x", "flag", "count", "arrow", "y"}
    np.testing.assert_allclose(record["y"], 2 * X)
    assert np.flatnonzero(np.isnan(record.signal("count").with_nan)).tolist() == [0]
    assert np.flatnonzero(np.isnan(record.signal("arrow").with_nan)).tolist() == [N - 1]
    assert dict(record.units) == {"y": "m"}


def dataset(**options: object) -> xr.Dataset:
    return xr.Dataset(
        {
            "x": ("time", X, {"units": "m"}),
            "acc": (("axis", "time"), np.stack([X, 2 * X, 3 * X]), {"units": "m/s2"}),
            "mass": ((), 7.0),
            "remark": ("time", ["a"] * N),
        },
        coords={"time": ("time", TIME, options)},
    )


def test_a_dataset_over_time():
    record = from_dataset(dataset())
    assert set(record.arrays) == {"x", "acc[0]", "acc[1]", "acc[2]"}
    np.testing.assert_array_equal(record["acc[2]"], 3 * X)
    assert dict(record.units) == {"x": "m", **{f"acc[{i}]": "m/s2" for i in range(3)}}
    np.testing.assert_allclose(record.time_step, 0.05, rtol=1e-12)


@pytest.mark.parametrize(("unit", "factor"), [("s", 1), ("ms", 1e-3), ("seconds since 2024", 1)])
def test_the_unit_of_a_datasets_time(unit, factor):
    record = from_dataset(dataset(units=unit))
    np.testing.assert_allclose(record.time_step, 0.05 * factor, rtol=1e-12)


def test_dates_in_a_dataset_under_any_name():
    data = dataset().rename(time="when").assign_coords(when=INDICES["dates"])
    np.testing.assert_allclose(from_dataset(data).time_step, 0.05, rtol=1e-9)
    record = from_dataset(data, rename={"a": "acc[1]"}, scale={"a": 2.0}, derive={"b": "a - x"})
    np.testing.assert_allclose(record["b"], 3 * X)
    data = dataset().rename(time="depth")
    with pytest.raises(DataError, match=r"time= must name .* there are: depth"):
        from_dataset(data)
    assert from_dataset(data, time="depth").sample_count == N
    with pytest.raises(DataError, match="no coordinate 'clock'"):
        from_dataset(data, time="clock")


def test_neither_library_is_imported():
    code = "import sys, riecjax.records.frames; print({'pandas', 'xarray'} & set(sys.modules))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "set()"


def test_columns_that_are_called_alike_are_refused():
    """Of levels that are joined one name may come of two labels."""
    labels = pd.MultiIndex.from_tuples([("a", "b"), ("c", ""), ("a", "b")])
    for columns, name in ((["x", "u", "x"], "x"), (labels, "a.b"), (["1", "u", 1], "1")):
        with pytest.raises(DataError, match=f"^two columns are called '{name}'"):
            from_dataframe(pd.DataFrame(np.eye(3), columns=columns), time_step=0.1)
