"""Cases of a test that `make nightly` adds to those of `make test`."""

from collections.abc import Collection, Iterable

import pytest


def nightly(cases: Iterable[object]) -> list[object]:
    """Each of the cases, a tuple where the test has several arguments, marked `slow`."""
    return [
        pytest.param(*(case if type(case) is tuple else (case,)), marks=pytest.mark.slow)
        for case in cases
    ]


def nightly_among(names: Iterable[str], late: Collection[str]) -> list[object]:
    """All of the names, the late ones marked `slow`."""
    return [nightly([name])[0] if name in late else name for name in names]


def by_day(names: Iterable[str], *chosen: str) -> list[object]:
    """All of the names, of which `make test` runs those that are chosen."""
    names = list(names)
    return nightly_among(names, [name for name in names if name not in chosen])
