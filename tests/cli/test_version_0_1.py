"""The options in docs/results.md give version 0.1's answers on the README's example.

They are compared with what version 0.1 printed, and with its formula written out in NumPy.
"""

import re
import shlex
from collections.abc import Mapping
from pathlib import Path

import jax
import numpy as np
import pytest
from command_line import call

PAGE = Path(__file__).parents[2] / "docs" / "results.md"
SECTION = PAGE.read_text(encoding="utf-8").partition("## The numbers of version 0.1")[2]
COMMANDS = re.findall(r"^riecjax (.*)$", SECTION, flags=re.MULTILINE)
SIMULATE, IDENTIFY = map(shlex.split, COMMANDS)
SHORTEST, LONGEST = 10, 100  # 0.05 and 0.5 s in samples
BREAK_POINTS = np.array([-0.8, -0.3, 0.3, 0.8])  # of the damper map, in m/s
NAMES = ("K_t", "M_us", "M_s", "K_s", "F_1", "F_2", "F_3", "F_4")

# Version 0.1 printed these in its README of commit 614ea28, with all windows; the intervals in that
# of 2c6f573.
ALL_WINDOWS = """
178747 23.2284 302.705 20721.4 -1189.26 -868.581 834.182 1116.57
177461 22.916 302.376 20534.2 -1205.13 -888.541 816.683 1104.07
179474 23.6009 302.982 20953.3 -1173.32 -847.79 853.781 1126.37
"""
# And these in its first, of commit 00e26c3, with 8000 random windows and the recording of seed 0.
RANDOM_WINDOWS = "175211 23.2293 302.589 20721.3 -1180.82 -861.114 824.585 1111.71"


def all_windows(sample_count: int) -> tuple[np.ndarray, np.ndarray]:
    """Starts and ends of all windows, lag by lag."""
    lags = range(SHORTEST, LONGEST + 1)
    start = np.concatenate([np.arange(sample_count - lag) for lag in lags])
    return start, start + np.repeat(lags, [sample_count - lag for lag in lags])


def random_windows(sample_count: int) -> tuple[np.ndarray, np.ndarray]:
    """8000 of them: the u-th of all, lag by lag, and a start uniform over the room that is left."""
    u, v = np.asarray(jax.random.uniform(jax.random.key(0), (2, 8000)))
    lags = np.arange(SHORTEST, LONGEST + 1)
    before = np.cumsum(sample_count - lags)
    lag = lags[np.searchsorted(before, u * before[-1], side="right")]
    start = np.floor(v * (sample_count - lag)).astype(int)
    return start, start + lag


def version_0_1(
    signals: Mapping[str, np.ndarray], start: np.ndarray, stop: np.ndarray
) -> list[float]:
    """Eqs (24a), (24b) and (24d), trapezoids over each window, one stage after the other."""

    def change(signal: np.ndarray) -> np.ndarray:
        return signal[stop] - signal[start]

    def impulse(signal: np.ndarray) -> np.ndarray:
        areas = np.diff(signals["t"]) * (signal[1:] + signal[:-1]) / 2
        return change(np.concatenate([[0.0], np.cumsum(areas)]))

    def fit(target: np.ndarray, *columns: np.ndarray) -> np.ndarray:
        return np.linalg.lstsq(np.stack(columns, axis=1), target)[0]

    velocity = signals["x3"] - signals["x4"]
    segment = np.clip(np.searchsorted(BREAK_POINTS, velocity) - 1, 0, 2)
    share = ((velocity - BREAK_POINTS[segment]) / np.diff(BREAK_POINTS)[segment])[:, None]
    roofs = np.eye(4)[segment] * (1 - share) + np.eye(4)[segment + 1] * share

    force = impulse(signals["F_t"])
    tyre = fit(force, impulse(signals["x1"]))
    masses = fit(force, change(signals["x3"]), change(signals["x4"]))
    columns = [impulse(signals["x2"]), *map(impulse, roofs.T)]
    return [*tyre, *masses, *fit(masses[1] * change(signals["x4"]), *columns)]


def in_six_digits(numbers: list[float]) -> list[str]:
    """As version 0.1 printed them."""
    return [f"{number:.6g}" for number in numbers]


@pytest.fixture
def answer(capsys, tmp_path, monkeypatch):
    """What the page's two commands say with further options, and the signals of their recording."""
    monkeypatch.chdir(tmp_path)

    def run(seed: int, *options: str) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        assert call(capsys, *SIMULATE, "--seed", seed).status == 0
        result = call(capsys, *IDENTIFY, *options, "--no-sweep", "--json")
        assert result.status == 0, result.err
        found = [result.document["parameters"][name] for name in NAMES]
        table = np.genfromtxt("drive.csv", delimiter=",", names=True)
        assert table.dtype.names is not None
        signals = {name: table[name] for name in table.dtype.names}
        return np.array([[each["value"], *each["interval95"]] for each in found]).T, signals

    return run


@pytest.mark.slow
def test_all_windows(answer):
    found, signals = answer(1)
    assert [in_six_digits(row) for row in found] == [
        row.split() for row in ALL_WINDOWS.strip().splitlines()
    ]
    assert found[0] == pytest.approx(version_0_1(signals, *all_windows(8000)), rel=1e-9)


@pytest.mark.slow
def test_random_windows(answer):
    found, signals = answer(0, "--windows", "8000")
    assert in_six_digits(found[0]) == RANDOM_WINDOWS.split()
    assert found[0] == pytest.approx(version_0_1(signals, *random_windows(8000)), rel=1e-9)
