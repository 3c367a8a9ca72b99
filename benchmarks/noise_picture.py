"""`docs/images/sensor_noise.png`: bias and error against the level of noise, by method."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

import riecjax as rx
from benchmarks import drag_problem
from benchmarks import noise_problems as problems
from benchmarks.noise_answers import CORRECTS, FEWEST, Run, fit_all, identified
from benchmarks.refinement import refine_all
from riecjax.records.record import stack_records

PICTURE = Path(__file__).parents[1] / "docs" / "images" / "sensor_noise.png"
LEVELS = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.4)


def draw(run: Run) -> dict[str, Any]:
    """Largest bias and error over the parameters of `drag` with velocity, drawn and returned."""
    seeds = max(FEWEST, run.seeds // 4)
    true = np.array(list(drag_problem.TRUTH.values()))
    report: dict[str, Any] = {"levels": LEVELS, "seeds_drawn": seeds, "methods": {}}
    for noise in LEVELS:
        records = [drag_problem.record(seed, noise) for seed in range(seeds)]
        bound = problems.drag_bound(noise, velocity=True)
        for name, estimate in methods().items():
            off = estimate(records) - true
            own = report["methods"].setdefault(name, {"bias": [], "error_over_bound": []})
            own["bias"].append(float(np.max(np.abs(off.mean(axis=0)) / off.std(axis=0))))
            rms = np.sqrt(np.mean(off**2, axis=0))
            own["error_over_bound"].append(float(np.max(rms / bound)))
    picture(report)
    return report


def methods() -> dict[str, Callable[[list[rx.Record]], np.ndarray]]:
    """Estimates of every record, shape `(n, p)`, by method."""
    model = rx.find_model("drag-oscillator")

    def riec(noise: str) -> Callable[[list[rx.Record]], np.ndarray]:
        fit = identified(model, Run(0, noise), intervals=rx.Naive())
        return lambda records: fit_all(records, fit).theta

    def dols(records: list[rx.Record]) -> np.ndarray:
        fit = identified(model, Run(0, "none"), criterion=rx.DOLS(), intervals=rx.Naive())
        return fit_all((rx.differentiate(one, "dx", "ddx") for one in records), fit).theta

    def output_error(records: list[rx.Record]) -> np.ndarray:
        return np.asarray(refine_all(stack_records(records)).theta)

    corrected = {"RIEC, corrected for noise": riec("auto")} if CORRECTS else {}
    return {
        "DOLS, acceleration differentiated": dols,
        "RIEC, uncorrected": riec("none"),
        **corrected,
        "output error": output_error,
    }


def picture(report: dict[str, Any]) -> None:
    percent = 100 * np.array(report["levels"])
    figure, axes = plt.subplots(1, 2, figsize=(9.5, 4.0), layout="constrained")
    styles = dict(zip(report["methods"], ("C3s-", "C1o-", "C0D-", "C2^-")))
    if len(report["methods"]) == 3:
        styles["output error"] = "C2^-"
    for axis, what, title in (
        (axes[0], "bias", "largest |bias| / standard deviation"),
        (axes[1], "error_over_bound", "largest r.m.s. error / Cramér-Rao bound"),
    ):
        for name, own in report["methods"].items():
            axis.loglog(percent, own[what], styles[name], ms=4, lw=1.4, label=name)
        axis.set_xlabel("noise in % of each signal's standard deviation")
        axis.set_title(title, fontsize=10)
        axis.set_xticks([0.1, 1, 10, 40], ["0.1", "1", "10", "40"])
        axis.grid(alpha=0.3)
    noise_floor = 1 / np.sqrt(report["seeds_drawn"])
    axes[0].axhspan(0.03, 2.5 * noise_floor, color="0.9", zorder=0)
    axes[0].text(0.11, 0.037, f"Monte Carlo error, {report['seeds_drawn']} seeds", fontsize=8)
    axes[0].set_ylim(bottom=0.03)
    axes[1].axhline(1, color="0.5", lw=0.8)
    figure.legend(
        *axes[1].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=9
    )
    figure.savefig(PICTURE, dpi=110)
    plt.close(figure)
