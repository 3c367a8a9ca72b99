"""Five machines whose parameters are known, driven by forces that are sums of sines.

Each is simulated by its own equations at `FINE` times the rate of its recordings, so that a fault
that acts before the sampling, such as a delay by half a sample, can be applied where it acts.
"""

import functools
from collections.abc import Mapping
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

import riecjax as rx
from riecjax.criteria.windows import DEFAULT_BAND
from riecjax.models.catalogue import find_model

RATE, SAMPLES = 200, 6000
LEAD, TAIL = 200, 200
"""Samples simulated before the first and after the last that is recorded."""
FINE = 4
TONES = 60


def _sine(signals: Mapping[str, Array]) -> Array:
    return jnp.sin(signals["q"])


PENDULUM = rx.Equation(
    rx.Term("J", "q", derivative=2, measured=("dq",), unit="kg m^2"),
    rx.Term("c", "q", derivative=1, measured=("dq",), unit="N m s"),
    rx.Term("g", _sine, unit="N m"),
    -rx.Term(1.0, "torque"),
    name="pendulum",
    unit="N m",
)
DRY = rx.Equation(
    rx.Term("m", "x", derivative=2, measured=("v",), unit="kg"),
    rx.Term("c", "x", derivative=1, measured=("v",), unit="N s/m"),
    rx.Term("k", "x", unit="N/m"),
    rx.Term("f", rx.odd("v", 0), unit="N"),
    -rx.Term(1.0, "u"),
    name="dry",
    unit="N",
)


class Machine(NamedTuple):
    """A machine, the model that is right for it, and which of its signals are what.

    **Fields:** `model`, by name; `truth`; `drive`, what moves it, with the rms and the lowest and
    highest frequency in hertz of its tones; `position`, `velocity` and `force`; `others`; how
    many `samples` a recording has.
    """

    name: str
    model: str
    truth: Mapping[str, float]
    drive: str
    tones: tuple[float, float, float]
    position: str
    velocity: str
    force: str
    others: tuple[str, ...] = ()
    samples: int = SAMPLES

    @property
    def signals(self) -> tuple[str, ...]:
        """All that is recorded."""
        return (self.position, self.velocity, self.force, *self.others)

    def lasting(self, blocks: int) -> "Machine":
        """With recordings of so many blocks, each of twice the longest window."""
        longest = rx.RIEC.of_band(find_model(self.model).band or DEFAULT_BAND).windows.beta
        return self._replace(samples=round(2 * float(longest) * RATE * blocks))


def _defaults(model: str) -> dict[str, float]:
    return {p.name: p.default for p in find_model(model).parameters if p.default is not None}


MACHINES = {
    machine.name: machine
    for machine in (
        Machine(
            "car",
            "quarter-car",
            _defaults("quarter-car"),
            "v_r",
            (0.35, 0.5, 15.0),
            "x2",
            "x4",
            "F_t",
            ("x1", "x3"),
        ),
        Machine(
            "drag",
            "drag-oscillator",
            _defaults("drag-oscillator"),
            "u",
            (10.0, 0.1, 3.0),
            "x",
            "dx",
            "u",
        ),
        Machine("axis", "emps", _defaults("emps"), "force", (150.0, 0.2, 4.0), "q", "dq", "force"),
        Machine(
            "pendulum",
            f"{__file__}:PENDULUM",
            {"J": 0.4, "c": 0.25, "g": 8.0},
            "torque",
            (2.5, 0.2, 2.0),
            "q",
            "dq",
            "torque",
        ),
        Machine(
            "dry",
            f"{__file__}:DRY",
            {"m": 2.0, "c": 3.0, "k": 200.0, "f": 4.0},
            "u",
            (30.0, 0.3, 5.0),
            "x",
            "v",
            "u",
        ),
    )
}


@functools.lru_cache(maxsize=64)
def motion(
    name: str, seed: int, share: float = 1.0, samples: int = SAMPLES
) -> dict[str, np.ndarray]:
    """A machine's signals without noise, at `FINE` times the recorded rate, `LEAD` samples early.

    `share` scales the drive.
    """
    machine = MACHINES[name]
    rng = np.random.default_rng([seed, list(MACHINES).index(name)])
    rms, low, high = machine.tones
    time = np.arange((LEAD + samples + TAIL) * FINE) / (RATE * FINE)
    frequencies = rng.uniform(low, high, TONES)
    phases = rng.uniform(0, 2 * np.pi, TONES)
    drive = np.zeros(time.size)
    for frequency, phase in zip(frequencies, phases):
        drive += np.sin(2 * np.pi * frequency * time + phase)
    drive *= share * rms * np.sqrt(2 / TONES)
    model = find_model(machine.model)
    system = model.build_system(machine.truth)
    inputs = rx.Record.from_samples({machine.drive: drive}, time_step=1 / (RATE * FINE))
    record = rx.simulate(system, inputs, intersample="smooth").checked().record
    return {signal: np.asarray(record[signal]) for signal in machine.signals}
