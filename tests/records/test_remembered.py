"""Answers kept by content: found once for the same samples, and never for others."""

import numpy as np

from riecjax.records import remembered as module
from riecjax.records.remembered import remembered


def test_the_same_content_is_asked_once_and_any_other_anew(monkeypatch):
    asked = []
    monkeypatch.setattr(module, "MOST", 2)

    @remembered
    def total(values, power):
        asked.append(power)
        return float(np.sum(values**power))

    values = np.arange(4.0)
    assert total(values, 1) == total(values.copy(), 1) == total(values[::-1][::-1], 1) == 6
    assert asked == [1]
    assert total(values, 2) == 14
    assert total(values.astype(np.float32), 1) == 6
    assert asked == [1, 2, 1]
    values[3] = 5
    assert total(values, 2) == 30
    # Of more than two the last are kept.
    values[3] = 3
    assert total(values, 2) == 14
    assert asked == [1, 2, 1, 2, 2]
