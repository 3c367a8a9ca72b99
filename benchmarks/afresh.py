"""Processes that find none of the caller's settings of JAX, and nothing compiled before."""

import json
import os
import subprocess
from collections.abc import Sequence
from typing import Any


def environment(cache: str) -> dict[str, str]:
    """This process's environment without settings of JAX; what is compiled is kept in `cache`."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("JAX_", "XLA_"))}
    return kept | {"XDG_CACHE_HOME": cache}


def last_line(command: Sequence[str], **settings: Any) -> Any:
    """The JSON document in the last line that a process prints."""
    run = subprocess.run(command, capture_output=True, text=True, check=True, **settings)
    return json.loads(run.stdout.splitlines()[-1])
