"""Objects drawn by matplotlib, by the charts of the report."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from riecjax.arrays import hosted
from riecjax.assessment.assess import Assessment
from riecjax.charts import (
    BOLD,
    LARGE,
    SERIES,
    THIN,
    Axis,
    Chart,
    Dots,
    Level,
    Line,
    Mark,
    Panel,
    labelled,
    single,
)
from riecjax.estimation.estimate import Estimate
from riecjax.records.record import Record
from riecjax.records.recording import Recording
from riecjax.reporting.answer import Answer, part_of
from riecjax.reporting.result_figures import (
    identification_figures,
    over_time,
)
from riecjax.reporting.tables import with_error
from riecjax.shows import chart_of, draw

FARTHEST = 100.0
"""Percent beyond which the ends of an interval are not drawn."""


@draw.register
def _(chart: Chart, ax: Any = None) -> Any:
    from riecjax.reporting.printed import drawn

    return drawn(chart, ax)


@chart_of.register
def _(thing: Record) -> Chart:
    batch, panels = np.ndim(thing.time_step) > 0, []
    steps = np.arange(thing.sample_count)
    time = np.mean(thing.time_step) * steps if batch else np.asarray(thing.elapsed)
    for name, signal in thing.by_name.items():
        samples = signal.with_nan
        # Of a batch of records, one line each.
        every = samples.reshape(-1, samples.shape[-1])
        times = np.broadcast_to(time, samples.shape).reshape(every.shape)
        lines = [Line(*pair, width=THIN) for pair in zip(times, every)]
        panels.append(Panel(lines, y=Axis(labelled(name, signal.unit))))
    return over_time(panels, "Signals over time.")


@chart_of.register
def _(thing: Recording) -> Chart:
    return chart_of(thing.record)


@chart_of.register
def _(thing: Estimate) -> Chart:
    if thing.batch_shape:
        return _batch(hosted(thing))
    return relative_figure({"": part_of(hosted(thing))})


chart_of.register(Answer, lambda answer: relative_figure({"": answer}))


@chart_of.register
def _(thing: Assessment) -> Chart:
    figures = identification_figures(thing)
    (values,) = chart_of(thing.answer).panels
    fit = list(figures["fit"].rows[0])
    rows: list[list[Panel | None]] = [[values, *fit]]
    for name, chart in figures.items():
        if name in ("curves", "window_sweep") or name.startswith("validation"):
            rows += [list(row) for row in chart.rows]
    width = max(len(row) for row in rows)
    for row in rows:
        if len(row) == 1 and row[0] is not None:
            # It takes all places, as signals over time should.
            row[0] = replace(row[0], columns=width)
        else:
            row += [None] * (width - len(row))
    return Chart(rows, f"{thing.model.name}.")


def _batch(batch: Estimate) -> Chart:
    """Each member as a dot, relative to the mean over the batch."""
    labels: list[str] = []
    marks: list[Mark] = [Level(axis="x")]
    for i, name in enumerate(batch.parameters):
        values = np.ravel(np.asarray(batch[name], float))
        mean = float(np.nanmean(values))
        labels.append(f"{name} = {mean:.4g} {batch.table[name].unit}".rstrip())
        marks.append(Dots(_percent(values, mean), np.full(values.size, i), opacity=0.4, size=LARGE))
    x, y = Axis("deviation from the mean / %"), _names(labels)
    return single(marks, x, y, "Members of a batch, relative to their mean.")


def _names(labels: Sequence[str]) -> Axis:
    """An axis of parameters, the first one above."""
    return Axis(categories=tuple(labels), low=-0.5, high=len(labels) - 0.5, reverse=True)


def relative_figure(answers: Mapping[str, Answer]) -> Chart:
    """Parameters with their 95 % intervals, relative to the values of the first answer."""
    first = next(iter(answers.values())).parameters
    names = list(dict.fromkeys(n for answer in answers.values() for n in answer.parameters))
    later_first = [answer.parameters for answer in reversed([*answers.values()])]
    reference = {n: entry.value for entries in later_first for n, entry in entries.items()}
    marks: list[Mark] = [Level(axis="x")]
    for j, (label, answer) in enumerate(answers.items()):
        shift = 0.0 if len(answers) == 1 else 0.5 * (j / (len(answers) - 1) - 0.5)
        color = SERIES[j % len(SERIES)]
        # A bar for each interval, in one line with gaps, and dots at the values.
        entries = answer.parameters
        ends = [_percent(entries[n].interval95, reference[n]) for n in names if n in entries]
        values = [_percent([entries[n].value], reference[n]) for n in names if n in entries]
        places = [i + shift for i, name in enumerate(names) if name in entries]
        x = np.ravel([(*pair, math.nan) for pair in ends])
        y = np.ravel([(place, place, math.nan) for place in places])
        marks.append(Line(x, y, label, color, width=BOLD))
        marks.append(Dots(np.ravel(values), places, color=color, size=LARGE))
    ends = [abs(x) for mark in marks if isinstance(mark, Line) for x in np.ravel(mark.x)]
    reach = max((end for end in ends if math.isfinite(end)), default=1.0)
    limit = FARTHEST if reach > FARTHEST else None
    base, labels = f"the value of {next(iter(answers))}", names
    if len(answers) == 1:
        base = "the value"
        values = {n: with_error(e.value, e.std_error) for n, e in first.items()}
        labels = [f"{n} = {values[n]} {first[n].unit}".rstrip() for n in names]
    across = Axis(f"95 % interval, from {base} / %", low=limit and -limit, high=limit)
    return single(marks, across, _names(labels), "Parameters with their 95 % intervals.")


def _percent(values: Iterable[Any], reference: Any) -> list[float]:
    """Deviation from a reference in percent of it; NaN where one of them is none, or it is 0."""
    if not reference:
        return [math.nan for _ in values]
    return [math.nan if v is None else 100 * (v - reference) / abs(reference) for v in values]
