"""Recordings of near lengths are simulated by the same compiled functions, with the same answer."""

from pathlib import Path
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from tests.machines import DRAG_START as START
from tests.machines import drag_oscillator as oscillator
from tests.machines import drag_record as record

from nightly import nightly
from riecjax import compilation, runtime
from riecjax.records.record import Record, shared_length
from riecjax.refinement.output_error import AbstractShooting, OutputError, Tiles, WholeRecord
from riecjax.refinement.refine import refine
from riecjax.simulation.method import FixedStep
from riecjax.simulation.system import AbstractSystem


def test_a_shared_length_is_a_quarter_longer_at_most():
    every = np.arange(2, 5000)
    shared = np.array([shared_length(int(n)) for n in every])
    assert np.all(shared >= every)
    assert np.all(shared <= 1.25 * every + 1)
    assert np.all(np.diff(shared) >= 0)
    assert len(set(shared[every > 1024])) <= 10


def test_another_length_compiles_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(compilation, "_programs", {})
    monkeypatch.setattr(runtime, "_programs_folder", tmp_path)
    whole = record(seed=0, count=1000)
    refine(oscillator(), whole, START)
    kept = sorted(path.name for path in tmp_path.iterdir())
    assert kept
    refine(oscillator(), whole.part(0, 930), START)
    assert sorted(path.name for path in tmp_path.iterdir()) == kept


@pytest.mark.parametrize(
    "shooting", [WholeRecord(), *nightly([Tiles(samples=150)])], ids=["whole", "tiles"]
)
def test_what_a_record_is_filled_up_with_tells_nothing(shooting: AbstractShooting):
    """Traced, a record is not filled up."""
    given = record(seed=1, count=930)
    by = OutputError(shooting, method=FixedStep(4))

    def fit(arrays: dict[str, Array]) -> tuple[Array, Array, Array]:
        found = refine(oscillator(), Record(arrays, given.time_step), START, by)
        return found.theta, found.standard_errors, found.rms

    for one, two in zip(fit(given.arrays), jax.jit(fit)(given.arrays)):
        np.testing.assert_allclose(one, two, rtol=1e-6)


class Hidden(AbstractSystem):
    """x' = c x^2, of which only y = x + 1 is recorded."""

    c: Array
    states: ClassVar = (("x", ""),)
    outputs: ClassVar = (("y", ""),)

    def derivative(self, state: Array, inputs: Array) -> Array:
        return self.c * state**2

    def output(self, state: Array, inputs: Array) -> dict[str, Array]:
        return {"y": state[0] + 1}


@pytest.mark.parametrize("count", [896, 897])
def test_steps_are_chosen_by_the_motion_within_the_record(count: int):
    """From 897 samples on it is filled up to 1024, past where the motion escapes."""
    t = np.arange(count) / 1000
    seen = Record.from_samples({"y": 1 + 1 / (1 - 0.98 * t)}, time_step=1e-3)
    found = refine(
        Hidden(jnp.asarray(0.95)), seen, {"c": 0.95}, OutputError(initial_states={"x": 1.0})
    )
    assert float(found["c"]) == pytest.approx(0.98, rel=1e-4)
    assert found.steps_label == "FixedStep(1)"
