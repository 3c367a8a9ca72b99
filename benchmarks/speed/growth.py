"""Seconds and memory of an estimate against its size: `python -m benchmarks.speed growth`.

What is measured is eager, from samples in memory to standard errors: all windows of 20 to 200
samples, no noise taken off. Every point is a process of its own, since its peak of memory counts,
less what it holds before it starts, the record included. Timed is the median of five calls after
the first, or one call of those that take long. Writes benchmarks/growth.json and
docs/images/growth.png.
"""

import json
import resource
import statistics
import sys

import numpy as np

import riecjax as rx
from benchmarks.recorded import FOLDER, last_line, write_json
from benchmarks.speed.timing import seconds

PICTURE = FOLDER.parent / "docs" / "images" / "growth.png"
REPEATS, LONG = 5, 10.0
"""Calls after the first; seconds from which on one is enough."""
PIECE = 2**20
"""Samples that are in memory at once where a record is streamed."""
POINTS = {
    "samples": [10**3, 10**4, 10**5, 10**6, 10**7, 10**8],
    "parameters": [4, 8, 16, 30, 60],
}
"""Of three parameters, and of 10^5 samples."""


def record_of(samples: int, columns: int) -> rx.Record:
    rng = np.random.default_rng(0)
    return rx.Record({f"s{i}": rng.normal(size=samples) for i in range(columns)}, 1e-3)


def measured(kind: str, count: int) -> dict[str, float]:
    rx.start_jax()
    samples, parameters = (count, 3) if kind == "samples" else (10**5, count)
    unknown = [rx.Term(f"p{i}", f"s{i}") for i in range(parameters)]
    equation = rx.Equation(*unknown, -rx.Term(1.0, f"s{parameters}"))
    criterion = rx.RIEC(rx.AllWindows(0.02, 0.2))
    piece = record_of(min(samples, PIECE), parameters + 1)
    pieces = -(-samples // PIECE)

    def work() -> rx.Estimate:
        """Of a record that does not fit, sums add up."""
        found = [rx.summarise(equation, piece, criterion, noise="none") for _ in range(pieces)]
        return rx.estimate(equation, found)

    before = peak()
    first = seconds(work)
    again = [seconds(work) for _ in range(REPEATS)] if first < LONG else [first]
    return {
        "count": count,
        "first_s": first,
        "seconds": statistics.median(again),
        "MiB_above_record": peak() - before,
    }


def peak() -> float:
    """MiB that the process has held at most."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def draw(found: dict[str, list[dict[str, float]]]) -> None:
    import matplotlib.pyplot as plt
    from matplotlib.ticker import NullFormatter

    figure, axes = plt.subplots(2, len(found), figsize=(8, 6), sharex="col")
    for (kind, points), (above, below) in zip(found.items(), axes.T):
        counts = np.array([p["count"] for p in points])
        times = np.array([p["seconds"] for p in points])
        above.loglog(counts, times, "o-")
        above.loglog(counts, times[-1] * counts / counts[-1], "k:", label="proportional")
        below.semilogx(counts, [p["MiB_above_record"] for p in points], "s-", color="C1")
        below.set_ylim(0, 1.1 * max(p["MiB_above_record"] for p in points))
        below.xaxis.set_minor_formatter(NullFormatter())
        below.set_xlabel(kind)
        above.grid(alpha=0.3)
        below.grid(alpha=0.3)
    axes[0, 0].set_ylabel("seconds, warm")
    axes[1, 0].set_ylabel("memory above the record, MiB")
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
