"""One task of a fleet: read some recordings, and sum up what they say to the model."""

import json
from collections.abc import Callable, Sequence
from typing import NamedTuple

from riecjax import Recording, summarise
from riecjax.errors import DataError, reason_of
from riecjax.estimation import recording_findings
from riecjax.fleets.order import Order, unpacked
from riecjax.fleets.sources import Piece, at_hand, recordings_of, rows_at_hand
from riecjax.runtime import release_memory

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


def sum_up(order: bytes, pieces: Sequence[Piece]) -> list[Row]:
    """The rows of some pieces, one of each at least."""
    asked = unpacked(order)
    return [row for piece in pieces for row in rows_of(asked, piece)]


def rows_of(order: Order, piece: Piece) -> list[Row]:
    """The rows of a piece; of what cannot be read or summed one that says why."""
    source, columns = piece.source, order.columns_in(piece.source)
    rows = []

    # What is wrong with one recording is not the end of a run over a hundred thousand others.
    def add(part: str, make: Callable[..., Row], run: Piece, *recording: Recording) -> None:
        try:
            rows.append(make(order, run, *recording))
        except Exception as error:
            rows.append(lost(run, reason_of(error), part))

    try:
        if piece.stop:
            add(piece.part, _row_of_stretch, piece)
            release_memory()
        elif source.is_parquet and columns:
            for run in recordings_of(source, columns, order.storage):
                add(run.part, _row_of_stretch, run)
        else:
            with at_hand(source, order.storage) as file:
                for recording in order.recordings_in(file):
                    add(recording.part, _row, piece, recording)
    except Exception as error:
        rows = [lost(piece, reason_of(error))]
    rows = rows or [lost(piece, "it holds no rows.")]
    return [row._replace(piece=piece.identity) for row in rows]


def lost(piece: Piece, why: str, part: str = "") -> Row:
    """The row of a piece, or of a part of it, that could not be read or summed."""
    return Row(piece.identity, piece.source.name, part, piece.labels, 0.0, "", 0, 0.0, why)


def _row_of_stretch(order: Order, piece: Piece) -> Row:
    """The row of some rows of a source."""
    low, high = piece.reach(order.window)
    with rows_at_hand(piece, low, high, order.storage) as file:
        (recording,) = order.recordings_in(file)
    if recording.record.sample_count != high - low:
        raise DataError(
            f"{piece.source.name}: of {high - low} rows {recording.record.sample_count} samples "
            f"were made, so that it cannot be summed in stretches: store it in parts as recordings "
            f"of their own, or without what changes the number of samples (pauses, --resample)."
        )
    step = float(recording.record.time_step)
    if piece.stop < piece.high and order.longest > order.window * step:
        raise DataError(
            f"{piece.source.name}: it is sampled faster than the first recording, whose stretches "
            f"reach less far. Sum recordings of other rates in a run of their own."
        )
    is_whole = (piece.first, piece.stop) == (piece.low, piece.high)
    starts = None if is_whole else (piece.first - low, piece.stop - low)
    row = _row(order, piece, recording, starts)
    return row._replace(part=piece.part, start=(piece.first - piece.low) * step)


def _row(
    order: Order, piece: Piece, recording: Recording, starts: tuple[int, int] | None = None
) -> Row:
    """The row of a recording, of which only windows with these starts may count."""
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
        piece.identity,
        piece.source.name,
        recording.part,
        piece.labels,
        0.0,
        digest,
        samples,
        samples * float(sums.time_step),
        DONE,
        json.dumps([finding._asdict() for finding in findings]),
        (summary if order.edges is None else summary.merge_length_bins()).to_bytes(),
        b"" if order.edges is None else summary.coarsen_blocks(FEW).to_bytes(),
    )
