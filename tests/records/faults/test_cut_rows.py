"""Rows that all signals lose at once, on motions that are known in closed form."""

import numpy as np
import pytest

from riecjax.records.consistency import check_derivatives, compared
from riecjax.records.faults.relations import relations
from riecjax.records.faults.rows import cut_rows
from riecjax.records.preparation.alignment import align
from riecjax.records.record import Record

RATE, COUNT, AT = 200, 6000, 2400


def rows(seed: int, noise: float = 0.01) -> dict[str, np.ndarray]:
    """Thirty tones up to 4 Hz, and their exact derivative."""
    rng = np.random.default_rng(seed)
    time = np.arange(COUNT + 400) / RATE
    omega = 2 * np.pi * rng.uniform(0.2, 4, 30)
    phase = rng.uniform(0, 2 * np.pi, 30)
    angle = omega[:, None] * time + phase[:, None]
    found = {"x": np.sin(angle).sum(0), "v": (omega[:, None] * np.cos(angle)).sum(0)}
    return {n: s + noise * np.std(s) * rng.standard_normal(s.size) for n, s in found.items()}


def record(columns: dict[str, np.ndarray], lost: int = 0) -> Record:
    kept = {n: np.delete(s, slice(AT, AT + lost))[:COUNT] for n, s in columns.items()}
    return Record.from_samples(kept, time_step=1 / RATE)


@pytest.mark.raises_finding("lost_rows")
@pytest.mark.parametrize("lost", [10, 40])
@pytest.mark.parametrize("noise", [0.001, 0.01])
def test_a_jump_is_found_at_its_time(lost, noise):
    columns = rows(1, noise)
    finding = cut_rows(record(columns, lost), "x", "v")
    assert finding is not None
    jump = rows(1, 0.0)["x"][AT + lost] - rows(1, 0.0)["x"][AT - 1]
    option, time = finding.remedy
    assert option == "--from"
    assert AT / RATE <= float(time) <= (AT + 5) / RATE
    assert abs(jump) > 0.3
    assert finding.doubt == pytest.approx(min(abs(jump) / np.std(columns["x"]), 1.0), rel=0.2)
    (said,) = check_derivatives(record(columns, lost), [("x", "v")])
    assert said.code == "lost_rows"


@pytest.mark.raises_finding("lost_rows")
@pytest.mark.parametrize("seed", [9, 14])
def test_lost_rows_are_not_taken_for_a_delay(seed):
    gone = record(rows(seed, 0.0), 100)
    (relation,) = relations([("x", "v")])
    _, pair = compared(gone, relation)
    assert pair is not None
    assert pair.is_late
    assert align(gone, [relation]).record is gone


@pytest.mark.no_finding("lost_rows")
@pytest.mark.parametrize("noise", [0.0, 0.01, 0.05])
def test_whole_records_show_none(noise):
    assert not [s for s in range(60) if cut_rows(record(rows(s, noise)), "x", "v")]


@pytest.mark.no_finding("lost_rows")
@pytest.mark.parametrize("fault", ["late", "gain", "offset", "spikes", "stuck", "gap", "steps"])
def test_other_faults_are_no_lost_rows(fault):
    columns = rows(2)
    x, v = columns["x"], columns["v"]
    if fault == "late":
        v = np.roll(v, 3)
    if fault == "gain":
        v = 1.2 * v
    if fault == "offset":
        v = v + np.std(v)
    if fault == "spikes":
        v[::100] += 50 * np.std(v)
    if fault == "stuck":
        v[1000:2000] = v[1000]
    if fault == "gap":
        v[1000:1020] = np.nan
    if fault == "steps":
        x = np.round(8 * x) / 8
    assert cut_rows(record({"x": x, "v": v}), "x", "v") is None


@pytest.mark.no_finding("lost_rows")
def test_gaps_so_near_that_no_two_sides_fit_between_them_are_no_jump():
    columns = rows(1)
    columns["x"][::30] = np.nan
    assert cut_rows(record(columns), "x", "v") is None
