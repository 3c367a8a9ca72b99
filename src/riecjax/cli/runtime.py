"""Global settings, which only the command line may make."""

import os


def start_jax() -> None:
    """Turn on 64-bit and keep JAX on the CPU quiet; call before the first array is made."""
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "2")
    # XLA's Fourier transforms wait for threads of the pool that they run on, so that two at once
    # may wait for each other for ever on a machine of two cores.
    flags = os.environ.get("XLA_FLAGS", "")
    if "xla_cpu_multi_thread_eigen" not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} --xla_cpu_multi_thread_eigen=false".strip()
    import jax

    jax.config.update("jax_enable_x64", True)
