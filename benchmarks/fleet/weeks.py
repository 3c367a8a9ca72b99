"""A recording of weeks: a data set of many files, one of real size and links to it."""

import json
import os
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from pyarrow import parquet
from tests.machines import STANDARD, drag_fleet

from benchmarks.fleet.commands import command, held
from riecjax.records.writing import write_record

ROWS = 100_000
"""Of a file."""


def data_set(work: Path, samples: int) -> Path:
    """A folder of so many samples, of seven columns, and no time: it goes on from file to file."""
    whole = work / "part.parquet"
    (record,) = drag_fleet(1, ROWS, 1)
    write_record(whole, record)
    table = parquet.read_table(whole)
    for name in ("spare1", "spare2", "spare3", "spare4"):
        table = table.append_column(name, table["x"])
    parquet.write_table(table.drop_columns(["t"]), whole, row_group_size=2**17)
    folder = work / f"weeks{samples}.parquet"
    folder.mkdir()
    for number in range(samples // ROWS):
        os.symlink(whole, folder / f"{number:06}.parquet")
    return folder


def words_for(folder: Path, out: Path) -> list[str]:
    words = [*command(folder, out, 2), "--time-step", str(STANDARD.step)]
    words[words.index("vehicle")] = "file"
    return words


def long(work: Path, samples: int) -> dict[str, Any]:
    """Time and memory, and how memory grows while it goes on."""
    folder, out = data_set(work, samples), work / "long"
    began, course = time.perf_counter(), []
    process = psutil.Popen(words_for(folder, out), stdout=subprocess.DEVNULL)
    while process.poll() is None:
        course.append(held(process))
        time.sleep(0.5)
    seconds = time.perf_counter() - began
    document = json.loads((out / "results.json").read_text())
    quarters = [float(np.mean(part)) for part in np.array_split(course, 4)]
    return {
        "samples": document["recordings"]["samples"],
        "seconds": seconds,
        "peak_bytes": max(course),
        "quarters_bytes": quarters,
        "growth": quarters[3] / quarters[1] - 1,
        "samples_per_second": samples / seconds,
    }
