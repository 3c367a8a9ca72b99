"""Angles that begin anew with each turn."""

import numpy as np
import pytest

from riecjax.doubts.reading import read_recording
from riecjax.records.faults.spikes import unwrapped

TIME = np.arange(4000) / 200


def turning(noise: float, seed: int = 0) -> np.ndarray:
    """Some turns, there and back, in radians."""
    angle = 20 * np.sin(0.7 * TIME) + 2 * np.sin(5 * TIME)
    return angle + noise * np.random.default_rng(seed).standard_normal(TIME.size)


@pytest.mark.parametrize("turn", [2 * np.pi, 360.0])
@pytest.mark.parametrize("first", [0.0, -0.5])
@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_they_go_on(turn, first, noise):
    angle = turning(noise) * turn / (2 * np.pi)
    shown = (angle - first * turn) % turn + first * turn
    shown[100:120] = np.nan
    whole, said = unwrapped(shown)
    assert int(said.split()[1]) > 10
    known = ~np.isnan(shown)
    np.testing.assert_allclose(np.diff(whole[known] - angle[known]), 0, atol=1e-9)


@pytest.mark.parametrize(
    "values",
    [
        turning(0.01),
        np.pi * np.sign(np.sin(TIME)),
        (3 * TIME) % 6.0,
        10 * np.random.default_rng(0).standard_normal(4000),
        np.where(TIME > 5, 6.28, 0.0) + 0.01 * np.sin(TIME),
        (40 * TIME) % (2 * np.pi) * np.where(TIME > 10, 1, 1.5),
        np.zeros(10),
        np.full(10, np.nan),
    ],
)
def test_what_is_no_such_angle_stays(values):
    whole, said = unwrapped(values)
    assert said == ""
    assert whole is values


def test_a_file_is_read_with_its_turns(tmp_path):
    angle = turning(0.001)
    table = np.column_stack([TIME, angle % (2 * np.pi), np.cos(TIME)])
    np.savetxt(tmp_path / "a.csv", table, delimiter=",", header="t,theta,u", comments="")
    read = read_recording(tmp_path / "a.csv")
    np.testing.assert_allclose(np.diff(read.record["theta"]), np.diff(angle), atol=1e-6)
    assert any(step.startswith("theta: unwrapped, ") for step in read.steps)
    assert read.findings == ()
