"""What processes of a cluster are asked to do; they import it by name."""

import os
import signal
from pathlib import Path


def square(number: int) -> int:
    return number**2


def dies_at_first(place: str, number: int) -> int:
    """Ends its process the first time that it is asked for a number."""
    marker = Path(place) / str(number)
    if not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def dies(number: int) -> int:
    if number == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return number
