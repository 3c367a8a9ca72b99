"""A result as plain data: what `--json` prints, results.json holds, and pages and tables show."""

import hashlib
import json
import math
import platform
from collections.abc import Sequence
from importlib.metadata import version
from typing import Any

Document = dict[str, Any]
"""Keys and values that JSON can express."""

SCHEMA = 4
"""Stands under `schema` in every document.

It is raised when the meaning of a key changes or a key is removed; new keys don't raise it.
"""
READABLE = (1, 2, 3, SCHEMA)
"""Schemas of documents that this version reads: 2 dropped `seed_scatter`, 3 dropped `loop` of
residual tests, 4 dropped `window_choice` and `follows` of residual tests, which no reader needs."""


def unread_schema(schema: object) -> str:
    """That this version does not read documents of a schema, in words; empty where it does."""
    wrong = f"it was written with schema {schema!r}, and this version reads 1 to {SCHEMA}"
    return "" if schema in READABLE else wrong


def sealed(document: Document) -> Document:
    """The document with a checksum of all else in it."""
    return {**document, "checksum": _checksum(document)}


def is_intact(document: Document) -> bool:
    """Whether a document says what it said when it was sealed; one that never was does."""
    told = document.get("checksum")
    return told is None or told == _checksum(document)


def _checksum(document: Document) -> str:
    told = {key: value for key, value in document.items() if key != "checksum"}
    # Keys that are no text become text in JSON, in an order of their own.
    plain = json.dumps(json.loads(json.dumps(told)), sort_keys=True)
    return hashlib.sha256(plain.encode()).hexdigest()


def versions() -> dict[str, str]:
    """Versions of everything that a number depends on."""
    packages = ("riecjax", "jax", "diffrax", "equinox", "optimistix", "numpy", "scipy")
    return {"python": platform.python_version()} | {name: version(name) for name in packages}


LONGEST = 1e6
"""Numbers below it are written out where their digits end before the point: 360, not 3.6e+02."""


def number(value: float | None, digits: int = 6) -> str:
    """A number for a table; `none` where there is none."""
    if value is None:
        return "none"
    said = f"{value:.{digits}g}"
    return f"{float(said):.0f}" if "e+" in said and abs(value) < LONGEST else said


def percents(share: float | None, form: str = ".3g", none: str = "?") -> str:
    """A share in percent, in this form."""
    return none if share is None else f"{100 * share:{form}}"


def share_in_words(share: float | None, digits: int = 3) -> str:
    """A share in percent; `?` where none is known, as of the noise in a function of signals."""
    return "?" if share is None else f"{number(100 * share, digits)} %"


def probability(p: float | None) -> str:
    """A probability for a table; `none` where there is none."""
    return "none" if p is None else "< 1e-6" if p < 1e-6 else number(p, 2)


HALF_DIGITS, MOST_DIGITS = 2, 12
"""Digits of an interval's half width that its ends show, and digits of an end at most."""


def ends_of(interval: Sequence[float | None], digits: int = 6) -> list[str]:
    """Both ends of an interval, with more digits where they would hardly differ; `none` of one that
    has no end."""
    ends = [end for end in interval if end is not None and math.isfinite(end)]
    if len(ends) == 2 and ends[0] != ends[1]:
        half, largest = abs(ends[1] - ends[0]) / 2, max(map(abs, ends))
        orders = math.floor(math.log10(largest)) - math.floor(math.log10(half))
        digits = min(max(digits, orders + HALF_DIGITS), MOST_DIGITS)
    return [number(end, digits) for end in interval] if ends else ["none"]
