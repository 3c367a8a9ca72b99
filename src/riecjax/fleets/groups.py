"""From the rows of recordings to estimates: one group, or one span of time, after the other."""

import json
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from riecjax import Finding, Summary
from riecjax.assessment import assess_summary
from riecjax.errors import DataError, reason_of
from riecjax.fleets.order import DONE, Order, Row

FEW = 8
"""Recordings of a group up to which each keeps its blocks of time; more are summed as one."""
BLOCKS = 64
"""Blocks that those have together, at the least one each."""
NAMED = 3
"""Recordings that a finding of a group names."""


class Entry(NamedTuple):
    """One parameter of one group, or of one span of time of one recording.

    **Fields:** `group`; `start`, `end` in seconds from the recording's first sample, and of a group
    0 and the seconds of all its recordings; `parameter`, `value`, `unit`, `std_error`; `low95` and
    `high95`, ends of its interval; `verdict`, its level; `findings`, codes of those that concern
    it, between commas; `status`, `ok`, or why there is no value: of a recording that could not be
    summed, or of a group that has no answer.
    """

    group: str
    start: float
    end: float
    parameter: str | None = None
    value: float | None = None
    unit: str | None = None
    std_error: float | None = None
    low95: float | None = None
    high95: float | None = None
    verdict: str | None = None
    findings: str = ""
    status: str = DONE


class Group(NamedTuple):
    """What is estimated together: a group, or one recording span by span.

    **Fields:** `name`; `rows` of its recordings without their sums; `summaries`, as bytes, of all
    of them: their sums, and those by window lengths if there are some; `in_spans`, whether each
    span of time is estimated by itself.
    """

    name: str
    rows: tuple[Row, ...]
    summaries: tuple[bytes, ...]
    in_spans: bool = False

    @property
    def size(self) -> int:
        """Bytes."""
        return sum(map(len, self.summaries))


def named(rows: Iterable[Row], by: Sequence[str], allow_duplicates: bool) -> list[tuple[str, Row]]:
    """Each row with its group; what belongs to none, or is a copy of another, says so.

    **Raises:** `DataError` where no recording at all could be summed.
    """
    firsts: dict[tuple[str, str], Row] = {}
    pairs = []
    for row in rows:
        keys, name, status = json.loads(row.keys), row.name, row.status
        if by[0] == "file":
            name = row.whole_name
        elif by[0] == "folder":
            name = row.name.rpartition("/")[0] or "."
        elif lacking := [key for key in by if key not in keys]:
            if status == DONE:
                status = (
                    f"{row.name}: neither the path nor a column says the recording's {lacking[0]}; "
                    f"what there is: {', '.join(keys) or 'nothing'}."
                )
        else:
            name = ", ".join(f"{key}={keys[key]}" for key in by)
        if status == DONE:
            first = firsts.setdefault((name, row.digest), row)
            if not allow_duplicates and (first.name, first.part) != (row.name, row.part):
                status = f"{row.name}: it holds the same samples as {first.name}."
        pairs.append((name, row._replace(status=status)))
    if not pairs:
        raise DataError("what was found holds no rows.")
    if all(row.status != DONE for _, row in pairs):
        first = pairs[0][1].status
        raise DataError(f"none of {len(pairs)} recordings can be used; the first: {first}")
    return pairs


def grouped(
    pairs: Sequence[tuple[str, Row]], whole: Iterable[Row], by: Sequence[str], in_spans: bool
) -> Iterator[Group]:
    """Each group, as soon as all its recordings are there; and of each recording its course.

    **Arguments:** `pairs` of names and rows; `whole`, the same rows with their sums.
    """
    members = Counter(name for name, row in pairs if row.status == DONE)
    waiting: dict[str, list[tuple[Row, list[Summary]]]] = {}
    for (name, row), full in zip(pairs, whole, strict=True):
        if row.status != DONE:
            continue
        summaries = [Summary.from_bytes(each) for each in (full.sums, full.lengths) if each]
        if members[name] > FEW:
            # What differs from recording to recording is alike within each: of so many, a
            # recording is the block of time that is independent of others.
            summaries = [each.coarsen_blocks(1) for each in summaries]
        parts = waiting.setdefault(name, [])
        parts.append((row, summaries))
        if in_spans:
            is_alone = members[name] == 1 or by[0] == "file"
            course = name if is_alone else f"{name}: {row.whole_name}"
            yield Group(course, (row,), (full.sums,), in_spans=True)
        if len(parts) == members[name]:
            # The same group whatever order its recordings come in.
            parts = waiting.pop(name)
            parts.sort(key=lambda part: (part[0].digest, part[0].name, part[0].start))
            rows, kinds = zip(*parts)
            merged = []
            for every in zip(*kinds):
                recordings = [recording for summary in every for recording in summary.recordings]
                joined = every[0].of_recordings(recordings)
                pooled = joined.pool_recordings(BLOCKS) if len(recordings) > FEW else joined
                merged.append(pooled.to_bytes())
            yield Group(name, rows, tuple(merged))


