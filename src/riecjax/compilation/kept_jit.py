"""`kept_jit`: `equinox.filter_jit`, whose compiled functions outlive the process that made them.

JAX's own compilation cache saves the next process XLA's work and nothing before it: to trace a
function and to lower it takes longer than to load it. Here what is kept is found by the
[`ProgramKey`][] of a call, which takes milliseconds, and nothing is traced. Functions are kept
only after `start_jax(keep_compiled=True)`, and behave as `equinox.filter_jit` in all else.
"""

import contextlib
import dataclasses
import functools
import io
import pickle
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FunctionType
from typing import Any, NamedTuple, ParamSpec, TypeVar

import equinox as eqx
import jax

from riecjax.compilation.program_files import Stored, read_program, write_program
from riecjax.compilation.program_key import NoKey, ProgramKey, key_of
from riecjax.leaves import is_concrete
from riecjax.runtime import programs_folder

P = ParamSpec("P")
T = TypeVar("T")
_NAME = "kept_"


@dataclasses.dataclass(frozen=True)
class _Place:
    """Stands for an array in what a function returns: which of the program's results it is."""

    result: int


class _Program(NamedTuple):
    """A compiled function of flat arrays, and what to put its results into."""

    compiled: jax.stages.Compiled
    template: Any


MOST_HELD = 500
"""Programs that a process holds. Each takes some 15 memory maps, of which Linux allows 65530, and
recordings of ever other lengths have ever other programs."""
_programs: dict[str, _Program] = {}


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
    program = _programs.pop(key.digest, None)
    program = program or _read(folder, key) or _made(function, arguments, folder, key)
    # Those that were used last stand last.
    _programs[key.digest] = program
    while len(_programs) > MOST_HELD:
        del _programs[next(iter(_programs))]
    return program


def _read(folder: Path, key: ProgramKey) -> _Program | None:
    stored = read_program(folder, key.digest)
    if stored is None:
        return None
    try:
        template = _Unpickler(io.BytesIO(stored.template), key).load()
    except Exception:  # as of a version that wrote other files
        return None
    return _Program(stored.compiled, template)


def _made(function: Callable, arguments: Any, folder: Path, key: ProgramKey) -> _Program:
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
    template = io.BytesIO()
    # A function that only the call's code can name has no place in a file.
    with contextlib.suppress(pickle.PicklingError, AttributeError, TypeError):
        _Pickler(template, key).dump(program.template)
        if not _calls_python(traced.jaxpr.jaxpr):
            write_program(folder, key.digest, Stored(program.compiled, template.getvalue()))
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
