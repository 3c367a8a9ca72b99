"""`kept_jit`: `equinox.filter_jit`, whose compiled functions outlive the process that made them.

JAX's own compilation cache saves the next process XLA's work and nothing before it: to trace a
function and to lower it takes longer than to load it. Here what is kept is found by the
[`ProgramKey`][] of a call, which takes milliseconds, and nothing is traced. Functions are kept
only after `start_jax(keep_compiled=True)`, and behave as `equinox.filter_jit` in all else.
"""

import contextlib
import dataclasses
import functools
import hashlib
import io
import os
import pickle
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FunctionType
from typing import Any, NamedTuple, ParamSpec, TypeVar

import equinox as eqx
import jax
import numpy as np
from jax.experimental import serialize_executable
from jaxlib import lapack

from riecjax.compilation.program_key import NoKey, ProgramKey, key_of
from riecjax.leaves import is_concrete
from riecjax.runtime import CACHE_BYTES, programs_folder

P = ParamSpec("P")
T = TypeVar("T")
_DIGEST_BYTES = 32
_SUFFIX = ".program"
_NAME = "kept_"


@dataclasses.dataclass(frozen=True)
class _Place:
    """Stands for an array in what a function returns: which of the program's results it is."""

    result: int


class _Program(NamedTuple):
    """A compiled function of flat arrays, and what to put its results into."""

    compiled: jax.stages.Compiled
    template: Any


_programs: dict[str, _Program | None] = {}


def kept_jit(function: Callable[P, T]) -> Callable[P, T]:
    """Compile a function by the types of its arrays and by whatever else its arguments hold.

    As `equinox.filter_jit`, which is what is called in other processes than those of the command
    line, while tracing, on several devices, and of arguments that no [`ProgramKey`][] tells apart.
    """
    jitted = eqx.filter_jit(function)

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        arguments = (args, kwargs)
        folder = programs_folder()
        program = None if folder is None else _program(function, arguments, folder)
        if program is None:
            return jitted(*args, **kwargs)
        try:
            results = jax.block_until_ready(program.compiled(*_arrays(arguments)))
        except jax.errors.JaxRuntimeError:  # it was loaded, and cannot be called
            return jitted(*args, **kwargs)
        return jax.tree.map(
            lambda leaf: results[leaf.result] if isinstance(leaf, _Place) else leaf,
            program.template,
        )

    return call


def _arrays(arguments: Any) -> list[Any]:
    return jax.tree.leaves(eqx.filter(arguments, eqx.is_array))


def _program(function: Callable, arguments: Any, folder: Path) -> _Program | None:
    """The program of a call, of this process, an earlier one, or new; `None` if none is kept."""
    if jax.config.values["jax_disable_jit"] or jax.device_count() > 1 or not is_concrete(arguments):
        return None
    try:
        key = key_of(function, arguments)
    except NoKey:
        return None
    if key.digest not in _programs:
        file = folder / (key.digest + _SUFFIX)
        found = _read(file, key)
        _programs[key.digest] = found or _made(function, arguments, file, key)
    return _programs[key.digest]


def _made(function: Callable, arguments: Any, file: Path, key: ProgramKey) -> _Program | None:
    arrays, others = eqx.partition(arguments, eqx.is_array)
    leaves, structure = jax.tree.flatten(arrays)
    templates = []

    def flat(*given: jax.Array) -> list[jax.Array]:
        args, kwargs = eqx.combine(jax.tree.unflatten(structure, given), others)
        returned, rest = eqx.partition(function(*args, **kwargs), eqx.is_array)
        results, form = jax.tree.flatten(returned)
        places = jax.tree.unflatten(form, [_Place(i) for i in range(len(results))])
        templates[:] = [eqx.combine(places, rest)]
        return results

    flat.__name__ = flat.__qualname__ = _NAME + function.__name__
    traced = jax.jit(flat).trace(*leaves)
    with _not_in_jax_cache():
        program = _Program(traced.lower().compile(), templates[0])
    if not _calls_python(traced.jaxpr.jaxpr):
        _write(file, program, key)
    return program


