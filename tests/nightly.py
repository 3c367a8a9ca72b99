"""Cases of a test that `make nightly` adds to those of `make test`."""

from collections.abc import Iterable

import pytest


def nightly(cases: Iterable[object]) -> list[object]:
    """Each of the cases, a tuple where the test has several arguments, marked `slow`."""
    return [
        pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.slow)
        for case in cases
    ]


def by_day(names: Iterable[str], *chosen: str) -> list[object]:
    """All of the names, of which `make test` runs those that are chosen."""
    return [name if name in chosen else nightly([name])[0] for name in names]
