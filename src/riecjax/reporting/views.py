"""What objects say when they are printed: titles, tables and lines of each kind."""

import functools
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from riecjax.arrays import are_traced, hosted
from riecjax.assessment.assess import Assessment
from riecjax.assessment.verdict import Verdict, percent
from riecjax.elements.evidence import Evidence
from riecjax.equations.equation import Equation
from riecjax.equations.model import OWN, Model
from riecjax.estimation.estimate import Estimate, span
from riecjax.findings import Step
from riecjax.records.record import Record
from riecjax.records.recording import Recording
from riecjax.reporting.answer import (
    Answer,
    HeldOutPart,
    ResidualTest,
    answer_of,
    next_steps,
    part_of,
    read,
)
from riecjax.reporting.document import number
from riecjax.reporting.equations import (
    equation_in_words,
    expression_in_words,
    model_in_words,
    parameters_in_words,
)
from riecjax.reporting.identification import (
    criterion_in_words,
    evidence_in_words,
    fits_in_words,
    reasons_in_words,
    words_of,
)
from riecjax.reporting.parameters import USUAL, bracketed, paper_table, parameter_table
from riecjax.reporting.result_page import held_out_table, residual_table
from riecjax.reporting.tables import Table, View
from riecjax.shows import Tabled, table_of, view_of
from riecjax.summaries.summary import Summary
from riecjax.validation import HeldOut, ResidualTests, WindowSweep

table_of.register(Tabled, paper_table)
Case = Callable[[Any], View]


def shown_if_known(case: Case) -> Case:
    """Registers what is said of a kind of objects, of which one that JAX traces has names alone."""

    @functools.wraps(case)
    def view(thing: Any) -> View:
        numbers = getattr(thing, "record", thing)
        if not are_traced(numbers):
            return case(thing)
        names = getattr(numbers, "parameters", None) or getattr(numbers, "arrays", ())
        units = dict(getattr(numbers, "units", ()))
        listed = f" of {parameters_in_words(names, units)}" if names else ""
        return View(f"{type(thing).__name__}{listed}, being traced by JAX")

    return view_of.register(view)


@view_of.register
def _(thing: Equation) -> View:
    known = ", ".join(f"{name} = {span(value, '.6g')}" for name, value in thing.known.items())
    lines = [
        f"parameters: {parameters_in_words(thing.parameters, thing.units)}",
        *([f"known: {known}"] if known and not are_traced(thing.known) else []),
        *([f"where {expression_in_words(thing.where)}"] if thing.where else []),
    ]
    unit = f" [{thing.unit}]" if thing.unit else ""
    return View(f"{thing.name}: {equation_in_words(thing)}{unit}", lines=lines)


@view_of.register
def _(thing: Model) -> View:
    equations = model_in_words(thing)
    if thing.summary == OWN:
        count = len(thing.stages)
        title = f"{count} stage{'s' if count > 1 else ''} of equations"
        said = f"parameters: {parameters_in_words(thing.parameter_names, thing.units)}"
        return View(title, lines=[*equations, said])
    roles = {
        "parameter": thing.parameters,
        "signal": thing.signals,
        "to simulate": thing.system.parameters,
        "input": thing.inputs,
    }
    rows = [[q.name, role, q.unit, q.meaning] for role, every in roles.items() for q in every]
    lines = [*equations, *([thing.note] if thing.note else [])]
    header = ("name", "is a", "unit", "meaning")
    return View(f"{thing.name}: {thing.summary}", [Table(header, rows)], lines)


