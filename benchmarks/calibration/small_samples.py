"""Do the intervals of short recordings cover? Nominal 95 % intervals on 4, 6, 10 and 20 blocks.

    python -m benchmarks.calibration small_samples [--seeds 400]
        [--out benchmarks/small_samples.json]

Three ways to record m x'' + c x' + k x = F, each known in closed form: a step of force, which tells
of m and c in its transient alone; a sweep, which tells of k, c and m one after the other; a random
drive, which tells of all of them all along. What is read of the force errs by a fifth of its
r.m.s., as a first-order autoregression or as the ringing of a mode that the model lacks, one or the
other by seed. Errors do not depend on the motion, so the criterion converges to the true values.

`evenly`: errors are alike all along. `unevenly`: they grow with the velocity. Beside what
`identify` prints stand the bootstrap and the HAC sandwich with Student's t as they are without
regard to few blocks. Widths are medians over seeds, compared with that sandwich's as it is.
"""

from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from benchmarks.recorded import write_json
from riecjax.criteria.criterion import RIEC
from riecjax.criteria.windows import AllWindows
from riecjax.equations.equation import Equation
from riecjax.equations.term import Term
from riecjax.estimation.identify import identify
from riecjax.records.record import Record
from riecjax.studies.monte_carlo import over_keys
from riecjax.uncertainty.covariances import (
    BlockStatistics,
    effective_freedom,
    jackknife_covariance,
    sandwich_covariance,
)
from riecjax.uncertainty.intervals import AbstractIntervals, BlockBootstrap, Sandwich, Uncertainty

STEP = 0.01
SAMPLES_OF_BLOCK = 256
"""Two longest windows: blocks are no shorter."""
CRITERION = RIEC(AllWindows(0.1, 1.26, longest_samples=128))
BLOCKS = (4, 6, 10, 20)
MASS, DAMPING, STIFFNESS = 2.0, 2.0, 180.0
TRUTH = np.array([MASS, DAMPING, STIFFNESS])
PARAMETERS = ("m", "c", "k")
EQUATION = Equation(
    Term(1.0, "F"), -Term("m", "v", derivative=1), -Term("c", "v"), -Term("k", "x"), name="force"
)
ERROR = 0.2
"""The force's error, as a share of its r.m.s."""


def after_a_step(time: Float[Array, ""], start: Float[Array, ""]) -> Float[Array, ""]:
    """Position after a step of force that deflects it by one; m and c are told by the transient."""
    since = time - start
    decay = DAMPING / (2 * MASS)
    rate = np.sqrt(STIFFNESS / MASS - decay**2)
    ringing = jnp.cos(rate * since) + decay / rate * jnp.sin(rate * since)
    return jnp.where(since > 0, 1 - jnp.exp(-decay * since) * ringing, 0.0)


def gain(omega: Float[Array, "*waves"]) -> Float[Array, "*waves"]:
    """How far a force of one moves it."""
    return 1 / jnp.sqrt((STIFFNESS - MASS * omega**2) ** 2 + (DAMPING * omega) ** 2)


def in_a_sweep(
    time: Float[Array, ""], phase: Float[Array, ""], duration: float
) -> Float[Array, ""]:
    """Position under a force from 0.3 to 4 Hz, as if settled at each frequency."""
    rise = 2 * np.pi * 3.7 / duration
    turn = 2 * np.pi * 0.3 * time + rise * time**2 / 2 + phase
    return gain(2 * np.pi * 0.3 + rise * time) * jnp.sin(turn)


def under_a_drive(time: Float[Array, ""], waves: Float[Array, "3 waves"]) -> Float[Array, ""]:
    """Position under a random force."""
    omega, phase, size = waves
    return jnp.sum(size * gain(omega) * jnp.cos(omega * time + phase))


def steps(key: Key[Array, ""], duration: float) -> Any:
    """One step, half a second to one and a half after the start, between two samples."""
    start = STEP * (jax.random.randint(key, (), 50, 150) + 0.5)
    return lambda time: after_a_step(time, start)


def sweeps(key: Key[Array, ""], duration: float) -> Any:
    """One sweep over the whole record."""
    phase = 2 * np.pi * jax.random.uniform(key)
    return lambda time: in_a_sweep(time, phase, duration)


def drives(key: Key[Array, ""], duration: float) -> Any:
    """Sixty waves from 0.3 to 4 Hz."""
    keys = jax.random.split(key, 3)
    omega = 2 * np.pi * jax.random.uniform(keys[0], (60,), minval=0.3, maxval=4.0)
    phase = 2 * np.pi * jax.random.uniform(keys[1], (60,))
    waves = jnp.stack([omega, phase, jnp.sqrt(jax.random.exponential(keys[2], (60,)))])
    return lambda time: under_a_drive(time, waves)


MOTIONS = {"steps": steps, "sweeps": sweeps, "drives": drives}


def force_error(key: Key[Array, ""], count: int) -> Float[Array, " count"]:
    """Of unit variance: memory of 0.05 s, or a mode at 6 Hz damped by 5 %."""
    which, noise_key = jax.random.split(key)
    omega, damping = 2 * np.pi * 6.0, 0.05
    decay = np.exp(-damping * omega * STEP)
    mode = 2 * decay * np.cos(omega * np.sqrt(1 - damping**2) * STEP), -(decay**2)
    rings = jax.random.bernoulli(which)
    one = jnp.where(rings, mode[0], np.exp(-STEP / 0.05))
    two = jnp.where(rings, mode[1], 0.0)

    def advance(last: tuple[Array, Array], noise: Array) -> tuple[tuple[Array, Array], Array]:
        now = one * last[0] + two * last[1] + noise
        return (now, last[0]), now

    settling = 600
    noise = jax.random.normal(noise_key, (count + settling,))
    _, error = jax.lax.scan(advance, (jnp.zeros(()), jnp.zeros(())), noise)
    variance = (1 - two) / ((1 + two) * ((1 - two) ** 2 - one**2))
    return error[settling:] / jnp.sqrt(variance)


