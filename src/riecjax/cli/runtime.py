"""Global settings, which only the command line may make."""

import os


def start_jax() -> None:
    """Turn on 64-bit and keep JAX on the CPU quiet; call before the first array is made."""
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "2")
    import jax

    jax.config.update("jax_enable_x64", True)
