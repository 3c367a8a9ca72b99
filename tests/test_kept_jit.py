"""Compiled functions that outlive their process, against `equinox.filter_jit`."""

import functools
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from riecjax import compilation as module
from riecjax import runtime
from riecjax.compilation import NoKey, ProgramKey, kept_jit

TRACED: list[str] = []


class Curve(eqx.Module):
    level: jax.Array
    shape: Callable = eqx.field(static=True)
    name: str = eqx.field(static=True)


class Found(NamedTuple):
    values: jax.Array
    names: tuple[str, ...]
    curve: Curve
    nothing: None


def _evaluate(curve: Curve, x: Any, power: int) -> Found:
    TRACED.append("evaluate")
    spread = jnp.outer(x, x) + jnp.eye(x.size)
    return Found(
        jnp.linalg.solve(spread, curve.level * curve.shape(x) ** power),
        (curve.name, f"power {power}"),
        eqx.tree_at(lambda c: c.level, curve, 2 * curve.level),
        None,
    )


evaluate = kept_jit(_evaluate)


def heard(_: Any) -> None:
    pass


def curve(factor: float = 1.0) -> Curve:
    return Curve(jnp.array(3.0), lambda x: factor * jnp.sin(x), "sine")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where programs are kept; functions of this file count as known."""
    monkeypatch.setattr(module, "_TOLD", {*module._TOLD, __name__.partition(".")[0]})
    monkeypatch.setattr(module, "_programs", {})
    monkeypatch.setattr(runtime, "_programs_folder", tmp_path)
    TRACED.clear()
    return tmp_path


def another_process() -> None:
    module._programs.clear()
    TRACED.clear()


X = np.linspace(0.1, 1.2, 5)


def assert_right(found: Found, factor: float = 1.0, x: np.ndarray = X, power: int = 2) -> None:
    spread = np.outer(x, x) + np.eye(x.size)
    expected = np.linalg.solve(spread, 3.0 * (factor * np.sin(x)) ** power)
    np.testing.assert_allclose(found.values, expected, rtol=1e-12)
    assert found.names == ("sine", f"power {power}")
    assert float(found.curve.level) == 6.0
    np.testing.assert_allclose(found.curve.shape(x), factor * np.sin(x), rtol=1e-12)
    assert found.nothing is None


def test_the_next_process_traces_nothing(folder):
    assert_right(evaluate(curve(), X, power=2))
    another_process()
    assert_right(evaluate(curve(), X, power=2))
    assert_right(evaluate(curve(), X, 2))  # called otherwise: another program
    assert TRACED == ["evaluate"]
    assert len(list(folder.iterdir())) == 2


def test_whatever_a_trace_can_see_makes_another_program(folder):
    assert_right(evaluate(curve(), X, 2))
    assert_right(evaluate(curve(2.0), X, 2), factor=2.0)
    assert_right(evaluate(curve(), X, 3), power=3)
    assert_right(evaluate(curve(), X[:4], 2), x=X[:4])
    assert len(TRACED) == 4
    single = evaluate(curve(), X.astype(np.float32), 2)
    assert len(TRACED) == 5
    assert single.curve.level.dtype == np.float64
    assert_right(evaluate(curve(), X, 2))
    assert len(TRACED) == 5


@pytest.mark.parametrize("damage", ["flipped", "cut", "empty", "foreign"])
def test_a_damaged_file_is_made_anew(folder, damage):
    evaluate(curve(), X, 2)
    (file,) = folder.iterdir()
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(
        {"flipped": bytes(content), "cut": content[:-9], "empty": b"", "foreign": b"x" * 99}[damage]
    )
    another_process()
    assert_right(evaluate(curve(), X, 2))
    another_process()
    assert_right(evaluate(curve(), X, 2))
    assert TRACED == []


def test_a_full_or_missing_folder_costs_nothing_but_time(folder, monkeypatch):
    monkeypatch.setattr(runtime, "_programs_folder", folder / "gone")
    assert_right(evaluate(curve(), X, 2))
    monkeypatch.setattr(runtime, "_programs_folder", folder)
    monkeypatch.setattr(module, "CACHE_BYTES", 1)
    another_process()
    assert_right(evaluate(curve(), X, 2))
    assert_right(evaluate(curve(), X, 3), power=3)
    assert len(list(folder.iterdir())) == 1


def test_what_the_last_of_a_kind_called_is_loaded_ahead(folder, monkeypatch):
    at_exit = []
    monkeypatch.setattr(module.atexit, "register", lambda *call: at_exit.append(call))
    monkeypatch.setattr(module, "_called", {})
    module.load_ahead("identify", "sine")  # there is nothing yet
    evaluate(curve(), X, 2)
    evaluate(curve(), X, 3)
    for note, *arguments in at_exit:
        note(*arguments)

    another_process()
    module.load_ahead("identify", "cosine")
    assert module._ahead == {}
    module.load_ahead("identify", "sine")
    assert len(module._ahead) == 2
    assert_right(evaluate(curve(), X, 3), power=3)
    assert_right(evaluate(curve(), X, 2))
    assert TRACED == []
    assert module._ahead == {}

    another_process()
    for file in folder.glob("*.program"):
        file.write_bytes(b"")
    module.load_ahead("identify", "sine")
    assert_right(evaluate(curve(), X, 2))
    assert TRACED == ["evaluate"]


GAINS = {"low": 2.0}
TABLE = np.array([1.0, 2.0])


def _of_table(x: Any) -> Any:
    return jnp.sum(TABLE) * x


def own(x: Any) -> Any:
    both = [GAINS["low"] * _of_table(part) for part in (x, x)]
    return both[0]


def test_a_function_of_ones_own_counts_with_all_that_it_refers_to(monkeypatch):
    def digest() -> str:
        return ProgramKey(jnp.linalg.norm, functools.partial(jax.jit(own), 1.0)).digest

    keys = [digest(), digest()]
    assert keys[0] == keys[1]
    monkeypatch.setitem(GAINS, "low", 3.0)
    keys.append(digest())
    TABLE[0] = 5.0
    keys.append(digest())
    monkeypatch.setitem(globals(), "_of_table", lambda x: x)
    keys.append(digest())
    assert len(set(keys)) == 4


def helper(x: Any) -> Any:
    return os.fspath(x)


@jax.custom_jvp
def with_own_derivative(x: Any) -> Any:
    return x


def local_class() -> object:
    class Local(NamedTuple):
        value: int

    return Local(1)


@pytest.mark.parametrize(
    "argument",
    [
        lambda x: open("table") * x,  # noqa: SIM115
        lambda x: os.environ["GAIN"] * x,
        lambda x: Curve(x, heard, "own").level,
        lambda: helper(1),
        with_own_derivative,
        local_class(),
        object(),
        curve(),
    ],
)
def test_what_cannot_be_told_has_no_key(argument):
    with pytest.raises(NoKey):
        ProgramKey(jnp.linalg.norm, functools.partial(jnp.sum, where=argument))
