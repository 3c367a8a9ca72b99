"""Tests that say which findings they make are held to it."""

from collections.abc import Iterator
from contextlib import contextmanager

from riecjax.findings import Finding


@contextmanager
def held_to(raised: set[str], absent: set[str]) -> Iterator[None]:
    """Fails unless findings of all codes `raised` are made meanwhile, and of none `absent`."""
    made: set[str] = set()
    new = Finding.__new__

    def noted(cls, code, *args, **kwargs):
        made.add(code)
        return new(cls, code, *args, **kwargs)

    Finding.__new__ = noted
    try:
        yield
    finally:
        Finding.__new__ = new
    assert raised <= made, f"no finding {sorted(raised - made)} was made, as the mark says"
    assert not absent & made, f"a finding {sorted(absent & made)} was made, against the mark"
