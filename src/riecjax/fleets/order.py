"""What is asked of all recordings of a fleet alike, and how it is done to each."""

import contextlib
import dataclasses
import functools
import hashlib
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

import numpy as np

from riecjax import DOLS, Model, Recording, Summary, read_recordings, summarise
from riecjax.criteria import AbstractCriterion, criterion_for
from riecjax.doubts import recording_findings
from riecjax.errors import DataError, ModelError, reason_of
from riecjax.estimation import plan_parameters
from riecjax.fleets.settings import Fleets
from riecjax.fleets.sources import Piece, Source, at_hand, recordings_of, stretches
from riecjax.summaries import Outline, default_criterion, stretch_starts
from riecjax.validation import LONGER, sweep_edges

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
    def columns(self) -> tuple[str, ...]:
        """What recordings are grouped by beside their paths."""
        return () if self.settings.keys[0] in WHOLE_PATHS else self.settings.keys

    def runs_of(self, piece: Piece) -> list[Piece]:
        """The recordings of a Parquet source that is long, or whose columns say what its path does
        not; all else is read as it is.

        **Raises:** `DataError` where a column is in none of its files; `OSError`.
        """
        source, keys = piece.source, dict(piece.source.keys)
        columns = [name for name in self.columns if name not in keys]
        is_read_by_rows = source.is_long or (source.is_parquet and bool(columns))
        if piece.stop or not is_read_by_rows:
            return [piece]
        return recordings_of(source, columns)

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

    def fitted(self, sources: Sequence[Source]) -> "Order":
        """The same with what the first recording that can be read says of how all are sampled.

        **Raises:** what the first recording fails by, where none of the first can be read;
        `ModelError` for a criterion that draws windows, and for known values that are none.
        """
        # The first recording that can be read, or as much of it as is enough.
        errors: list[Exception] = []
        for source in sources[:TRIED]:
            # What is wrong with one recording is told by its row.
            try:
                run = self.runs_of(Piece(source))[0]
                rows = run.low, min(run.high, run.low + LOOKED_AT)
                with at_hand(run, rows) as file:
                    first = self.recordings_in(file)[0]
                break
            except Exception as error:
                errors.append(error)
        else:
            name = sources[0].name
            raise DataError(
                f"none of the first {len(errors)} recordings can be read; the first: "
                f"{name}: {reason_of(errors[0]).removeprefix(f'{name}: ')}"
            )
        plan_parameters(self.model, 1, self.settings.known, ())
        if self.settings.says_of_criterion:
            criterion = criterion_for(self.settings, self.model, ())
        else:
            criterion = default_criterion(self.model, first, self.settings.noise)
        if criterion.needs_key:
            raise ModelError(
                "a fleet sums all windows: give rx.RIEC(rx.AllWindows(alpha, beta)) (on the "
                "command line: without --windows)."
            )
        edges, step = None, float(first.record.time_step)
        windows = criterion.all_windows
        if windows is not None and not self.model.has_hidden:
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
        criterion = criterion_for(self.settings, self.model, ())
        asked_for = self.settings.says_of_criterion
        if asked_for and criterion.describe() != summary.criterion.describe():
            raise ModelError(
                f"{name} holds sums by {summary.criterion.describe()}; for another criterion sum "
                f"the recordings anew."
            )
        return dataclasses.replace(self, criterion=summary.criterion)

    def pieces_of(self, sources: Sequence[Source]) -> Iterator[Piece]:
        """The pieces of all sources, in their order: of long ones stretches."""
        for source in sources:
            recordings = [Piece(source)]
            if source.is_long:
                # Whoever sums it says why not.
                with contextlib.suppress(Exception):
                    recordings = self.runs_of(recordings[0])
            for recording in recordings:
                if recording.stop:
                    yield from stretches(recording, self.starts, self.window)
                else:
                    yield recording


DONE = "ok"
"""Status of a recording that was summed."""
FEW = 8
"""Blocks of a recording that sums by window length are kept for: they tell of drift alone."""


