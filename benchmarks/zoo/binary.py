"""Binary files and spreadsheets, by the libraries that others make them with."""

import json
from collections.abc import Mapping
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.zoo.case import COUNT, STEP, Truth, case, motion, save, written


def _exact(*names: str) -> dict[str, np.ndarray]:
    """Signals as they are: the truth."""
    return {name: motion()[name] for name in names}


def _mat(file: Path, content: Mapping[str, Any]) -> None:
    import scipy.io

    scipy.io.savemat(file, content)


def _column(values: np.ndarray) -> np.ndarray:
    return values[:, None]


@case(".mat")
def mat_v5(file: Path) -> Truth:
    """MATLAB save: vectors t, x, u."""
    _mat(file, {name: _column(motion()[name]) for name in ("t", "x", "u")})
    return _exact("x", "u")


@case(".mat", x="x_F[0]", u="x_F[1]")
def mat_matrix(file: Path) -> Truth:
    """MATLAB and Simulink `To Workspace`: `tout` and a matrix."""
    both = np.stack([motion()["x"], motion()["u"]], axis=1)
    _mat(file, {"tout": _column(motion()["t"]), "x_F": both})
    return _exact("x", "u")


def _structure(values: np.ndarray) -> dict[str, Any]:
    signals = {"values": _column(values), "dimensions": 1.0, "label": "a"}
    return {"time": _column(motion()["t"]), "signals": signals, "blockName": "rig/Scope"}


@case(".mat", x="X.signals.values", u="U.signals.values")
def simulink_structure_with_time(file: Path) -> Truth:
    """Simulink, structure with time."""
    _mat(file, {"X": _structure(motion()["x"]), "U": _structure(motion()["u"])})
    return _exact("x", "u")


@case(".mat", x="logsout.x.Data", u="logsout.u.Data")
def simulink_dataset(file: Path) -> Truth:
    """Simulink Dataset, its timeseries unpacked to structs by name (`Time`, `Data`)."""
    t = _column(motion()["t"])
    series = {n: {"Name": n, "Time": t, "Data": _column(motion()[n])} for n in ("x", "u")}
    _mat(file, {"logsout": series})
    return _exact("x", "u")


@case(".mat", x="rec.Y(1).Data", u="rec.Y(2).Data")
def controldesk_mat(file: Path) -> Truth:
    """dSPACE ControlDesk, MAT: a struct with `X.Data` and an array of structs `Y`."""
    kind = [("Name", object), ("Data", object)]
    y = np.array([(n, motion()[n][None, :]) for n in ("x", "u")], dtype=kind)
    _mat(file, {"rec": {"X": {"Name": "Time", "Data": motion()["t"][None, :]}, "Y": y}})
    return _exact("x", "u")


def _halves() -> list[dict[str, np.ndarray]]:
    cut = [slice(0, 400), slice(400, COUNT)]
    return [{n: motion()[n][part] for n in ("t", "x", "u")} for part in cut]


def _cell(values: list[Any]) -> np.ndarray:
    cell = np.empty((len(values), 1), dtype=object)
    for i, value in enumerate(values):
        cell[i, 0] = value
    return cell


@case(".mat", t="T_id", x="X_id", u="U_id")
def mat_cells(file: Path) -> list[Truth]:
    """Several recordings in cells of one MAT file."""
    runs = _halves()
    _mat(file, {f"{n.upper()}_id": _cell([run[n] for run in runs]) for n in ("t", "x", "u")})
    return [{n: run[n] for n in ("x", "u")} for run in runs]


@case(".mat")
def mat_structs(file: Path) -> list[Truth]:
    """Several recordings as structs run1, run2 of one MAT file."""
    runs = _halves()
    _mat(file, {f"run{i + 1}": run for i, run in enumerate(runs)})
    return [{n: run[n] for n in ("x", "u")} for run in runs]


@case(".mat", needs="h5py")
def mat_v73(file: Path) -> Truth:
    """MATLAB save -v7.3: HDF5 behind a header of 512 bytes."""
    import h5py

    with h5py.File(file, "w", userblock_size=512) as out:
        for name in ("t", "x", "u"):
            out.create_dataset(name, data=motion()[name][None, :])
    with file.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    return _exact("x", "u")


@case(".npz")
def numpy_npz(file: Path) -> Truth:
    """NumPy savez."""
    np.savez(file, t=motion()["t"], x=motion()["x"], u=motion()["u"])
    return _exact("x", "u")


def _frame() -> Any:
    import pandas as pd

    return pd.DataFrame({name: motion()[name] for name in ("t", "x", "u")})


@case(".parquet", needs="pandas")
def pandas_parquet(file: Path) -> Truth:
    """pandas to_parquet."""
    _frame().to_parquet(file)
    return _exact("x", "u")


