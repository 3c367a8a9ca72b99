"""`kept_jit`: `equinox.filter_jit`, whose compiled functions outlive the process that made them.

JAX's own compilation cache saves the next process XLA's work and nothing before it: to trace a
function and to lower it takes longer than to load it. Here what is kept is found by the
[`ProgramKey`][] of a call, which takes milliseconds, and nothing is traced. Functions are kept
only after `start_jax(keep_compiled=True)`, and behave as `equinox.filter_jit` in all else.

A key covers all that a trace can see: source code of this package, versions of the libraries that
it calls, settings of JAX, and everything in a function's arguments that is not an array. A user's
own function counts with its code and with all that this refers to. Where part of that cannot be
told for sure, as of a class of the user's own, or of a file that is read, there is no key.

XLA loads a program without Python: beside the imports of a process, on another core. So what the
last process of a kind called is loaded from the start.
"""

import atexit
import contextlib
import dataclasses
import enum
import functools
import gzip
import hashlib
import inspect
import io
import json
import os
import pickle
import platform
import re
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from importlib import metadata
from pathlib import Path
from types import BuiltinFunctionType, CodeType, FunctionType, MethodType, ModuleType
from typing import Any, NamedTuple, ParamSpec, TypeVar

import equinox as eqx
import jax
import numpy as np
from jax.experimental import serialize_executable
from jaxlib import lapack

from riecjax.leaves import is_concrete
from riecjax.runtime import CACHE_BYTES, processor, programs_folder
from riecjax.whole_files import Store, write_whole

LIBRARIES = ("diffrax", "equinox", "jax", "jaxlib", "jaxtyping", "lineax", "numpy", "optimistix")
"""Whose functions a trace may call, and whose versions therefore count."""
_PACKAGE = __name__.partition(".")[0]
_JITTED = type(jax.jit(lambda: None))
_TOLD = {_PACKAGE, *LIBRARIES, "builtins", "cmath", "collections", "functools", "itertools", "math",
         "operator"}  # fmt: skip
_READERS = {"__import__", "eval", "exec", "fromfile", "genfromtxt", "getattr", "globals", "input",
            "load", "loadtxt", "memmap", "open", "random"}  # fmt: skip
"""What a user's function may not name: these reach what is in neither its code nor its globals."""
_PLAIN = (type(None), bool, int, float, complex, str, bytes, type(Ellipsis), range)
_NOT_OF_PROGRAMS = ("cache", "log", "dump", "explain", "traceback", "compiler_details")
"""Parts of the names of JAX's settings that change no program."""


class NoKey(Exception):
    """Something that may be another program in another process, and not look so."""


class ArrayType:
    """Stands where an argument's array was: any array of its type calls the same program."""

    def __init__(self, array: Any) -> None:
        # Weak types promote otherwise.
        self.described = (np.shape(array), str(array.dtype), getattr(array, "weak_type", False))


