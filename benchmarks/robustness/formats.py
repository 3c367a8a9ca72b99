"""Recordings as bytes of a file, in every format that is read."""

import io
import json
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import scipy.io
from pyarrow import parquet

Columns = list[tuple[str, np.ndarray]]
"""Names, which may come twice, and samples of any type."""


def csv_bytes(columns: Columns, delimiter: str = ",", header: bool = True) -> bytes:
    cells = [
        [text if isinstance(text, str) else f"{text:.9g}" for text in values.tolist()]
        for _, values in columns
    ]
    lines = [delimiter.join(row) for row in zip(*cells)]
    names = [delimiter.join(name for name, _ in columns)] if header else []
    return ("\n".join([*names, *lines]) + "\n").encode()


def tabbed_bytes(columns: Columns) -> bytes:
    return csv_bytes(columns, "\t")


def npz_bytes(columns: Columns) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, values in columns:
            member = io.BytesIO()
            np.save(member, values)
            # Another member of the same name is what is asked for: no warning.
            info = zipfile.ZipInfo(f"{name}.npy")
            archive.NameToInfo.pop(info.filename, None)
            archive.writestr(info, member.getvalue(), zipfile.ZIP_DEFLATED)
    return stream.getvalue()


def mat_bytes(columns: Columns) -> bytes:
    """Each variable's elements, one after the other, with one header: names may come twice."""
    content = b""
    for name, values in columns:
        stream = io.BytesIO()
        scipy.io.savemat(stream, {name: values})
        content += stream.getvalue() if not content else stream.getvalue()[128:]
    return content


def hdf5_bytes(columns: Columns) -> bytes:
    stream = io.BytesIO()
    with h5py.File(stream, "w") as file:
        for name, values in dict(columns).items():
            file[name] = values.astype("S") if values.dtype.kind == "U" else values
    return stream.getvalue()


def v73_bytes(columns: Columns) -> bytes:
    """Signals in a structure, with what lies in a cell beside them."""
    stream = io.BytesIO()
    with h5py.File(stream, "w", userblock_size=512) as file:
        for name, values in dict(columns).items():
            numeric = values if values.dtype.kind in "iufb" else np.zeros(values.size)
            file.create_dataset(f"run/{name}", data=numeric[None, :], compression="gzip")
        cell = file.create_dataset("cell", (1,), h5py.ref_dtype)
        cell[0] = file.create_dataset("#refs#/a", data=np.arange(3.0)).ref
        cell.attrs["MATLAB_class"] = np.bytes_("cell")
    head = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
    return head + stream.getvalue()[128:]


def parquet_bytes(columns: Columns) -> bytes:
    stream = io.BytesIO()
    names = [name for name, _ in columns]
    parquet.write_table(pa.table([pa.array(values) for _, values in columns], names), stream)
    return stream.getvalue()


def json_bytes(columns: Columns) -> bytes:
    return json.dumps({name: values.tolist() for name, values in columns}).encode()


def json_lines_bytes(columns: Columns) -> bytes:
    names, values = [name for name, _ in columns], [v.tolist() for _, v in columns]
    return "\n".join(json.dumps(dict(zip(names, row))) for row in zip(*values)).encode()


def excel_bytes(columns: Columns) -> bytes:
    import openpyxl

    book = openpyxl.Workbook(write_only=True)
    sheet = book.create_sheet("run")
    sheet.append([name for name, _ in columns])
    for row in zip(*(values.tolist() for _, values in columns)):
        sheet.append(row)
    stream = io.BytesIO()
    book.save(stream)
    return stream.getvalue()


def tdms_bytes(columns: Columns) -> bytes:
    from nptdms import ChannelObject, TdmsWriter

    stream = io.BytesIO()
    with TdmsWriter(stream) as out:
        out.write_segment([ChannelObject("run", name, values) for name, values in columns])
    return stream.getvalue()


def mdf_bytes(columns: Columns) -> bytes:
    import asammdf

    table = dict(columns)
    time = table.pop("t", np.arange(len(columns[0][1])) / 200.0)
    with tempfile.TemporaryDirectory() as folder, asammdf.MDF(version="4.10") as file:
        file.append([asammdf.Signal(values, time, name=name) for name, values in table.items()])
        return Path(file.save(Path(folder) / "a.mf4")).read_bytes()


def bag_bytes(columns: Columns) -> bytes:
    """One topic for each signal, logged at its time."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store, table = get_typestore(Stores.ROS2_HUMBLE), dict(columns)
    time = table.pop("t", np.arange(len(columns[0][1])) / 200.0)
    number = store.types["std_msgs/msg/Float64"]
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as out:
            for name, values in table.items():
                to = out.add_connection(f"/{name}", number.__msgtype__, typestore=store)
                for at, value in zip(np.asarray(time, float), np.asarray(values, float)):
                    packed = store.serialize_cdr(number(value), number.__msgtype__)
                    out.write(to, 10**18 + int(at * 1e9), packed)
        return next(bag.glob("*.mcap")).read_bytes()


WRITERS: dict[str, Callable[[Columns], bytes]] = {
    "a.csv": csv_bytes,
    "a.npz": npz_bytes,
    "a.mat": mat_bytes,
    "a.parquet": parquet_bytes,
}
"""What recordings are most often in."""
SLOW = ("a.xlsx", "a.mf4", "a.mcap")
"""Formats that take longer to write than to read."""
ALL_WRITERS = WRITERS | {
    "a.txt": tabbed_bytes,
    "a.h5": hdf5_bytes,
    "v73.mat": v73_bytes,
    "a.json": json_bytes,
    "a.jsonl": json_lines_bytes,
    "a.xlsx": excel_bytes,
    "a.tdms": tdms_bytes,
    "a.mf4": mdf_bytes,
    "a.mcap": bag_bytes,
}
