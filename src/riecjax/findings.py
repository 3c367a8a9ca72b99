"""What a user should know of data or of a result, with a code for scripts."""

from typing import NamedTuple


class Finding(NamedTuple):
    """Something a user should know, with a code for scripts."""

    code: str
    message: str
