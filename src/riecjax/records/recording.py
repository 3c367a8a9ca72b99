"""A recording: a record with where it came from, what was done to it and what is amiss with it."""

import contextlib
import os
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from riecjax.errors import DataError, MissingSignalError, ModelError, printable, require
from riecjax.findings import Finding
from riecjax.records.faults.rows import duplicates, without_repetitions
from riecjax.records.noise_judgement import given_noise, judged_together
from riecjax.records.preparation.filtering import without_computed
from riecjax.records.preparation.steps import halves, idle_cuts, prepare, split
from riecjax.records.reading.channels import Channels, about, read_channels
from riecjax.records.reading.selection import CHOOSE, Parts, record_from_channels, recordings_in
from riecjax.records.reading.times import TIME_COLUMNS, listed
from riecjax.records.reading.units import same, split_unit
from riecjax.records.record import Record, Records, as_records
from riecjax.records.relations import Pairs, Relation, declared_pairs
from riecjax.settings import Reading
from riecjax.shows import Drawn


# Its arrays have no one truth value to compare by, and would fill the screen.
@dataclass(frozen=True, eq=False, repr=False)
class Recording(Drawn):
    """A record, where it came from, what was done to it, and what is amiss with it.

    What identifies, refines or studies takes recordings as it takes records; steps of preparation,
    simulations and `jax.jit` take its `record`.

    **Fields:**

    - `record`: the signals, read and prepared.
    - `source`: the file, as it was given; empty for a record that was made in memory.
    - `steps`: how it was read and prepared, in words, in the order in which it was done.
    - `findings`: what is amiss with the file; `signals` of each says whom it concerns.
    - `left_out`: column of the file to why it is no signal.
    - `renamed`: signal to the column that it was called.
    - `converted`: signal to the unit that it was converted from.
    - `computed`: signals that no sensor recorded, by formulas or as derivatives.
    - `part`: which part of its file this is, where that holds several recordings or was split.
    - `kinematics`: relations between its signals that hold, as was found when it was read.
    """

    record: Record
    source: str = ""
    steps: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()
    left_out: Mapping[str, str] = field(default_factory=dict)
    renamed: Mapping[str, str] = field(default_factory=dict)
    part: str = ""
    converted: Mapping[str, str] = field(default_factory=dict)
    computed: tuple[str, ...] = ()
    kinematics: tuple[Relation, ...] = ()

    @property
    def name(self) -> str:
        """What messages and tables call it: its file's name, and which part of it."""
        return _name(self.source, self.part)

    def split(self, share: float) -> tuple["Recording", "Recording"]:
        """Hold out the last `share` of its samples; see [`split`][riecjax.split].

        **Returns:** the part to estimate from, and the last part, to validate on.
        """
        first, last = split(self.record, share)
        held_out = f"{self.part}, last part" if self.part else "last part"
        return replace(self, record=first), replace(self, record=last, part=held_out)

    def concerning(self, signals: Collection[str]) -> "Recording":
        """The same with only those steps and findings that concern these signals, or all."""
        idle = {name for name in self.record.arrays if name not in signals}
        return replace(
            self,
            steps=tuple(step for step in self.steps if step.partition(":")[0] not in idle),
            findings=tuple(f for f in self.findings if not f.signals or {*f.signals} & {*signals}),
        )

    def explaining_errors(self) -> contextlib.AbstractContextManager[None]:
        """Name the file in errors about its record, and say why a signal is absent."""
        return _explaining(self.source, self.renamed, self.left_out, self.part)


@contextlib.contextmanager
def explaining_errors(
    recordings: Sequence[Recording], is_state: Callable[[str], bool] = lambda name: False
) -> Iterator[None]:
    """Say of an absent signal which recording lacks it, and why; and whether it is a state."""
    try:
        yield
    except MissingSignalError as error:
        lacking = [one for one in recordings if error.signal not in one.record.arrays]
        with lacking[0].explaining_errors() if lacking else contextlib.nullcontext():
            told = error.signal, error.available, error.derivative_of
            raise MissingSignalError(*told, is_state(error.signal)) from None


def findings_of(
    recordings: Sequence[Recording], read: Callable[[Recording], Collection[str]]
) -> list[Finding]:
    """What recordings say of signals that are `read`, and that some were given twice."""
    told = [f for one in recordings if one.findings for f in one.concerning(read(one)).findings]
    return [*told, *duplicates(recordings)]


def as_recordings(records: Records) -> list[Recording]:
    """One recording or several as a list; several bare records are called by their number.

    **Raises:** as [`as_records`][riecjax.records.record.as_records].
    """
    given: Sequence[Any] = records if isinstance(records, list | tuple) else [records]
    return [
        (one if one.record is record else replace(one, record=record))
        if isinstance(one, Recording)
        else Recording(record, f"record {i + 1}" if len(given) > 1 else "")
        for i, (one, record) in enumerate(zip(given, as_records(records), strict=True))
    ]


