"""How much tighter an interval gets by a designed input, promised and confirmed.

    python -m benchmarks.paper input_design [--seeds 128] [--only NAME]

The rival is band-limited white noise of the same r.m.s., up to the same frequency. A state's travel
is limited to the median peak that such noise drives it to; of the noise, only realisations that
keep the limits are taken. Promised are Cramer-Rao bounds. Confirmed is the scatter of what output
error finds in simulated recordings with sensor noise, started 10 % away from the truth.
"""

import argparse
import math
import time
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key

from benchmarks.recorded import FOLDER, write_json
from riecjax.models.oscillators import DragOscillator
from riecjax.models.quarter_car.identification import QuarterCar
from riecjax.records.record import Record
from riecjax.refinement.output_error import OutputError
from riecjax.refinement.refine import refine
from riecjax.simulation.inputs import band_limited_noise, harmonics
from riecjax.simulation.method import FixedStep
from riecjax.simulation.simulate import simulate
from riecjax.simulation.system import AbstractSystem
from riecjax.studies.input_design import design_input, predicted_standard_errors
from riecjax.studies.monte_carlo import over_keys

DRAG = {"m": 1.5, "r": 0.8, "r2": 0.5, "k": 20.0}
QUARTER_CAR = {"K_t": 178e3, "M_us": 23.2, "M_s": 302.7, "K_s": 20.7e3}
DAMPER = (-1200.0, -870.0, 830.0, 1130.0)
DRAWN, TAKEN = 64, 20
"""Realisations of noise that limits are found from, and that a design is compared with."""


class Case(NamedTuple):
    """A rig, and the parameter that matters; the band in Hz, the r.m.s. in the input's unit."""

    name: str
    system: AbstractSystem
    truth: dict[str, float]
    parameter: str
    unit: str
    input: str
    channels: tuple[str, ...]
    sigma: dict[str, float]
    limited: tuple[str, ...]
    band: tuple[float, float]
    lines: int
    sample_count: int
    time_step: float
    rms: float
    method: FixedStep


def drag_oscillator(parameter: str, unit: str) -> Case:
    """20 s of a force of 6 N r.m.s., and a position sensor of 10 mm."""
    return Case(
        f"drag oscillator, {parameter}",
        DragOscillator(**{name: jnp.asarray(value) for name, value in DRAG.items()}),
        DRAG,
        parameter,
        unit,
        "u",
        ("x",),
        {"x": 0.01},
        ("x",),
        (0.1, 3.0),
        30,
        1000,
        0.02,
        6.0,
        FixedStep(2),
    )


def quarter_car() -> Case:
    """10 s on a shaker: sensors of 1 mm, 20 mm/s and 50 N; tyre and suspension travel limited."""
    forces = {f"F_{i}": force for i, force in enumerate(DAMPER, start=1)}
    numbers = {name: jnp.asarray(value) for name, value in (QUARTER_CAR | forces).items()}
    return Case(
        "quarter car, K_s",
        QuarterCar.from_parameters(numbers),
        QUARTER_CAR | {f"F[{i}]": force for i, force in enumerate(DAMPER)},
        "K_s",
        "N/m",
        "v_r",
        ("x2", "x3", "x4", "F_t"),
        {"x2": 1e-3, "x3": 0.02, "x4": 0.02, "F_t": 50.0},
        ("x1", "x2"),
        (0.2, 20.0),
        32,
        1000,
        0.01,
        0.3,
        FixedStep(8),
    )


def noise_record(key: Key[Array, ""], case: Case) -> Record:
    """Band-limited white noise of the case's r.m.s."""
    wave = band_limited_noise(
        key, case.sample_count, case.time_step, bandwidth=case.band[1], rms=case.rms
    )
    return Record({case.input: wave}, case.time_step)


def promised(record: Record, case: Case) -> Array:
    """Cramer-Rao bound of the parameter's standard deviation."""
    return predicted_standard_errors(
        case.system,
        case.truth,
        record,
        channels=case.channels,
        sigma=case.sigma,
        method=case.method,
    )[case.parameter]


def driven(record: Record, case: Case) -> Record:
    """The recording without sensor noise."""
    return simulate(case.system, record, method=case.method).record


def travelled(key: Key[Array, ""], case: Case) -> Array:
    """Peak of each limited state under noise."""
    quiet = driven(noise_record(key, case), case)
    return jnp.stack([jnp.max(jnp.abs(quiet[name])) for name in case.limited])


def estimated(key: Key[Array, ""], quiet: Record, case: Case) -> tuple[Array, Array]:
    """The parameter from one recording with sensor noise; whether the search converged."""
    keys = jax.random.split(key, len(case.channels))
    arrays = {case.input: quiet[case.input]}
    for name, own in zip(case.channels, keys):
        error = case.sigma[name] * jax.random.normal(own, (case.sample_count,))
        arrays[name] = quiet[name] + error
    by = OutputError(
        channels=case.channels, sigma=case.sigma, method=case.method, intersample="lines"
    )
    start = {name: 1.1 * value for name, value in case.truth.items()}
    fit = refine(case.system, Record(arrays, case.time_step), start, by)
    return fit[case.parameter], fit.converged


