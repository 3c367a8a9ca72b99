"""What is asked of all recordings of a fleet alike, and how it reaches who does it."""

import functools
import hashlib
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from riecjax.criteria.criterion import AbstractCriterion
from riecjax.equations.procedure import AtRest, Procedure, with_rests
from riecjax.fleets.sources import Source
from riecjax.models.model import Model
from riecjax.records.recording import Recording, read_parts
from riecjax.runtime import collect_seldom, start_jax
from riecjax.summaries.digest import Outline

USERS = "riecjax_user_"
"""Beginning of names of modules made of a user's file, which only this process has."""
WHOLE_PATHS = ("file", "folder")
"""Groups that the path of a recording makes."""


# Compared by identity: what was made of it once serves all recordings of a process.
@dataclass(frozen=True, eq=False)
class Order:
    """How each recording is read, summed and grouped.

    **Fields:** `model`; `criterion`, fitted to what was recorded; `edges` of bins of window lengths
    in seconds that drift is looked for over, `None` for none; `reading`, keywords of
    [`read_recordings`][riecjax.read_recordings]; `by`, `"file"`, `"folder"`, or names of columns or
    keys; `starts` of a stretch of a long recording, whose windows have `window` samples at most;
    `storage`, what fsspec is told; `at_rest`; `parts`, names of recordings that are read of a file
    that holds several, all if empty.
    """

    model: Model
    criterion: AbstractCriterion
    edges: np.ndarray | None
    reading: Mapping[str, Any] = field(default_factory=dict)
    by: Sequence[str] = ("file",)
    starts: int = 0
    window: int = 0
    storage: Mapping[str, Any] = field(default_factory=dict)
    at_rest: AtRest | None = None
    parts: Sequence[str] = ()

    def recordings_in(self, file: Path) -> list[Recording]:
        """What a file holds, or those of its parts that are asked for.

        **Raises:** `DataError`, also for a part that it lacks.
        """
        return read_parts(file, self.parts, model=self.model, **self.reading)

    @functools.cached_property
    def procedure(self) -> Procedure:
        """The model's equations, built once."""
        return with_rests(self.model.build_procedure(), self.at_rest)

    @functools.cached_property
    def reads(self) -> dict[tuple[str, ...], Any]:
        """Signals that are read, of recordings that hold these: kept from the first of them on."""
        return {}

    @property
    def columns(self) -> tuple[str, ...]:
        """What recordings are grouped by beside their paths."""
        return () if self.by[0] in WHOLE_PATHS else tuple(self.by)

    def columns_in(self, source: Source) -> tuple[str, ...]:
        """What of it only the columns of a source say."""
        keys = dict(source.keys)
        return tuple(name for name in self.columns if name not in keys)

    @property
    def longest(self) -> float:
        """Seconds of the longest window that is summed."""
        windows = self.criterion.windows
        longest = 0.0 if windows is None else float(windows.beta)
        return longest if self.edges is None else max(longest, float(self.edges[-1]))

    @functools.cached_property
    def digest(self) -> str:
        """Of all that sums depend on beside the samples, and of the version that makes them."""
        said = {
            "riecjax": version("riecjax"),
            "equations": Outline.of(self.procedure.linear).fingerprint,
            "criterion": self.criterion.describe(),
            "edges": None if self.edges is None else self.edges.tolist(),
            "reading": {name: _plain(value) for name, value in self.reading.items()},
            "columns": self.columns,
            "at_rest": self.at_rest,
            "parts": [*self.parts],
        }
        return hashlib.sha256(json.dumps(said, sort_keys=True, default=repr).encode()).hexdigest()

    def packed(self) -> bytes:
        """Bytes that [`unpacked`][] makes it of, in another process or on another machine.

        What a user's file defines goes with it; what it imports must be there.
        """
        import cloudpickle

        own = [module for name, module in sys.modules.items() if name.startswith(USERS)]
        for module in own:
            cloudpickle.register_pickle_by_value(module)
        try:
            return cloudpickle.dumps(self)
        finally:
            for module in own:
                cloudpickle.unregister_pickle_by_value(module)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in sorted(value.items())}
    return [_plain(v) for v in value] if isinstance(value, list | tuple) else value


def _is_worker() -> bool:
    import distributed

    try:
        distributed.get_worker()
    except ValueError:
        return False
    return True


@functools.lru_cache(maxsize=2)
def unpacked(order: bytes) -> Order:
    """The order that these bytes were made of, the same object as long as it is asked for.

    A process of Dask's starts JAX as the command line does; this one's settings are its own.
    """
    import cloudpickle

    if _is_worker():
        start_jax(keep_compiled=True)
        collect_seldom()
    return cloudpickle.loads(order)
