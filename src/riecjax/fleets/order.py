"""What is asked of all recordings of a fleet alike, and how it reaches who does it."""

import contextlib
import dataclasses
import functools
import hashlib
import json
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from riecjax.criteria.criterion import DOLS, AbstractCriterion
from riecjax.criteria.suited import suited
from riecjax.equations.procedure import AtRest, Procedure, with_rests
from riecjax.errors import DataError, ModelError, reason_of
from riecjax.fleets.sources import (
    STRETCH,
    Piece,
    Source,
    at_hand,
    is_long,
    recordings_of,
    rows_at_hand,
    stretches,
)
from riecjax.models.model import Model
from riecjax.records.recording import Recording, read_parts
from riecjax.runtime import collect_seldom, start_jax
from riecjax.summaries.digest import Outline
from riecjax.summaries.one_pass import stretch_starts
from riecjax.summaries.task import ready
from riecjax.validation.sweep import LONGER, sweep_edges

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


@functools.lru_cache(maxsize=2)
def unpacked(order: bytes) -> Order:
    """The order that these bytes were made of, the same object as long as it is asked for.

    A process of Dask's starts JAX as the command line does; this one's settings are its own.
    """
    import cloudpickle
    import distributed

    try:
        distributed.get_worker()
    except ValueError:
        pass  # this process is none of Dask's
    else:
        start_jax(keep_compiled=True)
        collect_seldom()
    return cloudpickle.loads(order)


TRIED = 20
"""Sources that are tried, to find one that says how all are sampled."""
BANDS = 5
"""Of window lengths that drift is looked for over: each costs every recording, and of many of them
a few tell as much as the ten that one is looked through by."""
LOOKED_AT = 2**15
"""Rows of a long one that are enough."""
TOGETHER, SMALL = 16, 2**22
"""Pieces of a task at most, and bytes of their sources together."""


def order_for(
    model: Model,
    sources: Sequence[Source],
    criterion: AbstractCriterion | None,
    by: tuple[str, ...],
    storage: Mapping[str, Any],
    at_rest: AtRest | None,
    reading: Mapping[str, Any],
    parts: Sequence[str],
) -> Order:
    """What is asked of all recordings alike, as the first that can be read says.

    **Raises:** what the first recording fails by, where none of the first can be read;
    `ModelError` for a criterion that draws windows.
    """
    if criterion is not None and criterion.needs_key:
        raise ModelError(
            "a fleet sums all windows: give rx.RIEC(rx.AllWindows(alpha, beta)) (on the command "
            "line: without --windows)."
        )
    reads = Order(model, criterion or DOLS(), None, reading, by, 0, 0, storage, at_rest, parts)
    found = _first(reads, sources)
    (one,) = ready(reads.procedure, found, reading.get("noise", "auto"))
    record = one.record
    if criterion is None:
        criterion = suited(reads.procedure, model.band, [record])
    edges = None
    if criterion.in_closed_form and not reads.procedure.has_hidden:
        with contextlib.suppress(DataError):  # too short for any sweep
            windows = criterion.windows
            assert windows is not None
            longest = LONGER * float(windows.beta)
            edges = sweep_edges([record], criterion, longest=longest, bands=BANDS)
    order = dataclasses.replace(reads, criterion=criterion, edges=edges)
    if not any(map(is_long, sources)):
        return order
    step = float(record.time_step)
    starts, window = stretch_starts(criterion, step, STRETCH), math.ceil(order.longest / step) + 2
    return dataclasses.replace(order, starts=starts, window=window)


def _first(order: Order, sources: Sequence[Source]) -> Recording:
    """The first recording that can be read, or as much of it as is enough."""
    errors: list[Exception] = []
    for source in sources[:TRIED]:
        columns = order.columns_in(source)
        # What is wrong with one recording is told by its row.
        try:
            if is_long(source) or (source.is_parquet and columns):
                first = recordings_of(source, columns, order.storage)[0]
                high = min(first.high, first.low + LOOKED_AT)
                opening = rows_at_hand(first, first.low, high, order.storage)
            else:
                opening = at_hand(source, order.storage)
            with opening as file:
                return order.recordings_in(file)[0]
        except Exception as error:
            errors.append(error)
    raise DataError(
        f"none of the first {len(errors)} recordings can be read; the first: "
        f"{sources[0].name}: {reason_of(errors[0]).removeprefix(f'{sources[0].name}: ')}"
    )


def planned(order: Order, sources: Sequence[Source]) -> Iterator[Piece]:
    """The pieces of all sources, in their order: of long ones stretches."""
    for source in sources:
        if not is_long(source):
            yield Piece(source)
            continue
        try:
            every = recordings_of(source, order.columns_in(source), order.storage)
        except Exception:
            yield Piece(source)  # whoever sums it says why not
            continue
        for recording in every:
            yield from stretches(recording, order.starts, order.window)


def tasks_of(pieces: Sequence[Piece]) -> Iterator[list[Piece]]:
    """Pieces that are summed by one task: as many as take longer than to hand it over."""
    some: list[Piece] = []
    for piece in pieces:
        size = sum(one.source.size for one in (*some, piece))
        if some and (len(some) >= TOGETHER or size > SMALL):
            yield some
            some = []
        some.append(piece)
    if some:
        yield some