def confirmed(
    record: Record, case: Case, key: Key[Array, ""], seeds: int
) -> tuple[np.ndarray, int]:
    """Errors of the parameter over sensor noise, and how many searches did not converge."""
    quiet = driven(record, case)
    found, converged = over_keys(estimated, key, seeds, quiet, case, chunk=min(32, seeds))
    errors = np.asarray(found) - case.truth[case.parameter]
    return errors, int(jnp.sum(~converged))


def scatter(errors: np.ndarray) -> float:
    """Standard deviation about the truth, without the bias that its root has of few errors."""
    n = errors.size
    short = math.sqrt(2 / n) * math.exp(math.lgamma((n + 1) / 2) - math.lgamma(n / 2))
    return float(np.sqrt(np.mean(errors**2))) / short


def cases() -> tuple[Case, ...]:
    return drag_oscillator("r2", "N s^2/m^2"), drag_oscillator("r", "N s/m"), quarter_car()


def accepted_noise(case: Case) -> tuple[dict[str, float], list[Record], float]:
    """Limits of travel, noise that keeps them, and the share that does."""
    keys = jax.random.split(jax.random.key(100), 4 * DRAWN)
    peaks = np.asarray(jax.jit(jax.vmap(lambda key: travelled(key, case)))(keys))
    limits = np.median(peaks[:DRAWN], axis=0)
    kept = np.flatnonzero((peaks <= limits).all(axis=1))
    records = [noise_record(keys[i], case) for i in kept[:TAKEN]]
    assert len(records) == TAKEN
    return dict(zip(case.limited, map(float, limits))), records, len(kept) / len(keys)


def run(case: Case, seeds: int) -> dict[str, Any]:
    """Both inputs, promised and confirmed."""
    limits, noise, share = accepted_noise(case)
    began = time.perf_counter()
    design = design_input(
        case.system,
        case.truth,
        case.parameter,
        frequencies=harmonics(
            case.sample_count,
            case.time_step,
            lowest=case.band[0],
            highest=case.band[1],
            count=case.lines,
        ),
        sample_count=case.sample_count,
        time_step=case.time_step,
        rms=case.rms,
        travel=limits,
        channels=case.channels,
        sigma=case.sigma,
        key=jax.random.key(0),
        method=case.method,
    )
    seconds = time.perf_counter() - began
    key = jax.random.key(7)
    own, own_lost = confirmed(design.record, case, key, seeds)
    bound = jax.jit(lambda record: promised(record, case))
    of_noise = np.array([float(bound(record)) for record in noise])
    each = max(-(-seeds // TAKEN), 8)
    runs = [
        confirmed(record, case, jax.random.fold_in(key, i), each) for i, record in enumerate(noise)
    ]
    rival = float(np.mean([scatter(errors) for errors, _ in runs]))
    tight = scatter(own)
    return {
        "parameter": case.parameter,
        "value": case.truth[case.parameter],
        "unit": case.unit,
        "rms": float(design.rms),
        "limits": limits,
        "peaks": {name: float(peak) for name, peak in design.peaks.items()},
        "noise_that_keeps_the_limits": share,
        "status": design.reason,
        "design": {
            "promised": float(design.standard_error),
            "confirmed": tight,
            "mean_error": float(np.mean(own)),
            "seeds": seeds,
            "not_converged": own_lost,
        },
        "white_noise": {
            "promised": float(of_noise.mean()),
            "promised_least": float(of_noise.min()),
            "confirmed": rival,
            "realisations": TAKEN,
            "seeds": TAKEN * each,
            "not_converged": sum(lost for _, lost in runs),
        },
        "tighter_promised": 1 - float(design.standard_error) / float(of_noise.mean()),
        "tighter_confirmed": 1 - tight / rival,
        "starts": [float(value) for value in design.starts],
        "frequencies": np.round(np.asarray(design.frequencies), 6).tolist(),
        "amplitudes": np.asarray(design.amplitudes).tolist(),
        "phases": np.asarray(design.phases).tolist(),
        "design_seconds": round(seconds, 1),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=128, help="recordings of the design")
    parser.add_argument("--only", help="name of one case")
    parser.add_argument("--out", type=Path, default=FOLDER / "input_design.json")
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    results = {}
    print(f"{'standard deviation of':<22}{'white noise':>24}{'design':>24}{'tighter':>22}")
    print(f"{'':<22}{'promised':>12}{'confirmed':>12}", end="")
    print(f"{'promised':>12}{'confirmed':>12}{'promised':>11}{'confirmed':>11}")
    for case in cases():
        if arguments.only not in (None, case.name):
            continue
        found = results[case.name] = run(case, arguments.seeds)
        noise, design = found["white_noise"], found["design"]
        print(
            f"{case.name:<22}{noise['promised']:>12.4g}{noise['confirmed']:>12.4g}"
            f"{design['promised']:>12.4g}{design['confirmed']:>12.4g}"
            f"{100 * found['tighter_promised']:>9.0f} %{100 * found['tighter_confirmed']:>9.0f} %"
            f"   ({found['status']}, {found['design_seconds']:.0f} s)",
            flush=True,
        )
        write_json(arguments.out, results)


if __name__ == "__main__":
    main()
