"""From the rows of recordings to estimates: one group, or one span of time, after the other."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import scipy.stats
from jaxtyping import Float

from riecjax.assessment.assess import assess_sums
from riecjax.assessment.assessment import Assessment
from riecjax.assessment.doubt import concerned
from riecjax.errors import DataError, reason_of
from riecjax.findings import Finding
from riecjax.fleets.order import Order, unpacked
from riecjax.fleets.sums import DONE, Row
from riecjax.summaries.summary import Summary, in_blocks, pooled
from riecjax.summaries.sums import RecordingSums
from riecjax.uncertainty.intervals import AbstractIntervals, BlockBootstrap

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
    parameter: str | None
    value: float | None
    unit: str | None
    std_error: float | None
    low95: float | None
    high95: float | None
    verdict: str | None
    findings: str
    status: str


def has_error(entry: Entry) -> bool:
    """Whether an entry has a value with an interval of some width, to be held against others."""
    ends = entry.low95, entry.value, entry.high95
    known = entry.status == DONE and all(end is not None and np.isfinite(end) for end in ends)
    return known and errors_of([entry])[0] > 0


def errors_of(entries: Sequence[Entry]) -> Float[np.ndarray, " n"]:
    """Standard errors of normal laws whose intervals are as wide as these entries': with few blocks
    of time an interval is wider than its standard error tells."""
    widths = np.array([(entry.high95 or 0.0) - (entry.low95 or 0.0) for entry in entries], float)
    return widths / (2 * scipy.stats.norm.isf(0.025))


@dataclass(frozen=True)
class Settings:
    """How groups are estimated from sums.

    **Fields:** `known` values; `intervals`; `span` in seconds, of estimates over time, `None` for
    none.
    """

    known: Mapping[str, float] = field(default_factory=dict)
    intervals: AbstractIntervals = field(default_factory=BlockBootstrap)
    span: float | None = None


def group_of(row: Row, by: Sequence[str]) -> str:
    """What a recording belongs to.

    **Raises:** `DataError` where its path and columns do not say.
    """
    if by[0] == "file":
        return row.whole_name
    if by[0] == "folder":
        return row.name.rpartition("/")[0] or "."
    keys = json.loads(row.keys)
    if missing := [name for name in by if name not in keys]:
        raise DataError(
            f"neither the path nor a column says the recording's {missing[0]}; what there is: "
            f"{', '.join(keys) or 'nothing'}."
        )
    return ", ".join(f"{name}={keys[name]}" for name in by)


class Part(NamedTuple):
    """What a group is estimated from, of one recording: the sums of its row, or smaller ones."""

    row: Row
    sums: Summary
    lengths: Summary | None


def part_of(row: Row, members: int) -> Part:
    """The sums of a row, for a group of so many recordings."""
    sums = Summary.from_bytes(row.sums)
    lengths = Summary.from_bytes(row.lengths) if row.lengths else None
    if members > FEW:
        # What differs from recording to recording is alike within each: of so many, a recording is
        # the block of time that is independent of others.
        sums = sums.of_recordings(in_blocks(one, 1) for one in sums.recordings)
        if lengths is not None:
            lengths = lengths.of_recordings(in_blocks(one, 1) for one in lengths.recordings)
    return Part(row._replace(sums=b"", lengths=b""), sums, lengths)


class Group(NamedTuple):
    """What is estimated together: a group, or one recording span by span.

    **Fields:** `name`; `rows` of its recordings without their sums; `sums` and `lengths`, bytes of
    a Summary of all of them; `in_spans`, whether each span of time is estimated by itself.
    """

    name: str
    rows: tuple[Row, ...]
    sums: bytes
    lengths: bytes = b""
    in_spans: bool = False


def group(name: str, parts: Sequence[Part]) -> Group:
    """A group of these parts, the same whatever order they come in."""
    ordered = sorted(parts, key=lambda part: (part.row.digest, part.row.name, part.row.start))
    sums = _joined([part.sums for part in ordered])
    lengths = [part.lengths for part in ordered if part.lengths is not None]
    return Group(
        name,
        tuple(part.row for part in ordered),
        sums.to_bytes(),
        _joined(lengths).to_bytes() if lengths else b"",
    )


def _joined(every: Sequence[Summary]) -> Summary:
    recordings = [one for summary in every for one in summary.recordings]
    if len(recordings) > FEW:
        recordings = [pooled(recordings, BLOCKS)]
    return every[0].of_recordings(recordings)


def estimated(order: bytes, settings: Settings, groups: Sequence[Group]) -> list[Entry]:
    """The entries of some groups; of one without an answer one that says why."""
    asked = unpacked(order)
    return [entry for one in groups for entry in _entries(asked, settings, one)]


def _entries(order: Order, settings: Settings, one: Group) -> Iterator[Entry]:
    sums, findings = Summary.from_bytes(one.sums), _findings(one.rows)
    if not one.in_spans:
        lengths = Summary.from_bytes(one.lengths) if one.lengths else None
        place = one.name, 0.0, sum(row.seconds for row in one.rows)
        yield from _of_sums(order, settings, place, sums, lengths, findings)
        return
    assert settings.span is not None
    begin = one.rows[0].start
    for start, end, some in _spans(sums.recordings[0], settings.span):
        place = one.name, begin + start, begin + end
        yield from _of_sums(order, settings, place, sums.of_recordings([some]), None, findings)


def _of_sums(
    order: Order,
    settings: Settings,
    place: tuple[str, float, float],
    sums: Summary,
    lengths: Summary | None,
    findings: Sequence[Finding],
) -> Iterator[Entry]:
    try:
        found = assess_sums(
            order.model,
            order.procedure,
            sums,
            lengths=lengths,
            findings=findings,
            known=settings.known,
            intervals=settings.intervals,
        )
        yield from _told(place, found)
    # Not the end of all other groups, whatever it is.
    except Exception as error:
        yield failed(place, reason_of(error))


def failed(place: tuple[str, float, float], why: str) -> Entry:
    """An entry without a value."""
    return Entry(*place, *(None,) * 7, findings="", status=why)  # pyright: ignore[reportCallIssue]


def _told(place: tuple[str, float, float], found: Assessment) -> Iterator[Entry]:
    estimate, levels = found.estimate, found.verdict.parameters
    ends, units = estimate.interval_by_name(), dict(estimate.units)
    findings = [(finding.code, concerned(found, finding)) for finding in found.findings()]
    for name, error in zip(estimate.parameters, np.asarray(estimate.standard_errors)):
        codes = dict.fromkeys(code for code, names in findings if name in names)
        low, high = ends[name]
        yield Entry(
            *place,
            name,
            float(estimate[name]),
            units.get(name, ""),
            float(error),
            float(low),
            float(high),
            levels[name].level,
            ",".join(codes),
            DONE,
        )


def _findings(rows: Sequence[Row]) -> list[Finding]:
    """Findings of recordings as a group's: how many have each, and by how much it puts a value in
    doubt, which is their share of all that was recorded."""
    every: dict[tuple[str, tuple[str, ...]], list[tuple[Row, Finding]]] = {}
    for row in rows:
        for told in json.loads(row.findings):
            sequences = {k: tuple(told[k]) for k in ("signals", "parameters", "remedy")}
            finding = Finding(**{**told, **sequences})
            every.setdefault((finding.code, finding.signals), []).append((row, finding))
    total = sum(row.samples for row in rows)
    found = []
    for some in every.values():
        first = some[0][1]
        if len(rows) == 1:
            found.append(first)
            continue
        share = sum(row.samples * finding.doubt for row, finding in some) / max(total, 1)
        named = ", ".join(dict.fromkeys(row.name for row, _ in some[:NAMED]))
        message = f"{len(some)} of {len(rows)} recordings, {named}: {first.message}"
        # What is proposed for one may harm another.
        found.append(first._replace(message=message, doubt=share, doubts={}, remedy=(), step=""))
    return found


def _spans(recording: RecordingSums, span: float) -> Iterator[tuple[float, float, RecordingSums]]:
    """Sums of stretches of about so many seconds, of two blocks at the least, with their ends."""
    seconds, count = float(recording.block_seconds), int(recording.blocks)
    each = max(round(span / seconds), 2)
    whole = recording.samples * recording.time_step
    for first in range(0, max(count - each // 2, 1), each):
        last = count if count - first <= 1.5 * each else first + each
        some = recording.of_blocks(np.arange(first, last))
        yield first * seconds, min(last * seconds, float(whole)), some
        if last == count:
            return
