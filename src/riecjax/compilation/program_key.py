"""What tells a compiled program from another one, beyond the process that made it.

A key covers all that a trace can see: source code of this package, versions of the libraries that
it calls, settings of JAX, and everything in a function's arguments that is not an array. A user's
own function counts with its code and with all that this refers to. Where part of that cannot be
told for sure, as of a class of the user's own, or of a file that is read, there is no key.
"""

import dataclasses
import enum
import functools
import hashlib
import inspect
import os
import platform
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from types import BuiltinFunctionType, CodeType, FunctionType, MethodType, ModuleType
from typing import Any

import equinox as eqx
import jax
import numpy as np

from riecjax.runtime import processor

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
    """

    def __init__(self, function: Callable, arguments: Any) -> None:
        self._hash = hashlib.sha256(f"{_of_process()} {_settings()}".encode())
        self._seen: dict[int, int] = {}
        # What is made on the way, as a list of fields, must live as long as its address counts.
        self._alive: list[Any] = []
        self.functions: list[FunctionType] = []
        self._add(function)
        self._add(arguments)
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
        if _root(function.__module__) not in _TOLD:
            self._add_globals(function)
        self._add(function.__defaults__)
        self._add(function.__kwdefaults__)
        self._add_all("cells", [_content(cell) for cell in function.__closure__ or ()])

    def _add_globals(self, function: FunctionType) -> None:
        """All that a user's function refers to by name."""
        names = sorted(_names(function.__code__))
        if reads := _READERS.intersection(names):
            raise NoKey(f"{_full_name(function)} calls {', '.join(sorted(reads))}")
        found = {name: function.__globals__[name] for name in names if name in function.__globals__}
        self._add((found, vars(function)))

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


def _content(cell: Any) -> Any:
    try:
        return cell.cell_contents
    except ValueError:
        raise NoKey("a function that is not yet whole") from None


def key_of(function: Callable, arguments: Any) -> ProgramKey:
    """The key of a call.

    **Raises:** `NoKey` where none is sure.
    """
    return ProgramKey(
        function,
        jax.tree.map(lambda leaf: ArrayType(leaf) if eqx.is_array(leaf) else leaf, arguments),
    )


def _settings() -> str:
    """What a process is told about how to trace and compile."""
    settings = {
        name: str(value)
        for name, value in sorted(jax.config.values.items())
        if not any(part in name for part in _NOT_OF_PROGRAMS)
    }
    return repr((settings, os.environ.get("XLA_FLAGS", "")))


@functools.cache
def _of_process() -> str:
    """Digest of the code that a trace may run, and of the machine."""
    digest = hashlib.sha256()
    for file in sorted(Path(__file__).parents[1].rglob("*.py")):
        digest.update(file.read_bytes())
    versions = {name: metadata.version(name) for name in LIBRARIES}
    devices = [device.device_kind for device in jax.devices()]
    digest.update(repr((platform.python_version(), versions, devices, processor())).encode())
    return digest.hexdigest()
