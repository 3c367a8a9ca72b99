"""Searches in sums of random columns, and what structures leave of folds, beside the rows."""

import numpy as np
import pytest
import scipy.stats

import riecjax as rx
from riecjax.discovery.candidate import Candidate, Shaped
from riecjax.discovery.search import RATE, Search, again
from riecjax.folds import Folds

LETTERS = "abcdefgh"


def offers(*names: str) -> list[Candidate]:
    return [Candidate(name, (rx.Term(name, name),)) for name in names]


def columns(seed: int, count: int = 8, rows: int = 1000) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((rows, count))


def search(target: np.ndarray, given: np.ndarray, kept: str = "a", **settings) -> Search:
    folds = folds_of(np.column_stack([target, given]), 20)
    rest = [name for name in LETTERS[: given.shape[1]] if name not in kept]
    return Search(folds, tuple(kept), offers(*rest), **settings)


def names(found: list[Candidate]) -> set[str]:
    return {offer.name for offer in found}


def test_exactly_what_is_there_is_found():
    for seed in range(30):
        given = columns(seed)
        noise = np.random.default_rng(100 + seed).standard_normal(len(given))
        target = given @ [1, 0, 0.5, 0, -2, 0, 0, 0] + noise
        assert names(search(target, given).found()) == {"c", "e"}


def test_where_nothing_is_missing_something_is_added_once_in_twenty_times_at_most():
    added = 0
    for seed in range(400):
        given = columns(1000 + seed)
        noise = np.random.default_rng(5000 + seed).standard_normal(len(given))
        added += bool(search(given[:, 0] + noise, given).found())
    assert added / 400 <= RATE


def test_what_was_taken_first_is_exchanged_for_what_belongs():
    """A sum of two columns is nearest to the target, and neither of them alone."""
    given = columns(3)
    target = given[:, 0] + given[:, 1] + given[:, 2]
    blurred = np.random.default_rng(20).standard_normal(len(given))
    given[:, 3] = given[:, 1] + given[:, 2] + 0.2 * blurred
    target = target + 0.01 * np.random.default_rng(4).standard_normal(len(given))
    found = search(target, given)
    assert names(found._grown([])) == {"d"}  # pyright: ignore[reportArgumentType]
    assert names(found.found()) == {"b", "c"}


def test_one_term_is_taken_instead_of_two_that_say_the_same():
    given = columns(5)
    target = given[:, 0] + given[:, 1]
    given[:, 2] = given[:, 1] + given[:, 3]
    noise = 0.1 * np.random.default_rng(6).standard_normal(len(given))
    found = search(target + noise, given)
    two = [one for one in found.offers if one.name in "cd"]
    assert names(found._settled(two)) == {"b"}


def test_of_a_law_with_several_widths_one_is_taken():
    given = columns(7)
    for place in (2, 3, 4):
        given[:, place] = given[:, 1] + 0.3 * (place - 1) * given[:, place]
    folds = folds_of(np.column_stack([given[:, 0] + given[:, 1], given]), 20)
    law = Shaped("law", lambda name, _: rx.Term(name, "x"), np.arange(3.0), "x")
    widths = [Candidate(f"{n}@", (rx.Term(n, n),), law=law) for n in "cde"]
    found = Search(folds, ("a",), widths).found()
    assert [one.name for one in found] == ["c@"]


def test_the_path_goes_down_and_ends_at_what_noise_makes():
    given = columns(12)
    noise = np.random.default_rng(13).standard_normal(len(given))
    target = given @ [1, 0, 0.5, 0, -2, 0, 0, 0] + noise
    found = search(target, given)
    steps = found.path(found.found())
    assert [step.added for step in steps] == ["", "e", "c"]
    left = [step.unexplained for step in steps]
    assert left == sorted(left, reverse=True)
    assert left[-1] == pytest.approx(noise @ noise / (target @ target), rel=0.02)
    assert all(step.chance < 1e-3 for step in steps)
    assert all(rejected.gain < 0.02 for rejected in found.next_best(found.found()))


def test_data_drawn_again_choose_what_is_sure_each_time_and_what_is_not_less_often():
    given = columns(14)
    noise = np.random.default_rng(15).standard_normal(len(given))
    weak = search(given @ [1, 0, 0.14, 0, -2, 0, 0, 0] + noise, given)
    chosen = [one for one in weak.offers if one.name in "ce"]
    shares, errors = again(weak, chosen, seed=0, times=40)
    assert shares["e"] == 1.0
    assert 0.2 < shares["c"] < 1.0
    # One coefficient of a thousand rows of unit size.
    assert errors["e"] == pytest.approx(1 / np.sqrt(1000), rel=0.35)


def folds_of(rows: np.ndarray, count: int, noise: np.ndarray | None = None) -> Folds:
    """Folds of rows `(n, 1 + p)`, the target first."""
    parts = np.array_split(rows, count)
    samples = np.stack([part.T @ part for part in parts])
    names = tuple("abcdefgh"[: rows.shape[1] - 1])
    motion = samples if noise is None else samples - noise
    return Folds(samples, motion, names)


