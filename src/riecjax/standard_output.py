"""Standard output for answers alone: what a user's model prints must not stand among JSON."""

import contextlib
import sys
from collections.abc import Iterator
from typing import TextIO

import click

_answers: list[TextIO] = []


@contextlib.contextmanager
def for_answers_alone() -> Iterator[None]:
    """What else is printed goes to standard error."""
    _answers.append(sys.stdout)
    try:
        with contextlib.redirect_stdout(sys.stderr):
            yield
    finally:
        _answers.pop()


def answer(text: str) -> None:
    """Print an answer."""
    click.echo(text, file=_answers[-1] if _answers else None)
