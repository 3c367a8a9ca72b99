"""What one value of a setting may be: how its text is understood, and written so that it is."""

import dataclasses
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any


@dataclasses.dataclass(frozen=True)
class Kind:
    """One value of a setting.

    **Fields:** `name`, what help calls it; `parse`, which makes the value of a text and whose
    `ValueError` says what is wrong with it; `write`, its inverse; `is_number`, whether a job file
    holds it as a number, and `is_whole`, a whole one; `word`, which stands in place of a number;
    `choices`, all texts there are, if they are few; `example` of a tuple; `path`: `"file"` for a
    path, `"code"` for `FILE.py[:OBJECT]` or a name, `""` for neither.
    """

    name: str
    parse: Callable[[str], Any] = str
    write: Callable[[Any], str] = str
    is_number: bool = False
    is_whole: bool = False
    word: str = ""
    choices: tuple[str, ...] = ()
    example: tuple[Any, ...] = ()
    path: str = ""


def number_text(value: float) -> str:
    """The shortest text that is read as the same number."""
    return str(value) if isinstance(value, int) else repr(float(value)).removesuffix(".0")


def number(name: str, condition: Callable[[float], bool], words: str, kind: type = float) -> Kind:
    """A number that satisfies a condition; `words` follow the number in a refusal."""
    article = "a whole number" if kind is int else "a number"

    def parse(text: str) -> Any:
        try:
            value = kind(text)
        except ValueError:
            raise ValueError(f"'{text}' is not {article}.") from None
        if not condition(value):
            raise ValueError(f"'{text}' {words}.")
        return value

    return Kind(name, parse, number_text, is_number=True, is_whole=kind is int)


def whole(low: int, high: int | None = None) -> Kind:
    """A whole number from `low` on, up to `high` if there is one."""
    words = f"must be from {low} {'on' if high is None else f'to {high}'}"
    top = math.inf if high is None else high
    return number("integer", lambda value: low <= value <= top, words, int)


def choice(*texts: str) -> Kind:
    """One of a few words."""

    def parse(text: str) -> str:
        if text not in texts:
            raise ValueError(f"'{text}' is not one of {', '.join(map(repr, texts))}.")
        return text

    return Kind("choice", parse, choices=texts)


def _new(text: str, other: str, is_other: Callable[[Path], bool]) -> Path:
    """A path to write to, where nothing of the other kind stands."""
    if is_other(Path(text)):
        raise ValueError(f"'{text}' is a {other}.")
    return Path(text)


TEXT = Kind("text")
TRUTH = Kind("truth")
FILE = Kind("path", Path, str, path="file")
FOLDER = Kind("directory", lambda text: _new(text, "file", Path.is_file), str, path="file")
NEW_FILE = Kind("file", lambda text: _new(text, "directory", Path.is_dir), str, path="file")
CODE = Kind("text", path="code")
POSITIVE = number(
    "number",
    lambda value: math.isfinite(value) and value > 0,
    "must be a finite number greater than zero",
)
NOT_NEGATIVE = number(
    "number",
    lambda value: math.isfinite(value) and value >= 0,
    "is negative or not finite; give a number from 0 on",
)
FINITE = number("number", math.isfinite, "is not a finite number")
LIMIT = number("number", lambda value: not math.isnan(value), "is no end of a range")
SHARE = number("share", lambda value: 0 < value < 1, "must lie between 0 and 1")


def word_or(word: str, kind: Kind, form: str) -> Kind:
    """A word, or a value of a kind."""

    def parse(text: str) -> Any:
        if text == word:
            return word
        try:
            return kind.parse(text)
        except ValueError as error:
            raise ValueError(f"{str(error).rstrip('.')} (or '{word}').") from None

    def write(value: Any) -> str:
        return word if isinstance(value, str) else kind.write(value)

    return dataclasses.replace(kind, name=form, parse=parse, write=write, word=word)


MOST_WINDOWS = 100_000_000
WINDOW_COUNT = word_or("all", whole(1, MOST_WINDOWS), "N|all")
HERTZ_OR_AUTO = word_or("auto", POSITIVE, "HZ|auto")

TEST_FUNCTION = choice("auto", "boxcar", "hat", "bump")
"""As in `criteria.test_functions`, whose import takes JAX."""

NAMES = Kind("A,B,...", lambda text: tuple(map(str.strip, text.split(","))), ",".join)


def parts(
    example: tuple[Any, ...], form: str, pattern: str, write: str, *kinds: Kind, more: str = ""
) -> Kind:
    """Values of these kinds, one for each group of a pattern, `None` for one that is not there.

    **Arguments:** an `example`; its `form`, as help shows it; the `pattern` of texts; how to
    `write` them, with a place for each; `more`, a further form that is understood.
    """

    def parse(text: str) -> tuple[Any, ...]:
        match = re.fullmatch(pattern, text.strip())
        if match is None:
            raise ValueError(f"'{text}' is not of the form {form}{more}.")
        pairs = zip(kinds, match.groups(), strict=True)
        return tuple(None if part is None else kind.parse(part) for kind, part in pairs)

    def written(values: Any) -> str:
        pairs = zip(kinds, values, strict=True)
        texts = ("" if part is None else kind.write(part) for kind, part in pairs)
        return write.format(*texts).rstrip("=")

    return Kind(form, parse, written, example=example)


SIGNAL = r"([^=\s](?:[^=]*[^=\s])?)\s*(?:=\s*(.*\S))?"
PLACE = parts(("x", None), "SIGNAL[=HZ]", SIGNAL, "{}={}", TEXT, POSITIVE)
"""A signal, and perhaps a frequency near which something is looked for."""
ELEMENT = dataclasses.replace(parts(
    ("mode", "x", None),
    "KIND:SIGNAL[=HZ]",
    r"((?:.*\.py\s*:)?[^:]*[^:\s])\s*:\s*" + SIGNAL,
    "{}:{}={}",
    *(TEXT, TEXT, POSITIVE),
), path="code")  # fmt: skip
"""A kind of element, where it is looked for, and perhaps near which frequency."""
ENDS = parts((0.0, None), "LOW:HIGH", r"(.*\S)?\s*:\s*(.+)?", "{}:{}", LIMIT, LIMIT)
"""Both ends of a range, either of which may be left out."""
MEAN_AND_DEVIATION = parts(
    (1.0, 0.1),
    "MEAN±SD",
    r"(.*)(?:±|\+-)(.*)",
    "{}±{}",
    *(FINITE, POSITIVE),
    more=" (or MEAN+-SD)",
)
"""Mean and standard deviation, with `+-` between them too."""
