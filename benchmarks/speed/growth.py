"""Seconds and peak memory against the size of the problem: `python -m benchmarks.speed growth`.

Every point is a process of its own, since its peak of memory is what is measured; the median
of five calls after the first is timed. Writes benchmarks/growth.json and docs/images/growth.png.
"""

import json
import resource
import statistics
import sys
from collections.abc import Callable
from typing import Any

import numpy as np

import riecjax as rx
from benchmarks.recorded import FOLDER, last_line, write_json
from benchmarks.speed.all_windows import moments
from benchmarks.speed.timing import seconds

PICTURE = FOLDER.parent / "docs" / "images" / "growth.png"
REPEATS = 5
PIECE = 2**20
"""Samples that are in memory at once where a record is streamed."""
POINTS = {
    "samples": [10**4, 10**5, 10**6, 10**7, 10**8],
    "parameters": [2, 4, 8, 16, 30, 60],
}


def record_of(samples: int, columns: int) -> rx.Record:
    rng = np.random.default_rng(0)
    return rx.Record({f"s{i}": rng.normal(size=samples) for i in range(columns)}, 1e-3)


def equation_of(parameters: int) -> rx.Equation:
    unknown = [rx.Term(f"p{i}", f"s{i}") for i in range(parameters)]
    return rx.Equation(*unknown, -rx.Term(1.0, f"s{parameters}"))


def all_windows(record: rx.Record, parameters: int) -> Callable[[], Any]:
    criterion = rx.RIEC(rx.AllWindows(0.02, 0.2)).fitted([record])
    equation = equation_of(parameters)
    return lambda: moments(equation, record, criterion)


def samples(count: int) -> Callable[[], Any]:
    """Normal equations add up: a record that does not fit is summed in pieces."""
    piece = all_windows(record_of(min(count, PIECE), 4), 3)
    pieces = -(-count // PIECE)

    def streamed() -> np.ndarray:
        return np.sum([np.asarray(piece()) for _ in range(pieces)], axis=0)

    return streamed


def parameters(count: int) -> Callable[[], Any]:
    return all_windows(record_of(10**5, count + 1), count)


def measured(kind: str, count: int) -> dict[str, float]:
    rx.start_jax()
    work = {"samples": samples, "parameters": parameters}[kind](count)
    first = seconds(work)
    again = [seconds(work) for _ in range(REPEATS)]
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {"count": count, "first_s": first, "seconds": statistics.median(again), "peak_MiB": peak}


def draw(found: dict[str, list[dict[str, float]]]) -> None:
    import matplotlib.pyplot as plt
    from matplotlib.ticker import NullFormatter

    figure, axes = plt.subplots(2, len(found), figsize=(8, 6), sharex="col")
    for (kind, points), (above, below) in zip(found.items(), axes.T):
        counts = np.array([p["count"] for p in points])
        times = np.array([p["seconds"] for p in points])
        above.loglog(counts, times, "o-")
        above.loglog(counts, times[-1] * counts / counts[-1], "k:", label="proportional")
        below.semilogx(counts, [p["peak_MiB"] for p in points], "s-", color="C1")
        below.set_ylim(0, 1.1 * max(p["peak_MiB"] for p in points))
        below.xaxis.set_minor_formatter(NullFormatter())
        below.set_xlabel(kind)
        above.grid(alpha=0.3)
        below.grid(alpha=0.3)
    axes[0, 0].set_ylabel("seconds, warm")
    axes[1, 0].set_ylabel("peak memory of the process, MiB")
    axes[0, 0].legend()
    figure.tight_layout()
    PICTURE.parent.mkdir(exist_ok=True)
    figure.savefig(PICTURE, dpi=110)


def main(point: str = "") -> None:
    """All points; `KIND,COUNT` of one is what the processes are started with."""
    if point:
        kind, _, count = point.partition(",")
        print(json.dumps(measured(kind, int(count))))
        return
    found = {}
    for kind, counts in POINTS.items():
        found[kind] = []
        for count in counts:
            command = [sys.executable, "-m", "benchmarks.speed", "growth", "--point"]
            found[kind].append(last_line([*command, f"{kind},{count}"]))
            print(kind, found[kind][-1], flush=True)
    write_json(FOLDER / "growth.json", found)
    draw(found)
