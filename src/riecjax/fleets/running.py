"""The two passes over a fleet: sum every recording, then estimate every group of them."""

import itertools
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence

from riecjax.errors import DataError, RiecjaxError
from riecjax.fleets.engine import Engine, Lost
from riecjax.fleets.groups import (
    Entry,
    Group,
    Part,
    Settings,
    estimated,
    failed,
    group,
    group_of,
    part_of,
)
from riecjax.fleets.kept import Kept
from riecjax.fleets.order import Order
from riecjax.fleets.pieces import Piece
from riecjax.fleets.planning import planned, tasks_of
from riecjax.fleets.sources import Source
from riecjax.fleets.sums import DONE, Row, lost, sum_up

ROUNDS = 3
"""Times that sources are looked through, for those that changed while others were summed."""
GROUPS, MESSAGE = 8, 2**22
"""Groups to a task, and bytes of their sums, at most."""

Progress = Callable[[str, int, int, int], None]
"""Told what is being done, how much of it is, of how much, and how many samples that were."""


def summed(
    order: Order,
    sources: list[Source],
    look: Callable[[], list[Source]],
    kept: Kept,
    runs: Engine,
    strict: bool,
    tell: Progress,
) -> tuple[list[str], list[str]]:
    """Keep the rows of all pieces, of which those that are kept already are not summed again.

    **Arguments:** `sources`; `look` finds them once more afterwards, and what has changed since is
    summed anew.

    **Returns:** the pieces, in the order of their sources' names; and the names of sources that
    have changed once more since they were summed last.

    **Raises:** `DataError` where rows cannot be kept, or the scheduler is gone; with `strict` for
    the first recording that fails.
    """
    packed, pieces = order.packed(), []
    for _ in range(ROUNDS):
        pieces = list(planned(order, sources))
        missing = [piece for piece in pieces if piece.identity not in kept]
        if not missing:
            return [piece.identity for piece in pieces], []
        done, samples = len(pieces) - len(missing), 0
        tell("summing", done, len(pieces), samples)
        with kept.to_the_last():
            for rows in _rows(packed, missing, runs):
                if strict and (reason := next((r.status for r in rows if r.status != DONE), "")):
                    raise DataError(reason)
                kept.add(rows)
                done += len({row.piece for row in rows})
                samples += sum(row.samples for row in rows)
                tell("summing", done, len(pieces), samples)
        sources = look()
    changed = {one.source.name for one in planned(order, sources) if one.identity not in kept}
    return [piece.identity for piece in pieces], sorted(changed)


def _rows(packed: bytes, pieces: Sequence[Piece], runs: Engine) -> Iterator[list[Row]]:
    """Rows of pieces as they come; those of a task that ends its workers one by one."""
    again: list[Piece] = []
    for (_, some), answer in runs.each(sum_up, ((packed, some) for some in tasks_of(pieces))):
        if not isinstance(answer, Lost):
            yield answer
        elif len(some) > 1:
            again += some
        else:
            yield [lost(some[0], f"{some[0].source.name}: {answer.why}.")]
    for (_, some), answer in runs.each(sum_up, ((packed, [piece]) for piece in again)):
        told = isinstance(answer, Lost)
        yield [lost(some[0], f"{some[0].source.name}: {answer.why}.")] if told else answer


def estimates(
    order: Order,
    settings: Settings,
    rows: Sequence[Row],
    whole: Iterable[Row],
    runs: Engine,
    tell: Progress,
) -> tuple[list[Entry], list[Entry]]:
    """Entries of all groups, and of all spans of time; of rows that have no sums, why.

    **Arguments:** `rows`, without their sums; `whole`, the same with them, in the same order.
    """
    packed = order.packed()
    groups = _groups(rows, whole, order.by, settings.span is not None)
    count = len({_name(row, order.by) for row in rows if row.status == DONE})
    done, entries, over_time = 0, [], []
    tell("estimating", 0, count, 0)
    tasks = ((packed, settings, some) for some in _batches(groups))
    for (_, _, some), answer in runs.each(estimated, tasks):
        if isinstance(answer, Lost):
            answer = [failed((one.name, 0.0, 0.0), answer.why) for one in some]
        if some[0].in_spans:
            over_time += answer
        else:
            entries += answer
            done += len(some)
            tell("estimating", done, count, 0)
    entries += [
        failed((_name(row, order.by), row.start, row.start + row.seconds), row.status)
        for row in rows
        if row.status != DONE
    ]
    return sorted(entries, key=_place), sorted(over_time, key=_place)


def _place(entry: Entry) -> tuple[str, float, float, str]:
    return entry.group, entry.start, entry.end, entry.status


def _batches(groups: Iterator[Group]) -> Iterator[list[Group]]:
    """A few groups at a time, of one kind, as many as one message holds."""
    for _, of_kind in itertools.groupby(groups, lambda one: one.in_spans):
        some: list[Group] = []
        for one in of_kind:
            size = sum(len(each.sums) + len(each.lengths) for each in (*some, one))
            if some and (len(some) >= GROUPS or size > MESSAGE):
                yield some
                some = []
            some.append(one)
        yield some


def _name(row: Row, by: Sequence[str]) -> str:
    """The group of a recording; its own name where that is not known."""
    try:
        return group_of(row, by)
    except RiecjaxError:
        return row.name


def _groups(
    rows: Sequence[Row], whole: Iterable[Row], by: Sequence[str], in_spans: bool
) -> Iterator[Group]:
    """Each group, as soon as all its recordings are there; and of each recording its course."""
    members = Counter(_name(row, by) for row in rows if row.status == DONE)
    held: dict[str, list[Part]] = {}
    for row, full in zip(rows, whole, strict=True):
        if row.status != DONE:
            continue
        name = _name(row, by)
        parts = held.setdefault(name, [])
        parts.append(part_of(full, members[name]))
        if in_spans:
            own = name if members[name] == 1 or by[0] == "file" else f"{name}: {row.whole_name}"
            light = full._replace(sums=b"", lengths=b"")
            yield Group(own, (light,), full.sums, in_spans=True)
        if len(parts) == members[name]:
            yield group(name, held.pop(name))


def judged(rows: Sequence[Row], by: Sequence[str], allow_duplicates: bool) -> list[Row]:
    """The same rows, where what belongs to no group or is a copy of another says so."""
    seen: dict[tuple[str, str], Row] = {}
    found = []
    for row in rows:
        status = row.status
        if status == DONE:
            try:
                name = group_of(row, by)
            except RiecjaxError as error:
                found.append(row._replace(status=f"{row.name}: {error}"))
                continue
            first = seen.setdefault((name, row.digest), row)
            if not allow_duplicates and (first.name, first.part) != (row.name, row.part):
                status = f"{row.name}: it holds the same samples as {first.name}."
        found.append(row._replace(status=status))
    return found
