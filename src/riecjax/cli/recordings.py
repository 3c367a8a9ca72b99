"""Options that say how a recording is read and prepared, and the reading itself."""

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import click

from riecjax.cli.options import FINITE, POSITIVE, assignments, collecting
from riecjax.errors import DataError, MissingSignalError
from riecjax.findings import Finding

if TYPE_CHECKING:
    from riecjax.criteria.criterion import AbstractCriterion
    from riecjax.models.model import Model
    from riecjax.records.preparation.steps import Preparation
    from riecjax.records.reading.channels import Channels
    from riecjax.records.reading.selection import Selection
    from riecjax.records.record import Record

RECORD_OPTIONS = (
    click.argument(
        "files", metavar="RECORD...", nargs=-1, required=True, type=click.Path(path_type=Path)
    ),
    assignments("--map", str, "SIGNAL=COLUMN", "Call a column by the model's name.", "rename"),
    assignments("--scale", float, "COLUMN=FACTOR", "Convert a column to SI units.", "scale"),
    assignments(
        "--derive",
        str,
        "SIGNAL=FORMULA",
        "Compute a signal from others, as in 'force=35.15*volt'.",
        "derive",
    ),
    click.option(
        "--time-step", type=POSITIVE, help="Seconds between samples, for files without time."
    ),
    click.option(
        "--resample",
        type=POSITIVE,
        metavar="HZ",
        help="Bring unevenly or differently sampled signals to one even rate, anti-aliased.",
    ),
    click.option("--delimiter", help="Between columns of a text file. [default: detected]"),
    click.option(
        "--decimal",
        type=click.Choice([".", ","]),
        help="Decimal sign of a text file. [default: detected]",
    ),
    click.option(
        "--from",
        "start",
        type=FINITE,
        metavar="S",
        help="Use the record from this time on, in seconds from its first sample.",
    ),
    click.option(
        "--to",
        "stop",
        type=FINITE,
        metavar="S",
        help="Use the record up to this time, in seconds from its first sample.",
    ),
    click.option(
        "--remove-offset",
        "offsets",
        multiple=True,
        metavar="SIGNAL",
        help="Subtract a signal's mean. Repeatable.",
    ),
    click.option(
        "--remove-drift",
        "drifts",
        multiple=True,
        metavar="SIGNAL",
        help="Subtract a signal's straight line. Repeatable.",
    ),
    assignments(
        "--low-pass",
        float,
        "SIGNAL=HZ",
        "Filter a signal first: zero-phase 4th-order Butterworth.",
        "cutoffs",
    ),
    click.option(
        "--upsample",
        type=click.IntRange(min=1, max=1000),
        default=1,
        metavar="N",
        help="Interpolate N times as many samples, band-limited: for few samples per period.",
    ),
    assignments(
        "--differentiate", str, "NEW=SIGNAL", "Add a signal's central differences.", "derivatives"
    ),
    click.option(
        "--every",
        type=click.IntRange(min=1),
        default=1,
        metavar="N",
        help="Use every N-th sample, after all other steps.",
    ),
)


@dataclass(frozen=True)
class RecordingOptions:
    """What the user said of the recordings."""

    files: tuple[Path, ...]
    rename: dict[str, str]
    scale: dict[str, float]
    derive: dict[str, str]
    time_step: float | None
    resample: float | None
    delimiter: str | None
    decimal: str | None
    start: float | None
    stop: float | None
    offsets: tuple[str, ...]
    drifts: tuple[str, ...]
    cutoffs: dict[str, float]
    upsample: int
    derivatives: dict[str, str]
    every: int

    def selection(self) -> "Selection":
        from riecjax.records.reading.selection import Selection

        return Selection(
            rename=self.rename,
            scale=self.scale,
            derive=self.derive,
            time_step=self.time_step,
            resample=self.resample,
        )

    def preparation(self) -> "Preparation":
        from riecjax.records.preparation.steps import Preparation

        return Preparation(
            start=self.start,
            stop=self.stop,
            offsets=self.offsets,
            drifts=self.drifts,
            cutoffs=self.cutoffs,
            upsample=self.upsample,
            derivatives=self.derivatives,
            every=self.every,
        )


record_options = collecting(RECORD_OPTIONS, RecordingOptions, "recordings")
"""The RECORD... argument and its options; they arrive as one `recordings`."""


class Recording(NamedTuple):
    """A prepared record, its file, how it came about in words, and what seems amiss with it."""

    file: Path
    record: "Record"
    steps: list[str]
    findings: list[Finding]


SMALL_FILES = 2**24
"""Bytes of all recordings below which compiling code takes longer than running it."""


def are_small(files: Sequence[Path]) -> bool:
    """Whether these recordings are so short that what works on them runs in no time."""
    return sum(file.stat().st_size for file in files if file.exists()) < SMALL_FILES


