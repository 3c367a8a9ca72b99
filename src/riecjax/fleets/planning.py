"""Before a fleet is summed: what all recordings have in common, and what the tasks are."""

import contextlib
import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from riecjax.criteria.criterion import DOLS, AbstractCriterion
from riecjax.criteria.suited import suited
from riecjax.equations.procedure import AtRest
from riecjax.errors import DataError, ModelError
from riecjax.fleets.order import Order
from riecjax.fleets.pieces import STRETCH, Piece, is_long, recordings_of, rows_at_hand, stretches
from riecjax.fleets.sources import Source, at_hand
from riecjax.fleets.sums import reason_of
from riecjax.models.model import Model
from riecjax.records.recording import Recording
from riecjax.studies.sweep import LONGER, sweep_edges
from riecjax.summaries.one_pass import stretch_starts
from riecjax.summaries.task import ready

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
    errors: list[Exception] = []
    for source in sources[:TRIED]:
        try:
            return _beginning(order, source)
        # What is wrong with one recording is told by its row.
        except Exception as error:
            errors.append(error)
    raise DataError(
        f"none of the first {len(errors)} recordings can be read; the first: "
        f"{sources[0].name}: {reason_of(errors[0]).removeprefix(f'{sources[0].name}: ')}"
    )


def _beginning(order: Order, source: Source) -> Recording:
    """A recording of a source, or as much of it as is enough."""
    columns = order.columns_in(source)
    if not (is_long(source) or (source.is_parquet and columns)):
        with at_hand(source, order.storage) as file:
            return order.recordings_in(file)[0]
    first = recordings_of(source, columns, order.storage)[0]
    high = min(first.high, first.low + LOOKED_AT)
    with rows_at_hand(first, first.low, high, order.storage) as file:
        return order.recordings_in(file)[0]


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
