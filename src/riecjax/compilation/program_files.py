"""Compiled programs in files, loaded when they are called or ahead of that.

XLA loads a program without Python: beside the imports of a process, on another core. So what the
last process of a kind called is loaded from the start.
"""

# This module imports little beside JAX, so that loading can begin before all else is imported.

import atexit
import contextlib
import hashlib
import json
import pickle
import re
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from jax.experimental import serialize_executable
from jaxlib import lapack

from riecjax.runtime import CACHE_BYTES, programs_folder
from riecjax.whole_files import Store, read_sealed, write_sealed

_SUFFIX = ".program"
_KEY = re.compile("[0-9a-f]{64}")


class Stored(NamedTuple):
    """A compiled function of flat arrays, and what its caller keeps with it."""

    compiled: jax.stages.Compiled
    template: bytes


_ahead: dict[str, Future[Stored | None]] = {}
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
    atexit.register(_note, calls)
    with contextlib.suppress(OSError, ValueError):
        keys = [key for key in json.loads(read_sealed(calls) or b"[]") if _KEY.fullmatch(key)]
        loader = ThreadPoolExecutor(1)
        _ahead.update({key: loader.submit(_loaded, folder, key) for key in keys})
        loader.shutdown(wait=False)


def read_program(folder: Path, key: str) -> Stored | None:
    """The program of a key; `None` if there is none, or none that can be loaded."""
    _called[key] = None
    ahead = _ahead.pop(key, None)
    return _loaded(folder, key) if ahead is None else ahead.result()


def write_program(folder: Path, key: str, program: Stored) -> None:
    """Keep a program, where it can be."""
    try:
        payload, inputs, outputs = serialize_executable.serialize(program.compiled)
    except Exception:  # each part of JAX that cannot be kept has an error of its own
        return
    counts = (inputs.num_leaves, outputs.num_leaves)
    _store(folder).put(key, pickle.dumps((counts, payload, program.template)))


def _store(folder: Path) -> Store:
    return Store(folder, _SUFFIX, CACHE_BYTES)


def _loaded(folder: Path, key: str) -> Stored | None:
    written = _store(folder).get(key)
    if written is None:
        return None
    try:
        (inputs, outputs), payload, template = pickle.loads(written)
        # XLA ends the process at LAPACK's functions unless a lowering, which is what is spared
        # here, has looked them up.
        lapack.prepare_lapack_call("potrf_ffi", np.float64)
        structure = jax.tree.structure(((0,) * inputs, {}))
        compiled = serialize_executable.deserialize_and_load(
            payload, structure, jax.tree.structure([0] * outputs)
        )
    except Exception:  # what cannot be loaded is made anew
        return None
    return Stored(compiled, template)


def _note(calls: Path) -> None:
    if _called:
        with contextlib.suppress(OSError):
            write_sealed(calls, json.dumps(list(_called)).encode())
