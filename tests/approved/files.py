"""One motion as twenty-odd programs write it, with the options that each file needs."""

import datetime
import importlib
import json
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from tests.approved.inputs import Columns, drag, made

FILES: dict[str, str] = {}
"""Options beside the model, by the file's name."""
NEEDS = {"book.xlsx": "openpyxl", "rig.tdms": "nptdms", "rig.mf4": "asammdf"}
MAPPED = "--map x=Weg --map u=Kraft"


def file(name: str, options: str = "") -> Callable[[Callable[[Path, Columns], None]], None]:
    """Register what writes a file of the motion; velocities are in none of them."""

    def register(write: Callable[[Path, Columns], None]) -> None:
        FILES[name] = options

        @made(name)
        def _(folder: Path) -> None:
            motion = drag(seed=7, count=801, step=0.005)
            write(folder / name, {key: motion[key] for key in ("t", "x", "u")})

    return register


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


@file("timetable.csv")
def _(path: Path, c: Columns) -> None:
    """MATLAB's writetimetable."""
    path.write_text(
        table(["Time,x,u"], printed(c["t"], "%.5g sec"), printed(c["x"]), printed(c["u"]))
    )


@file("german.csv", MAPPED)
def _(path: Path, c: Columns) -> None:
    """Excel in German."""
    columns = [printed(c["t"]), printed(1e3 * c["x"]), printed(c["u"])]
    text = table(["Zeit (s);Weg (mm);Kraft (N)"], *columns, sep=";", decimal=",", end="\r\n")
    path.write_bytes(text.encode("cp1252"))


@file("thousands.csv")
def _(path: Path, c: Columns) -> None:
    """Excel in the US."""
    force = [f'"{1000 + u:,.3f}"' for u in c["u"]]
    path.write_text(table(["Time (s),x,u"], printed(c["t"]), printed(c["x"]), force), "utf-8-sig")


@file("unicode.txt", MAPPED)
def _(path: Path, c: Columns) -> None:
    """Excel's Unicode text."""
    text = table(["Zeit\tWeg\tKraft"], *(printed(x) for x in c.values()), sep="\t")
    path.write_text(text, "utf-16")


@file("bare.csv", "--columns sec,nsec,t,x,u")
def _(path: Path, c: Columns) -> None:
    """`ros2 topic echo --csv`."""
    ticks = np.arange(801)
    whole, part = printed(1709294400 + ticks // 200, "%d"), printed(ticks % 200 * 5_000_000, "%d")
    path.write_text(table([], whole, part, *(printed(x) for x in c.values())))


@file("datetime_index.csv")
def _(path: Path, c: Columns) -> None:
    """A frame of pandas by time."""
    time = stamps(c["t"], "%Y-%m-%d %H:%M:%S.%f+00:00")
    path.write_text(table([",x,u"], time, printed(c["x"]), printed(c["u"])))


@file("missing.csv")
def _(path: Path, c: Columns) -> None:
    """Julia's CSV.write."""
    x = printed(c["x"])
    x[100:103] = ["missing"] * 3
    path.write_text(table(["t,x,u"], printed(c["t"]), x, printed(c["u"])))


@file("savetxt.txt")
def _(path: Path, c: Columns) -> None:
    """NumPy's savetxt."""
    np.savetxt(path, np.column_stack([*c.values()]), header="t x u", fmt="%.10e")


@file("units.txt", "--map x=Position --map u=Load")
def _(path: Path, c: Columns) -> None:
    """A row of units in words below the names, a preamble above."""
    head = ["MTS793|MPT|ENU|1|0", "", "Time\tPosition\tLoad", "Seconds\tMillimeters\tPounds"]
    columns = [c["t"], 1e3 * c["x"], c["u"] / 4.4482216152605]
    path.write_text(table(head, *(printed(x) for x in columns), sep="\t"))


@file("din.csv", "--map 'x=Position / mm' --map 'u=Kraft / kN'")
def _(path: Path, c: Columns) -> None:
    """Units behind a slash, as by DIN 1313."""
    columns = [c["t"], 1e3 * c["x"], 1e-3 * c["u"]]
    head = ["Zeit / s;Position / mm;Kraft / kN"]
    path.write_text(table(head, *(printed(x) for x in columns), sep=";"))


@file("daq.lvm", MAPPED)
def _(path: Path, c: Columns) -> None:
    """NI LabVIEW."""
    head = ["LabVIEW Measurement", "Writer_Version\t2", "Separator\tTab", "Decimal_Separator\t.",
            "***End_of_Header***", "", "Channels\t2", "Samples\t801\t801",
            "X_Dimension\tTime\tTime",
            "X0\t0.0\t0.0", "Delta_X\t0.005\t0.005", "***End_of_Header***",
            "X_Value\tWeg\tKraft\tComment"]  # fmt: skip
    path.write_text(table(head, *(printed(x) for x in c.values()), sep="\t"))


@file("midnight.csv")
def _(path: Path, c: Columns) -> None:
    """A time of day that passes midnight."""
    columns = [stamps(c["t"], "%H:%M:%S.%f"), printed(c["x"]), printed(c["u"])]
    path.write_text(table(["clock,x,u"], *columns))


@file("epoch.csv")
def _(path: Path, c: Columns) -> None:
    """PlotJuggler: nanoseconds since 1970."""
    time = printed(1709294400000000000 + 5000000 * np.arange(801), "%d")
    path.write_text(table(["__time,x,u"], time, printed(c["x"]), printed(c["u"])))


@file("pause.csv")
def _(path: Path, c: Columns) -> None:
    """A logger that paused for a second."""
    rows = np.r_[0:400, 600:801]
    path.write_text(table(["t,x,u"], *(printed(x[rows]) for x in c.values())))


@file("no_time.csv", "--time-step 0.005")
def _(path: Path, c: Columns) -> None:
    path.write_text(table(["x,u"], printed(c["x"]), printed(c["u"])))


@file("uneven.csv", "--resample 100")
def _(path: Path, c: Columns) -> None:
    time = c["t"] + 0.001 * np.sin(7.0 * np.arange(801))
    path.write_text(table(["t,x,u"], *(printed(x) for x in (time, c["x"], c["u"]))))


@file("contradiction.csv")
def _(path: Path, c: Columns) -> None:
    """A name that says mm above a row of units that says m: refused."""
    path.write_text(table(["t,x [mm],u", "s,m,N"], *(printed(x) for x in c.values())))


@file("two_runs.csv")
def _(path: Path, c: Columns) -> None:
    """Time begins anew: refused."""
    path.write_text(table(["t,x,u"], *(2 * printed(x) for x in c.values())))


@file("newest_first.csv")
def _(path: Path, c: Columns) -> None:
    """Refused."""
    path.write_text(table(["t,x,u"], *(printed(x[::-1]) for x in c.values())))


@file("lines.jsonl")
def _(path: Path, c: Columns) -> None:
    rows = [dict(zip(c, map(float, row))) for row in np.column_stack([*c.values()])]
    path.write_text("\n".join(json.dumps(row) for row in rows))


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
    np.savez(path, **c)


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
