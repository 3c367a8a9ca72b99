"""Errors that a user can act on: each message says what is wrong and what to do about it."""

import contextlib
import os
import re
import site
import sysconfig
import traceback
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from types import UnionType

MOST_WORDS = 300
_STEERING = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]"
)
"""Characters that steer a terminal or turn the direction of writing, and halves of characters."""


def printable(text: str) -> str:
    """The text, of a file or its name, with its control characters as escapes such as `\\x1b`."""
    return _STEERING.sub(lambda found: found[0].encode("unicode_escape").decode(), text)


class RiecjaxError(ValueError):
    """Base of every error that riecjax raises on purpose; `code` names its kind for scripts."""

    code = "error"


class DataError(RiecjaxError):
    """The recorded data does not allow what was asked of it (missing signal, NaN, too short)."""

    code = "data"


class DuplicateRecordingError(DataError):
    """A recording was given twice, as a whole or in part."""

    code = "duplicate_recording"


class MissingSignalError(DataError):
    """A record lacks a signal; `signal` is its name, `available` what the record has.

    `derivative_of` names the signal whose time derivative it is, where that is known; `is_state`,
    whether the model says how it changes, so that a simulation carries it.
    """

    code = "missing_signal"

    def __init__(
        self,
        signal: str,
        available: tuple[str, ...],
        derivative_of: str = "",
        is_state: bool = False,
    ):
        self.signal = signal
        self.available = available
        self.derivative_of = derivative_of
        listed = ", ".join(available) or "none"
        rename = f"Rename a column to it (on the command line: --map {signal}=COLUMN)"
        if not signal.strip():
            message = f"a signal's name is empty; the record has: {listed}."
        elif derivative_of:
            message = (
                f"the record has no signal '{signal}', the derivative of {derivative_of}; it has: "
                f"{listed}. {rename}, form it (--differentiate {signal}={derivative_of}), or write "
                f"its terms as derivatives of {derivative_of}, which hats take off the motion "
                f"(--test-function hat)."
            )
        else:
            message = (
                f"the record has no signal '{signal}'; it has: {listed}. {rename}, or form it of "
                f"others (--differentiate {signal}=SIGNAL, --derive {signal}=FORMULA)."
            )
            if is_state:
                message += (
                    " Where nothing records it, it is a state that a simulation carries, since "
                    "the model says how it changes: rx.refine(model, record, start), start a "
                    "value of each parameter by name, fits what is recorded without it."
                )
        super().__init__(message)


class ModelError(RiecjaxError):
    """A model, equation or criterion is invalid, or a name in it is unknown."""

    code = "model"


class IdentifiabilityError(RiecjaxError):
    """The data cannot tell the parameters apart: regressors are collinear or carry no signal.

    `code` is that of the finding behind it: `unidentifiable`, `not_excited`, `constant_target`.
    """

    def __init__(self, message: str, code: str = "unidentifiable"):
        self.code = code
        super().__init__(message)


class SimulationError(RiecjaxError):
    """A simulation lost its solution where one was needed."""

    code = "simulation"


LONGEST_REASON = 500
"""Characters of a reason that are told."""


def reason_of(error: BaseException) -> str:
    """Why something failed, in one line."""
    said = " ".join(printable(str(error)).split())
    kind = "" if isinstance(error, RiecjaxError | OSError) else f"{type(error).__name__}: "
    return (kind + said)[:LONGEST_REASON] or type(error).__name__


def require(
    what: str,
    value: object,
    kinds: type | UnionType | tuple[type, ...],
    write: str,
    error: type[RiecjaxError] = ModelError,
) -> None:
    """Raise `error` unless the argument `what` is of these kinds; `write` says what to write.

    For slips that would fail far from their cause: a name, a class or a list in place of an object.
    """
    if isinstance(value, kinds):
        return
    if isinstance(value, type):
        given = f"the class {value.__name__}, not an object of it"
    elif isinstance(value, str):
        given = f"the text '{value}'"
    elif value is None:
        given = "None"
    else:
        kind = type(value).__name__
        given = f"{'an' if kind[0] in 'AEIOaeio' else 'a'} {kind}"
    raise error(f"{what} is {given}. Write {write}.")


def refuse_unknown(
    unknown: Sequence[str], names: Iterable[str], has: str = "the model has"
) -> None:
    """Raise `ModelError` for the first of the parameters that are `unknown`, if any, with the
    `names` that there are."""
    if unknown:
        raise ModelError(f"unknown parameter '{unknown[0]}'; {has}: {', '.join(names)}.")


@contextlib.contextmanager
def users_code(name: object) -> Iterator[None]:
    """Run the user's own code: whatever it raises becomes a `ModelError` of one line about it."""
    try:
        yield
    except RiecjaxError:
        raise
    except (Exception, SystemExit) as error:
        words = " ".join(str(error).split("See https")[0].split())
        if len(words) > MOST_WORDS:
            words = f"{words[:MOST_WORDS].rpartition(' ')[0]} ..."
        # The last line of the user's own that it passed through: of a file that belongs neither to
        # this package nor to an installed one nor to Python.
        installed = [sysconfig.get_path(name) for name in ("stdlib", "purelib", "platlib")]
        packages = [*site.getsitepackages(), site.getusersitepackages()]
        folders = [Path(__file__).parent, *installed, *packages]
        where = ""
        for frame in traceback.extract_tb(error.__traceback__):
            path = Path(os.path.abspath(frame.filename))
            if not (frame.filename.startswith("<") or any(map(path.is_relative_to, folders))):
                where = f" at line {frame.lineno} of {path.name}"
        kind = type(error).__name__
        hint = HINTS.get(kind, ": ")
        raise ModelError(f"{name} failed{where}{hint}{kind}: {words}") from error


HINTS = {
    "TracerArrayConversionError": ". Use functions of jax.numpy, such as jnp.sin, in place of "
    "NumPy's. ",
    "TracerBoolConversionError": ". Use jnp.where(condition, a, b) in place of if. ",
}
"""What to write instead, before JAX's own words where they explain the slip at length."""