def _calls_python(jaxpr: Any) -> bool:
    """Whether a program calls a function of this process, whose address means nothing later."""
    if jaxpr.effects:
        return True
    for equation in jaxpr.eqns:
        if "callback" in equation.primitive.name:
            return True
        inner = (getattr(leaf, "jaxpr", leaf) for leaf in jax.tree.leaves(equation.params))
        if any(_calls_python(part) for part in inner if hasattr(part, "eqns")):
            return True
    return False


@contextlib.contextmanager
def _not_in_jax_cache() -> Iterator[None]:
    """Let JAX's own cache keep nothing.

    XLA cannot serialise anew what was loaded from there: the names of its kernels are lost. What
    is called by `_NAME` is never written, and so never read.
    """
    setting = "jax_persistent_cache_min_compile_time_secs"
    before = jax.config.values[setting]
    jax.config.update(setting, float("inf"))
    try:
        yield
    finally:
        jax.config.update(setting, before)


class _Pickler(pickle.Pickler):
    """Pickles functions of a call's arguments, lambdas too, as their place in these."""

    def __init__(self, file: io.BytesIO, key: ProgramKey) -> None:
        super().__init__(file)
        self._places = {id(function): i for i, function in enumerate(key.functions)}

    def persistent_id(self, obj: Any) -> int | None:
        return self._places.get(id(obj)) if isinstance(obj, FunctionType) else None


class _Unpickler(pickle.Unpickler):
    def __init__(self, file: io.BytesIO, key: ProgramKey) -> None:
        super().__init__(file)
        self._functions = key.functions

    def persistent_load(self, pid: int) -> FunctionType:
        return self._functions[pid]


def _write(file: Path, program: _Program, key: ProgramKey) -> None:
    """Keep a program, where it can be."""
    written = io.BytesIO()
    try:
        payload, inputs, outputs = serialize_executable.serialize(program.compiled)
        counts = (inputs.num_leaves, outputs.num_leaves)
        _Pickler(written, key).dump((counts, program.template, payload))
    except Exception:  # each part of JAX that cannot be kept has an error of its own
        return
    content = written.getvalue()
    with contextlib.suppress(OSError):
        _make_room(file.parent, len(content))
        with tempfile.NamedTemporaryFile(dir=file.parent, suffix=_SUFFIX, delete=False) as new:
            new.write(hashlib.sha256(content).digest() + content)
        os.replace(new.name, file)


def _read(file: Path, key: ProgramKey) -> _Program | None:
    try:
        content = file.read_bytes()
        os.utime(file)
    except OSError:
        return None
    told, written = content[:_DIGEST_BYTES], content[_DIGEST_BYTES:]
    if hashlib.sha256(written).digest() != told:
        return None
    try:
        counts, template, payload = _Unpickler(io.BytesIO(written), key).load()
        inputs, outputs = counts
        # XLA ends the process at LAPACK's functions unless a lowering, which is what is spared
        # here, has looked them up.
        lapack.prepare_lapack_call("potrf_ffi", np.float64)
        structure = jax.tree.structure(((0,) * inputs, {}))
        compiled = serialize_executable.deserialize_and_load(
            payload, structure, jax.tree.structure([0] * outputs)
        )
    except Exception:  # what cannot be loaded is made anew
        return None
    return _Program(compiled, template)


def _make_room(folder: Path, needed: int) -> None:
    """Forget the programs that were not used for longest."""
    used = sorted((file.stat().st_mtime, file) for file in folder.glob("*" + _SUFFIX))
    sizes = [file.stat().st_size for _, file in used]
    excess = sum(sizes) + needed - CACHE_BYTES
    for (_, file), size in zip(used, sizes):
        if excess <= 0:
            return
        file.unlink(missing_ok=True)
        excess -= size
