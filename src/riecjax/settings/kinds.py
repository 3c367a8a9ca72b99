"""What one value of a setting may be: how its text is understood, and written so that it is."""

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any


@dataclasses.dataclass(frozen=True)
class Kind:
    """One value of a setting.

    **Fields:** `name`, what help calls it; `parse`, which makes the value of a text and whose
    `ValueError` says what is wrong with it; `write`, its inverse; `is_number`, whether a job file
    holds it as a number, and `is_whole`, a whole one; `holds`, whether a number lies in its range,
    and `range`, words that say which; `word`, which stands in place of a number;
    `choices`, all texts there are, if they are few; `path`: `"file"` for a path, `"code"` for
    `FILE.py[:OBJECT]` or a name, `""` for neither.
    """

    name: str
    parse: Callable[[str], Any] = str
    write: Callable[[Any], str] = str
    is_number: bool = False
    is_whole: bool = False
    holds: Callable[[float], bool] = lambda value: True
    range: str = ""
    word: str = ""
    choices: tuple[str, ...] = ()
    path: str = ""


def number_text(value: float) -> str:
    """The shortest text that is read as the same number."""
    return str(value) if isinstance(value, int) else repr(float(value)).removesuffix(".0")


def number(name: str, holds: Callable[[float], bool], range: str, kind: type = float) -> Kind:
    """A number in a range, whose words follow the number in a refusal."""
    article = "a whole number" if kind is int else "a number"

    def parse(text: str) -> Any:
        try:
            value = kind(text)
        except ValueError:
            raise ValueError(f"'{text}' is not {article}.") from None
        if not holds(value):
            raise ValueError(f"'{text}' {range}.")
        return value

    return Kind(
        name, parse, number_text, is_number=True, is_whole=kind is int, holds=holds, range=range
    )


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

TEST_FUNCTIONS = ("auto", "boxcar", "hat", "bump")
"""As in `criteria.test_functions`, whose import takes JAX."""


def _test_function(text: str) -> str:
    if text not in TEST_FUNCTIONS and not text.rpartition(":")[0].endswith(".py"):
        listed = ", ".join(f"'{name}'" for name in TEST_FUNCTIONS)
        raise ValueError(f"'{text}' is not one of {listed}, nor FILE.py:CLASS.")
    return text


TEST_FUNCTION = Kind("|".join((*TEST_FUNCTIONS, "FILE.py:CLASS")), _test_function, path="code")


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(","))


NAMES = Kind("A,B,...", _names, ",".join)


def _place(text: str) -> tuple[str, float | None]:
    name, equals, frequency = text.partition("=")
    if not name.strip() or (equals and not frequency.strip()):
        raise ValueError(f"'{text}' is not of the form SIGNAL[=HZ].")
    return name.strip(), POSITIVE.parse(frequency) if equals else None


def _place_text(place: tuple[str, float | None]) -> str:
    name, hertz = place
    return name if hertz is None else f"{name}={number_text(hertz)}"


PLACE = Kind("SIGNAL[=HZ]", _place, _place_text)
"""A signal, and perhaps a frequency near which something is looked for."""


def _element(text: str) -> tuple[str, str, float | None]:
    kind, colon, place = text.partition(":")
    if not (kind.strip() and colon and place.strip()):
        raise ValueError(f"'{text}' is not of the form KIND:SIGNAL[=HZ].")
    return kind.strip(), *_place(place)


ELEMENT = Kind(
    "KIND:SIGNAL[=HZ]", _element, lambda element: f"{element[0]}:{_place_text(element[1:])}"
)
"""A kind of element, where it is looked for, and perhaps near which frequency."""


def _ends(text: str) -> tuple[float | None, float | None]:
    low, colon, high = text.partition(":")
    if not colon:
        raise ValueError(f"'{text}' is not of the form LOW:HIGH.")
    try:
        return float(low) if low.strip() else None, float(high) if high.strip() else None
    except ValueError:
        raise ValueError(f"the ends in '{text}' are not numbers.") from None


def _ends_text(ends: tuple[float | None, float | None]) -> str:
    return ":".join("" if end is None else number_text(end) for end in ends)


ENDS = Kind("LOW:HIGH", _ends, _ends_text)
"""Both ends of a range, either of which may be left out."""


def _mean_and_deviation(text: str) -> tuple[float, float]:
    mean, sign, deviation = text.replace("+-", "±").partition("±")
    if not sign:
        raise ValueError(f"'{text}' is not of the form MEAN±SD (or MEAN+-SD).")
    return FINITE.parse(mean), POSITIVE.parse(deviation)


MEAN_AND_DEVIATION = Kind(
    "MEAN±SD",
    _mean_and_deviation,
    lambda pair: "±".join(map(number_text, pair)),
)
"""Mean and standard deviation, with `+-` between them too."""
