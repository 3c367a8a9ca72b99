"""The test problem that peers were measured on, refined: `python -m benchmarks.speed refinement`.

m x'' + r x' + r2 x'|x'| + k x = u from (1, 1, 1, 10), 5 % noise on position and velocity: root mean
square errors over 100 noise seeds against the Cramer-Rao bound, standard errors, seconds warm and
vmapped, beside SciPy with a fair step. Written to benchmarks/refinement.json.
"""

import json
import time
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np
from tests.machines import DRAG
from tests.machines import DRAG_BOUND as BOUND
from tests.machines import DRAG_START as START
from tests.machines import DRAG_TRUTH as TRUTH
from tests.machines import drag_oscillator as oscillator
from tests.machines import drag_record as record

from benchmarks.recorded import FOLDER, write_json
from benchmarks.speed.baselines import scipy_drag
from riecjax.records.record import Record, stack_records
from riecjax.refinement.output_error import OutputError
from riecjax.refinement.refine import Refined, refine
from riecjax.runtime import start_jax
from riecjax.simulation.method import FixedStep

# One step between samples: the oscillator turns by 0.04 rad.
METHOD = FixedStep(1)


@eqx.filter_jit
def refine_all(batch: Record) -> Refined:
    def one(arrays: dict[str, jax.Array]) -> Refined:
        return refine(
            oscillator(), Record(arrays, DRAG.shape.step), START, OutputError(method=METHOD)
        )

    return jax.vmap(one)(batch.arrays)


def statistics(found: Refined) -> dict[str, Any]:
    truth, bound = (np.array(list(values.values())) for values in (TRUTH, BOUND))
    off = np.asarray(found.theta) / truth - 1
    errors = np.asarray(jax.vmap(lambda r: r.standard_errors)(found)) / truth
    return {
        name: {
            "rms_error_over_bound": float(np.sqrt(np.mean(off[:, i] ** 2)) / bound[i]),
            "mean_std_error_over_bound": float(np.mean(errors[:, i]) / bound[i]),
            "scatter_of_std_error": float(np.std(errors[:, i]) / np.mean(errors[:, i])),
            "median_error_percent": float(100 * np.median(np.abs(off[:, i]))),
        }
        for i, name in enumerate(TRUTH)
    }


def warm(repeats: int = 9) -> float:
    refine(oscillator(), record(0), START)
    seconds = []
    for seed in range(1, repeats + 1):
        own = record(seed)
        began = time.perf_counter()
        jax.block_until_ready(refine(oscillator(), own, START).theta)
        seconds.append(time.perf_counter() - began)
    return float(np.median(seconds))


def by_scipy(seed: int = 1) -> tuple[float, list[float]]:
    """Seconds and values of `least_squares` over RK45, its step far above the solver's noise."""
    own = record(seed)
    t, x, v, u = (np.asarray(values) for values in (own.time, own["x"], own["dx"], own["u"]))
    began = time.perf_counter()
    found = scipy_drag.fit(t, x, v, u)
    return time.perf_counter() - began, [found[name] for name in TRUTH]


def main(out: Path = FOLDER / "refinement.json") -> None:
    start_jax()
    batch = stack_records([record(seed) for seed in range(100)])
    jax.block_until_ready(refine_all(batch).theta)
    began = time.perf_counter()
    found = jax.block_until_ready(refine_all(batch))
    vmapped = time.perf_counter() - began
    single = refine(oscillator(), record(1), START)
    seconds, values = by_scipy()
    document = {
        "parameters": statistics(found),
        "all_converged": bool(np.all(np.asarray(jax.vmap(lambda r: r.converged)(found)))),
        "seconds": {"warm": warm(), "vmapped_100": vmapped, "scipy": seconds},
        "seed_1": {"refined": [float(v) for v in single.theta], "scipy": values},
    }
    write_json(out, document)
    print(json.dumps(document, indent=2))
