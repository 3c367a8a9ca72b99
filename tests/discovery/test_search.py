"""Searches in sums of random columns, whose structure is known."""

import numpy as np
import pytest
from test_folds import folds_of

from riecjax.discovery.search import RATE, Offer, Search, again

LETTERS = "abcdefgh"


def offers(*names: str) -> list[Offer]:
    return [Offer(name, (name,), name) for name in names]


def columns(seed: int, count: int = 8, rows: int = 1000) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((rows, count))


def search(target: np.ndarray, given: np.ndarray, kept: str = "a", **settings) -> Search:
    folds = folds_of(np.column_stack([target, given]), 20)
    rest = [name for name in LETTERS[: given.shape[1]] if name not in kept]
    return Search(folds, tuple(kept), offers(*rest), **settings)


def names(found: list[Offer]) -> set[str]:
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
    widths = [Offer(f"{n}@", (n,), "law", simple=False) for n in "cde"]
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
    assert all(gain < 0.02 for _, gain, _ in found.next_best(found.found()))


def test_data_drawn_again_choose_what_is_sure_each_time_and_what_is_not_less_often():
    given = columns(14)
    noise = np.random.default_rng(15).standard_normal(len(given))
    weak = search(given @ [1, 0, 0.14, 0, -2, 0, 0, 0] + noise, given)
    chosen = [one for one in weak.offers if one.name in "ce"]
    found = again(weak, chosen, seed=0)
    assert found.shares["e"] == 1.0
    assert 0.2 < found.shares["c"] < 1.0
    # One coefficient of a thousand rows of unit size.
    assert found.errors["e"] == pytest.approx(1 / np.sqrt(1000), rel=0.35)