def load(
    files: Sequence[Path], options: RecordingOptions, model: "Model", criterion: "AbstractCriterion"
) -> list[Recording]:
    """Read and prepare the files for a model; only signals that it reads are kept.

    **Raises:** `DataError` naming the file.
    """
    import numpy as np

    from riecjax.records.preparation.steps import prepare
    from riecjax.records.reading.read import read_channels
    from riecjax.records.reading.selection import record_from_channels
    from riecjax.summaries.task import signals_read

    procedure = model.build_procedure()
    loaded = []
    for file in files:
        # Damaged numbers overflow; what is not finite is found and named.
        with about(file, options.rename), np.errstate(all="ignore"):
            channels = read_channels(file, delimiter=options.delimiter, decimal=options.decimal)
            with _saying_why(channels, options.rename):
                record = record_from_channels(channels, options.selection())
                notes = [*channels.notes, *_reading_steps(options)]
                given = tuple(record.arrays)
                record, mismatched = with_model_units(record, model, options)
                idle = options.preparation().idle_cuts(record)
                record, steps = prepare(record, model.derived, options.preparation())
                read = signals_read(procedure, record, criterion)
            unread = [name for name in record.arrays if name not in read]
            steps = [step for step in steps if step.partition(":")[0] not in unread]
            doubts = [
                Finding("unit_mismatch", f"{file.name}: {message}")
                for name, message in mismatched.items()
                if name in read
            ]
            doubts += [Finding("nothing_cut", f"{file.name}: {why}") for why in idle.values()]
            doubts += [
                Finding(
                    "column_left_out",
                    f"{file.name}: {why}, and {name} is computed from other signals instead.",
                )
                for name in read
                if name not in given and (why := _why_missing(channels, name))
            ]
            loaded.append(Recording(file, record, [*notes, *steps], doubts))
    return loaded


@contextlib.contextmanager
def _saying_why(channels: "Channels", rename: Mapping[str, str]) -> Iterator[None]:
    """Add to what is said about a missing signal why the column of that name is none."""
    try:
        yield
    except MissingSignalError as error:
        why = "" if error.signal in rename.values() else _why_missing(channels, error.signal)
        if not why:
            raise
        listed = ", ".join(error.available) or "none"
        raise DataError(
            f"{why}, so that the record has no signal '{error.signal}'; it has: {listed}."
        ) from None


def _why_missing(channels: "Channels", signal: str) -> str:
    """Why the column of this name, perhaps with its unit behind it, is no signal; empty if none."""
    import numpy as np

    from riecjax.records.reading.units import split_unit

    for column, why in channels.left_out.items():
        if signal in (column, split_unit(column)[0]):
            return f"column '{column}' was left out: {why}"
    for column, values in channels.columns.items():
        if signal in (column, split_unit(column)[0]):
            if np.isnan(values).all():
                return f"column '{column}' was left out: it holds no number at all"
            return f"column '{column}' was left out: it has not the length of the time"
    return ""


def with_model_units(
    record: "Record", model: "Model", options: RecordingOptions
) -> tuple["Record", dict[str, str]]:
    """The record in the model's units, and what the file says against them, by signal."""
    from riecjax.records.reading.units import NOT_SI

    stated = dict(record.units)
    units = {quantity.name: quantity.unit for quantity in model.signals if quantity.unit}
    mismatched = {}
    for name, unit in units.items():
        column = options.rename.get(name, name)
        scaled = column in options.scale or name in options.scale or name in options.derive
        if name in stated and not scaled and _plain(stated[name]) != _plain(unit):
            mismatched[name] = (
                f"the file gives {column} in {stated[name]}, the model reads {name} in {unit}; "
                f"convert it by --scale {name}=FACTOR."
            )
    for name, unit in stated.items():
        column = options.rename.get(name, name)
        si, factor = NOT_SI.get(unit.replace("^", ""), ("", 1.0))
        if si and name not in mismatched and name not in units:
            mismatched[name] = (
                f"the file gives {column} in {unit}, and nothing converts it: parameters come out "
                f"in {unit}, not in {si}. Convert it by --scale {name}={factor:g}."
            )
    return record.with_signals({}, units), mismatched


def _plain(unit: str) -> str:
    """A unit without what is only spelling: m/s2, m/s^2 and m/s² are one."""
    plain = unit.replace("²", "2").replace("³", "3").replace("·", " ")
    return "".join(plain.replace("^", "").replace("*", " ").split()).replace("sec", "s")


def common_steps(loaded: list[Recording]) -> list[str]:
    """The steps common to all recordings once, and those of one with its name."""
    if len(loaded) == 1:
        return loaded[0].steps
    common = [step for step in loaded[0].steps if all(step in other.steps for other in loaded)]
    own = [f"{r.file.name}: {step}" for r in loaded for step in r.steps if step not in common]
    return common + own


def _reading_steps(options: RecordingOptions) -> list[str]:
    steps = [f"{name}: column scaled by {factor:g}" for name, factor in options.scale.items()]
    if options.resample is not None:
        steps.append(f"resampled to {options.resample:g} Hz")
    return steps + [f"{name}: {formula}" for name, formula in options.derive.items()]


@contextlib.contextmanager
def about(file: Path, rename: Mapping[str, str]) -> Iterator[None]:
    """Name the file in what is said about its record."""
    try:
        yield
    except MissingSignalError as error:
        taken = [new for new, column in rename.items() if column == error.signal]
        if taken:
            raise DataError(
                f"{file.name}: there is no signal '{error.signal}', for --map {taken[0]}="
                f"{error.signal} renamed that column; there are: {', '.join(error.available)}."
            ) from None
        raise DataError(f"{file.name}: {error}") from None
    except DataError as error:
        message = str(error)
        prefix = "" if message.startswith(f"{file.name}: ") else f"{file.name}: "
        raise DataError(prefix + message) from None
