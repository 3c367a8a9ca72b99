"""The verb: sum recordings by the thousand, merge what belongs together, estimate each group."""

import contextlib
import dataclasses
import functools
import os
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

from riecjax import BlockBootstrap, DataError, Equation, Model, Summary
from riecjax.equations import as_model, with_rests
from riecjax.errors import require
from riecjax.extensions import require_packages
from riecjax.fleets import kept
from riecjax.fleets.engine import Each, Lost, engine
from riecjax.fleets.groups import Entry, estimated, grouped, named
from riecjax.fleets.order import DONE, Order, Row, lost, sum_up
from riecjax.fleets.report import Fleet
from riecjax.fleets.settings import Fleets, Progress
from riecjax.fleets.sources import Piece, Source, find_sources
from riecjax.settings import taking

PATTERNS = "paths of recordings, as in 'drives/**/*.csv', of which each is read once"


@taking(Fleets)
def fleet(
    model: Equation | Model,
    patterns: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    settings: Fleets,
) -> Fleet:
    """Identify a model's parameters from each group of recordings, of which there may be many.

    Each is read once and summed; a group is estimated from the sums of its recordings as by
    [`identify`][]. What was summed is kept in `out`: an interrupted run goes on from there, and
    groups are estimated anew without a sample. Results are the same to the bit for any number of
    workers, in any order, after any interruption. A script calls it below `if __name__ ==
    "__main__":`, since processes import it.

    **Arguments:**

    - `patterns`: paths, folders, `drives/**/*.csv`, `s3://bucket/drives/*.parquet` of stores that
      fsspec knows; or a `summaries.parquet` of an earlier run, to estimate anew. A folder called
      `*.parquet` is a data set, whose files are one recording.
    - others: see `riecjax.fleets.Fleets`; `criterion`, `known`, `intervals` and `at_rest` as for
      [`identify`][], and those of reading as for [`read_recording`][riecjax.read_recording].

    **Returns:** a [`Fleet`][riecjax.fleets.Fleet].

    **Raises:** `DataError` where nothing matches, none can be read, `out` cannot be written, the
    scheduler is gone, or with `strict` for the first recording that fails; `ModelError` for a
    criterion that draws windows, and for sums of another model.
    """
    require_packages("fleet")
    require("patterns", patterns, str | os.PathLike | list | tuple, PATTERNS)
    listed = [patterns] if isinstance(patterns, str | os.PathLike) else [*patterns]
    for pattern in listed or [None]:
        require("a pattern", pattern, str | os.PathLike, PATTERNS)
    tell: Progress = settings.progress or (lambda *_: None)
    is_usual = settings.intervals in (None, "bootstrap")
    intervals = BlockBootstrap(seed=settings.seed) if is_usual else settings.intervals
    settings = dataclasses.replace(settings, intervals=intervals, progress=None)
    asked = Order(with_rests(as_model(model), settings.at_rest), settings)
    with contextlib.ExitStack() as stack:
        folder = Path(
            settings.out or stack.enter_context(tempfile.TemporaryDirectory(prefix="riecjax-"))
        )

        def look() -> list[Source]:
            return find_sources(listed, lambda path: kept.is_result(folder, path))

        table, sources = Path(listed[0]), []
        if has_table := len(listed) == 1 and kept.is_table(table):
            row = next((row for row in kept.read_rows(table) if row.status == DONE), None)
            if row is None:
                raise DataError(f"{table.name}: no recording of it could be summed.")
            order = asked.of_table(table.name, Summary.from_bytes(row.sums))
        else:
            sources = look()
            order = asked.fitted(sources)
        kept.make_folder(folder)
        store = None if has_table else kept.SumStore(folder, order)
        each = stack.enter_context(engine(settings.workers, settings.scheduler))
        changed: list[str] = []
        if store is not None:
            pieces = [*order.pieces_of(sources)]
            _sum(order, pieces, store, each, tell)
            table = store.finish([piece.identity for piece in pieces])
            later = [piece for piece in order.pieces_of(look()) if piece.identity not in store]
            changed = sorted({piece.source.name for piece in later})
        rows = (row.without_sums for row in kept.read_rows(table))
        pairs = named(rows, settings.keys, settings.allow_duplicates)
        entries, over_time = _estimate(order, pairs, kept.read_rows(table), each, tell)
        if settings.out is not None:
            kept.write_batches(folder / kept.ESTIMATES, Entry, [[*entries, *over_time]], {})
    found = Fleet(
        order.model,
        settings.keys,
        order.criterion,
        entries,
        over_time,
        [row for _, row in pairs],
        changed,
    )
    if all(entry.status != DONE for entry in entries):
        raise DataError(f"no group can be estimated; the first: {found.unanswered[0].status}")
    return found


def _sum(
    order: Order, pieces: Sequence[Piece], store: kept.SumStore, each: Each, tell: Progress
) -> None:
    """Keep the rows of all pieces, of which those that are kept already are not summed again.

    **Raises:** `DataError` where rows cannot be kept, or the scheduler is gone; with `strict` for
    the first recording that fails.
    """
    lacking = [piece for piece in pieces if piece.identity not in store]
    if not lacking:
        return
    done, samples = len(pieces) - len(lacking), 0
    tell("summing", done, len(pieces), samples)
    for some, rows in each(functools.partial(sum_up, order), lacking, lambda p: p.source.size):
        if isinstance(rows, Lost):
            rows = [lost(piece, f"{piece.source.name}: {rows.why}.") for piece in some]
        failures = [row.status for row in rows if row.status != DONE]
        if failures and order.settings.strict:
            raise DataError(failures[0])
        store.add(rows)
        done += len(some)
        samples += sum(row.samples for row in rows)
        tell("summing", done, len(pieces), samples)


def _estimate(
    order: Order,
    pairs: Sequence[tuple[str, Row]],
    whole: Iterable[Row],
    each: Each,
    tell: Progress,
) -> tuple[list[Entry], list[Entry]]:
    """Entries of all groups, and of all spans of time; of rows that have no sums, why.

    **Arguments:** `pairs` of each row and its group; `whole`, the same rows with their sums.
    """
    count = len({name for name, row in pairs if row.status == DONE})
    done, entries, over_time = 0, [], []
    tell("estimating", 0, count, 0)
    groups = grouped(pairs, whole, order.settings.keys, order.settings.span is not None)
    for some, answers in each(
        functools.partial(estimated, order), groups, lambda group: group.size
    ):
        if isinstance(answers, Lost):
            answers = [[Entry(group.name, 0.0, 0.0, status=answers.why)] for group in some]
        for group, answer in zip(some, answers):
            (over_time if group.in_spans else entries).extend(answer)
            done += not group.in_spans
        tell("estimating", done, count, 0)
    entries += [
        Entry(name, row.start, row.start + row.seconds, status=row.status)
        for name, row in pairs
        if row.status != DONE
    ]

    def place(entry: Entry) -> tuple[str, float, float, str]:
        return entry.group, entry.start, entry.end, entry.status

    return sorted(entries, key=place), sorted(over_time, key=place)
