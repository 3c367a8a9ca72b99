"""What objects say when they are printed: titles, tables and lines of each kind."""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from riecjax.assessment.assess import Assessment
from riecjax.assessment.verdict import Verdict
from riecjax.discovery.discover import Discovery
from riecjax.equations.equation import Equation
from riecjax.equations.model import OWN, Model
from riecjax.estimation import ModeEvidence
from riecjax.estimation.estimate import Estimate, span
from riecjax.leaves import is_concrete, on_host
from riecjax.records.record import Record
from riecjax.records.recording import Recording
from riecjax.reporting.answer import (
    Answer,
    Judgement,
    Known,
    VerdictPart,
    part_of,
    read,
    verdict_entries,
)
from riecjax.reporting.discovery import choice_lines, discovery_answer, path_table, rejected_table
from riecjax.reporting.document import number, share_in_words
from riecjax.reporting.equations import (
    equation_in_words,
    expression_in_words,
    model_in_words,
    parameters_in_words,
)
from riecjax.reporting.identification import criterion_in_words, reasons_in_words
from riecjax.reporting.parameters import USUAL, bracketed, paper_table, parameter_table
from riecjax.reporting.tables import Table, View, with_error
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
        if is_concrete(numbers):
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
        *([f"known: {known}"] if known and is_concrete(thing.known) else []),
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
def _(thing: Discovery) -> View:
    answer = discovery_answer(thing)
    tables = [path_table(answer), rejected_table(answer), parameter_table(answer)]
    return View(answer.sentence, tables, [*choice_lines(answer), answer.equation])


@shown_if_known
def _(thing: ModeEvidence) -> View:
    left, without = (100 * max(float(x), 0.0) for x in (thing.unexplained, thing.without))
    return View(
        f"hidden mode on {thing.on} ({thing.parameters.mass}), "
        f"{'carried' if thing.carried else 'not carried'} by the recordings",
        lines=[
            f"{with_error(*thing.frequency)} Hz with the body at rest, damping ratio "
            f"{with_error(*thing.damping_ratio)}",
            f"{thing.stage}, on time left out: {left:.2g} % unexplained with it, {without:.2g} % "
            f"without",
            *thing.findings(),
        ],
    )


@shown_if_known
def _(thing: Summary) -> View:
    host, outline = on_host(thing), thing.outline
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
    host = on_host(thing)
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
    cells = {
        "fit": lambda signal: f"{float(signal.fit):.1f} %",
        "VAF": lambda signal: f"{float(signal.vaf):.1f} %",
        "p": lambda signal: f"{float(signal.p):.1f} %",
        "predicted": lambda signal: signal.grade,
    }
    return View(thing.verdict, [Table.of("signal", thing.signals.items(), cells)])


@shown_if_known
def _(thing: ResidualTests) -> View:
    cells = {
        "left, sample by sample": lambda test: share_in_words(test.relative_rms),
        "peak": lambda test: "" if test.peak is None else f"{test.peak.frequency:.3g} Hz",
        "follows most (correlation)": lambda test: "".join(
            f"{other.signal} ({other.largest:.2f})" for other in test.follows[:1]
        ),
    }
    tests = [(test.name, test) for test in thing.equations]
    table = Table.of("equation", tests, cells)
    return View("what each equation leaves", [table], thing.findings())


@view_of.register
def _(thing: Assessment) -> View:
    shown, verdict, refinement = view_of(thing.answer), thing.verdict, thing.refinement
    how = shown.title if thing.answer is thing.estimate else "refined"
    declined = "" if refinement is None else refinement.declined
    runs = [] if (validation := thing.test("validation")) is None else validation.runs
    lines = [
        *_to_do(verdict),
        f"{thing.model.name} by {how}",
        *(line for line in shown.lines if isinstance(line, str)),
        *([f"not refined: {declined}"] if declined else []),
        *(f"validated on {run.recording.name}: {run.held.verdict}" for run in runs),
        *thing.findings(),
    ]
    columns, judgements = (*USUAL, "doubt", "verdict"), _judgements(verdict)
    table = parameter_table(part_of(thing.answer), columns, bracketed, judgements)
    return View(verdict.sentence, [table], lines)


@view_of.register
def _(thing: Answer) -> View:
    sentence = thing.verdict.sentence
    made = f"{thing.model} by {criterion_in_words(thing.criterion)}"
    reasons = [*reasons_in_words(thing.verdict), made] if sentence else []
    command = thing.provenance.command
    by = [] if command is None else [f"made by: {command}"]
    table = parameter_table(thing, USUAL, bracketed)
    return View(sentence or made, [table], [*reasons, *thing.findings(), *by])


@view_of.register
def _(thing: Verdict) -> View:
    columns = ("value", "unit", "doubt", "verdict", "mostly from")
    judged = {n: Known(value=j.value, unit=j.unit) for n, j in thing.parameters.items()}
    values = Answer(criterion={}, parameters={}, known=judged, warnings=[])
    table = parameter_table(values, columns, judgements=_judgements(thing))
    return View(thing.sentence, [table], _to_do(thing))


def _judgements(verdict: Verdict) -> dict[str, Judgement]:
    return read(VerdictPart, verdict_entries(verdict)).parameters


def _to_do(verdict: Verdict) -> list[str]:
    steps = dict.fromkeys(cause.step for cause in verdict.causes if cause.step is not None)
    return [f"to do: {step.words} {' '.join(step.options)}".rstrip() for step in steps]
