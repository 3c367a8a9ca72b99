"""`riecjax fleet` as a process of its own, and what it takes."""

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import psutil

MODEL = "drag-oscillator"


def command(folder: Path, out: Path, workers: int) -> list[str]:
    options = ["--model", MODEL, "--by", "vehicle", "--workers", str(workers), "--out", str(out)]
    return [sys.executable, "-m", "riecjax", "fleet", str(folder), *options]


def run(folder: Path, out: Path, workers: int) -> dict[str, Any]:
    """A whole command: seconds, and most memory of all its processes together."""
    began, peak = time.perf_counter(), 0
    process = psutil.Popen(command(folder, out, workers), stdout=subprocess.DEVNULL)
    while process.poll() is None:
        peak = max(peak, held(process))
        time.sleep(0.25)
    if process.returncode:
        raise RuntimeError(f"the fleet ended with {process.returncode}")
    seconds = time.perf_counter() - began
    document = json.loads((out / "results.json").read_text())
    return {
        "workers": workers,
        "seconds": seconds,
        "samples_per_second": document["recordings"]["samples"] / seconds,
        "peak_bytes": peak,
        "sentence": document["sentence"],
    }


def held(process: psutil.Process) -> int:
    held = 0
    for one in (process, *process.children(recursive=True)):
        try:
            held += one.memory_info().rss
        except psutil.NoSuchProcess:
            continue
    return held
