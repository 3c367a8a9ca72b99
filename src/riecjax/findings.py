"""What a user should know of data or of a result, with a code for scripts."""

from collections.abc import Iterable, Mapping
from typing import NamedTuple


class Finding(NamedTuple):
    """Something a user should know, with a code for scripts.

    **Fields:** `code`, one of `riecjax.finding_codes.CODES`; `message`, with what to do about it;
    `signals` and `parameters`, the names of those that it concerns, empty where it concerns all or
    none; `doubt`, the share of a value by which it puts each of them in doubt, where it tells, and
    `doubts`, the same by parameter where it differs; `remedy`, options of `riecjax identify` that
    put it right, and `step`, the same in words.
    """

    code: str
    message: str
    signals: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()
    doubt: float = 0.0
    doubts: Mapping[str, float] = {}
    remedy: tuple[str, ...] = ()
    step: str = ""


def option_for(option: str, signals: Iterable[str], value: str) -> tuple[str, ...]:
    """An option of the command line for each of these signals, `--shift v=0.005`."""
    return tuple(word for name in signals for word in (option, f"{name}={value}"))