class Aligned(NamedTuple):
    """A record, what was shifted in words, what was found amiss and put right, and the relations
    that hold as they were recorded."""

    record: Record
    words: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()
    holding: tuple[Relation, ...] = ()


Aligning: TypeAlias = Callable[[Record, Pairs, str | Sequence[str]], Aligned]
"""What brings late signals of a record forward, by pairs of a signal and its derivative, as it is
asked to."""


def only_recording(
    path: str | os.PathLike[str], settings: Reading, aligning: Aligning
) -> Recording:
    """The recording that a file holds.

    **Raises:** `DataError` if it holds several and no part is chosen, and as
    [`every_recording`][riecjax.records.recording.every_recording].
    """
    parts = _held(path, settings.part or ", ".join(settings.parts), settings)
    if len(parts.held) > 1:
        raise DataError(
            f"{Path(path).name}: it holds {len(parts.held)} recordings: {listed(parts.held)}; read "
            f"all of them with rx.read_recordings, or {CHOOSE}."
        )
    return _recordings(path, parts, settings, aligning)[0]


def every_recording(
    path: str | os.PathLike[str], settings: Reading, aligning: Aligning
) -> list[Recording]:
    """All recordings that a file holds.

    **Raises:** `DataError` if the file cannot be read or makes no record, `ModelError` for a
    formula that is not understood.
    """
    return [
        recording
        for part in settings.parts or [settings.part or ""]
        for recording in _recordings(path, _held(path, part, settings), settings, aligning)
    ]


def _held(path: str | os.PathLike[str], part: str, settings: Reading) -> Parts:
    require("the file", path, str | os.PathLike, "rx.read_recording('drive.csv')", DataError)
    if isinstance(settings.model, str | type):
        require("the model", settings.model, (), "model=rx.find_model('quarter-car')")
    dialect = {name: getattr(settings, name) for name in ("delimiter", "decimal", "columns")}
    channels = read_channels(path, **dialect)
    with _explaining(str(path), {}, {}):
        return recordings_in(channels, settings.rename.values(), part)


def _recordings(
    path: str | os.PathLike[str], parts: Parts, settings: Reading, aligning: Aligning
) -> list[Recording]:
    """The parts that can be read; the first tells of the others."""
    read: list[Recording] = []
    errors: dict[str, DataError] = {}
    for name, channels in parts.held.items():
        try:
            read.append(_recording(path, name, channels, settings, aligning))
        except DataError as error:
            errors[name] = error
    if not read:
        raise next(iter(errors.values()))
    file = Path(path).name
    unread = {k: str(e).removeprefix(f"{file}, {k}: ") for k, e in errors.items()}
    said = [
        Finding("part_left_out", f"{file}: part '{name}' is left out: {why.rstrip('.')}.")
        for name, why in {**parts.broken, **unread}.items()
    ]
    read[0] = replace(read[0], findings=(*said, *read[0].findings))
    return read


