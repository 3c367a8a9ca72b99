"""One task of a fleet: read some recordings, and sum up what they say to the model."""

import json
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

from riecjax.errors import DataError, reason_of
from riecjax.estimation.check import of_sensors, read_of
from riecjax.findings import Finding
from riecjax.fleets.order import Order, unpacked
from riecjax.fleets.sources import Piece, at_hand, recordings_of, rows_at_hand
from riecjax.records.recording import Recording
from riecjax.runtime import release_memory
from riecjax.summaries.summarise import summed
from riecjax.summaries.summary import in_blocks, together
from riecjax.summaries.task import task

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


def sum_up(order: bytes, pieces: Sequence[Piece]) -> list[Row]:
    """The rows of some pieces; one that cannot be read or summed is a row that says why."""
    asked = unpacked(order)
    return [row for piece in pieces for row in rows_of(asked, piece)]


def rows_of(order: Order, piece: Piece) -> list[Row]:
    """The rows of a piece, one at least."""
    try:
        return list(_rows(order, piece)) or [lost(piece, "it holds no rows.")]
    # Not the end of a run over a hundred thousand others, whatever it is.
    except Exception as error:
        return [lost(piece, reason_of(error))]
    finally:
        if piece.stop:
            release_memory()


def lost(piece: Piece, why: str, part: str = "") -> Row:
    """The row of a piece, or of a part of it, that could not be read or summed."""
    keys = json.dumps(dict((*piece.source.keys, *piece.keys)))
    return Row(piece.identity, piece.source.name, part, keys, 0.0, "", 0, 0.0, why)


def _rows(order: Order, piece: Piece) -> Iterator[Row]:
    source = piece.source
    columns = order.columns_in(source)
    if piece.stop:
        yield _stretch(order, piece)
    elif source.is_parquet and columns:
        for run in recordings_of(source, columns, order.storage):
            yield _or_lost(run, run.part, _stretch, order, run)._replace(piece=piece.identity)
    else:
        with at_hand(source, order.storage) as file:
            for one in order.recordings_in(file):
                yield _or_lost(piece, one.part, _row, order, piece, one, one.part)


def _or_lost(piece: Piece, part: str, make: Callable[..., Row], *given: Any) -> Row:
    """The row of one recording of several in a source, of which the others stay."""
    try:
        return make(*given)
    except Exception as error:
        return lost(piece, reason_of(error), part)


def _stretch(order: Order, piece: Piece) -> Row:
    """The row of some rows of a source."""
    part = piece.part
    low, high = piece.reach(order.window)
    with rows_at_hand(piece, low, high, order.storage) as file:
        (one,) = order.recordings_in(file)
    if one.record.sample_count != high - low:
        raise DataError(
            f"{piece.source.name}: of {high - low} rows {one.record.sample_count} samples were "
            f"made, so that it cannot be summed in stretches: store it in parts as recordings of "
            f"their own, or without what changes the number of samples (pauses, --resample)."
        )
    if piece.stop < piece.high and order.longest > order.window * float(one.record.time_step):
        raise DataError(
            f"{piece.source.name}: it is sampled faster than the first recording, whose stretches "
            f"reach less far. Sum recordings of other rates in a run of their own."
        )
    if (piece.first, piece.stop) == (piece.low, piece.high):
        return _row(order, piece, one, part)
    return _row(
        order, piece, one, part, (piece.first - low, piece.stop - low), piece.first - piece.low
    )


def _row(
    order: Order,
    piece: Piece,
    recording: Recording,
    part: str,
    starts: tuple[int, int] | None = None,
    skipped: int = 0,
) -> Row:
    asked = task(order.procedure, [recording], order.criterion, None, at_rest=order.at_rest)
    summary = summed(asked, bins=order.edges, starts=starts)
    (one,) = summary.recordings
    sums = summary if order.edges is None else together(summary)
    lengths = (
        b"" if order.edges is None else summary.of_recordings([in_blocks(one, FEW)]).to_bytes()
    )
    step = float(one.time_step)
    (digest,) = summary.digests
    return Row(
        piece.identity,
        piece.source.name,
        part,
        json.dumps(dict((*piece.source.keys, *piece.keys))),
        skipped * step,
        digest,
        int(one.samples),
        int(one.samples) * step,
        DONE,
        json.dumps([finding._asdict() for finding in _findings(order, recording)]),
        sums.to_bytes(),
        lengths,
    )


def _findings(order: Order, recording: Recording) -> Iterator[Finding]:
    """What is amiss with a recording, each with the parameters that it concerns."""
    procedure = order.procedure
    equations = [equation for stage in procedure.stages for equation in stage]
    # Which signals are read is a matter of which there are, the same for most of a fleet.
    names = tuple(recording.record.arrays)
    if names not in order.reads:
        order.reads[names] = (
            read_of(procedure, recording, order.criterion, summed=True),
            [e.signals_read(recording.record, order.criterion.smoothness) for e in equations],
        )
    read, of_equations = order.reads[names]
    found = (*recording.concerning(read).findings, *of_sensors(procedure, recording, read))
    for finding in found:
        if finding.parameters or not finding.signals:
            yield finding
            continue
        both = zip(equations, of_equations)
        concerned = [e.parameters for e, signals in both if {*finding.signals} & signals]
        parameters = tuple(dict.fromkeys(name for some in concerned for name in some))
        yield finding._replace(parameters=parameters)
