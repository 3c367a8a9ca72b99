"""The verb: sum recordings by the thousand, merge what belongs together, estimate each group."""

import contextlib
import importlib.util
import itertools
import math
import os
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from numbers import Real
from pathlib import Path
from typing import Any

from riecjax.criteria.criterion import AbstractCriterion
from riecjax.equations.equation import Equation
from riecjax.equations.procedure import AtRest, HasProcedure, Procedure
from riecjax.errors import DataError, ModelError, RiecjaxError, require
from riecjax.estimation.parameters import plan_parameters
from riecjax.fleets.engine import Engine, Lost, engine
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
from riecjax.fleets.kept import (
    ESTIMATES,
    LIGHT,
    Kept,
    is_result,
    is_table,
    make_folder,
    read_rows,
    write_entries,
)
from riecjax.fleets.order import Order, order_for, planned, tasks_of
from riecjax.fleets.report import Fleet
from riecjax.fleets.sources import Piece, Source, find_sources
from riecjax.fleets.spread import changes, spreads
from riecjax.fleets.sums import DONE, Row, lost, sum_up
from riecjax.models.model import Model, as_model
from riecjax.summaries.summary import Summary
from riecjax.uncertainty.intervals import AbstractIntervals, BlockBootstrap

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
    """The same rows, where what belongs to no group or is a copy of another says so.

    **Raises:** `DataError` where no recording at all could be summed.
    """
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
    if not found:
        raise DataError("what was found holds no rows.")
    if all(row.status != DONE for row in found):
        first = found[0].status
        raise DataError(f"none of {len(found)} recordings can be used; the first: {first}")
    return found


PATTERNS = "paths of recordings, as in 'drives/**/*.csv', of which each is read once"
AS_THEY_ARE = {"noise": "auto", "outliers": "repair", "align": "auto", "upsample": 1, "every": 1}
"""Settings by which recordings are read where nothing is said."""


