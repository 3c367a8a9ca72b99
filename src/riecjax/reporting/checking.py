"""Results of a check before a fit: its document, and tables on a terminal."""

from collections.abc import Mapping, Sequence

from rich.console import Console

from riecjax.doubts.check import Check
from riecjax.leaves import finite, told
from riecjax.records.noise_judgement import noise_entries
from riecjax.records.recording import Recording, common_steps
from riecjax.reporting.answer import (
    Excitation,
    NoisePart,
    RecordPart,
    excitation_entries,
    read,
    recording_entry,
    start_times,
)
from riecjax.reporting.document import SCHEMA, Document, share_in_words, versions
from riecjax.reporting.identification import noise_in_words
from riecjax.reporting.tables import Table, View, in_rich, print_table, say
from riecjax.shows import view_of


def check_document(checked: Check, model: str, recordings: Sequence[Recording]) -> Document:
    """What was checked of these recordings for a model: the document that `riecjax check --json`
    prints, with an `error` if that exits with 1."""
    refusal = checked.refusal
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
            "criterion": checked.criterion.describe(),
            "answerable": refusal is None,
            "by_refinement": checked.by_refinement,
            "records": records,
            "signals": checked.signals,
            "excitation": excitation_entries(checked),
            "noise": noise_entries([one.record for one in recordings], checked.signals),
            "warnings": [finding._asdict() for finding in checked.findings],
            "provenance": {
                "start_times": start_times(recordings),
                "preparation": common_steps([r.concerning(checked.signals) for r in recordings]),
                "versions": versions(),
            },
        },
    )


def excitation_table(excitation: Mapping[str, Excitation], caption: str = "") -> Table:
    """How each parameter is excited."""
    cells = {
        "equation": lambda entry: entry.equation,
        "own share": lambda entry: share_in_words(entry.own_share),
        "noise": lambda entry: share_in_words(entry.noise_share, 2),
    }
    return Table.of("parameter", excitation.items(), cells, caption)


def print_check(document: Document, console: Console) -> None:
    """The answer, and tables for a reader."""
    # Whether the recordings can answer, in a sentence.
    doubts = len(document["warnings"])
    warned = f", with {doubts} warning{'s' * (doubts > 1)}" if doubts else ""
    recordings = "These recordings" if len(document["records"]) > 1 else "This recording"
    sentence = f"{recordings} can answer what the model asks{warned}."
    if not document["answerable"]:
        sentence = f"{recordings} cannot answer what the model asks; see the warnings."
    elif (errors := document["by_refinement"]) is not None:
        shares = (f"{name} to about {share_in_words(e, 2)}" for name, e in errors.items())
        sentence = (
            f"Windows cannot tell these parameters from noise, and identify refines them by "
            f"itself: {', '.join(shares)}."
        )
    say(console, sentence, style="bold")
    say(console, "")
    for entry in document["records"]:
        record, stretches = read(RecordPart, entry), entry["stretches"]
        parted = "" if stretches == 1 else f", in {stretches} unbroken stretches"
        say(
            console,
            f"{record.name}: {record.samples} samples at {1 / record.time_step:.6g} Hz, "
            f"{entry['duration']:.4g} s{parted}",
        )
    say(console, *(f"prepared: {step}" for step in document["provenance"]["preparation"]))
    say(console, *noise_in_words(read(dict[str, NoisePart], document["noise"])), "")
    excitation = read(dict[str, Excitation], document["excitation"])
    print_table(in_rich(excitation_table(excitation)), console)
    say(
        console,
        "own share: what no combination of the others could do as well (100 % is best)",
        "noise: share of the sensors' noise in what multiplies the parameter",
        style="dim",
    )


@view_of.register
def _(thing: Check) -> View:
    return View(
        f"These recordings {'can' if thing.answerable else 'cannot'} answer what the model asks.",
        [excitation_table(read(dict[str, Excitation], excitation_entries(thing)))],
        thing.findings,
    )