@shown_if_known
def _(thing: Record) -> View:
    shape = next(iter(thing.arrays.values())).shape[:-1]
    step = np.asarray(thing.time_step)
    batch = f"batch of {' x '.join(map(str, shape))} records of " if shape else ""
    title = (
        f"{batch}{thing.sample_count} samples at {span(1 / step, '.6g')} Hz, "
        f"{span(np.asarray(thing.duration), '.4g')} s"
    )
    rows = []
    for name, signal in thing.by_name.items():
        values = signal.with_nan
        kept = values[~np.isnan(values)]
        numbers = [kept.mean(), kept.std(), kept.min(), kept.max()] if kept.size else [np.nan] * 4
        label = parameters_in_words([name], {name: signal.unit})
        missing = values.size - kept.size
        rows.append([label, *(f"{x:.4g}" for x in numbers), f"{missing}" if missing else ""])
    header = ["signal", "mean", "std", "min", "max", "missing"]
    if not any(row[-1] for row in rows):
        header, rows = header[:-1], [row[:-1] for row in rows]
    return View(title, [Table(header, rows)])


@shown_if_known
def _(thing: Recording) -> View:
    record = view_of(thing.record)
    steps = [f"prepared: {step}" for step in thing.steps]
    return View(f"{thing.name}: {record.title}", record.tables, [*steps, *thing.findings])


@shown_if_known
def _(thing: Evidence) -> View:
    words = evidence_in_words(thing.test, thing.entry())
    carried = f"{'carried' if thing.carried else 'not carried'} by the recordings"
    return View(f"{thing.parameters[0]}, {carried}", lines=[*words, *thing.findings()])


@shown_if_known
def _(thing: Summary) -> View:
    host, outline = hosted(thing), thing.outline
    lines = [
        f"parameters: {parameters_in_words(outline.parameters, dict(outline.units))}",
        *(
            f"recording {i}: {span(sums.samples, 'd')} samples at "
            f"{span(1 / sums.time_step, '.6g')} Hz, in {span(sums.blocks, 'd')} blocks of "
            f"{span(sums.block_seconds)} s"
            for i, sums in enumerate(host.recordings, start=1)
        ),
    ]
    count, bins = len(host.recordings), host.bins
    kept = "together" if bins is None else f"apart in {len(bins.edges) - 1} bins"
    return View(
        f"sums of {count} recording{'s' if count != 1 else ''} by "
        f"{criterion_in_words(host.criterion.describe())}",
        lines=[*lines, f"window lengths kept {kept}; {host.byte_count / 1024:.4g} KiB"],
    )


@shown_if_known
def _(thing: Estimate) -> View:
    host = hosted(thing)
    if (search := host.search) is not None:
        both = (np.moveaxis(np.asarray(rms), -1, 0) for rms in (search.rms_before, search.rms))
        left = (" -> ".join(span(rms, ".4g") for rms in pair) for pair in zip(*both))
        lines = [
            f"{search.reason} after {span(search.steps, 'd')} steps",
            f"left before -> after ({search.basis}):",
            *(
                f"{name}: {rms} {unit} r.m.s.".replace("  ", " ")
                for name, rms, unit in zip(search.quantities, left, search.quantity_units)
            ),
        ]
        return _of_parameters(host, "" if host.batch_shape else "refined", lines)
    lines = [
        f"intervals: {host.uncertainty.label}, {span(host.block_count, 'd')} blocks of "
        f"{span(host.block_length)} s",
        f"condition number {span(host.condition_number)}",
    ]
    for label, names, stage in zip(host.stage_names, host.equation_names, host.stages):
        apart = zip(names, stage.equations) if len(names) > 1 else ()
        lines.extend(
            f"{name}: relative residual {span(100 * np.asarray(fit.relative_rms))} %"
            for name, fit in ((label, stage), *apart)
        )
    title = "" if host.batch_shape else criterion_in_words(host.criterion.describe())
    return _of_parameters(host, title, lines)


