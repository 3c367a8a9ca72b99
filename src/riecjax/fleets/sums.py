"""One task of a fleet: read some recordings, and sum up what they say to the model."""

import json
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from riecjax import Recording, summarise
from riecjax.errors import DataError, reason_of
from riecjax.estimation import recording_findings
from riecjax.fleets.order import Order, unpacked
from riecjax.fleets.sources import Piece, at_hand
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
    # What is wrong with one recording is not the end of a run over a hundred thousand others.
    try:
        rows = [row for run in order.runs_of(piece) for row in _rows_of_run(order, run)]
    except Exception as error:
        rows = [lost(piece, reason_of(error))]
    if piece.stop:
        release_memory()
    rows = rows or [lost(piece, "it holds no rows.")]
    return [row._replace(piece=piece.identity) for row in rows]


def _rows_of_run(order: Order, run: Piece) -> Iterator[Row]:
    """A row for each recording of a file, or the row of some rows of one."""
    try:
        with at_hand(run, run.reach(order.window), order.storage) as file:
            recordings = order.recordings_in(file)
    except Exception as error:
        yield lost(run, reason_of(error), run.part)
        return
    for recording in recordings:
        part = run.part if run.stop else recording.part
        try:
            yield _row(order, run, recording, part)
        except Exception as error:
            yield lost(run, reason_of(error), part)


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
        order.procedure,
        recording,
        order.criterion,
        bins=order.edges,
        at_rest=order.settings.at_rest,
        starts=starts,
    )
    (sums,), (digest,) = summary.recordings, summary.digests
    samples = int(sums.samples)
    findings = recording_findings(order.procedure, recording, order.criterion)
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
