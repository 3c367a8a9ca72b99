"""Print what the README says of measured recordings: `python -m benchmarks.measured`."""

import os
from pathlib import Path

import jax

from benchmarks.measured import emps_closed_loop, silverbox
from riecjax.criteria.bump import Bump
from riecjax.criteria.test_functions import Hat
from riecjax.records.preparation import upsample

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


def print_emps() -> None:
    rig = emps_closed_loop.load_rig(DATA / "emps")
    print("EMPS under its controller, relative error in %: q, dq, ddq, force")
    print(f"  {'benchmark, published':<36}", *emps_closed_loop.PUBLISHED.values())
    for name, axis in emps_closed_loop.identified_axes(rig).items():
        record = emps_closed_loop.sampled(rig, axis, delay=0)
        found = emps_closed_loop.errors(rig, record)
        print(f"  {name:<36}", *(f"{error:7.4f}" for error in found.values()))


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    print_silverbox()
    print_emps()