def _of_parameters(estimate: Estimate, title: str, said: Sequence[str]) -> View:
    lines = [*said, *estimate.findings()]
    if not estimate.batch_shape:
        return View(title, [parameter_table(part_of(estimate), USUAL, bracketed)], lines)
    # How each is distributed over the batch. Scatter over members is not uncertainty of one of
    # them, so both are told.
    finite = np.isfinite(estimate.theta).all(axis=-1)
    valid = finite & np.asarray(estimate.determined)
    lost = {"not finite": np.sum(~finite), "undetermined": np.sum(finite & ~valid)}
    words = ", ".join(f"{count} of them {what}" for what, count in lost.items() if count)
    left_out = f", {words} and left out of this table" if words and valid.any() else ""
    valid = valid if valid.any() else np.full(finite.shape, True)

    def scatter(values: np.ndarray) -> float:
        return float(np.std(values - values[0], ddof=min(1, values.size - 1)))

    def mean_error(name: str) -> str:
        return f"{np.mean(estimate.standard_error(name)[valid]):.3g}"

    cells = {
        "mean": lambda name: f"{np.mean(estimate[name][valid]):.6g}",
        "std over batch": lambda name: f"{scatter(np.asarray(estimate[name])[valid]):.3g}",
        "mean std error": lambda name: "known" if name in estimate.known else mean_error(name),
        "min .. max": lambda name: span(estimate[name][valid], ".6g"),
        "unit": lambda name: estimate.table[name].unit,
    }
    size = " x ".join(map(str, estimate.batch_shape))
    table = Table.of("parameter", [(name, name) for name in estimate], cells)
    return View(f"batch of {size} estimates{left_out}", [table], lines)


@shown_if_known
def _(thing: WindowSweep) -> View:
    theta, errors, units = np.asarray(thing.theta), thing.standard_errors, dict(thing.table.units)
    rows = [
        [
            f"{float(low):.3g} .. {float(high):.3g}",
            *(f"{number(value, 5)} ± {number(error, 2)}" for value, error in zip(*estimates)),
        ]
        for low, high, *estimates in zip(thing.alpha, thing.beta, theta, np.asarray(errors))
    ]
    header = ("windows / s", *(parameters_in_words([n], units) for n in thing.parameters))
    if len(thing.parameters) > len(rows):
        header, *rows = zip(header, *rows)
    title = f"estimates at {len(theta)} window lengths, {int(thing.block_count)} blocks of time"
    return View(title, [Table(header, rows)], thing.findings())


@shown_if_known
def _(thing: HeldOut) -> View:
    return View(thing.verdict, [held_out_table(read(HeldOutPart, thing.entry()))])


@shown_if_known
def _(thing: ResidualTests) -> View:
    table = residual_table(read(dict[str, ResidualTest], thing.entry()))
    return View("what each equation leaves", [table], thing.findings())


@view_of.register
def _(thing: Answer) -> View:
    verdict, command = thing.verdict, thing.provenance.command
    made = f"{thing.model} by {criterion_in_words(thing.criterion)}"
    columns = (*USUAL, "doubt", "verdict") if verdict.sentence else USUAL
    lines = [
        *reasons_in_words(verdict),
        *_to_do(verdict.next),
        *([made] if verdict.sentence else []),
        *fits_in_words(thing.residual),
        *words_of(thing),
        *thing.findings(),
        *([] if command is None else [f"made by: {command}"]),
    ]
    return View(verdict.sentence or made, [parameter_table(thing, columns, bracketed)], lines)


view_of.register(Assessment, lambda assessment: view_of(answer_of(assessment)))


@view_of.register
def _(thing: Verdict) -> View:
    cells = {
        "value": lambda judged: number(judged.value),
        "unit": lambda judged: judged.unit,
        "doubt": lambda judged: "?" if np.isnan(judged.share) else percent(judged.share),
        "verdict": lambda judged: judged.level,
        "mostly from": lambda judged: judged.reason,
    }
    table = Table.of("parameter", thing.parameters.items(), cells)
    return View(thing.sentence, [table], _to_do(next_steps(thing.causes)))


def _to_do(steps: Iterable[Step]) -> list[str]:
    return [f"to do: {step.said} {' '.join(step.options)}".rstrip() for step in steps]