class ProgramKey:
    """The key of a call, and the functions on its way, which what it returns may hold.

    **Fields:** `digest` in hexadecimal; `functions` in the order in which they were found.

    **Raises:** `NoKey` where none is sure.
    """

    def __init__(self, function: Callable, arguments: Any) -> None:
        # What a process is told about how to trace and compile.
        settings = {
            name: str(value)
            for name, value in sorted(jax.config.values.items())
            if not any(part in name for part in _NOT_OF_PROGRAMS)
        }
        flags = os.environ.get("XLA_FLAGS", "")
        self._hash = hashlib.sha256(f"{_of_process()} {settings!r} {flags}".encode())
        self._seen: dict[int, int] = {}
        # What is made on the way, as a list of fields, must live as long as its address counts.
        self._alive: list[Any] = []
        self.functions: list[FunctionType] = []
        self._add(function)
        self._add(
            jax.tree.map(lambda leaf: ArrayType(leaf) if eqx.is_array(leaf) else leaf, arguments)
        )
        self.digest = self._hash.hexdigest()

    def _write(self, *parts: object) -> None:
        for part in parts:
            self._hash.update(repr(part).encode() + b"\0")

    def _add(self, value: Any) -> None:
        if isinstance(value, _PLAIN):
            self._write(type(value).__name__, value)
        elif isinstance(value, ArrayType):
            self._write("array", *value.described)
        elif id(value) in self._seen:
            self._write("seen", self._seen[id(value)])
        else:
            self._seen[id(value)] = len(self._seen)
            self._alive.append(value)
            self._add_new(value)

    def _add_new(self, value: Any) -> None:
        match value:
            case type() | BuiltinFunctionType() | ModuleType():
                self._write_name(value)
            case FunctionType():
                self._add_function(value)
            case MethodType():
                self._add_all("method", (value.__func__, value.__self__))
            case functools.partial():
                self._add_all("partial", (value.func, value.args, value.keywords))
            case enum.Enum():
                self._write("enum", type(value).__qualname__, value.name)
            case tuple() | list():
                self._write_name(type(value))
                self._add_all("items", value)
            case dict():
                self._write_name(type(value))
                self._add_all("keys", value.keys())
                self._add_all("values", value.values())
            case set() | frozenset():
                if not all(isinstance(item, _PLAIN) for item in value):
                    raise NoKey(f"a set of {value}")
                self._add_all("set", sorted(value, key=repr))
            case jax.Array():
                self._add(np.asarray(value))
            case np.ndarray() | np.generic():
                if value.dtype.hasobject:
                    raise NoKey("an array of objects")
                self._write("constant", value.shape, str(value.dtype), value.tobytes())
            case np.dtype():
                self._write("dtype", str(value))
            case _ if dataclasses.is_dataclass(value):
                self._write_name(type(value))
                names = [field.name for field in dataclasses.fields(value)]
                self._add_all(repr(names), [getattr(value, name, None) for name in names])
            case _ if isinstance(value, _JITTED):
                self._add_all("jit", [inspect.unwrap(value)])
            case _ if _root(type(value).__module__) == _PACKAGE and hasattr(value, "__dict__"):
                self._write_name(type(value))
                self._add(dict(sorted(vars(value).items())))
            case _:
                raise NoKey(f"{type(value).__module__}.{type(value).__qualname__}")

    def _add_all(self, label: str, values: Any) -> None:
        self._write(label, len(values))
        for value in values:
            self._add(value)

    def _write_name(self, value: Any) -> None:
        name = _full_name(value)
        if _root(name) not in _TOLD:
            raise NoKey(f"{name} is not of a library whose version counts")
        if isinstance(value, type) and "<locals>" in name:
            raise NoKey(f"{name} is a class of a call")
        self._write(name)

    def _add_function(self, function: FunctionType) -> None:
        self._write(_full_name(function))
        self.functions.append(function)
        # Two lambdas of a function have one name.
        self._write_code(function.__code__)
        if _root(function.__module__) not in _TOLD:  # all that a user's refers to by name
            names = _names(function.__code__)
            if reads := _READERS & names:
                raise NoKey(f"{_full_name(function)} calls {', '.join(sorted(reads))}")
            scope = function.__globals__
            self._add(({name: scope[name] for name in sorted(names & {*scope})}, vars(function)))
        self._add(function.__defaults__)
        self._add(function.__kwdefaults__)
        try:
            contents = [cell.cell_contents for cell in function.__closure__ or ()]
        except ValueError:
            raise NoKey("a function that is not yet whole") from None
        self._add_all("cells", contents)

    def _write_code(self, code: CodeType) -> None:
        self._write(code.co_firstlineno, code.co_code, code.co_names, code.co_varnames)
        for constant in code.co_consts:
            match constant:
                case CodeType():
                    self._write_code(constant)
                case frozenset():  # whose order is another one in each process
                    self._write("set", sorted(map(repr, constant)))
                case _:
                    self._write(constant)


def _root(module: str) -> str:
    return module.partition(".")[0]


def _full_name(value: Any) -> str:
    if isinstance(value, ModuleType):
        return value.__name__
    return f"{getattr(value, '__module__', None) or 'builtins'}.{value.__qualname__}"


def _names(code: CodeType) -> set[str]:
    """Globals and attributes that a function's code names, and code inside of it."""
    inner = (part for part in code.co_consts if isinstance(part, CodeType))
    return set(code.co_names).union(*map(_names, inner))


@functools.cache
def _of_process() -> str:
    """Digest of the code that a trace may run, and of the machine."""
    digest = hashlib.sha256()
    for file in sorted(Path(__file__).parent.rglob("*.py")):
        digest.update(file.read_bytes())
    versions = {name: metadata.version(name) for name in LIBRARIES}
    devices = [device.device_kind for device in jax.devices()]
    digest.update(repr((platform.python_version(), versions, devices, processor())).encode())
    return digest.hexdigest()


P = ParamSpec("P")
T = TypeVar("T")
_NAME = "kept_"
_SUFFIX = ".program"
_KEY = re.compile("[0-9a-f]{64}")


class Program(NamedTuple):
    """A compiled function of flat arrays, and what to put its results into: pickled, in a file."""

    compiled: jax.stages.Compiled
    template: Any


_ahead: dict[str, Future[Program | None]] = {}
_called: dict[str, None] = {}


