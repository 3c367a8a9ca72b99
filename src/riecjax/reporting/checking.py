"""Results of a check before a fit: its document, and tables on a terminal."""

from collections.abc import Mapping, Sequence

from msgspec import UNSET, UnsetType
from rich.console import Console

from riecjax.assessment.assess import Answering
from riecjax.estimation.check import Check
from riecjax.records.recording import Recording, common_steps
from riecjax.reporting.answer import (
    Excitation,
    NoisePart,
    Number,
    Part,
    RecordPart,
    Settings,
    WarningPart,
    excitation_entries,
    noise_entries,
    read,
    recording_entry,
    start_times,
)
from riecjax.reporting.document import SCHEMA, share_in_words, versions
from riecjax.reporting.identification import noise_in_words
from riecjax.reporting.tables import Table, View, in_rich, print_table, say
from riecjax.shows import view_of


class Refusal(Part):
    """Why there is no answer."""

    code: str
    message: str


class CheckedRecord(RecordPart, kw_only=True):
    """A recording, with its length in seconds and its unbroken stretches."""

    duration: float
    stretches: int


class CheckProvenance(Part):
    """What was checked."""

    start_times: list[Number]
    preparation: list[str]
    versions: dict[str, str]


class CheckAnswer(Part, kw_only=True):
    """The document that `riecjax check --json` prints, with an `error` if that exits with 1."""

    schema: int = SCHEMA
    error: Refusal | UnsetType = UNSET
    model: str
    criterion: Settings
    answerable: bool
    by_refinement: dict[str, Number] | None
    records: list[CheckedRecord]
    signals: list[str]
    excitation: dict[str, Excitation]
    noise: dict[str, NoisePart]
    warnings: list[WarningPart]
    provenance: CheckProvenance


def check_answer(answering: Answering, model: str, recordings: Sequence[Recording]) -> CheckAnswer:
    """The document of what was checked of these recordings for a model."""
    checked, refusal = answering.checked, answering.refusal
    records = [
        {
            **recording_entry(recording),
            "duration": recording.record.duration,
            "stretches": len(recording.record.segments(checked.signals)),
        }
        for recording in recordings
    ]
    error = {} if refusal is None else {"error": refusal._asdict()}
    return read(
        CheckAnswer,
        {
            **error,
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


def print_check(answer: CheckAnswer, console: Console) -> None:
    """The answer, and tables for a reader."""
    # Whether the recordings can answer, in a sentence.
    doubts = len(answer.warnings)
    warned = f", with {doubts} warning{'s' * (doubts > 1)}" if doubts else ""
    sentence = f"These recordings can answer what the model asks{warned}."
    if not answer.answerable:
        sentence = "These recordings cannot answer what the model asks; see the warnings."
    elif (errors := answer.by_refinement) is not None:
        shares = (f"{name} to about {share_in_words(e, 2)}" for name, e in errors.items())
        sentence = (
            f"Windows cannot tell these parameters from noise, and identify refines them by "
            f"itself: {', '.join(shares)}."
        )
    say(console, sentence, style="bold")
    say(console, "")
    for record in answer.records:
        stretches = record.stretches
        parted = "" if stretches == 1 else f", in {stretches} unbroken stretches"
        say(
            console,
            f"{record.name}: {record.samples} samples at {1 / record.time_step:.6g} Hz, "
            f"{record.duration:.4g} s{parted}",
        )
    say(console, *(f"prepared: {step}" for step in answer.provenance.preparation))
    say(console, *noise_in_words(answer.noise), "")
    print_table(in_rich(excitation_table(answer.excitation)), console)
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
