"""One motion as twenty-odd programs write it, with the options that each file needs."""

import datetime
import importlib
import io
import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from tests.approved.inputs import Columns, drag, made

FILES: dict[str, str] = {}
"""Options beside the model, by the file's name."""
NEEDS = {"book.xlsx": "openpyxl", "rig.tdms": "nptdms", "rig.mf4": "asammdf"}
MAPPED = "--map x=Weg --map u=Kraft"


def file(name: str, options: str = "") -> Callable[[Callable[[Path, Columns], object]], None]:
    """Register what writes a file of the motion; velocities are in none of them."""

    def register(write: Callable[[Path, Columns], object]) -> None:
        FILES[name] = options

        @made(name)
        def _(folder: Path) -> None:
            motion = drag(seed=7, count=801, step=0.005)
            write(folder / name, {key: motion[key] for key in ("t", "x", "u")})

    return register


def text_file(
    name: str, write: Callable[[Columns], str], options: str = "", encoding: str = "utf-8"
) -> None:
    file(name, options)(lambda path, motion: path.write_bytes(write(motion).encode(encoding)))


def table(
    head: Iterable[str],
    *columns: Iterable[str],
    sep: str = ",",
    decimal: str = ".",
    end: str = "\n",
) -> str:
    rows = [sep.join(row) for row in zip(*columns, strict=True)]
    rows = [row.replace(".", decimal) for row in rows]
    return end.join([*head, *rows]) + end


def printed(values: np.ndarray, form: str = "%.7g") -> list[str]:
    return [form % value for value in values]


def stamps(t: np.ndarray, form: str) -> list[str]:
    start = datetime.datetime(2024, 3, 1, 23, 59, 58, tzinfo=datetime.UTC)
    return [(start + datetime.timedelta(seconds=round(x, 6))).strftime(form) for x in t]


HEAD_OF_LVM = """\
LabVIEW Measurement
Writer_Version\t2
Separator\tTab
Decimal_Separator\t.
***End_of_Header***

Channels\t2
Samples\t801\t801
X_Dimension\tTime\tTime
X0\t0.0\t0.0
Delta_X\t0.005\t0.005
***End_of_Header***
X_Value\tWeg\tKraft\tComment"""
TICKS = np.arange(801)
NANOSECONDS = 1709294400000000000 + 5000000 * TICKS


def lines(c: Columns, head: str = "t,x,u", sep: str = ",", **replaced: Any) -> str:
    """A table below its head; columns that are replaced may be printed already."""
    columns = [x if isinstance(x, list) else printed(x) for x in (c | replaced).values()]
    return table(head.splitlines(), *columns, sep=sep)


def german(c: Columns) -> str:
    columns = [printed(c["t"]), printed(1e3 * c["x"]), printed(c["u"])]
    return table(["Zeit (s);Weg (mm);Kraft (N)"], *columns, sep=";", decimal=",", end="\r\n")


