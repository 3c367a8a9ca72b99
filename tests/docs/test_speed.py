"""The page on speed shows what was recorded, and the suite notices what has become slow."""

import json

import pytest
from benchmarks.speed import __main__ as speed

NAMES = [
    "all-windows-long",
    "all-windows-paper",
    "seeds",
    "simulate-one",
    "simulate-one-limit",
    "simulate-batch",
    "bootstrap",
    "refine",
    "weak-peer",
    "read-csv",
]


@pytest.mark.parametrize("file", ["results.json", "results_small.json"])
def test_results_hold_every_benchmark_and_its_own_arithmetic(file):
    results = json.loads((speed.FOLDER / file).read_text())
    assert [result["name"] for result in results] == NAMES
    for r in results:
        assert r["ratio"] == pytest.approx(r["baseline_s"] / r["ours_s"])
        assert r["met"] == (r["ratio"] >= r["target"])
        assert r["accuracy"]


def test_half_of_a_recorded_ratio_is_too_slow():
    recorded = [{"name": "a", "ratio": 10.0}, {"name": "b", "ratio": 2.0}]
    assert (
        speed.fallen([{"name": "a", "ratio": 5.1}, {"name": "new", "ratio": 0.1}], recorded) == []
    )
    (message,) = speed.fallen([{"name": "a", "ratio": 4.9}, {"name": "b", "ratio": 2.0}], recorded)
    assert "a" in message
    assert "4.90" in message