@pytest.fixture
def rows() -> np.ndarray:
    rng = np.random.default_rng(0)
    columns = rng.standard_normal((400, 3)) * [1.0, 100.0, 0.01]
    target = columns @ [2.0, 0.03, 0.0] + 0.5 * rng.standard_normal(400)
    return np.column_stack([target, columns])


def test_what_is_left_is_that_of_rows_that_were_left_out(rows):
    found = folds_of(rows, 8).left(("a", "c"))
    for number, part in enumerate(np.array_split(rows, 8)):
        others = np.concatenate([p for i, p in enumerate(np.array_split(rows, 8)) if i != number])
        theta = np.linalg.lstsq(others[:, [1, 3]], others[:, 0], rcond=None)[0]
        left = np.sum((part[:, 0] - part[:, [1, 3]] @ theta) ** 2)
        assert found.samples[number] == pytest.approx(left, rel=1e-9)
        assert found.motion[number] == pytest.approx(left, rel=1e-9)


def test_noise_is_taken_off_columns_before_they_are_fitted_and_off_what_is_left():
    """Of a column with noise of its own size, least squares find half."""
    rng = np.random.default_rng(1)
    signal = rng.standard_normal(40000)
    rows = np.column_stack([3 * signal, signal + rng.standard_normal(signal.size)])
    noise = np.diag([0.0, signal.size / 10])
    found = folds_of(rows, 10, noise)
    assert folds_of(rows, 10).fitted(("a",))[0] == pytest.approx(1.5, rel=0.03)
    assert found.fitted(("a",))[0] == pytest.approx(3.0, rel=0.03)
    left = found.left(("a",))
    assert abs(left.motion.sum()) < 0.03 * found.energy
    assert left.samples.sum() == pytest.approx(9 * signal.size, rel=0.05)


def test_folds_are_of_whole_blocks_and_empty_blocks_are_in_none():
    moments, count = np.arange(44.0)[:, None, None] * np.ones((2, 2)), np.ones(44)
    moments[40:], count[40:] = np.nan, 0
    found = Folds.of(moments, moments, count, ("a",))
    assert found.samples[:, 0, 0].tolist() == [4 * i + 1 for i in range(20)]
    assert found.number == 20


def test_structures_with_more_columns_leave_what_each_leaves_by_itself(rows):
    """Of any sizes, one elimination for all, and noise taken off."""
    rng = np.random.default_rng(3)
    rows = np.column_stack([rows, rows[:, :1] + rng.standard_normal((400, 3))])
    folds = folds_of(rows, 8, np.diag([0.0, 0.1, 0.2, 1e-6, 0.1, 0.1, 0.1]))
    structures, groups = ["ab", "a", "", "cb"], ["", "d", "ef", "f"]
    columns = folds.columns("abc")
    there = np.array([[name in one for name in "abc"] for one in structures])
    more = np.array([[*folds.columns(names), 0, 0][:2] for names in groups])
    found = folds.left_with(columns, there, more)
    for i, structure in enumerate(structures):
        for j, group in enumerate(groups):
            alone = folds.left(structure + group)
            assert found.motion[i, j] == pytest.approx(alone.motion, rel=1e-9)
            assert found.samples[i, j] == pytest.approx(alone.samples, rel=1e-9)


@pytest.mark.parametrize("apart", [True, False])
def test_columns_that_are_nearly_one_are_not_told_apart(rows, apart):
    double = rows[:, 1] + (0.1 if apart else 1e-5) * rows[:, 2] / 100
    folds = folds_of(np.column_stack([rows, double]), 8)

    def left(names: str, more: str) -> float:
        columns, there = folds.columns(names), np.ones((1, len(names)), bool)
        return folds.left_with(columns, there, folds.columns(more)[None]).motion.sum()

    assert np.isfinite(left("a", "d")) == np.isfinite(left("", "ad")) == apart
    assert np.isfinite(left("ad", "c")) == apart
    assert not np.isfinite(left("ab", "d"))


@pytest.mark.parametrize("decay", [0.0, 6.0])
def test_chance_is_uniform_of_columns_that_explain_nothing(decay):
    """Also where nearly all of the motion is in one of the folds."""
    rng = np.random.default_rng(2)
    size = np.exp(-decay * np.linspace(0, 1, 400))[:, None]
    chances = []
    for _ in range(1000):
        columns = size * rng.standard_normal((400, 3))
        target = columns[:, 0] + 0.3 * rng.standard_normal(400)
        chances.append(folds_of(np.column_stack([target, columns]), 20).told("ab", "b").chance)
    # Where energy is in few folds the larger of two variances is taken, which is cautious.
    assert np.mean(np.less(chances, 0.05)) < 0.075
    assert np.mean(np.less(chances, 0.001)) < 0.005
    if not decay:
        assert scipy.stats.kstest(chances, "uniform").pvalue > 1e-3
