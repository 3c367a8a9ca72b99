"""Steps of the simulation behind a refinement: chosen along the record, and judged by halving."""

from typing import ClassVar

import diffrax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.signal
from jaxtyping import Array

from riecjax.errors import ModelError
from riecjax.models.catalogue import built_in_model
from riecjax.records.record import Record
from riecjax.refinement.optimum import RefinementStatus
from riecjax.refinement.output_error import OutputError
from riecjax.refinement.refine import refine
from riecjax.simulation.method import Adaptive, FixedStep
from riecjax.simulation.system import AbstractSystem

RATE = 100
HARD = {"d": 2.0, "k1": 100.0, "k3": 3e6}


def duffing() -> AbstractSystem:
    return built_in_model("duffing").build_system({"m": 1.0, "k2": 0.0, **HARD})


@pytest.fixture(scope="module")
def hardening() -> dict[str, np.ndarray]:
    """Slow at rest, ten times as fast where it is deflected most."""
    t = np.arange(2001) / RATE
    u = 60 * np.sin(2 * np.pi * t) * np.minimum(t / 2, 1)

    def slope(now, s):
        force = np.interp(now, t, u)
        return [s[1], force - 2 * s[1] - 100 * s[0] - 3e6 * s[0] ** 3]

    # Input is linear between samples: no step is longer than half a sample.
    run = scipy.integrate.solve_ivp(
        slope, (0, t[-1]), [0, 0], "DOP853", t, rtol=1e-11, atol=1e-13, max_step=0.005
    )
    return {"u": u, "y": run.y[0], "dy": run.y[1]}


def record_of(signals, *names) -> Record:
    return Record.from_samples({name: signals[name] for name in names}, time_step=1 / RATE)


@pytest.fixture(scope="module")
def recording(hardening) -> Record:
    return record_of(hardening, "u", "y", "dy")


@pytest.mark.slow
def test_a_spring_that_hardens_is_resolved_where_it_is_deflected(recording):
    refined = refine(duffing(), recording, HARD, OutputError(intersample="lines"))
    assert bool(refined.search.converged)
    assert [finding for finding in refined.findings() if finding.code == "coarse_steps"] == []
    for name, true in HARD.items():
        assert float(refined[name]) == pytest.approx(true, rel=1e-4)


@pytest.mark.slow
@pytest.mark.raises_finding("coarse_steps")
def test_steps_that_change_the_answer_are_a_finding_with_the_change(recording):
    refined = refine(duffing(), recording, HARD, OutputError(method=FixedStep(1)))
    assert float(refined["d"]) == pytest.approx(1.776, abs=0.01)
    (finding,) = [finding for finding in refined.findings() if finding.code == "coarse_steps"]
    assert "FixedStep(1), are part of the answer" in finding.message
    assert "d by 0.2" in finding.message
    # To first order, from so far off, a good part of the way to the truth.
    for name in ("d", "k3"):
        off = float(refined[name]) - HARD[name]
        assert 0.5 < -float(refined.search.step_change[refined.parameters.index(name)]) / off < 1.2


def test_a_slow_motion_takes_one_step(hardening):
    """The same spring, deflected a thousandth: sqrt(k1 / m) is 10 rad/s."""
    small = {name: 1e-3 * values for name, values in hardening.items()}
    by, records = OutputError(), [record_of(small, "u", "y", "dy")]
    method = by.residuals(duffing(), records, HARD).method
    assert method == FixedStep(1)


class Bursting(AbstractSystem):
    """A sum of squares that overflows is infinite, and infinite over infinite is no number."""

    c: Array
    states: ClassVar = (("x", ""),)

    def derivative(self, state: Array, inputs: Array) -> Array:
        return self.c * state**3


def test_what_diverged_is_halved_without_a_warning():
    """In the shortest steps it diverges again: at the start there is nothing to compare."""
    rest = Record.from_samples({"x": np.linspace(1.0, 2.0, 100)}, time_step=0.1)
    lost = refine(Bursting(jnp.asarray(1.0)), rest, {"c": 1e6})
    assert lost.search.status == RefinementStatus.not_finite
    assert not np.any(lost.search.coarse)


def test_an_adjoint_that_only_goes_backward_is_refused():
    method = Adaptive(1e-8, 1e-10, adjoint=diffrax.RecursiveCheckpointAdjoint())
    with pytest.raises(ModelError, match="Jacobians forward, which RecursiveCheckpointAdjoint"):
        OutputError(method=method)
