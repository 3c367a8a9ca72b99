"""Ten million samples of eight signals in one `identify` call: seconds, and memory above the data.

    python -m benchmarks.speed long_record [--samples 10000000] [--test-function boxcar|hat|bump]

A process of its own, since its peak of memory is what is measured.
"""

import argparse
import json
import time
from pathlib import Path

import jax
import numpy as np

from riecjax.criteria.criterion import RIEC
from riecjax.criteria.test_functions import Boxcar, Bump, Hat
from riecjax.criteria.windows import AllWindows
from riecjax.equations.equation import Equation
from riecjax.equations.term import Term
from riecjax.estimation.estimate import Estimate
from riecjax.estimation.identify import identify
from riecjax.records.record import Record

STEP = 1e-3
TRUTH = {"m": 2.0, "c": 3.0, "k": 400.0, "a_1": 0.5, "a_2": -1.0, "a_3": 0.25}
WEIGHTS = {"boxcar": Boxcar(4), "hat": Hat(4), "bump": Bump()}
MEBIBYTE = 2**20
PROCESS = Path("/proc/self")


def made_record(samples: int) -> Record:
    """m dv/dt + c v + k x + a_i s_i = u + noise, of eight signals, on a motion in closed form."""
    rng = np.random.default_rng(0)
    t = STEP * np.arange(samples)
    x, v, a = np.zeros(samples), np.zeros(samples), np.zeros(samples)
    for frequency in (0.7, 2.3, 4.1):
        phase, w = 2 * np.pi * frequency * t, 2 * np.pi * frequency
        x += np.sin(phase) / frequency
        v += np.cos(phase) * w / frequency
        a -= np.sin(phase) * w**2 / frequency
    others = {f"s_{i}": rng.normal(size=samples) for i in (1, 2, 3)}
    u = TRUTH["m"] * a + TRUTH["c"] * v + TRUTH["k"] * x
    for i in (1, 2, 3):
        u += TRUTH[f"a_{i}"] * others[f"s_{i}"]
    noise = rng.normal(size=samples)
    return Record({"x": x, "v": v, **others, "u": u, "noise": noise, "t": t}, STEP)


def equation() -> Equation:
    """Six unknown parameters."""
    return Equation(
        Term("m", "v", derivative=1),
        Term("c", "v"),
        Term("k", "x"),
        *(Term(f"a_{i}", f"s_{i}") for i in (1, 2, 3)),
        -Term(1.0, "u"),
        -Term(1.0, "noise"),
    )


def memory(what: str) -> float:
    """Resident memory of this process in MiB: VmRSS now, VmHWM at its peak (Linux)."""
    lines = (PROCESS / "status").read_text().splitlines()
    return next(float(line.split()[1]) for line in lines if line.startswith(what)) / 1024


def forget_peak() -> None:
    """Let the peak be what is resident now."""
    (PROCESS / "clear_refs").write_text("5")


def timed(record: Record, criterion: RIEC) -> tuple[Estimate, float]:
    begin = time.perf_counter()
    estimate = identify(equation(), record, criterion)
    jax.block_until_ready(estimate.covariance)
    return estimate, time.perf_counter() - begin


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--samples", type=int, default=10_000_000)
    parser.add_argument("--test-function", choices=list(WEIGHTS), default="boxcar")
    parser.add_argument("--out", type=Path, help="write the figures as JSON")
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    record = made_record(arguments.samples)
    forget_peak()
    data = memory("VmRSS")
    criterion = RIEC(AllWindows(0.02, 0.5), WEIGHTS[arguments.test_function])
    estimate, first = timed(record, criterion)
    highest = memory("VmHWM")
    _, again = timed(record, criterion)
    worst = max(abs(float(estimate[name]) / value - 1) for name, value in TRUTH.items())
    report = {
        "samples": arguments.samples,
        "signals": len(record.arrays),
        "test_function": arguments.test_function,
        "first_s": round(first, 2),
        "again_s": round(again, 2),
        "data_MiB": round(sum(v.nbytes for v in record.arrays.values()) / MEBIBYTE),
        "peak_above_data_MiB": round(highest - data),
        "largest_relative_error": float(f"{worst:.2g}"),
    }
    text = json.dumps(report, indent=1)
    print(text)
    if arguments.out is not None:
        arguments.out.write_text(text + "\n")


if __name__ == "__main__":
    main()