def estimated(order: Order, groups: Sequence[Group]) -> list[list[Entry]]:
    """The entries of each of some groups; of one without an answer one that says why."""
    return [[*_entries(order, group)] for group in groups]


def _entries(order: Order, group: Group) -> Iterator[Entry]:
    sums, *lengths = map(Summary.from_bytes, group.summaries)
    findings = _findings(group.rows)
    if not group.in_spans:
        end = sum(row.seconds for row in group.rows)
        yield from _answers(order, (group.name, 0.0, end), sums, lengths, findings)
        return
    # Stretches of about so many seconds, of two blocks at the least.
    assert order.settings.span is not None
    (recording,), (row,) = sums.recordings, group.rows
    seconds, count = float(recording.block_seconds), int(recording.blocks)
    each = max(round(order.settings.span / seconds), 2)
    first = 0
    while first < count:
        last = count if count - first <= 1.5 * each else first + each
        some = sums.of_recordings([recording.of_blocks(np.arange(first, last))])
        end = min(last * seconds, float(recording.samples * recording.time_step))
        place = group.name, row.start + first * seconds, row.start + end
        yield from _answers(order, place, some, [], findings)
        first = last


def _answers(
    order: Order,
    place: tuple[str, float, float],
    sums: Summary,
    lengths: Sequence[Summary],
    findings: Sequence[Finding],
) -> Iterator[Entry]:
    try:
        assessment = assess_summary(
            order.model,
            sums,
            lengths=lengths[0] if lengths else None,
            findings=findings,
            known=order.settings.known,
            intervals=order.settings.intervals,
        )
        estimate, levels = assessment.estimate, assessment.verdict.parameters
        ends = estimate.interval_by_name()
        concerned = [(f.code, assessment.parameters_of(f)) for f in assessment.findings()]
        for name, error in zip(estimate.parameters, np.asarray(estimate.standard_errors)):
            codes = dict.fromkeys(code for code, names in concerned if name in names)
            yield Entry(
                *place,
                parameter=name,
                value=float(estimate[name]),
                unit=estimate.table[name].unit,
                std_error=float(error),
                low95=float(ends[name][0]),
                high95=float(ends[name][1]),
                verdict=levels[name].level,
                findings=",".join(codes),
            )
    # Not the end of all other groups, whatever it is.
    except Exception as error:
        yield Entry(*place, status=reason_of(error))


def _findings(rows: Sequence[Row]) -> list[Finding]:
    """Findings of recordings as a group's: how many have each, and by how much it puts a value in
    doubt, which is their share of all that was recorded."""
    alike: dict[tuple[str, tuple[str, ...]], list[tuple[Row, Finding]]] = {}
    for row in rows:
        for fields in json.loads(row.findings):
            sequences = {name: tuple(fields[name]) for name in ("signals", "parameters", "remedy")}
            finding = Finding(**{**fields, **sequences})
            alike.setdefault((finding.code, finding.signals), []).append((row, finding))
    if len(rows) == 1:
        return [some[0][1] for some in alike.values()]
    total = max(sum(row.samples for row in rows), 1)
    findings = []
    for some in alike.values():
        first = some[0][1]
        doubt = sum(row.samples * finding.doubt for row, finding in some) / total
        names = ", ".join(dict.fromkeys(row.name for row, _ in some[:NAMED]))
        message = f"{len(some)} of {len(rows)} recordings, {names}: {first.message}"
        # What is proposed for one may harm another.
        told = {"message": message, "doubt": doubt, "doubts": {}, "remedy": (), "step": ""}
        findings.append(first._replace(**told))
    return findings
