"""Results of a check before a fit: JSON document and tables on a terminal."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from rich.console import Console

from riecjax.assessment.assess import Answering
from riecjax.errors import printable
from riecjax.estimation.check import Check
from riecjax.records.noise_judgement import judged
from riecjax.records.recording import Recording, common_steps
from riecjax.reporting.document import SCHEMA, Document, finite, number, told, versions
from riecjax.reporting.tables import Table, in_rich, print_table, say


def check_document(answering: Answering, model: str, recordings: Sequence[Recording]) -> Document:
    """The document that `riecjax check --json` prints, with an `error` if that exits with 1."""
    checked, refusal = answering.checked, answering.refusal
    return {
        "schema": SCHEMA,
        **({} if refusal is None else {"error": told(refusal, "code", "message")}),
        "model": model,
        "criterion": answering.criterion.describe(),
        "answerable": refusal is None,
        "by_refinement": answering.by_refinement,
        "records": [
            {
                **recording_entry(recording),
                "duration": float(recording.record.duration),
                "stretches": len(recording.record.segments(checked.signals)),
            }
            for recording in recordings
        ],
        "signals": list(checked.signals),
        "excitation": excitation_entries(checked),
        "noise": noise_entries(recordings, checked.signals),
        "warnings": [finding._asdict() for finding in checked.findings],
        "provenance": {
            "start_times": start_times(recordings),
            "preparation": common_steps([r.concerning(checked.signals) for r in recordings]),
            "versions": versions(),
        },
    }


def recording_entry(recording: Recording) -> Document:
    """Where a recording is from, and how it is sampled."""
    return {
        "file": printable(recording.source),
        "part": recording.part or None,
        "samples": recording.record.sample_count,
        "time_step": float(recording.record.time_step),
    }


def named(record: Document) -> str:
    """A recording by its file, and by its part of one that holds several."""
    return ", ".join(filter(None, (record["file"], record.get("part"))))


def start_times(recordings: Sequence[Recording]) -> list[float]:
    """The time stamp of each recording's first sample, from which all other times count."""
    return [float(r.record.start_time - r.record.skipped) for r in recordings]


def excitation_entries(checked: Check) -> dict[str, Any]:
    """For each parameter, how much of its regressor is its own, and how much is noise."""
    return {
        name: {
            "equation": stage.stage_name,
            "own_share": finite(own),
            "noise_share": finite(noise),
        }
        for stage in checked.excitations
        for name, own, noise in zip(stage.parameters, stage.own_share, stage.noise_share)
    }


def excitation_table(entries: Document, caption: str = "") -> Table:
    """How each parameter is excited."""
    cells = {
        "equation": lambda entry: entry["equation"],
        "own share": lambda entry: share_in_words(entry["own_share"]),
        "noise": lambda entry: share_in_words(entry["noise_share"], 2),
    }
    return Table.of("parameter", entries.items(), cells, caption)


def print_check(document: Document, console: Console) -> None:
    """The answer, and tables for a reader."""
    # Whether the recordings can answer, in a sentence.
    doubts = len(document["warnings"])
    warned = f", with {doubts} warning{'s' * (doubts > 1)}" if doubts else ""
    answer = f"These recordings can answer what the model asks{warned}."
    if not document["answerable"]:
        answer = "These recordings cannot answer what the model asks; see the warnings."
    elif (errors := document["by_refinement"]) is not None:
        shares = (f"{name} to about {number(100 * e, 2)} %" for name, e in errors.items())
        answer = (
            f"Windows cannot tell these parameters from noise, and identify refines them by "
            f"itself: {', '.join(shares)}."
        )
    say(console, answer, style="bold")
    say(console, "")
    for record in document["records"]:
        stretches = record["stretches"]
        parted = "" if stretches == 1 else f", in {stretches} unbroken stretches"
        say(
            console,
            f"{named(record)}: {record['samples']} samples at {1 / record['time_step']:.6g} Hz, "
            f"{record['duration']:.4g} s{parted}",
        )
    say(console, *(f"prepared: {step}" for step in document["provenance"]["preparation"]))
    say(console, *noise_in_words(document["noise"]), "")
    print_table(in_rich(excitation_table(document["excitation"])), console)
    say(
        console,
        "own share: what no combination of the others could do as well (100 % is best)",
        "noise: share of the sensors' noise in what multiplies the parameter",
        style="dim",
    )


def share_in_words(share: float | None, digits: int = 3) -> str:
    """A share in percent; `?` where none is known, as of the noise in a function of signals."""
    return "?" if share is None else f"{number(100 * share, digits)} %"


LEAST_SHOWN = 1e-4
"""Share of a signal's standard deviation below which noise is not worth a line."""


def noise_entries(recordings: Sequence[Recording], signals: Iterable[str]) -> dict[str, Any]:
    """Of each signal, its noise's standard deviation (r.m.s. over recordings), and which share of
    its own that is."""
    entries = {}
    for name in signals:
        if records := [r.record.select(name) for r in recordings if name in r.record.by_name]:
            noise = np.sqrt(np.mean([np.mean(judged(r).noise.std(name) ** 2) for r in records]))
            size = np.sqrt(np.mean([np.var(np.asarray(r[name])) for r in records]))
            share = finite(noise / size) if size > 0 else None
            unit = records[0].signal(name).unit
            entries[name] = {"std": finite(noise), "unit": unit, "share": share}
    return entries


def noise_in_words(entries: Document) -> Iterator[str]:
    """One line on all signals that have some, if any is known."""
    shares = {name: entry["share"] or 0.0 for name, entry in entries.items()}
    shown = [f"{n} {number(100 * s, 2)} %" for n, s in shares.items() if s >= LEAST_SHOWN]
    noun = "their standard deviations" if len(shown) > 1 else "its standard deviation"
    if shown:
        yield f"noise: {', '.join(shown)} of {noun}"
    elif entries:
        yield f"noise: below {100 * LEAST_SHOWN:g} % of each signal's standard deviation"
