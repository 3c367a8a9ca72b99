"""What a user should know of data or of a result, with a code for scripts."""

from typing import NamedTuple


class Finding(NamedTuple):
    """Something a user should know, with a code for scripts.

    **Fields:** `code`; `message`, with what to do about it; `signals` and `parameters`, the names
    of those that it concerns, empty where it concerns all or none; `doubt`, the share of a value by
    which it puts each of them in doubt, where it tells.
    """

    code: str
    message: str
    signals: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()
    doubt: float = 0.0
