"""Sums made smaller say what they said: bins, blocks and recordings together, and stretches."""

import itertools

import numpy as np
import pytest
from tests.machines import STANDARD
from tests.machines import drag_fleet as drives

import riecjax as rx
from riecjax.summaries import stretch_starts

MODEL = rx.find_model("drag-oscillator")
CRITERION = rx.RIEC(rx.AllWindows(0.05, 0.5))


@pytest.fixture(scope="module")
def records() -> list[rx.Record]:
    return [*drives(2, 1500, 1), *drives(2, 2100, 2)]


@pytest.fixture(scope="module")
def binned(records) -> rx.Summary:
    return rx.summarise(MODEL, records, CRITERION, bins=4)


def theta(summary: rx.Summary) -> np.ndarray:
    return np.asarray(rx.estimate(MODEL, summary).theta)


def test_bytes_hold_all_and_are_the_same_for_the_same(binned):
    written = binned.to_bytes()
    read = rx.Summary.from_bytes(written)
    assert read.to_bytes() == written
    assert read.digests == binned.digests
    # Arrays as they are, with names of files beside them.
    assert len(written) < 1.2 * binned.byte_count
    middle = len(written) // 2
    damaged = written[:middle] + bytes([written[middle] ^ 4]) + written[middle + 1 :]
    with pytest.raises(rx.DataError, match="not a readable Summary"):
        rx.Summary.from_bytes(damaged)


def test_bins_together_are_the_sums_without_bins(records, binned):
    plain = rx.summarise(MODEL, records, CRITERION)
    found = binned.merge_length_bins()
    assert found.bins is None
    for one, other in zip(found.recordings, plain.recordings):
        a, b = one.stages[0][0], other.stages[0][0]
        np.testing.assert_allclose(a.moments, b.moments, rtol=1e-9, atol=1e-9)
        np.testing.assert_array_equal(a.count, b.count)
    np.testing.assert_allclose(theta(found), theta(plain), rtol=1e-10)


def test_blocks_together_keep_every_window_and_second(binned):
    for one in binned.recordings:
        few = one.in_blocks(5)
        assert int(few.blocks) == 5
        a, b = few.stages[0][0], one.stages[0][0]
        assert np.asarray(a.count).shape[1] == 5
        np.testing.assert_allclose(a.moments.sum(1), np.asarray(b.moments).sum(1), rtol=1e-12)
        np.testing.assert_array_equal(a.count.sum(1), np.asarray(b.count).sum(1))
        lasted = float(few.block_seconds) * 5
        assert lasted == pytest.approx(float(one.block_seconds) * int(one.blocks))
        assert one.in_blocks(10**6).stages[0][0].count.shape == b.count.shape


@pytest.mark.parametrize("each", [1, 8, 10**6])
def test_recordings_as_one_give_what_they_give_side_by_side(binned, each):
    apart = binned.merge_length_bins()
    joined = apart.pool_recordings(each)
    assert len(joined.recordings) == 1
    np.testing.assert_allclose(theta(joined), theta(apart), rtol=1e-9)
    (one,) = joined.recordings
    assert int(one.samples) == sum(int(r.samples) for r in apart.recordings)
    # As long as each keeps its blocks the scatter over them is the same.
    if each > 100:
        errors = [np.asarray(rx.estimate(MODEL, s).standard_errors) for s in (joined, apart)]
        np.testing.assert_allclose(*errors, rtol=0.6)


def test_of_more_recordings_than_there_is_room_neighbours_share_a_block(binned):
    few = binned.merge_length_bins()
    many = few.of_recordings([*few.recordings] * 300)
    (one,), (few,) = (some.pool_recordings().recordings for some in (many, few))
    assert int(one.blocks) == 1024
    expected = 300 * np.asarray(few.stages[0][0].moments).sum(1)
    np.testing.assert_allclose(np.asarray(one.stages[0][0].moments).sum(1), expected, rtol=1e-10)


def test_a_test_function_that_is_defined_anew_is_the_one_that_counts(records):
    """As a cell of a notebook that is run once more does."""

    def defined() -> type[rx.Bump]:
        class DefinedTwice(rx.Bump):
            pass

        return DefinedTwice

    first = defined()
    criterion = rx.RIEC(rx.AllWindows(0.05, 0.5), first())
    written = rx.summarise(MODEL, records[0], criterion).to_bytes()
    assert type(rx.Summary.from_bytes(written).criterion.test_function) is first
    second = defined()
    assert type(rx.Summary.from_bytes(written).criterion.test_function) is second


def test_stretches_with_what_their_windows_reach_sum_to_one_pass():
    rng = np.random.default_rng(0)
    n, reach = 2**18 + 5000, 150
    wave = np.cumsum(rng.standard_normal((3, n)), axis=1) * 0.01
    signals = dict(zip(("u", "x", "dx"), wave - wave.mean(1, keepdims=True)))
    noise = {"u": 0.0, "x": 1e-3, "dx": 1e-2}

    def sums(low: int, high: int, starts: tuple[int, int] | None = None) -> rx.Summary:
        part = {name: values[low:high] for name, values in signals.items()}
        record = rx.Record.from_samples(part, time_step=STANDARD.step)
        return rx.summarise(MODEL, record, CRITERION, noise=noise, bins=3, starts=starts)

    whole, size = sums(0, n), stretch_starts(CRITERION, STANDARD.step, 10)
    assert size == 2**17
    ends = [0, size, n]
    parts = []
    for first, stop in itertools.pairwise(ends):
        low, high = max(first - 64, 0), min(stop + reach, n)
        parts += sums(low, high, (first - low, stop - low)).recordings
    one, of = whole.recordings[0].stages[0][0], [part.stages[0][0] for part in parts]
    for name in ("moments", "count", "noise"):
        total = np.asarray(getattr(one, name)).sum(1)
        found = sum(np.asarray(getattr(part, name)).sum(1) for part in of)
        np.testing.assert_allclose(found, total, rtol=1e-12, atol=1e-12 * np.abs(total).max())
    assert sum(int(part.samples) for part in parts) == n
