"""Measured recordings: the terms that are found there, and simulations before and after.

Each search starts from a model without them, and is told nothing.
"""

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy.io

import riecjax as rx
from benchmarks.measured import emps_closed_loop, silverbox, silverbox_refined
from riecjax.discovery.discover import Discovery
from riecjax.equations.bases import AbstractShape
from riecjax.equations.model import as_model
from riecjax.records.preparation.resampling import upsample
from riecjax.refinement.output_error import OutputError, Tiles
from riecjax.reporting.discovery import sentence
from riecjax.simulation.method import FixedStep
from riecjax.simulation.system import AbstractSystem
from riecjax.validation.residuals import residual_tests

EXACT = (0.005, 1e-6)
"""Least shares of a term in the circuit, which is measured more exactly than machines are."""
MR_TRAIN = 1000
"""Samples of the damper's 1501 that the search reads."""


def told(found: Discovery) -> dict[str, Any]:
    """What was found, in words and numbers."""
    return {
        "sentence": sentence(found),
        "terms": [one.candidate.meaning for one in found.chosen],
        "values": {name: float(found.estimate[name]) for name in found.estimate.parameters},
        "widths": {one.candidate.name: one.width for one in found.chosen if one.width is not None},
    }


def silverbox_found(data: Path) -> dict[str, Any]:
    """A mass under a voltage; then all by output error on the training slice, as it was found."""
    record = silverbox.load_silverbox(data / "silverbox")
    fine = upsample(record, silverbox.FACTOR)
    train = record.part(*silverbox.TRAIN)
    start = rx.Equation(
        rx.Term("m", "y", derivative=2, measured=("dy",)), -rx.Term(1.0, "u"), name="circuit"
    )
    finer = rx.differentiate(upsample(train, silverbox.FACTOR // 2), "y", "dy")
    model = rx.Model("circuit", "", stages=start, band=(20, 150))
    found = rx.discover(model, finer, least=EXACT[0], smallest=EXACT[1])
    identified = told(found)["values"]
    widths = {f"{name}_width": width for name, width in told(found)["widths"].items()}
    values = {**identified, **widths}
    tiles = Tiles(samples=silverbox_refined.WINDOW * silverbox.FACTOR)
    by = OutputError(tiles, channels=("y",), method=FixedStep(1))
    build = _by_widths(found)
    fitted = silverbox_refined.slice_of(fine, *silverbox.TRAIN)
    fitted = silverbox_refined.as_recorded(fitted)
    # Widths last: of coefficients that are far off, a width may run away.
    nearer = rx.refine(build, fitted, identified, by, known=widths)
    begun = {**{name: float(nearer[name]) for name in identified}, **widths}
    refined = rx.refine(build, fitted, begun, by)
    after = {name: float(refined[name]) for name in values}
    return {
        **told(found),
        "identified_mV": _scores(build, values, fine),
        "refined_mV": _scores(build, after, fine),
        "refined": after,
        "parameters": len(values),
    }


def _shaped(model: rx.Model) -> list[tuple[str, AbstractShape]]:
    """Laws with a width, by name."""
    every = (term for equation in model.equations for term in equation.terms)
    named = [(str(term.name), term.basis) for term in every if term.basis is not None]
    return [(name, basis) for name, basis in named if isinstance(basis, AbstractShape)]


def _by_widths(found: Discovery) -> Callable[[Mapping[str, Any]], AbstractSystem]:
    """The system of what was found, of its coefficients and widths."""
    model = found.model

    def build(values: Mapping[str, Any]) -> AbstractSystem:
        widths = [values[f"{name}_width"] for name, _ in _shaped(model)]
        fitted = model
        if widths:
            fitted = eqx.tree_at(lambda p: [basis.width for _, basis in _shaped(p)], model, widths)
        return rx.equation_system(fitted, {name: values[name] for name in model.parameter_names})

    return build


def _scores(
    build: Callable[[Mapping[str, Any]], AbstractSystem],
    values: Mapping[str, float],
    fine: rx.Record,
) -> dict[str, float]:
    system = build({name: jnp.asarray(value) for name, value in values.items()})
    return {
        name: silverbox_refined.score(system, fine, *ends)
        for name, ends in silverbox.SLICES.items()
    }


def emps_found(data: Path) -> dict[str, Any]:
    """A mass under the drive's force; its friction is found, and the axis runs in its loop."""
    rig = emps_closed_loop.load_rig(data / "emps")
    record = rx.Record({"q": rig.position, "force": rig.gain * rig.voltage}, emps_closed_loop.STEP)
    record = rx.differentiate(record, "q", "dq")
    inertia = rx.Term("M", "q", derivative=2, measured=("dq",), unit="kg")
    start = rx.Equation(inertia, -rx.Term(1.0, "force"), name="axis", unit="N")
    found = rx.discover(start, record, criterion=rx.RIEC(rx.AllWindows(0.01, 0.1)))
    alone = rx.identify(start, record, rx.RIEC(rx.AllWindows(0.01, 0.1)))
    return {
        **told(found),
        "loop_before": _loop(rig, start, alone),
        "loop_after": _loop(rig, found.model, found.estimate),
    }


def _loop(
    rig: emps_closed_loop.Rig, model: rx.Equation | rx.Model, estimate: rx.Estimate
) -> dict[str, float]:
    """Errors in percent of the axis under its controller, which knows its position and velocity."""
    axis = rx.equation_system(model, estimate.values)
    if unknown := {*axis.state_names} - {"q", "dq"}:
        raise ValueError(f"the loop has no {', '.join(sorted(unknown))}")
    return emps_closed_loop.errors(rig, emps_closed_loop.sampled(rig, axis, delay=0))


def pendulum_found(data: Path) -> dict[str, Any]:
    """A swinging arm with viscous friction; the last recording is held out, and simulated."""
    file = scipy.io.loadmat(
        data / "pendulum_single" / "SinglePendulumDataForParameterEstimation.mat"
    )
    angles = [one[0].ravel() for one in file["Y_id"].ravel()]
    records = [
        rx.differentiate(rx.Record.from_samples({"theta": a}, time_step=1e-3), "theta", "dtheta")
        for a in angles
    ]
    model = rx.find_model("pendulum")
    found = rx.discover(model, records[:-1])
    before = rx.identify(model, records[:-1])
    return {
        **told(found),
        "simulated_before": _swings(model, before, records[-1]),
        "simulated_after": _swings(found.model, found.estimate, records[-1]),
    }


def _swings(model: rx.Model, estimate: rx.Estimate, record: rx.Record) -> float:
    """Relative error in percent of a simulation from the recording's first state."""
    values = {name: float(estimate[name]) for name in estimate.values}
    at = {name: float(record[name][0]) for name in ("theta", "dtheta")}
    system = rx.equation_system(model, values)
    run = rx.simulate(system, record, method=FixedStep(4), initial_state=at)
    theta = np.asarray(record["theta"])
    return 100 * float(np.linalg.norm(run.record["theta"] - theta) / np.linalg.norm(theta))


def damper_found(data: Path) -> dict[str, Any]:
    """A damper as a curve over velocity; its force is predicted behind what the search reads."""
    file = scipy.io.loadmat(data / "mr_damper_labcontrol" / "data_simulation_4.4_MRdamper.mat")
    moved, force = file["x_F"][:, 0], file["x_F"][:, 2]
    record = rx.Record.from_samples(
        {"x": moved, "F": force}, time_step=0.01, units={"x": "mm", "F": "N"}
    )
    record = rx.differentiate(record, "x", "v")
    reach = float(np.max(np.abs(np.asarray(record["v"]))))
    curve = rx.Terms("F", rx.roof([-reach, -0.4 * reach, 0.4 * reach, reach]), "v", unit="N")
    start = rx.Equation(curve, -rx.Term(1.0, "F"), name="damper", unit="N")
    windows = rx.RIEC(rx.AllWindows(0.02, 0.1))
    train, rest = record.part(0, MR_TRAIN), record.part(MR_TRAIN, record.sample_count)
    alone = rx.identify(start, train, windows)
    found = rx.discover(start, train, criterion=windows)
    return {
        **told(found),
        "finding": [
            f.message for f in rx.assess(start, train, windows).findings() if f.code == "hysteresis"
        ],
        "held_out_before": _left(start, alone, rest, record),
        "held_out_after": _left(found.model, found.estimate, rest, record),
    }


def _left(model: Any, estimate: rx.Estimate, rest: rx.Record, whole: rx.Record) -> float:
    """Error of the force in percent of it, on what was not read, states known from before."""
    (equation,) = residual_tests(as_model(model), whole, dict(estimate.values)).equations
    error, target = (np.asarray(of) for of in (equation.error.error, equation.error.target))
    late = np.asarray(equation.error.times) > float(rest.start_time)
    return 100 * math.sqrt(np.sum(error[late] ** 2) / np.sum(target[late] ** 2))


MEASURED = {
    "silverbox": silverbox_found,
    "emps": emps_found,
    "pendulum": pendulum_found,
    "mr_damper": damper_found,
}
