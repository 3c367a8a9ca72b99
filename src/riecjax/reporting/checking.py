"""Results of a check before a fit: its document, and tables on a terminal."""

from collections.abc import Mapping, Sequence

from rich.console import Console

from riecjax.assessment.assess import Answering
from riecjax.estimation.check import Check
from riecjax.leaves import finite, told
from riecjax.records.recording import Recording, common_steps
from riecjax.reporting.answer import (
    Excitation,
    NoisePart,
    RecordPart,
    excitation_entries,
    noise_entries,
    read,
    recording_entry,
    start_times,
)
from riecjax.reporting.document import SCHEMA, Document, share_in_words, versions
from riecjax.reporting.identification import noise_in_words
from riecjax.reporting.tables import Table, View, in_rich, print_table, say
from riecjax.shows import view_of


def check_document(answering: Answering, model: str, recordings: Sequence[Recording]) -> Document:
    """What was checked of these recordings for a model: the document that `riecjax check --json`
    prints, with an `error` if that exits with 1."""
    checked, refusal = answering.checked, answering.refusal
    records = [
        {
            **recording_entry(recording),
            "duration": recording.record.duration,
            "stretches": len(recording.record.segments(checked.signals)),
        }
        for recording in recordings
    ]
    return finite(
        {
            "schema": SCHEMA,
            **({} if refusal is None else {"error": told(refusal, "code", "message")}),
            "model": model,
            "criterion": answering.criterion.describe(),
            "answerable": refusal is None,
            "by_refinement": answering.by_refinement,
            "records": records,
            "signals": checked.signals,
            "excitation": excitation_entries(checked),
            "noise": noise_entries(recordings, checked.signals),
            "warnings": [finding._asdict() for finding in checked.findings],
            "provenance": {
                "start_times": start_times(recordings),
                "preparation": _prepared(answering, recordings),
                "versions": versions(),
            },
        },
    )


def _prepared(answering: Answering, recordings: Sequence[Recording]) -> list[str]:
    return common_steps([r.concerning(answering.checked.signals) for r in recordings])


def excitation_table(excitation: Mapping[str, Excitation], caption: str = "") -> Table:
    """How each parameter is excited."""
    cells = {
        "equation": lambda entry: entry.equation,
        "own share": lambda entry: share_in_words(entry.own_share),
        "noise": lambda entry: share_in_words(entry.noise_share, 2),
    }
    return Table.of("parameter", excitation.items(), cells, caption)


def print_check(answering: Answering, recordings: Sequence[Recording], console: Console) -> None:
    """The answer, and tables for a reader."""
    checked = answering.checked
    # Whether the recordings can answer, in a sentence.
    doubts = len(checked.findings)
    warned = f", with {doubts} warning{'s' * (doubts > 1)}" if doubts else ""
    sentence = f"These recordings can answer what the model asks{warned}."
    if answering.refusal is not None:
        sentence = "These recordings cannot answer what the model asks; see the warnings."
    elif (errors := answering.by_refinement) is not None:
        shares = (f"{name} to about {share_in_words(finite(e), 2)}" for name, e in errors.items())
        sentence = (
            f"Windows cannot tell these parameters from noise, and identify refines them by "
            f"itself: {', '.join(shares)}."
        )
    say(console, sentence, style="bold")
    say(console, "")
    for recording in recordings:
        record = read(RecordPart, recording_entry(recording))
        stretches = len(recording.record.segments(checked.signals))
        parted = "" if stretches == 1 else f", in {stretches} unbroken stretches"
        say(
            console,
            f"{record.name}: {record.samples} samples at {1 / record.time_step:.6g} Hz, "
            f"{float(recording.record.duration):.4g} s{parted}",
        )
    say(console, *(f"prepared: {step}" for step in _prepared(answering, recordings)))
    noise = read(dict[str, NoisePart], noise_entries(recordings, checked.signals))
    say(console, *noise_in_words(noise), "")
    print_table(in_rich(_excited(checked)), console)
    say(
        console,
        "own share: what no combination of the others could do as well (100 % is best)",
        "noise: share of the sensors' noise in what multiplies the parameter",
        style="dim",
    )


def _excited(checked: Check) -> Table:
    return excitation_table(read(dict[str, Excitation], excitation_entries(checked)))


@view_of.register
def _(thing: Check) -> View:
    return View(
        f"These recordings {'can' if thing.answerable else 'cannot'} answer what the model asks.",
        [_excited(thing)],
        thing.findings,
    )
