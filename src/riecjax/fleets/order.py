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

from riecjax import DOLS, Model, Recording, Summary, read_recordings
from riecjax.criteria import AbstractCriterion, criterion_for
from riecjax.errors import DataError, ModelError, reason_of
from riecjax.estimation import plan_parameters
from riecjax.fleets.settings import Fleets
from riecjax.fleets.sources import Piece, Source, at_hand, recordings_of, rows_at_hand, stretches
from riecjax.runtime import collect_seldom, start_jax
from riecjax.summaries import Outline, default_criterion, stretch_starts
from riecjax.validation import LONGER, sweep_edges

USERS = "riecjax_user_"
"""Beginning of names of modules made of a user's file, which only this process has."""
WHOLE_PATHS = ("file", "folder")
"""Groups that the path of a recording makes."""
TRIED = 20
"""Sources that are tried, to find one that says how all are sampled."""
LOOKED_AT = 2**15
"""Rows of a long one that are enough."""
BANDS = 5
"""Of window lengths that drift is looked for over: each costs every recording, and of many of them
a few tell as much as the ten that one is looked through by."""
STRETCH = 2**20
"""Starts of a stretch of a long recording, about."""


# Compared by identity: what was made of it once serves all recordings of a process.
@dataclass(frozen=True, eq=False)
class Order:
    """How each recording is read, summed and grouped, and each group estimated.

    **Fields:** `model`; `settings`; `criterion`, fitted to what was recorded; `edges` of bins of
    window lengths in seconds that drift is looked for over, `None` for none; `starts` of a stretch
    of a long recording, whose windows have `window` samples at most.
    """

    model: Model
    settings: Fleets
    criterion: AbstractCriterion = field(default_factory=DOLS)
    edges: np.ndarray | None = None
    starts: int = 0
    window: int = 0

    def recordings_in(self, file: Path) -> list[Recording]:
        """What a file holds, or those of its parts that are asked for.

        **Raises:** `DataError`, also for a part that it lacks.
        """
        return read_recordings(file, **{**vars(self.settings.reading), "model": self.model})

    @property
    def storage(self) -> Mapping[str, Any]:
        """What fsspec is told of the store."""
        return self.settings.storage or {}

    @property
    def columns(self) -> tuple[str, ...]:
        """What recordings are grouped by beside their paths."""
        return () if self.settings.keys[0] in WHOLE_PATHS else self.settings.keys

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
        settings = {
            "riecjax": version("riecjax"),
            "equations": Outline.of(self.model.linear).fingerprint,
            "criterion": self.criterion.describe(),
            "edges": None if self.edges is None else self.edges.tolist(),
            "reading": repr(self.settings.reading),
            "columns": self.columns,
            "at_rest": self.settings.at_rest,
        }
        written = json.dumps(settings, sort_keys=True, default=repr)
        return hashlib.sha256(written.encode()).hexdigest()

    @functools.cached_property
    def packed(self) -> bytes:
        """Bytes that [`unpacked`][] makes it of, in another process or on another machine.

        What a user's file defines goes with it; what it imports must be there.
        """
        import cloudpickle

        users_modules = [module for name, module in sys.modules.items() if name.startswith(USERS)]
        for module in users_modules:
            cloudpickle.register_pickle_by_value(module)
        try:
            return cloudpickle.dumps(self)
        finally:
            for module in users_modules:
                cloudpickle.unregister_pickle_by_value(module)

    def fitted(self, sources: Sequence[Source]) -> "Order":
        """The same with what the first recording that can be read says of how all are sampled.

        **Raises:** what the first recording fails by, where none of the first can be read;
        `ModelError` for a criterion that draws windows, and for known values that are none.
        """
        first = self._first(sources)
        plan_parameters(self.model, 1, self.settings.known, ())
        if self.settings.says_of_criterion:
            criterion = criterion_for(self.settings, self.model, self.model.band, ())
        else:
            criterion = default_criterion(self.model, first, self.settings.noise)
        if criterion.needs_key:
            raise ModelError(
                "a fleet sums all windows: give rx.RIEC(rx.AllWindows(alpha, beta)) (on the "
                "command line: without --windows)."
            )
        edges, step = None, float(first.record.time_step)
        if criterion.in_closed_form and not self.model.has_hidden:
            windows = criterion.windows
            assert windows is not None
            with contextlib.suppress(DataError):  # too short for any sweep
                longest = LONGER * float(windows.beta)
                edges = sweep_edges([first.record], criterion, longest=longest, bands=BANDS)
        order = dataclasses.replace(self, criterion=criterion, edges=edges)
        if not any(source.is_long for source in sources):
            return order
        return dataclasses.replace(
            order,
            starts=stretch_starts(criterion, step, STRETCH),
            window=math.ceil(order.longest / step) + 2,
        )

    def of_table(self, name: str, summary: Summary) -> "Order":
        """The same with what the recordings of an earlier run were summed by, as one of them says.

        **Raises:** `DataError` for settings by which no sample can be read again; `ModelError` for
        sums of another model, or by another criterion than is asked for.
        """
        if unheeded := [n for n in self.settings.reading.options() if self.settings.says(n)]:
            raise DataError(
                f"{name} holds sums, of which no sample is read again: it cannot heed "
                f"{', '.join(unheeded)}. Leave that out, or give the recordings."
            )
        summary.require_model(self.model)
        criterion = criterion_for(self.settings, self.model, self.model.band, ())
        asked_for = self.settings.says_of_criterion
        if asked_for and criterion.describe() != summary.criterion.describe():
            raise ModelError(
                f"{name} holds sums by {summary.criterion.describe()}; for another criterion sum "
                f"the recordings anew."
            )
        return dataclasses.replace(self, criterion=summary.criterion)

    def _first(self, sources: Sequence[Source]) -> Recording:
        """The first recording that can be read, or as much of it as is enough."""
        errors: list[Exception] = []
        for source in sources[:TRIED]:
            columns = self.columns_in(source)
            # What is wrong with one recording is told by its row.
            try:
                if source.is_long or (source.is_parquet and columns):
                    piece = recordings_of(source, columns, self.storage)[0]
                    high = min(piece.high, piece.low + LOOKED_AT)
                    opening = rows_at_hand(piece, piece.low, high, self.storage)
                else:
                    opening = at_hand(source, self.storage)
                with opening as file:
                    return self.recordings_in(file)[0]
            except Exception as error:
                errors.append(error)
        name = sources[0].name
        raise DataError(
            f"none of the first {len(errors)} recordings can be read; the first: "
            f"{name}: {reason_of(errors[0]).removeprefix(f'{name}: ')}"
        )

    def pieces_of(self, sources: Sequence[Source]) -> Iterator[Piece]:
        """The pieces of all sources, in their order: of long ones stretches."""
        for source in sources:
            recordings = [Piece(source)]
            if source.is_long:
                # Whoever sums it says why not.
                with contextlib.suppress(Exception):
                    recordings = recordings_of(source, self.columns_in(source), self.storage)
            for recording in recordings:
                if recording.stop:
                    yield from stretches(recording, self.starts, self.window)
                else:
                    yield recording


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
