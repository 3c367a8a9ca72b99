"""`riecjax fleet` as a process of its own, and what it takes."""

import contextlib
import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil

MODEL = "drag-oscillator"


def command(folder: Path, out: Path, workers: int) -> list[str]:
    options = ["--model", MODEL, "--by", "vehicle", "--workers", str(workers), "--out", str(out)]
    return [sys.executable, "-m", "riecjax", "fleet", str(folder), *options]


def run(folder: Path, out: Path, workers: int) -> dict[str, Any]:
    """A whole command: seconds, CPU seconds and most memory of all its processes together."""
    began, peak, busy = time.perf_counter(), 0, {}
    process = psutil.Popen(command(folder, out, workers), stdout=subprocess.DEVNULL)
    while process.poll() is None:
        peak, busy = max(peak, held(process)), busy | spent(process)
        time.sleep(0.25)
    if process.returncode:
        raise RuntimeError(f"the fleet ended with {process.returncode}")
    seconds = time.perf_counter() - began
    document = json.loads((out / "results.json").read_text())
    return {
        "workers": workers,
        "seconds": seconds,
        "cpu_seconds": sum(busy.values()),
        "samples_per_second": document["recordings"]["samples"] / seconds,
        "peak_bytes": peak,
        "sentence": document["sentence"],
    }


def held(process: psutil.Process) -> int:
    """Bytes of memory of a process and its children."""
    return sum(_each(process, lambda one: one.memory_info().rss).values())


def spent(process: psutil.Process | None = None) -> dict[int, float]:
    """CPU seconds of a process, this one if none is given, and of its children, by their numbers:
    other work on the same cores hardly changes them."""
    return _each(process or psutil.Process(), lambda one: sum(one.cpu_times()[:2]))


def _each(process: psutil.Process, of: Callable[[psutil.Process], Any]) -> dict[int, Any]:
    found = {}
    for one in (process, *process.children(recursive=True)):
        with contextlib.suppress(psutil.NoSuchProcess):
            found[one.pid] = of(one)
    return found