def load_ahead(*kind: str) -> None:
    """Begin to load, on a thread, what the last process of this kind called; note what this one
    calls."""
    folder = programs_folder()
    if folder is None:
        return
    calls = folder / (
        hashlib.sha256("\0".join(kind).encode(errors="surrogatepass")).hexdigest() + ".calls"
    )

    def note() -> None:
        if _called:
            with contextlib.suppress(OSError):
                write_whole(calls, json.dumps(list(_called)).encode())

    atexit.register(note)
    with contextlib.suppress(OSError, ValueError, TypeError):
        keys = [key for key in json.loads(calls.read_bytes()) if _KEY.fullmatch(key)]
        loader = ThreadPoolExecutor(1)
        _ahead.update({key: loader.submit(_loaded, folder, key) for key in keys})
        loader.shutdown(wait=False)


def _loaded(folder: Path, key: str) -> Program | None:
    written = Store(folder, _SUFFIX, CACHE_BYTES).get(key)
    if written is None:
        return None
    try:
        # A checksum is part of the format: what is damaged does not unpack.
        (inputs, outputs), payload, template = pickle.loads(gzip.decompress(written))
        # XLA ends the process at LAPACK's functions unless a lowering, which is what is spared
        # here, has looked them up.
        lapack.prepare_lapack_call("potrf_ffi", np.float64)
        structure = jax.tree.structure(((0,) * inputs, {}))
        compiled = serialize_executable.deserialize_and_load(
            payload, structure, jax.tree.structure([0] * outputs)
        )
    except Exception:  # what cannot be loaded is made anew
        return None
    return Program(compiled, template)


@dataclasses.dataclass(frozen=True)
class _Place:
    """Stands for an array in what a function returns: which of the program's results it is."""

    result: int


MOST_HELD = 500
"""Programs that a process holds. Each takes some 15 memory maps, of which Linux allows 65530, and
recordings of ever other lengths have ever other programs."""
_programs: dict[str, Program] = {}


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
            arrays = jax.tree.leaves(eqx.filter(arguments, eqx.is_array))
            results = jax.block_until_ready(program.compiled(*arrays))
        except jax.errors.JaxRuntimeError:  # it was loaded, and cannot be called
            return jitted(*args, **kwargs)
        return jax.tree.map(
            lambda leaf: results[leaf.result] if isinstance(leaf, _Place) else leaf,
            program.template,
        )

    return call


def _program(function: Callable, arguments: Any, folder: Path) -> Program | None:
    """The program of a call, of this process, an earlier one, or new; `None` if none is kept."""
    if jax.config.values["jax_disable_jit"] or jax.device_count() > 1 or not is_concrete(arguments):
        return None
    try:
        key = ProgramKey(function, arguments)
    except NoKey:
        return None
    program = _programs.pop(key.digest, None)
    program = program or _read(folder, key) or _made(function, arguments, folder, key)
    # Those that were used last stand last.
    _programs[key.digest] = program
    while len(_programs) > MOST_HELD:
        del _programs[next(iter(_programs))]
    return program


def _read(folder: Path, key: ProgramKey) -> Program | None:
    """The program of a key; `None` if there is none, or none that can be loaded."""
    _called[key.digest] = None
    ahead = _ahead.pop(key.digest, None)
    stored = _loaded(folder, key.digest) if ahead is None else ahead.result()
    if stored is None:
        return None
    try:
        unpickler = pickle.Unpickler(io.BytesIO(stored.template))
        unpickler.persistent_load = key.functions.__getitem__
        template = unpickler.load()
    except Exception:  # as of a version that wrote other files
        return None
    return Program(stored.compiled, template)


def _made(function: Callable, arguments: Any, folder: Path, key: ProgramKey) -> Program:
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
    # XLA cannot serialise anew what was loaded from JAX's own cache: the names of its kernels are
    # lost. What is called by `_NAME` is never written there, and so never read.
    setting = "jax_persistent_cache_min_compile_time_secs"
    before = jax.config.values[setting]
    jax.config.update(setting, float("inf"))
    try:
        program = Program(traced.lower().compile(), templates[0])
    finally:
        jax.config.update(setting, before)
    template = io.BytesIO()
    pickler = pickle.Pickler(template)
    # Functions of a call's arguments, lambdas too, are kept as their place in these. A function
    # that only the call's code can name has none; each part of JAX that cannot be kept has an error
    # of its own.
    places = {id(function): place for place, function in enumerate(key.functions)}
    pickler.persistent_id = lambda part: places.get(id(part))
    with contextlib.suppress(Exception):
        pickler.dump(program.template)
        if not _calls_python(traced.jaxpr.jaxpr):
            payload, inputs, outputs = serialize_executable.serialize(program.compiled)
            counts = (inputs.num_leaves, outputs.num_leaves)
            written = pickle.dumps((counts, payload, template.getvalue()))
            store = Store(folder, _SUFFIX, CACHE_BYTES)
            store.put(key.digest, gzip.compress(written, compresslevel=1))
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