def fleet(
    model: Equation | Procedure | HasProcedure,
    patterns: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    criterion: AbstractCriterion | None = None,
    *,
    by: str | Sequence[str] = "file",
    span: float | None = None,
    known: Mapping[str, float] | None = None,
    intervals: AbstractIntervals | None = None,
    at_rest: AtRest | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    out: str | os.PathLike[str] | None = None,
    strict: bool = False,
    allow_duplicates: bool = False,
    storage: Mapping[str, Any] | None = None,
    parts: Sequence[str] = (),
    progress: Progress | None = None,
    on_start: Callable[[str], None] | None = None,
    **reading: Any,
) -> Fleet:
    """Identify a model's parameters from each group of recordings, of which there may be many.

    Each is read once and summed; a group is estimated from the sums of its recordings as by
    [`identify`][]. What was summed is kept in `out`: an interrupted run goes on from there, and
    groups are estimated anew without a sample. Results are the same to the bit for any number of
    workers, in any order, after any interruption. A script calls it below `if __name__ ==
    "__main__":`, since processes import it.

    **Arguments:** `model`, `criterion`, `known`, `intervals`, `at_rest` as for [`identify`][];

    - `patterns`: paths, folders, `drives/**/*.csv`, `s3://bucket/drives/*.parquet` of stores that
      fsspec knows; or a `summaries.parquet` of an earlier run, to estimate anew. A folder called
      `*.parquet` is a data set, whose files are one recording.
    - `by`: what a group is: each `"file"`, each `"folder"`, or recordings that agree in these keys
      of their paths (`vehicle=3/`) or columns of their Parquet files, `"vehicle,load"`.
    - `span`: estimate each recording over time as well, in spans of about so many seconds.
    - `workers`: processes of this machine, one a core by default; 0 for none but this one.
      `scheduler`: address of one of Dask's, whose workers are used instead.
    - `out`: folder for `summaries.parquet` and `estimates.parquet`; `None` keeps nothing.
    - `strict`: raise what the first recording fails by, instead of going on without it.
    - `allow_duplicates`: count recordings of a group that hold the same samples each.
    - `storage`: what fsspec is to know of the store.
    - `parts`: names of the recordings that are read of each file that holds several; all of them,
      if none is given.
    - `progress`: called with what is being done, how much of it is, of how much, and samples.
    - `on_start`: called with the address of Dask's dashboard, if it has one.
    - `reading`: keywords of [`ReadingSettings`][riecjax.records.ReadingSettings].

    **Returns:** a [`Fleet`][riecjax.fleets.Fleet].

    **Raises:** `DataError` where nothing matches, none can be read, `out` cannot be written, the
    scheduler is gone, or with `strict` for the first recording that fails; `ModelError` for a
    criterion that draws windows, and for sums of another model.
    """
    names = ("cloudpickle", "distributed", "fsspec", "ruptures", "statsmodels")
    if missing := [name for name in names if importlib.util.find_spec(name) is None]:
        raise DataError(
            f'fleets need {", ".join(missing)}; install them by pip install "riecjax[fleet]".'
        )
    require("by", by, str | list | tuple, "by='file', 'folder' or names of columns")
    keys = tuple(part.strip() for part in by.split(",")) if isinstance(by, str) else tuple(by)
    _require_sense(keys, span, workers, known)
    require("parts", parts, (tuple, list), f"parts=('{parts}',), names of recordings in a file")
    require("patterns", patterns, str | os.PathLike | list | tuple, PATTERNS)
    listed = [patterns] if isinstance(patterns, str | os.PathLike) else [*patterns]
    for pattern in listed:
        require("a pattern", pattern, str | os.PathLike, PATTERNS)
    model, settings = as_model(model), Settings(known or {}, intervals or BlockBootstrap(), span)
    tell: Progress = progress or (lambda *_: None)
    with contextlib.ExitStack() as stack:
        folder = Path(out or stack.enter_context(tempfile.TemporaryDirectory(prefix="riecjax-")))

        def look() -> list[Source]:
            return find_sources(listed, storage or {}, lambda path: is_result(folder, path))

        def started() -> Engine:
            runs = stack.enter_context(engine(workers, scheduler))
            if on_start is not None and runs.dashboard:
                on_start(runs.dashboard)
            return runs

        if len(listed) == 1 and is_table(listed[0]):
            table = Path(listed[0])
            asked_for = [n for n, value in reading.items() if value and value != AS_THEY_ARE.get(n)]
            if parts or asked_for:
                raise DataError(
                    f"{table.name} holds sums, of which no sample is read again: it cannot heed "
                    f"{', '.join([*asked_for, *['parts'] * bool(parts)])}. Leave that out, or give "
                    f"the recordings."
                )
            order = _order_of(model, table, criterion, keys, at_rest)
            changed: list[str] = []
            rows = judged([*read_rows(table, LIGHT)], keys, allow_duplicates)
            found = estimates(order, settings, rows, read_rows(table), started(), tell)
            make_folder(folder)
        else:
            sources = look()
            order = order_for(
                model, sources, criterion, keys, storage or {}, at_rest, reading, parts
            )
            plan_parameters(order.procedure, 1, settings.known, ())
            make_folder(folder)
            kept = Kept(folder, order.digest, {b"riecjax.model": model.name.encode()})
            runs = started()
            pieces, changed = summed(order, sources, look, kept, runs, strict, tell)
            rows = judged([*kept.light(pieces)], keys, allow_duplicates)
            found = estimates(order, settings, rows, kept.whole(pieces), runs, tell)
            kept.finish(pieces)
        entries, over_time = found
        if out is not None:
            write_entries(folder / ESTIMATES, [*entries, *over_time])
    shown = spreads(entries), changes(over_time)
    made = Fleet(model, keys, order.criterion, entries, over_time, *shown, rows, changed)
    if all(entry.status != DONE for entry in entries):
        raise DataError(f"no group can be estimated; the first: {made.unanswered[0].status}")
    return made


def _order_of(
    model: Model,
    table: Path,
    criterion: AbstractCriterion | None,
    by: tuple[str, ...],
    at_rest: AtRest | None,
) -> Order:
    """How the recordings of an earlier run were summed.

    **Raises:** `ModelError` for sums of another model, or by another criterion than is asked for.
    """
    summed = next((row for row in read_rows(table) if row.status == DONE), None)
    if summed is None:
        raise DataError(f"{table.name}: no recording of it could be summed.")
    summary = Summary.from_bytes(summed.sums)
    order = Order(model, summary.criterion, None, by=by, at_rest=at_rest)
    summary.require_model(order.procedure)
    if criterion is not None and criterion.describe() != summary.criterion.describe():
        raise ModelError(
            f"{table.name} holds sums by {summary.criterion.describe()}; for another criterion sum "
            f"the recordings anew."
        )
    return order


def _require_sense(
    by: Sequence[str], span: float | None, workers: int | None, known: Mapping[str, float] | None
) -> None:
    if not by or not all(by):
        raise ModelError("by names what groups are: by='file', 'folder' or names of columns.")
    require("known", known or {}, Mapping, "known={'M_s': 302.7}")
    for name in by:
        require("a name of by", name, str, "by='vehicle,load'")
    if span is not None and not (isinstance(span, Real) and 0 < span < math.inf):
        raise ModelError(f"span is a positive number of seconds; got {span!r}.")
    if workers is not None and not (isinstance(workers, int) and workers >= 0):
        raise ModelError(f"workers is a number of processes, 0 for none; got {workers!r}.")
