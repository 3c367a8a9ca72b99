"""What processes of a cluster are asked to do; they import it by name."""

import os
import signal
from pathlib import Path


def squares(numbers: list[int]) -> list[int]:
    return [number**2 for number in numbers]


def dies_at_first(place: Path, numbers: list[int]) -> list[int]:
    """Ends its process the first time that it is asked for a number."""
    for number in numbers:
        marker = place / str(number)
        if not marker.exists():
            marker.touch()
            os.kill(os.getpid(), signal.SIGKILL)
    return numbers


def dies(numbers: list[int]) -> list[int]:
    if 1 in numbers:
        os.kill(os.getpid(), signal.SIGKILL)
    return numbers