def _recording(
    path: str | os.PathLike[str],
    part: str,
    channels: Channels,
    settings: Reading,
    aligning: Aligning,
) -> Recording:
    model = settings.model
    file = Path(path).name
    # Of what may be a signal, why it would not be; the first sample settles it for nearly all.
    left_out = channels.left_out | {
        column: "it holds no number at all"
        if np.isnan(values[:1]).all() and np.isnan(values).all()
        else "its length differs from the time's"
        for column, values in channels.columns.items()
    }
    # Damaged numbers overflow; what is not finite is found and named.
    with _explaining(str(path), settings.rename, left_out, part), np.errstate(all="ignore"):
        try:
            # What the model reads and what others are derived from, with the units of both.
            units = {signal.name: signal.unit for signal in getattr(model, "signals", ())}
            read_by = dict.fromkeys(settings.derivatives.values(), "") | units
            band = getattr(model, "band", None)
            selected = record_from_channels(
                channels, settings, read_by, 0.5 / band[1] if band else None
            )
            record, left_out = selected.record, {**left_out, **selected.left_out}
        except ModelError as error:  # of a formula
            raise ModelError(f"{file}: {error}") from None
        read = tuple(record.arrays)
        # The record in the model's units, and what the file says against them.
        stated, mismatches = dict(record.units), {}
        units = {name: unit for name, unit in units.items() if unit}
        for name, unit in units.items():
            column = settings.rename.get(name, name)
            converted = {column, name} & {*settings.scale} or name in settings.derive
            if name in stated and not converted and not same(stated[name], unit):
                mismatches[name] = (
                    f"the file gives {column} in {stated[name]}, the model reads {name} in {unit}, "
                    f"and nothing converts one to the other; correct the file's unit: "
                    f"units={{'{name}': ...}} (on the command line: --unit {name}=UNIT), or "
                    f"convert it: --scale {name}=FACTOR."
                )
        record = record.with_signals(
            {n: replace(s, unit=units[n]) for n, s in record.by_name.items() if n in units}
        )
        idle = idle_cuts(settings, record)
        before, after = halves(settings)
        record, repeated = without_repetitions(record)
        record, first_steps = prepare(record, {}, before)
        pairs, given = declared_pairs(model), given_noise(settings.noise, record.arrays).kernels
        record, found = without_computed(record, pairs, given)
        aligned = aligning(record, pairs, settings.align)
        record = judged_together(aligned.record, pairs, read_by, given)
        record, last_steps = prepare(record, getattr(model, "derived", {}), after)
    findings = [
        *(Finding("time_unit_doubtful", why, doubt=1.0) for why in filter(None, [selected.doubt])),
        *(Finding("unit_mismatch", why, (name,), doubt=1.0) for name, why in mismatches.items()),
        *selected.findings,
        *repeated,
        *aligned.findings,
        *(Finding("nothing_cut", why) for why in idle.values()),
        *(
            Finding(
                "column_left_out", f"{why}, and {n} is computed from other signals instead.", (n,)
            )
            for n in record.arrays
            if n not in read and (why := _why_absent(left_out, n))
        ),
    ]
    sizes = sorted({values.size for values in channels.columns.values()})
    rows = " to ".join(map(str, dict.fromkeys((sizes[0], sizes[-1]))))
    read_steps = [
        f"{rows} rows of {len(channels.columns)} columns of numbers read",
        *channels.notes,
        *selected.steps,
        *_gaps(selected.record),
        *(*first_steps, *found, *aligned.words, *last_steps),
    ]
    if record.sample_count != selected.record.sample_count:
        kept = f"{record.sample_count} of {selected.record.sample_count} samples"
        read_steps.append(f"{kept} left, from {record.elapsed[0]:.6g} s on")
    used = {*read, *TIME_COLUMNS, *settings.rename.values(), *channels.time_of.values()}
    return Recording(
        record,
        str(path),
        (*read_steps,),
        tuple(f._replace(message=f"{file}: {f.message}") for f in findings),
        {c: why for c, why in left_out.items() if not used & {c, split_unit(c)[0]}},
        settings.rename,
        part,
        selected.converted,
        tuple(n for n in record.arrays if n not in read or n in settings.derive),
        () if aligned.words or last_steps else aligned.holding,
    )


def _gaps(record: Record) -> Iterator[str]:
    """How many samples signals lack, in words; those that lack as many together."""
    lacking: dict[int, list[str]] = {}
    for name, signal in record.by_name.items():
        if signal.present is not None:
            lacking.setdefault(int(np.sum(~np.asarray(signal.present))), []).append(name)
    for count, names in lacking.items():
        yield f"{listed(names)}: {count} sample{'s' * (count > 1)} missing"


def _why_absent(left_out: Mapping[str, str], signal: str) -> str:
    """Why the column of this name, perhaps with its unit behind it, is no signal; empty if none."""
    called = (column for column in left_out if signal in (column, split_unit(column)[0]))
    return next((f"column '{c}' was left out: {left_out[c]}" for c in called), "")


@contextlib.contextmanager
def _explaining(
    source: str, renamed: Mapping[str, str], left_out: Mapping[str, str], part: str = ""
) -> Iterator[None]:
    """Name the file in errors about its record, and say why a signal is absent."""
    try:
        yield
    except DataError as error:
        if not source:
            raise
        said = ""
        if isinstance(error, MissingSignalError):
            name, there = error.signal, ", ".join(error.available) or "none"
            if taken := [new for new, column in renamed.items() if column == name]:
                said = (
                    f"there is no signal '{name}': its column was renamed to '{taken[0]}' "
                    f"(--map {taken[0]}={name}); there are: {there}."
                )
            elif why := _why_absent(left_out, name):
                said = f"{why}, so that the record has no signal '{name}'; it has: {there}."
        raise about(_name(source, part), error, said) from None


def _name(source: str, part: str) -> str:
    """What messages and tables call a recording: its file's name, and which part of it."""
    return printable(", ".join(filter(None, (Path(source).name or "the record", part))))


def common_steps(recordings: Sequence[Recording]) -> list[str]:
    """Steps that all recordings have in common once, and those of one with its name."""
    first, *others = recordings
    common = [step for step in first.steps if all(step in other.steps for other in others)]
    own = [f"{r.name}: {step}" for r in recordings for step in r.steps if step not in common]
    return common + own