def record_of(key: Key[Array, ""], kind: str, blocks: int, uneven: bool) -> Record:
    """A record of so many blocks, each of two longest windows."""
    motion_key, error_key = jax.random.split(key)
    count = blocks * SAMPLES_OF_BLOCK
    position = MOTIONS[kind](motion_key, count * STEP)
    velocity = jax.grad(position)
    time = jnp.arange(count) * STEP
    x, v, a = (jax.vmap(f)(time) for f in (position, velocity, jax.grad(velocity)))
    force = MASS * a + DAMPING * v + STIFFNESS * x
    error = force_error(error_key, count)
    if uneven:
        error = error * jnp.abs(v) / jnp.sqrt(jnp.mean(v**2))
    return Record({"x": x, "v": v, "F": force + ERROR * jnp.std(force) * error}, STEP)


class Plain(AbstractIntervals):
    """Uncertainty whatever the number of blocks: bootstrap, or HAC sandwich."""

    bootstrap: bool = eqx.field(static=True)

    def uncertainty(self, statistics: BlockStatistics) -> Uncertainty:
        """With `few_blocks` nowhere."""
        covariance, replicates = sandwich_covariance(statistics), None
        if self.bootstrap:
            covariance = jackknife_covariance(statistics)
            replicates = BlockBootstrap().uncertainty(statistics).studentized
        freedom = effective_freedom(statistics)
        nowhere = jnp.zeros(freedom.shape, bool)
        return Uncertainty(covariance, replicates, freedom, nowhere, "plain")


INTERVALS = {
    "identify": BlockBootstrap(),
    "sandwich": Sandwich(),
    "plain_bootstrap": Plain(True),
    "plain_sandwich": Plain(False),
}


class Found(NamedTuple):
    """Of one record: the estimate, and its uncertainty by kind."""

    theta: Float[Array, " p"]
    uncertainty: dict[str, Uncertainty]
    block_count: Array


def one_record(key: Key[Array, ""], kind: str, blocks: int, uneven: bool) -> Found:
    """One record identified, with every kind of interval."""
    record = record_of(key, kind, blocks, uneven)
    found = {
        name: identify(EQUATION, record, CRITERION, intervals=intervals)
        for name, intervals in INTERVALS.items()
    }
    first = found["identify"]
    return Found(first.theta, {n: e.uncertainty for n, e in found.items()}, first.block_count)


def cell(kind: str, blocks: int, uneven: bool, seeds: int) -> dict[str, Any]:
    """Coverage and widths of one class at one number of blocks."""
    found = over_keys(
        one_record, jax.random.key(blocks), seeds, kind, blocks, uneven, chunk=min(seeds, 50)
    )
    found = jax.tree.map(np.asarray, found, is_leaf=eqx.is_array)
    assert (found.block_count == blocks).all()
    off = found.theta - TRUTH
    reach = {}  # how far 95 % intervals reach below and above estimates
    for name, uncertainty in found.uncertainty.items():
        error = np.sqrt(np.diagonal(uncertainty.covariance, axis1=1, axis2=2))
        reach[name] = tuple(side * error for side in uncertainty.reach(0.95))
    plain = np.median(sum(reach["plain_sandwich"]), axis=0)
    report: dict[str, Any] = {"small_sample": share(found.uncertainty["identify"].few_blocks)}
    for name, (below, above) in reach.items():
        inside = (off <= below) & (-off <= above)
        mean, times = inside.mean(axis=1), np.median(below + above, axis=0) / plain
        report[name] = {
            "coverage": float(mean.mean()),
            "known_to": float(mean.std() / np.sqrt(seeds)),
            "each": share(inside),
            "width_to_plain_sandwich": dict(zip(PARAMETERS, times.tolist())),
        }
    return report


def share(true: np.ndarray) -> dict[str, float]:
    """Of the seeds, for each parameter."""
    return dict(zip(PARAMETERS, np.mean(true, axis=0).tolist()))


def pooled(cells: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Over all cells, for each kind of interval."""
    report = {}
    for name in INTERVALS:
        rows = [one[name] for one in cells.values()]
        coverage = [row["coverage"] for row in rows]
        widths = [one for row in rows for one in row["width_to_plain_sandwich"].values()]
        report[name] = {
            "coverage": float(np.mean(coverage)),
            "known_to": float(np.sqrt(sum(row["known_to"] ** 2 for row in rows)) / len(rows)),
            "least": min(coverage),
            "most": max(coverage),
            "width_to_plain_sandwich": float(np.median(widths)),
        }
    return report


def main(seeds: int = 400, blocks: tuple[int, ...] = BLOCKS, out: Path | None = None) -> None:
    jax.config.update("jax_enable_x64", True)
    document: dict[str, Any] = {"seeds": seeds}
    for errors in ("evenly", "unevenly"):
        cells = {
            f"{kind}, {count} blocks": cell(kind, count, errors == "unevenly", seeds)
            for kind in MOTIONS
            for count in blocks
        }
        document[errors] = {"pooled": pooled(cells), "cells": cells}
        for kind, row in document[errors]["pooled"].items():
            print(errors, kind, " ".join(f"{key} {value:.3f}" for key, value in row.items()))
    if out is not None:
        write_json(out, document)