@case(".parquet", needs="pandas")
def pandas_parquet_datetimes(file: Path) -> Truth:
    """pandas to_parquet of a frame indexed by date-times in UTC."""
    import pandas as pd

    frame = _frame().drop(columns="t")
    frame.index = pd.date_range("2024-03-01 12:00", periods=COUNT, freq="5ms", tz="UTC")
    frame.to_parquet(file)
    return _exact("x", "u")


@case(".xlsx", needs="openpyxl", x="Weg", u="Kraft")
def excel_workbook(file: Path) -> Truth:
    """Excel: a sheet with names and units in round brackets."""
    import openpyxl

    c, truth = written(t="%.3f", x=("%.4f", 1e-3), u="%.5f")
    book = openpyxl.Workbook()
    sheet = book.worksheets[0]
    sheet.append(["Zeit (s)", "Weg (mm)", "Kraft (N)"])
    for row in zip(*c.values(), strict=True):
        sheet.append([float(text) for text in row])
    book.save(file)
    return truth


@case(".xlsx", needs="openpyxl", step_rtol=1e-4)
def excel_dates(file: Path) -> Truth:
    """Excel: date-time cells, a title above the names, an empty sheet first."""
    import openpyxl

    c, truth = written(x="%.6f", u="%.5f")
    book = openpyxl.Workbook()
    sheet = book.create_sheet("Daten")
    sheet.append(["Rig 3, first of March"])
    sheet.append([])
    sheet.append(["Time", "x", "u"])
    start = datetime(2024, 3, 1, 12)
    for i, (x, u) in enumerate(zip(c["x"], c["u"], strict=True)):
        sheet.append([start + timedelta(milliseconds=5 * i), float(x), float(u)])
    book.save(file)
    return truth


@case(".tdms", needs="nptdms", x="Weg", u="Kraft")
def labview_tdms(file: Path) -> Truth:
    """NI TDMS: channels of one group, `wf_increment`, `unit_string`."""
    from nptdms import ChannelObject, TdmsWriter

    def channel(name: str, values: np.ndarray, unit: str) -> Any:
        properties = {"wf_increment": STEP, "wf_start_offset": 0.0, "wf_samples": COUNT}
        return ChannelObject("Messung", name, values, {**properties, "unit_string": unit})

    with TdmsWriter(str(file)) as out:
        out.write_segment(
            [channel("Weg", 1e3 * motion()["x"], "mm"), channel("Kraft", motion()["u"], "N")]
        )
    return _exact("x", "u")


@case(".h5", needs="h5py", x="position", u="force")
def hdf5(file: Path) -> Truth:
    """HDF5 by h5py: datasets in one group, units as attributes."""
    import h5py

    with h5py.File(file, "w") as out:
        group = out.create_group("run")
        for name, of, unit in (("time", "t", "s"), ("position", "x", "m"), ("force", "u", "N")):
            group.create_dataset(name, data=motion()[of]).attrs["units"] = unit
    return _exact("x", "u")


@case(".jsonl")
def json_lines(file: Path) -> Truth:
    """JSON lines: an object for each sample."""
    c, truth = written(t="%.3f", x="%.6f", u="%.5f")
    rows = zip(*c.values(), strict=True)
    save(file, *(json.dumps(dict(zip(c, map(float, row), strict=True))) for row in rows))
    return truth


@case(".mf4", needs="asammdf", x="Position", u="Force")
def canape_mf4(file: Path) -> Truth:
    """Vector CANape, MDF4: one group on a common time, units mm and N."""
    from asammdf import MDF, Signal

    c = motion()
    group = [
        Signal(1e3 * c["x"], c["t"], name="Position", unit="mm"),
        Signal(c["u"], c["t"], name="Force", unit="N"),
    ]
    with MDF(version="4.10") as out:
        out.append(group)
        out.save(file, overwrite=True)
    return _exact("x", "u")


RIG = "float64 position\nfloat64 force\n"


@case(".mcap", needs="rosbags", x="position", u="force", step_rtol=1e-4)
def ros2_mcap(file: Path) -> Truth:
    """ROS 2, a bag in MCAP: one topic with a message of one's own."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(RIG, "rig_msgs/msg/Rig"))
    message = store.types["rig_msgs/msg/Rig"]
    folder = file.with_suffix("")
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as out:
        topic = out.add_connection("/rig", message.__msgtype__, typestore=store)
        for i, (x, u) in enumerate(zip(motion()["x"], motion()["u"], strict=True)):
            data = store.serialize_cdr(message(float(x), float(u)), message.__msgtype__)
            out.write(topic, 1_709_294_400_000_000_000 + 5_000_000 * i, data)
    next(folder.glob("*.mcap")).rename(file)
    return _exact("x", "u")
