"""Files as recordings, whose signals a model's kinematics brings to one time."""

import dataclasses
import itertools
import os
from collections.abc import Sequence

from riecjax.doubts.delays import SMALLEST
from riecjax.doubts.kinematics import GROSS, UNRELATED, Compared, compare, findings_of
from riecjax.equations.equation import Equation
from riecjax.equations.model import Model, as_model
from riecjax.errors import DataError
from riecjax.findings import Finding, joined
from riecjax.records.derived import names_in
from riecjax.records.faults.signals import holding
from riecjax.records.preparation.resampling import shift
from riecjax.records.record import Record
from riecjax.records.recording import Aligned, Recording, every_recording, only_recording
from riecjax.records.relations import Pairs, relations
from riecjax.settings import Prepare, Reading, taking


def align(record: Record, pairs: Pairs, how: str | Sequence[str] = "auto") -> Aligned:
    """Bring the later one of each signal and its recorded derivative forward.

    Of two signals one sees which is later, not which is wrong; but sensors, filters and loggers
    delay, and nothing comes before its time. So the earliest of signals that are derivatives of
    each other is taken to be in time, and the others are advanced to it. A signal that holds its
    value for a while is not looked at.

    **Arguments:** `pairs` of a signal and its derivative, or relations; `how`: `"auto"`;
    `"none"`; or the signals to shift, by whatever delay is found.

    **Raises:** `DataError` for a signal that belongs to no pair in the record.
    """
    names = () if isinstance(how, str) else tuple(how)
    if isinstance(how, str) and how not in ("auto", "none"):
        raise DataError(f"align is 'auto', 'none' or a tuple of signals; got '{how}'.")
    every = [one for one in relations(pairs) if {*one.names} <= {*record.arrays}]
    for name in names:
        if not any(name in one.names for one in every):
            raise DataError(
                f"'{name}' cannot be aligned: the model knows no recorded derivative of it, nor "
                f"what it is the derivative of. Shift it by a known time (--shift {name}=SECONDS)."
            )
    if how == "none":
        return Aligned(record)
    compared = [one for relation in every if (one := compare(record, relation)) is not None]
    findings = [[*findings_of(record, one)] for one in compared]
    holds = tuple(one.relation for one, told in zip(compared, findings) if not told)
    found = [one for each in zip(compared, findings) if (one := _in_step(*each)) is not None]
    # What a sensor holds for a while is no delay, and is found no more once it is shifted.
    if not names and any(one.late for one in found):
        held = holding(record, {name for one in found for name in one.late})
        found = [one for one in found if not held & {*one.relation.names}]
    late: dict[str, float] = {}
    # By which each of these signals is later than the first one it is paired with.
    for name, one in itertools.product(names, found):
        if name in one.relation.names:
            others = (-each.size for each in one.late.values())
            late.setdefault(name, one.late[name].size if name in one.late else sum(others))
    if not names:
        # By which signals are later than the earliest of those that they belong to.
        groups: list[dict[str, float]] = []
        for one in found:
            times = {n: one.late[n].size if n in one.late else 0.0 for n in one.relation.names}
            group = next((g for g in groups if {*times} & {*g}), None)
            if group is None:
                groups.append(group := {})
            # By a signal that both know.
            ahead = next((group[name] - s for name, s in times.items() if name in group), 0.0)
            for name, seconds in times.items():
                group.setdefault(name, ahead + seconds)
        after = ((name, s - min(g.values())) for g in groups for name, s in g.items())
        late = {name: s for name, s in after if s > SMALLEST * float(record.time_step)}
    words = tuple(f"{name}: no delay found" for name in names if not late.get(name))
    late = {name: seconds for name, seconds in late.items() if seconds}
    if not late:
        return Aligned(record, words, holding=holds)
    told = []
    for name, seconds in late.items():
        mine = [one for one in found if name in one.relation.names]
        one = next((one for one in mine if one.late), mine[0])
        mine, reach = {*one.late}, 1e3 * max((e.reach for e in one.late.values()), default=0.0)
        others = {*one.relation.names} - mine if name in mine else mine
        message = (
            f"{name} came {seconds / float(record.time_step):.3g} samples ({1e3 * seconds:.3g} ms, "
            f"+-{reach:.2g} ms) late against {' and '.join(sorted(others))}, and was brought "
            f"forward by that; --align none leaves it. Whether both are late against other signals "
            f"the two cannot tell."
        )
        told.append(Finding("late_signal", message, (name,)))
    words += tuple(f"{name}: advanced by {seconds:.4g} s" for name, seconds in late.items())
    return Aligned(shift(record, late), words, tuple(told))


