"""Processes that find none of the caller's settings of JAX, and nothing compiled before."""

import os


def environment(cache: str) -> dict[str, str]:
    """This process's environment without settings of JAX; what is compiled is kept in `cache`."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("JAX_", "XLA_"))}
    return kept | {"XDG_CACHE_HOME": cache}
