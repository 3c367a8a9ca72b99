"""Faults of sensors, cables and loggers, each in three sizes, and the codes that name them.

A fault acts on a logger: before the sampling on the signals themselves or on the times at which
they are sampled, or after it on the samples, noise included.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy.interpolate
import scipy.signal

from benchmarks.recovery.machines import FINE, LEAD, RATE, Machine, motion

Rows = dict[str, np.ndarray]
SEVERITIES = ("mild", "middle", "severe")


class Logger:
    """A machine's recording in the making.

    **Fields:** `fine`, the signals; `times` in samples at which each is sampled; `noise`, the
    standard deviation of each; `rows`, what is logged; `rng` of the fault's own chance.
    """

    def __init__(self, machine: Machine, seed: int, noise: float, share: float = 1.0):
        self.machine, self.samples = machine, machine.samples
        self.fine = dict(motion(machine.name, seed, share, self.samples))
        self.times = {name: np.arange(self.samples, dtype=float) for name in self.fine}
        self.noise = {name: noise * float(np.std(row)) for name, row in self.fine.items()}
        self.rows: Rows = {}
        self.seed = seed
        self.rng = np.random.default_rng([seed, 7])

    def sample(self) -> None:
        """Sample every signal at its times, with noise that no fault changes."""
        rng = np.random.default_rng([self.seed, 1])
        at = np.arange(self.fine[self.machine.force].size) / FINE - LEAD
        for name, values in self.fine.items():
            exact = scipy.interpolate.make_interp_spline(at, values, 3)(self.times[name])
            self.rows[name] = exact + self.noise[name] * rng.standard_normal(self.samples)

    def deviation(self, name: str) -> float:
        """Standard deviation of a signal in motion."""
        return float(np.std(self.fine[name]))


Act = Callable[[Logger, str, Any], None]


class Fault(NamedTuple):
    """A fault of one signal: what it does to a logger, its sizes, and the codes that name it.

    **Fields:** `on`: position, velocity, force, or empty for all; `before` the sampling or behind
    it; `machines` that can have it, all if empty; `again`: what a second recording is made of.
    """

    act: Act
    on: str
    sizes: tuple[Any, ...]
    codes: tuple[str, ...]
    before: bool = False
    machines: tuple[str, ...] = ()

    def severities(self) -> dict[str, Any]:
        """Size of each severity; a fault that is there or not is severe."""
        return dict(zip(SEVERITIES[-len(self.sizes) :], self.sizes))


# Before the sampling.


def late(log: Logger, name: str, samples: float) -> None:
    log.times[name] -= samples


def low_passed(log: Logger, name: str, samples: float) -> None:
    """A first-order filter with this time constant, settled before the recording begins."""
    # By the trapezoidal rule, which delays slow motion by the time constant exactly.
    width = 2 * samples * FINE
    weights = np.ones(2) / (1 + width), [1.0, (1 - width) / (1 + width)]
    start = scipy.signal.lfilter_zi(*weights) * log.fine[name][0]
    log.fine[name] = scipy.signal.lfilter(*weights, log.fine[name], zi=start)[0]


def times(log: Logger, name: str, factor: float) -> None:
    log.fine[name] = factor * log.fine[name]
    log.noise[name] *= abs(factor)


def offset(log: Logger, name: str, share: float) -> None:
    log.fine[name] = log.fine[name] + share * log.deviation(name)


def drift(log: Logger, name: str, share: float) -> None:
    ramp = np.arange(log.fine[name].size) / (log.samples * FINE) - 0.5
    log.fine[name] = log.fine[name] + share * log.deviation(name) * ramp


def rows_lost(log: Logger, name: str, count: int) -> None:
    for each in [name] if name else log.times:
        log.times[each][int(0.4 * log.samples) :] += count


def other_clock(log: Logger, name: str, ppm: float) -> None:
    log.times[name] *= 1 + 1e-6 * ppm


def hum(log: Logger, name: str, share: float) -> None:
    """A little off 50 Hz, as the mains are."""
    time = np.arange(log.fine[name].size) / (RATE * FINE)
    line = np.sin(2 * np.pi * 50.02 * time + 1.0)
    log.fine[name] = log.fine[name] + np.sqrt(2) * share * log.deviation(name) * line


# Behind it.


def quantised(log: Logger, name: str, bits: int) -> None:
    values = log.rows[name]
    step = 2.0 * np.max(np.abs(values)) / 2**bits
    log.rows[name] = step * np.round(values / step)


def clipped(log: Logger, name: str, share: float) -> None:
    limit = share * np.max(np.abs(log.rows[name]))
    log.rows[name] = np.clip(log.rows[name], -limit, limit)


def spikes(log: Logger, name: str, deviations: float) -> None:
    """On one sample of a hundred, of either sign."""
    where = log.rng.choice(log.samples, log.samples // 100, replace=False)
    log.rows[name][where] += deviations * log.noise[name] * log.rng.choice([-1, 1], where.size)


def huge_spike(log: Logger, name: str, size: float) -> None:
    log.rows[name][log.samples // 3] = size


def stuck(log: Logger, name: str, seconds: float) -> None:
    begin = int(0.6 * log.samples)
    log.rows[name][begin : begin + int(seconds * RATE)] = log.rows[name][begin]


def held(log: Logger, name: str, samples: int) -> None:
    """A message that comes once in so many rows."""
    log.rows[name] = np.repeat(log.rows[name][::samples], samples)[: log.samples]


def dropouts(log: Logger, name: str, samples: int) -> None:
    """At 20 places, to what a logger writes for none: zero of a position, else the value before."""
    for place in (log.samples // 20) * np.arange(20) + log.rng.integers(0, log.samples // 40, 20):
        zero = name == log.machine.position
        log.rows[name][place : place + samples] = 0.0 if zero else log.rows[name][place]


def copied(log: Logger, name: str, factor: float) -> None:
    """The position's column instead, or a multiple of it to seven digits."""
    values = factor * log.rows[log.machine.position]
    log.rows[name] = values if factor == 1 else np.float32(values).astype(float)


