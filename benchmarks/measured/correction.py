"""What quadrature and the correction for noise do to answers of measured recordings, step by step.

    python -m benchmarks.measured.correction

Prints the table of docs/sensor_noise.md: values and standard errors of trapezoids with nothing
taken off, as identified before; of fourth order; with the noise taken off; and by default, which
takes other windows where no sensor measured the velocity.
"""

from collections.abc import Mapping, Sequence

import scipy.io

import riecjax as rx
from benchmarks.measured import silverbox
from benchmarks.measured.__main__ import DATA
from benchmarks.measured.emps_closed_loop import load_rig
from riecjax.models.emps import emps_equation
from riecjax.models.oscillators import duffing_equation, pendulum_equation
from riecjax.records.preparation import differentiate, upsample

BAND = rx.AllWindows(0.05, 0.5)
STEPS = ("trapezoids", "fourth order", "noise taken off", "by default")
Fits = Mapping[str, rx.Estimate]


def emps() -> Fits:
    """The axis by its position, the velocity by central differences but for the last."""
    rig = load_rig(DATA / "emps")
    force = rig.gain * rig.voltage
    record = rx.Record.from_samples({"q": rig.position, "force": force}, time_step=1e-3)
    return _of_positions(emps_equation(), [record], "q", "dq")


def pendulum() -> Fits:
    """Four records of an angle."""
    file = DATA / "pendulum_single" / "SinglePendulumDataForParameterEstimation.mat"
    angles = [piece[0] for piece in scipy.io.loadmat(file)["Y_id"].ravel()]
    records = [rx.Record.from_samples({"theta": angle}, time_step=1e-3) for angle in angles]
    return _of_positions(pendulum_equation(), records, "theta", "dtheta")


def _of_positions(
    equation: rx.Equation, records: Sequence[rx.Record], position: str, velocity: str
) -> Fits:
    # Noise goes through differences as well: judged of the position, before.
    judged = [rx.records.judged(record) for record in records]
    derived = [differentiate(record, position, velocity) for record in judged]
    plain = {"trapezoids": rx.Boxcar(2), "fourth order": rx.Boxcar()}
    fits = {
        name: rx.identify(equation, derived, rx.RIEC(BAND, weight), noise="none")
        for name, weight in plain.items()
    }
    fits["noise taken off"] = rx.identify(equation, derived, rx.RIEC(BAND, rx.Boxcar()))
    return fits | {"by default": rx.identify(equation, records)}


def silverbox_fits() -> Fits:
    """The train slice, eight times upsampled, by hats of its own band."""
    train = silverbox.load_silverbox(DATA / "silverbox").part(*silverbox.TRAIN)
    fine = upsample(rx.records.judged(train), silverbox.FACTOR)
    windows = rx.AllWindows(0.006, 0.026)

    def fit(order: int, noise: rx.records.GivenNoise) -> rx.Estimate:
        return rx.identify(duffing_equation(), fine, rx.RIEC(windows, rx.Hat(order)), noise=noise)

    return {
        "trapezoids": fit(2, "none"),
        "fourth order": fit(4, "none"),
        "noise taken off": fit(4, "auto"),
    }


def table(name: str, fits: Fits) -> str:
    """In Markdown, a line for each parameter."""
    lines = []
    for parameter in next(iter(fits.values())).parameters:
        cells = [_cell(fits[step], parameter) if step in fits else "-" for step in STEPS]
        lines.append(f"| {name} {parameter} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _cell(estimate: rx.Estimate, parameter: str) -> str:
    error = float(estimate.standard_error(parameter))
    return f"{float(estimate[parameter]):.5g} +- {error:.2g}"


if __name__ == "__main__":
    rx.start_jax()
    print(f"| | {' | '.join(STEPS)} |\n| {' | '.join(['---'] * (1 + len(STEPS)))} |")
    for name, fits in (("EMPS", emps), ("pendulum", pendulum), ("Silverbox", silverbox_fits)):
        print(table(name, fits()), flush=True)
