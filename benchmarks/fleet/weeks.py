"""A recording of weeks: a data set of many files, one of real size and links to it."""

import json
import os
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from pyarrow import concat_tables, parquet
from tests.machines import STANDARD, drag_fleet

from benchmarks.fleet.commands import MODEL, command, held
from riecjax.criteria.criterion import AbstractCriterion
from riecjax.fleets.kept import read_rows
from riecjax.fleets.sums import DONE, Row
from riecjax.models.catalogue import find_model
from riecjax.records.recording import read_recording
from riecjax.records.writing import write_record
from riecjax.runtime import start_jax
from riecjax.summaries.summarise import summed
from riecjax.summaries.summary import Summary
from riecjax.summaries.task import task

ROWS = 100_000
"""Of a file."""
COMPARED = 10_000_000
"""Samples that are summed in one pass as well."""
NOISE = {"x": 0.006, "dx": 0.019, "u": 0.0}
NOISE_WORDS = [word for k, v in NOISE.items() for word in ("--noise", f"{k}={v}")]
AS_LOGGED = ("--align", "none", "--outliers", "keep", *NOISE_WORDS)
"""What is judged of one stretch and of all would be no difference of the sums."""


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


def one_pass(work: Path) -> dict[str, Any]:
    """Sums of stretches against those of one pass over all samples at once."""
    start_jax(keep_compiled=True)
    folder, out = data_set(work, COMPARED), work / "stretches"
    subprocess.run([*words_for(folder, out), *AS_LOGGED], check=True, stdout=subprocess.DEVNULL)
    rows = [row for row in read_rows(out / "summaries.parquet") if row.status == DONE]
    moments, count = map(sum, zip(*map(_totals, map(_summary, rows))))
    of_all, counted = _totals(_at_once(folder, _summary(rows[0]).criterion))
    size = np.sqrt(np.diag(of_all))
    return {
        "samples": COMPARED,
        "stretches": len(rows),
        "difference": float(np.max(np.abs(moments - of_all) / np.outer(size, size))),
        "counted": "the same" if count == counted else f"{count:.0f}, not {counted:.0f}",
    }


def _summary(row: Row) -> Summary:
    return Summary.from_bytes(row.sums)


def _totals(summary: Summary) -> tuple[np.ndarray, float]:
    """Moments of all windows, and their number."""
    (sums,) = (recording.stages[0][0] for recording in summary.recordings)
    return np.asarray(sums.moments).sum((0, 1)), float(np.asarray(sums.count).sum())


def _at_once(folder: Path, criterion: AbstractCriterion) -> Summary:
    """All samples in one file, read and summed as one record."""
    whole, model = folder.with_suffix(".whole.parquet"), find_model(MODEL)
    tables = [
        parquet.read_table(file, columns=["x", "dx", "u"]) for file in sorted(folder.iterdir())
    ]
    parquet.write_table(concat_tables(tables), whole)
    recording = read_recording(
        whole, model=model, time_step=STANDARD.step, align="none", outliers="keep", noise=NOISE
    )
    return summed(task(model, [recording], criterion, None))