def bare(c: Columns) -> str:
    whole, part = printed(1709294400 + TICKS // 200, "%d"), printed(TICKS % 200 * 5_000_000, "%d")
    return table([], whole, part, *(printed(x) for x in c.values()))


def with_gap(c: Columns) -> str:
    x = printed(c["x"])
    x[100:103] = ["missing"] * 3
    return lines(c, x=x)


def json_lines(c: Columns) -> str:
    rows = [dict(zip(c, map(float, row))) for row in np.column_stack([*c.values()])]
    return "\n".join(json.dumps(row) for row in rows)


def numpys(c: Columns) -> str:
    text = io.StringIO()
    np.savetxt(text, np.column_stack([*c.values()]), header="t x u", fmt="%.10e")
    return text.getvalue()


# MATLAB's writetimetable, Excel in German and in the US, its Unicode text.
text_file("timetable.csv", lambda c: lines(c, "Time,x,u", t=printed(c["t"], "%.5g sec")))
text_file("german.csv", german, MAPPED, "cp1252")
text_file(
    "thousands.csv",
    lambda c: lines(c, "Time (s),x,u", u=[f'"{1000 + u:,.3f}"' for u in c["u"]]),
    encoding="utf-8-sig",
)
text_file("unicode.txt", lambda c: lines(c, "Zeit\tWeg\tKraft", "\t"), MAPPED, "utf-16")
# `ros2 topic echo --csv`, a frame of pandas by time, Julia's CSV.write, NumPy's savetxt.
text_file("bare.csv", bare, "--columns sec,nsec,t,x,u")
text_file(
    "datetime_index.csv",
    lambda c: lines(c, ",x,u", t=stamps(c["t"], "%Y-%m-%d %H:%M:%S.%f+00:00")),
)
text_file("missing.csv", with_gap)
text_file("savetxt.txt", numpys)
# A row of units in words below the names, a preamble above; units behind a slash, as by DIN 1313.
text_file(
    "units.txt",
    lambda c: lines(
        c,
        "MTS793|MPT|ENU|1|0\n\nTime\tPosition\tLoad\nSeconds\tMillimeters\tPounds",
        "\t",
        x=1e3 * c["x"],
        u=c["u"] / 4.4482216152605,
    ),
    "--map x=Position --map u=Load",
)
text_file(
    "din.csv",
    lambda c: lines(c, "Zeit / s;Position / mm;Kraft / kN", ";", x=1e3 * c["x"], u=1e-3 * c["u"]),
    "--map 'x=Position / mm' --map 'u=Kraft / kN'",
)
# NI LabVIEW, a time of day that passes midnight, PlotJuggler's nanoseconds since 1970.
text_file("daq.lvm", lambda c: lines(c, HEAD_OF_LVM, "\t"), MAPPED)
text_file("midnight.csv", lambda c: lines(c, "clock,x,u", t=stamps(c["t"], "%H:%M:%S.%f")))
text_file("epoch.csv", lambda c: lines(c, "__time,x,u", t=printed(NANOSECONDS, "%d")))
# A logger that paused for a second; no time, uneven time.
text_file("pause.csv", lambda c: lines({name: x[np.r_[0:400, 600:801]] for name, x in c.items()}))
text_file(
    "no_time.csv",
    lambda c: lines({"x": c["x"], "u": c["u"]}, "x,u"),
    "--time-step 0.005",
)
text_file(
    "uneven.csv",
    lambda c: lines(c, t=c["t"] + 0.001 * np.sin(7.0 * TICKS)),
    "--resample 100",
)
# Refused: a name that says mm above a row of units that says m, time that begins anew, that falls.
text_file("contradiction.csv", lambda c: lines(c, "t,x [mm],u\ns,m,N"))
text_file("two_runs.csv", lambda c: lines({name: np.tile(x, 2) for name, x in c.items()}))
text_file("newest_first.csv", lambda c: lines({name: x[::-1] for name, x in c.items()}))
text_file("lines.jsonl", json_lines)


@file("vectors.mat")
def _(path: Path, c: Columns) -> None:
    import scipy.io

    scipy.io.savemat(path, {name: x[:, None] for name, x in c.items()})


@file("structures.mat")
def _(path: Path, c: Columns) -> None:
    """Two recordings."""
    import scipy.io

    halves = [{name: x[rows] for name, x in c.items()} for rows in (slice(400), slice(400, 801))]
    scipy.io.savemat(path, {"run1": halves[0], "run2": halves[1]})


@file("arrays.npz")
def _(path: Path, c: Columns) -> None:
    np.savez(path, allow_pickle=False, **c)


@file("group.h5", "--map x=position --map u=force")
def _(path: Path, c: Columns) -> None:
    import h5py

    with h5py.File(path, "w") as out:
        group = out.create_group("run")
        columns = {"time": (c["t"], "s"), "position": (1e3 * c["x"], "mm"), "force": (c["u"], "N")}
        for name, (x, unit) in columns.items():
            group.create_dataset(name, data=x).attrs["units"] = unit


@file("frame.parquet")
def _(path: Path, c: Columns) -> None:
    import pyarrow
    from pyarrow import parquet

    time = (1709294400 * 10**9 + 5_000_000 * np.arange(801)).astype("datetime64[ns]")
    parquet.write_table(pyarrow.table({"time": time, "x": c["x"], "u": c["u"]}), path)


@file("book.xlsx", MAPPED)
def _(path: Path, c: Columns) -> None:
    openpyxl = importlib.import_module("openpyxl")
    book = openpyxl.Workbook()
    sheet = book.worksheets[0]
    for row in [["Zeit (s)", "Weg (mm)", "Kraft (N)"], *zip(c["t"], 1e3 * c["x"], c["u"])]:
        sheet.append(row if isinstance(row, list) else [float(value) for value in row])
    book.save(path)


@file("rig.tdms", MAPPED)
def _(path: Path, c: Columns) -> None:
    nptdms = importlib.import_module("nptdms")
    step = {"wf_increment": 0.005, "wf_start_offset": 0.0, "wf_samples": 801}
    channels = [
        nptdms.ChannelObject("Messung", "Weg", 1e3 * c["x"], {**step, "unit_string": "mm"}),
        nptdms.ChannelObject("Messung", "Kraft", c["u"], {**step, "unit_string": "N"}),
    ]
    with nptdms.TdmsWriter(str(path)) as out:
        out.write_segment(channels)


@file("rig.mf4", MAPPED)
def _(path: Path, c: Columns) -> None:
    asammdf = importlib.import_module("asammdf")
    signals = [
        asammdf.Signal(1e3 * c["x"], c["t"], name="Weg", unit="mm"),
        asammdf.Signal(c["u"], c["t"], name="Kraft", unit="N"),
    ]
    with asammdf.MDF(version="4.10") as out:
        out.append(signals)
        out.save(path, overwrite=True)
