"""The measured EMPS axis under its controller, simulated with published and with RIEC's parameters.

The published figures come from the benchmark's own simulation of this record, compared with
filtered central differences of the measured position without the first 49 samples.
"""

from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy.io
import scipy.signal

import riecjax as rx
from benchmarks.measured.emps_axis import (
    RISE,
    StribeckAxis,
    sampled_control,
    stribeck_axis,
    stribeck_balance,
)
from riecjax.models.catalogue import built_in_model
from riecjax.simulation.system import AbstractSystem

STEP = 1e-3
EDGE = 49
SYMMETRIC = {"M": 95.1089, "Fv": 203.5034, "Fc": 20.3935, "offset": -3.1648}
ASYMMETRIC = {
    "M": 95.1540,
    "Fv_pos": 166.7061,
    "Fc_pos": 20.1440,
    "Fv_neg": 240.4236,
    "Fc_neg": 20.6277,
}
PUBLISHED = {"q": 0.0138, "dq": 0.229, "ddq": 8.60, "force": 5.85}
"""Relative errors in percent."""


class Rig(NamedTuple):
    time: np.ndarray
    measured: dict[str, np.ndarray]
    reference: rx.Record
    gain: float
    voltage: np.ndarray
    position: np.ndarray


def difference(y: np.ndarray) -> np.ndarray:
    return np.concatenate([[y[1] - y[0]], (y[2:] - y[:-2]) / 2, [y[-1] - y[-2]]]) / STEP


def load_rig(folder: Path) -> Rig:
    file = scipy.io.loadmat(folder / "DATA_EMPS.mat")
    v = {name: np.asarray(file[name]).squeeze() for name in ("t", "qm", "qg", "vir", "gtau")}
    coefficients = scipy.signal.butter(4, 100, fs=1 / STEP)
    assert coefficients is not None
    q = scipy.signal.filtfilt(coefficients[0], coefficients[1], v["qm"])
    dq, gain = difference(q), float(v["gtau"])
    measured = {"q": q, "dq": dq, "ddq": difference(dq), "force": gain * v["vir"]}
    return Rig(v["t"], measured, rx.Record({"qg": v["qg"]}, STEP), gain, v["vir"], v["qm"])


def identified_axes(rig: Rig) -> dict[str, AbstractSystem]:
    """Published values by pointwise least squares, and RIEC's on the raw record."""
    raw = rx.Record({"q": rig.position, "force": rig.gain * rig.voltage}, STEP)
    raw = rx.differentiate(raw, "q", "dq")
    criterion = rx.RIEC(rx.RandomWindows(0.05, 0.5, 20_000))
    found = {}
    for name, model, published in (
        ("symmetric", built_in_model("emps"), SYMMETRIC),
        ("asymmetric", built_in_model("emps-asymmetric"), ASYMMETRIC),
    ):
        found[f"published {name}"] = model.build_system(published)
        estimate = rx.identify(model, raw, criterion, key=jax.random.key(0))
        found[f"RIEC {name}"] = model.build_system({k: estimate[k] for k in published})
    return found


def refined_axis(rig: Rig, windows: rx.AllWindows) -> tuple[rx.Estimate, StribeckAxis]:
    """Friction that may fall or rise near rest, refined from the published asymmetric one.

    The sign of the velocity changes over 0.1 mm/s, the encoder's resolution over some samples: the
    sampled loop needs no width, and the data hardly tell one.
    """
    raw = rx.Record({"q": rig.position, "force": rig.gain * rig.voltage}, STEP)
    start = {**ASYMMETRIC, **RISE}
    known = {"width": start.pop("width")}
    refined = rx.refine(
        stribeck_balance({**start, **known}),
        rx.differentiate(raw, "q", "dq"),
        start,
        rx.IntegralError(rx.RIEC(windows)),
        known=known,
        bounds={"vs": (1e-3, 0.5)},
    )
    return refined, stribeck_axis(refined.values)


def errors(rig: Rig, record: dict[str, jax.Array], clock: float = STEP) -> dict[str, float]:
    """Relative errors in percent of a simulation read every `clock` seconds, as if every ms."""
    read = np.arange(rig.time.size) * clock
    found = {}
    for name, measured in rig.measured.items():
        simulated = np.interp(read, np.arange(rig.time.size) * STEP, np.asarray(record[name]))
        error = np.linalg.norm((simulated - measured)[EDGE:])
        found[name] = float(100 * error / np.linalg.norm(measured[EDGE:]))
    return found


def sampled(rig: Rig, axis: AbstractSystem, delay: int) -> dict[str, jax.Array]:
    gain, start = jnp.asarray(rig.gain), jnp.asarray(rig.position[0])
    return sampled_control(axis, rig.reference, gain=gain, start=start, delay=delay)