def silent(log: Logger, name: str, level: float | None) -> None:
    """A constant, or noise alone."""
    noise = log.noise[name] * log.rng.standard_normal(log.samples)
    log.rows[name] = noise if level is None else np.full(log.samples, level)


def gaps(log: Logger, name: str, share: float) -> None:
    """Stretches of 20 samples."""
    starts = log.rng.choice(log.samples // 20, round(share * log.samples / 20), replace=False) * 20
    for start in starts:
        log.rows[name][start : start + 20] = np.nan


def nothing(log: Logger, name: str, size: Any) -> None:
    """A fault of the motion or of what is given, see `duplicates` and `drives`."""


ZERO = ("wrong_zero", "uneven_errors", "constant_target")
GAIN = ("wrong_gain", "not_its_derivative", "unit_mismatch")
FAULTS = {
    "late velocity": Fault(late, "velocity", (0.5, 1, 3), ("late_signal",), True),
    "late force": Fault(late, "force", (0.5, 1, 3), ("late_signal",), True),
    "low-passed velocity": Fault(
        low_passed, "velocity", (0.5, 1, 3), ("low_passed", "late_signal"), True
    ),
    "low-passed force": Fault(
        low_passed, "force", (0.5, 1, 3), ("low_passed", "late_signal"), True
    ),
    "gain of velocity": Fault(times, "velocity", (1.02, 1.05, 1.2), GAIN, True),
    "sign of velocity": Fault(times, "velocity", (-1,), GAIN, True),
    "sign of force": Fault(times, "force", (-1,), ("negative_value",), True),
    "unit of velocity": Fault(times, "velocity", (0.3048, 3.6, 1000), GAIN, True),
    "unit of position": Fault(times, "position", (0.3048, 57.3, 1000), GAIN, True),
    "offset of velocity": Fault(offset, "velocity", (0.05, 0.2, 1), ("velocity_offset",), True),
    "zero of position": Fault(
        offset,
        "position",
        (0.3, 3, 30),
        ZERO,
        True,
        # The car's damper map takes up any constant force: where its own zero is, nothing tells.
        ("drag", "axis", "pendulum", "dry"),
    ),
    "zero of force": Fault(
        offset,
        "force",
        (0.1, 1, 10),
        ZERO,
        True,
        # The axis has a constant term, which is that of its zero.
        ("car", "drag", "pendulum", "dry"),
    ),
    "drift of velocity": Fault(
        drift, "velocity", (0.1, 0.5, 2), ("drifting_signal", "velocity_offset"), True
    ),
    "drift of force": Fault(drift, "force", (0.1, 0.5, 2), ("drifting_signal",), True),
    "rows lost of velocity": Fault(rows_lost, "velocity", (1, 3, 20), ("lost_rows",), True),
    "rows lost of force": Fault(rows_lost, "force", (1, 3, 20), ("lost_rows",), True),
    "rows lost of all": Fault(rows_lost, "", (5, 20, 100), ("lost_rows",), True),
    "clock of velocity": Fault(other_clock, "velocity", (20, 100, 500), ("two_clocks",), True),
    "clock of force": Fault(other_clock, "force", (20, 100, 500), ("two_clocks",), True),
    "hum in velocity": Fault(hum, "velocity", (0.01, 0.05, 0.2), ("hum",), True),
    "hum in force": Fault(hum, "force", (0.01, 0.05, 0.2), ("hum",), True),
    "bits of position": Fault(quantised, "position", (10, 8, 6), ("quantised",)),
    "bits of velocity": Fault(quantised, "velocity", (10, 8, 6), ("quantised",)),
    "bits of force": Fault(quantised, "force", (10, 8, 6), ("quantised",)),
    "clipped velocity": Fault(clipped, "velocity", (0.95, 0.9, 0.8), ("clipped",)),
    "clipped force": Fault(clipped, "force", (0.95, 0.9, 0.8), ("clipped",)),
    "spikes in position": Fault(spikes, "position", (10, 20, 1000), ("outliers",)),
    "spikes in velocity": Fault(spikes, "velocity", (10, 20, 1000), ("outliers",)),
    "spikes in force": Fault(spikes, "force", (10, 20, 1000), ("outliers",)),
    "huge spike in velocity": Fault(huge_spike, "velocity", (1e6, 1e30, 1e300), ("outliers",)),
    "huge spike in force": Fault(huge_spike, "force", (1e6, 1e30, 1e300), ("outliers",)),
    "stuck velocity": Fault(stuck, "velocity", (0.1, 0.5, 5.0), ("stuck_sensor",)),
    "stuck force": Fault(stuck, "force", (0.1, 0.5, 5.0), ("stuck_sensor",)),
    "held velocity": Fault(held, "velocity", (2, 5, 10), ("held_signal",)),
    "dropouts of position": Fault(dropouts, "position", (4, 8, 16), ("stuck_sensor",)),
    "dropouts of velocity": Fault(dropouts, "velocity", (4, 8, 16), ("stuck_sensor",)),
    "copied velocity": Fault(copied, "velocity", (2.5, -1.0, 1.0), ("copied_signal",)),
    "silent force": Fault(
        silent, "force", (None, 1.0, 0.0), ("silent_input", "constant_signal", "constant_target")
    ),
    "gaps in velocity": Fault(gaps, "velocity", (0.01, 0.05, 0.2), ("missing_samples",)),
    "duplicate": Fault(nothing, "", ("half", "shifted", "copy"), ("duplicate_recording",)),
    "sticking": Fault(nothing, "velocity", (0.45, 0.3, 0.2), ("at_rest",), machines=("dry",)),
}


def recorded(
    machine: Machine, name: str | None, severity: str, seed: int, noise: float
) -> list[tuple[float, Rows]]:
    """Recordings with a fault, or without: of each the time of its first row, and its columns."""
    fault = FAULTS[name] if name else None
    size: Any = fault.severities()[severity] if fault else None
    share = size if fault and name == "sticking" else 1.0
    log = Logger(machine, seed, noise, share)
    signal = getattr(machine, fault.on) if fault and fault.on else ""
    if fault and fault.before:
        fault.act(log, signal, size)
    log.sample()
    if fault and not fault.before:
        fault.act(log, signal, size)
    if name != "duplicate":
        return [(0.0, log.rows)]
    part = slice(log.samples // 2, None) if size == "half" else slice(None)
    again = {k: v[part] for k, v in log.rows.items()}
    return [(0.0, log.rows), (60.0 if size == "shifted" else 0.0, again)]
