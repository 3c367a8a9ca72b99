"""A million rows of eight columns from CSV: against PyArrow's own reader of the same file."""

import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import csv

from benchmarks.speed.timing import Comparison, Size, compare
from riecjax.records.reading.channels import read_channels

COLUMNS, RATE = ["t", "x", "dx", "ddx", "F", "i", "v", "u"], 1000.0


def run(size: Size) -> Iterator[Comparison]:
    rows = size.long_samples // 4
    samples = np.random.default_rng(0).standard_normal((len(COLUMNS), rows))
    samples[0] = np.arange(rows) / RATE
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "a.csv"
        csv.write_csv(pa.table(dict(zip(COLUMNS, samples, strict=True))), file)
        ours, theirs = read_channels(file).columns, csv.read_csv(file)
        apart = [np.abs(ours[name] - theirs[name].to_numpy()).max() for name in COLUMNS]
        yield compare(
            "read-csv",
            lambda: read_channels(file),
            "PyArrow's `read_csv`, dialect and names known",
            lambda: csv.read_csv(file),
            0.625,
            {"difference": float(max(apart))},
            repeats=size.repeats,
        )