def _in_step(one: Compared, findings: Sequence[Finding]) -> Compared | None:
    """Signals that belong to each other, of which no lost rows, clocks or filters look like a
    delay."""
    is_gross = any(abs(size.value - 1) > GROSS for size in (one.sizes or {}).values())
    if is_gross or one.explained < UNRELATED:
        return None
    late = {n: each for n, each in one.late.items() if not each.low_passed}
    if late and any(told.code == "lost_rows" and told not in one.found for told in findings):
        return None
    return one._replace(late=late)


@taking(Reading)
def read_record(path: str | os.PathLike[str], settings: Reading) -> Record:
    """Read a record from a file of any format that [`read_recording`][] reads.

    With the same keywords and errors, but only the signals.
    """
    return only_recording(path, _of_model(settings), align).record


@taking(Reading)
def read_recording(path: str | os.PathLike[str], settings: Reading) -> Recording:
    """Read a recording from a text file, Excel, NPZ, MAT, HDF5, JSON, Parquet, MDF, TDMS or a bag.

    Time is a column in seconds, called `t` or `time` or renamed to `t`; where the file states
    another unit of time (`time [ms]`) it is converted. Signals are converted to SI from the units
    that the file states, or `units` does.
    Without `rename` every column as long as the time is a signal. [`read_channels`][] lists what a
    file holds, and the readers of the formats say how columns are named in files that hold more.

    **Arguments:** `model`, or an equation, whose units the signals get, and which says which are
    derivatives of others, to be formed if the file lacks them; and the keywords of
    [`Select`][riecjax.settings.Select], [`Read`][riecjax.settings.Read] and
    [`Prepare`][riecjax.settings.Prepare].

    **Raises:** `DataError` if the file cannot be read, holds several recordings and no `part` is
    chosen, a named column is absent, the samples do not make a record (see
    [`Record.from_samples`][]), or a step is not possible; `ModelError` for a formula that is not
    understood.
    """
    return only_recording(path, _of_model(settings), align)


@taking(Reading)
def read_recordings(path: str | os.PathLike[str], settings: Reading) -> list[Recording]:
    """Read all recordings that a file holds, each as [`read_recording`][] reads one.

    Elements of a cell or an array of structures of MATLAB, groups with the same channels in HDF5
    and TDMS, sheets with the same columns: `part` of each recording says which it is, as
    `runs(2)`. Columns are called as if a part were alone in its file: `x`, not `runs(2).x`. A
    part of which no record can be made is left out, with a finding; a file that is one recording
    gives a list of one.

    **Arguments** and errors as of [`read_recording`][]; of errors of parts, the first is raised
    where none can be read.
    """
    return every_recording(path, _of_model(settings), align)


def _of_model(settings: Reading) -> Reading:
    """With the model of an equation.

    **Raises:** `DataError` for a step of preparation of a signal that only formulas read, and that
    comes after these.
    """
    is_one = isinstance(settings.model, Equation)
    model = as_model(settings.model) if is_one else settings.model
    if not isinstance(model, Model):
        return settings
    read = {signal.name for signal in model.signals}
    steps = {name: option for name, option in Prepare.options().items() if option.shape == "named"}
    for field, option in steps.items():
        for name in {*getattr(settings, field)} - read - {*settings.derive}:
            of = [new for new, formula in settings.derive.items() if name in names_in(formula)]
            if of:
                raise DataError(
                    f"{option.flag} of {name} comes after {joined(of)}, which is computed from it, "
                    f"and the model reads {joined(of)} alone: name {of[0]} instead."
                )
    return dataclasses.replace(settings, model=model)
