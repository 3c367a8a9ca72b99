"""Standard output for answers alone: what a user's model prints must not stand among JSON."""

import contextlib
import sys
from collections.abc import Iterator
from typing import TextIO

import click

_answers: list[TextIO] = []


def keep_for_answers() -> None:
    """From now on what else is printed goes to standard error, up to the end of [`restored`][]."""
    if not _answers:
        _answers.append(sys.stdout)
        sys.stdout = sys.stderr


def is_for_answers() -> bool:
    """Whether standard output holds one JSON document, of an error too."""
    return bool(_answers)


@contextlib.contextmanager
def restored() -> Iterator[None]:
    """Afterwards, what is printed goes where it went before."""
    try:
        yield
    finally:
        if _answers:
            sys.stdout = _answers.pop()


def answer(text: str) -> None:
    """Print an answer."""
    click.echo(text, file=_answers[-1] if _answers else None)
