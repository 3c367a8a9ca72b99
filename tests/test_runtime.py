"""Global settings, each in a process of its own."""

import os
import subprocess
import sys

import pytest

from riecjax.runtime import processor

CLEAN = {k: v for k, v in os.environ.items() if not k.startswith(("JAX_", "XLA_", "XDG_"))}
COMPILED = "import jax, jax.numpy as jnp; jax.jit(lambda x: jnp.sin(x) + 1)(jnp.ones(3))"


def process(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code], env=CLEAN | environment, capture_output=True, text=True
    )


def test_it_turns_on_64_bit_and_keeps_what_stands_in_xla_flags():
    run = process(
        "import os; from riecjax import start_jax; start_jax()\n"
        "import jax.numpy as jnp\n"
        "print(jnp.ones(1).dtype, os.environ['XLA_FLAGS'])",
        XLA_FLAGS="--xla_cpu_multi_thread_eigen=true",
    )
    dtype, *flags = run.stdout.split()
    assert dtype == "float64"
    assert flags[0] == "--xla_cpu_multi_thread_eigen=true"
    assert sum("multi_thread_eigen" in flag for flag in flags) == 1
    assert any("small_while_loop" in flag for flag in flags)


def test_too_late_is_said_and_a_second_time_is_no_harm():
    run = process(f"{COMPILED}\nfrom riecjax import start_jax; start_jax()")
    assert "RuntimeError: start_jax() is too late" in run.stderr
    again = "from riecjax import start_jax; start_jax()"
    assert process(f"{again}\n{COMPILED}\n{again}").returncode == 0


@pytest.mark.slow
def test_what_is_compiled_is_kept_where_it_can_be(tmp_path):
    code = f"from riecjax import start_jax; start_jax(keep_compiled=True)\n{COMPILED}"
    assert process(code, XDG_CACHE_HOME=str(tmp_path)).returncode == 0
    assert list(tmp_path.glob("riecjax/*-jax/*"))
    elsewhere = tmp_path / "elsewhere"
    chosen = {"XDG_CACHE_HOME": str(elsewhere), "JAX_COMPILATION_CACHE_DIR": str(tmp_path / "own")}
    assert process(code, **chosen).returncode == 0
    assert not elsewhere.exists()
    (tmp_path / "file").write_text("")
    run = process(code, XDG_CACHE_HOME=str(tmp_path / "file"))
    assert run.returncode == 0, run.stderr


@pytest.mark.portable
def test_without_a_home_nothing_is_kept():
    code = "def homeless():\n    raise RuntimeError('no home')\nimport pathlib\n"
    code += "pathlib.Path.home = homeless\nfrom riecjax import runtime\n"
    code += "import jax\nruntime.start_jax(keep_compiled=True)\n"
    code += "print(jax.config.jax_compilation_cache_dir)"
    assert process(code).stdout == "None\n"


@pytest.mark.portable
def test_processors_differ_where_their_abilities_are_not_told(monkeypatch):
    def absent(*_: object, **__: object) -> str:
        raise FileNotFoundError

    monkeypatch.setattr("pathlib.Path.read_text", absent)
    names = set()
    for kind in ("Intel64 Family 6 Model 85", "Intel64 Family 6 Model 143"):
        monkeypatch.setattr("platform.processor", lambda kind=kind: kind)
        names.add(processor())
    assert len(names) == 2
