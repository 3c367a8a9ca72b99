"""Standard output for answers alone: what a user's model prints must not stand among JSON."""

import contextlib
import json
import sys
from collections.abc import Iterator, Mapping
from typing import Any, TextIO

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


def answer(document: Mapping[str, Any]) -> None:
    """Print an answer as JSON."""
    text = json.dumps(document, indent=2, allow_nan=False)
    click.echo(text, file=_answers[-1] if _answers else None)
