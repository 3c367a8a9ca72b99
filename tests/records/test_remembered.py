"""Answers kept by content: found once for the same samples, and never for others."""

import numpy as np
import pytest
from tests.machines import drag_signals as signals

from riecjax.records.faults import spikes
from riecjax.records.faults.spikes import find_spikes
from riecjax.records.remembered import remembered


def test_the_same_content_is_asked_once_and_any_other_anew():
    asked = []

    @remembered(2, lambda values, power: (values, power))
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


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_spikes_are_those_that_fits_of_all_suspects_in_each_pass_find(noise, monkeypatch):
    values = signals(0, noise)["x"].copy()
    rng = np.random.default_rng(1)
    where = rng.choice(values.size, values.size // 50, replace=False)
    values[where] += 0.1 * values.std() * rng.choice([-1, 1], where.size)
    values[300] = np.nan
    found = find_spikes(values)
    assert found.places.size > 10

    def everywhere(self, values, places, noise):
        return spikes.fits(values, places, noise, self.stretch, self.local)

    monkeypatch.setattr(spikes.Around, "at", everywhere)
    again = find_spikes.__wrapped__(values)  # pyright: ignore[reportFunctionMemberAccess]
    for one, other in zip(found, again, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9)