class Row(NamedTuple):
    """What became of one recording, or of one stretch of it.

    **Fields:** `piece`, identity of the piece that it is part of; `name` of its source, `part` of
    it; `keys`, JSON of what its path and columns say; `start` in seconds from the recording's
    first sample; `digest` of its samples and of all settings; `samples`; `seconds`; `status`, `ok`
    or why not; `findings`, JSON; `sums` and `lengths`, a Summary each as bytes: of all windows by
    blocks of time, and by window lengths.
    """

    piece: str
    name: str
    part: str
    keys: str
    start: float
    digest: str
    samples: int
    seconds: float
    status: str
    findings: str = "[]"
    sums: bytes = b""
    lengths: bytes = b""

    @property
    def whole_name(self) -> str:
        """Of the recording: its source's, and which part of it."""
        return ", ".join(filter(None, (self.name, self.part)))

    @property
    def without_sums(self) -> "Row":
        """The same row, without what is large."""
        return self._replace(sums=b"", lengths=b"")


def sum_up(order: Order, pieces: Sequence[Piece]) -> list[Row]:
    """The rows of some pieces, one of each at least."""
    return [row for piece in pieces for row in rows_of(order, piece)]


def rows_of(order: Order, piece: Piece) -> list[Row]:
    """The rows of a piece; of what cannot be read or summed one that says why."""
    # What is wrong with one recording is not the end of a run over a hundred thousand others.
    rows, runs = [], []
    try:
        runs = order.runs_of(piece)
    except Exception as error:
        rows.append(lost(piece, reason_of(error)))
    for run in runs:
        try:
            with at_hand(run, run.reach(order.window)) as file:
                recordings = order.recordings_in(file)
        except Exception as error:
            rows.append(lost(run, reason_of(error), run.part))
            continue
        for recording in recordings:
            part = run.part if run.stop else recording.part
            try:
                rows.append(_row(order, run, recording, part))
            except Exception as error:
                rows.append(lost(run, reason_of(error), part))
    rows = rows or [lost(piece, "it holds no rows.")]
    return [row._replace(piece=piece.identity) for row in rows]


def lost(piece: Piece, why: str, part: str = "") -> Row:
    """The row of a piece, or of a part of it, that could not be read or summed."""
    return Row(piece.identity, piece.source.name, part, piece.labels, 0.0, "", 0, 0.0, why)


def _row(order: Order, run: Piece, recording: Recording, part: str) -> Row:
    """The row of a recording, or of a stretch of one, in which only its own windows count."""
    step, starts = float(recording.record.time_step), None
    if run.stop:
        low, high = run.reach(order.window)
        if recording.record.sample_count != high - low:
            raise DataError(
                f"{run.source.name}: of {high - low} rows {recording.record.sample_count} samples "
                f"were made, so that it cannot be summed in stretches: store it in parts as "
                f"recordings of their own, or without what changes the number of samples (pauses, "
                f"--resample)."
            )
        if run.stop < run.high and order.longest > order.window * step:
            raise DataError(
                f"{run.source.name}: it is sampled faster than the first recording, whose "
                f"stretches reach less far. Sum recordings of other rates in a run of their own."
            )
        if (run.first, run.stop) != (run.low, run.high):
            starts = run.first - low, run.stop - low
    summary = summarise(
        order.model,
        recording,
        order.criterion,
        bins=order.edges,
        at_rest=order.settings.at_rest,
        starts=starts,
    )
    (sums,), (digest,) = summary.recordings, summary.digests
    samples = int(sums.samples)
    findings = recording_findings(order.model, recording, order.criterion)
    return Row(
        run.identity,
        run.source.name,
        part,
        run.labels,
        (run.first - run.low) * step,
        digest,
        samples,
        samples * float(sums.time_step),
        DONE,
        json.dumps([finding._asdict() for finding in findings]),
        (summary if order.edges is None else summary.merge_length_bins()).to_bytes(),
        b"" if order.edges is None else summary.coarsen_blocks(FEW).to_bytes(),
    )
