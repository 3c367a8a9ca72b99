"""Print what docs/measured.md says of measured recordings: `python -m benchmarks.measured`."""

import os
from pathlib import Path

import jax

from benchmarks.measured import emps_closed_loop, silverbox, silverbox_refined
from riecjax.criteria.test_functions import Bump, Hat
from riecjax.criteria.windows import AllWindows
from riecjax.records.preparation.resampling import upsample

DATA = Path(os.environ.get("RIECJAX_DATA", Path(__file__).parents[3] / "shared" / "data"))


def print_silverbox() -> None:
    record = silverbox.load_silverbox(DATA / "silverbox")
    fine = upsample(record, silverbox.FACTOR)
    train = record.part(*silverbox.TRAIN)
    finer = upsample(train, silverbox.FACTOR)
    print("Silverbox, simulation error in mV:", ", ".join(silverbox.SLICES))
    for name, data, weight in (
        ("raw samples, hat, trapezoids", train, Hat(2)),
        ("raw samples, hat, quadrature 8", train, Hat(8)),
        ("up-sampled by 8, hat, trapezoids", finer, Hat(2)),
        ("up-sampled by 8, hat, quadrature 4", finer, Hat(4)),
        ("up-sampled by 8, bump 4", finer, Bump(4)),
    ):
        estimate = silverbox.estimate_from(data, weight)
        scores = [silverbox.score(estimate, fine, *ends) for ends in silverbox.SLICES.values()]
        mass = float(estimate["m"])
        print(f"  {name:<36}", *(f"{score:7.3f}" for score in scores), f"  m {mass:.4g}")


def print_silverbox_refined() -> None:
    record = silverbox.load_silverbox(DATA / "silverbox")
    fine = upsample(record, silverbox.FACTOR)
    finer = upsample(record.part(*silverbox.TRAIN), silverbox.FACTOR)
    estimate = silverbox.estimate_from(finer, Hat(4))
    start = {name: float(value) for name, value in estimate.values.items()}
    print("Silverbox refined, train r.m.s. and simulation error in mV, seconds of the fit")
    plain = None
    for name, (refined, seconds) in silverbox_refined.models(fine, start):
        values = {n: float(v) for n, v in refined.values.items()}
        plain = values if plain is None else plain
        scores = [
            silverbox_refined.score(silverbox_refined.circuit(values), fine, *ends)
            for ends in silverbox.SLICES.values()
        ]
        train = 1e3 * float(refined.search.rms[0])
        print(f"  {name:<28}", *(f"{s:7.4f}" for s in (train, *scores)), f"{seconds:6.1f} s")
        for parameter in refined.parameters:
            error = float(refined.standard_error(parameter))
            print(f"    {parameter:<4} {values[parameter]:.5g} +- {error:.1g}")
    print("  damping of the plain model on parts of the arrow: r.m.s. of y / mV, change / %")
    for amplitude, change, error in silverbox_refined.damping_over_amplitude(
        fine, plain or {}, silverbox.SLICES["arrow"]
    ):
        print(f"    {amplitude:6.1f}  {change:+.2f} +- {error:.2f}")


def print_emps() -> None:
    rig = emps_closed_loop.load_rig(DATA / "emps")
    print("EMPS under its controller, relative error in %: q, dq, ddq, force")
    print(f"  {'benchmark, published':<36}", *emps_closed_loop.PUBLISHED.values())
    for name, axis in emps_closed_loop.identified_axes(rig).items():
        record = emps_closed_loop.sampled(rig, axis, delay=0)
        found = emps_closed_loop.errors(rig, record)
        print(f"  {name:<36}", *(f"{error:7.4f}" for error in found.values()))
    for alpha, beta in ((0.05, 0.5), (0.02, 0.2), (0.005, 0.05)):
        refined, axis = emps_closed_loop.refined_axis(rig, AllWindows(alpha, beta))
        found = emps_closed_loop.errors(rig, emps_closed_loop.sampled(rig, axis, delay=0))
        name = f"refined, windows {alpha} to {beta} s"
        print(f"  {name:<36}", *(f"{error:7.4f}" for error in found.values()))
        for parameter in ("M", "Fc_pos", "excess", "vs"):
            low, high = refined.interval(parameter)
            print(f"    {parameter:<7} {float(refined[parameter]):8.4g}  {low:.4g} .. {high:.4g}")


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    print_silverbox()
    print_silverbox_refined()
    print_emps()
