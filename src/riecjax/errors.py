"""Errors that a user can act on: each message says what is wrong and what to do about it."""

import contextlib
from collections.abc import Iterator


class RiecjaxError(ValueError):
    """Base of every error that riecjax raises on purpose."""


class DataError(RiecjaxError):
    """The recorded data does not allow what was asked of it (missing signal, NaN, too short)."""


class MissingSignalError(DataError):
    """A record lacks a signal; `signal` is its name, `available` what the record has."""

    def __init__(self, signal: str, available: tuple[str, ...]):
        self.signal = signal
        self.available = available
        super().__init__(
            f"the record has no signal '{signal}'; it has: {', '.join(available) or 'none'}. "
            f"Rename a column to it (on the command line: --map {signal}=COLUMN)."
        )


class ModelError(RiecjaxError):
    """A model, equation or criterion is put together wrongly, or a name in it is unknown."""


class IdentifiabilityError(RiecjaxError):
    """The data cannot tell the parameters apart: regressors are collinear or carry no signal."""


class SimulationError(RiecjaxError):
    """A simulation lost its solution where one was needed."""


@contextlib.contextmanager
def users_code(name: object) -> Iterator[None]:
    """Run the user's own code: whatever it raises becomes a `ModelError` of one line about it."""
    try:
        yield
    except RiecjaxError:
        raise
    except (Exception, SystemExit) as error:
        raise ModelError(f"{name} failed: {type(error).__name__}: {error}") from error
