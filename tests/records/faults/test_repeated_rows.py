"""Rows that a logger wrote twice."""

import numpy as np
import pytest
from tests.machines import drag_signals as signals

from riecjax.records.faults.rows import Repetition, repetitions, without_repetitions
from riecjax.records.record import Record


def columns(seed: int = 0, noise: float = 0.01) -> np.ndarray:
    return np.stack(list(signals(seed, noise).values()), axis=1)


@pytest.mark.raises_finding("repeated_rows")
@pytest.mark.parametrize("lag", [40, 300])
def test_the_second_copy_counts_as_missing(lag):
    rows = columns()
    rows[800:840] = rows[800 - lag : 840 - lag]
    assert repetitions([*rows.T]) == [Repetition(800 - lag, 800, 40)]
    record = Record.from_samples(dict(zip("uxv", rows.T)), time_step=0.01)
    left, (found,) = without_repetitions(record)
    assert "from 8 s on, for 0.4 s" in found.message
    for name in "uxv":
        np.testing.assert_array_equal(np.flatnonzero(left.missing[name]), np.arange(800, 840))


def test_missing_samples_are_rows_of_their_own():
    rows = columns()
    rows[[5, 700]], rows[701] = np.nan, 0.0
    assert repetitions([*rows.T]) == []


def test_rows_that_were_written_in_between_move_the_others():
    rows = columns()
    rows = np.concatenate([rows[:900], rows[850:900], rows[900:]])
    assert repetitions([*rows.T]) == [Repetition(850, 900, 50)]


@pytest.mark.no_finding("repeated_rows")
@pytest.mark.parametrize(
    "rows",
    [
        columns(),
        columns(1, 0.0),
        np.round(columns(), 2),
        np.tile(columns()[:500], (4, 1)),
        np.zeros((2000, 3)),
        np.repeat(columns()[:700], 3, axis=0),
        np.where(np.arange(2000)[:, None] > 1200, 0.0, columns()[:2000]),
        np.sin(2 * np.pi * np.arange(2000) / 100)[:, None],
        np.full((100, 2), np.nan),
    ],
)
def test_motions_rest_and_periods_are_none(rows):
    record = Record.from_samples(
        {f"s{i}": c for i, c in enumerate(np.nan_to_num(rows).T)}, time_step=0.01
    )
    assert without_repetitions(record) == (record, [])
    assert repetitions([*rows.T]) == []
