"""From the channels of a file to records: which recordings it holds, which channels are signals of
each, which is time, in which units.
"""

import re
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from riecjax.errors import DataError
from riecjax.findings import Finding
from riecjax.records.derived import derived, sensitivities
from riecjax.records.faults.spikes import REGISTERS, treat_all, unwrapped
from riecjax.records.noise_judgement import given_noise, judged
from riecjax.records.preparation.resampling import on_grid, on_grid_noise
from riecjax.records.reading import times as clocks
from riecjax.records.reading.channels import NUMBERED, Channels
from riecjax.records.reading.times import TIME_COLUMNS, TimeColumn, find_time, listed, seconds_in
from riecjax.records.reading.units import (
    conversion,
    require_known_unit,
    require_sure_unit,
    split_unit,
    unit_behind,
)
from riecjax.records.record import Record
from riecjax.records.time_base import SHORTEST_PAUSE, StampError, time_base
from riecjax.settings import Read, Select


@dataclass
class _Signal:
    """Values of a column, which change as it is converted; its unit, and the one before.

    **Fields:** `time` of each value in s, once it is known.
    """

    values: np.ndarray
    column: str
    unit: str = ""
    converted: str = ""
    time: np.ndarray = field(default_factory=lambda: np.zeros(0))


def record_from_channels(
    channels: Channels,
    selection: Select,
    read: Mapping[str, str] | None = None,
    shortest: float | None = None,
) -> "Selected":
    """Make a record of a file's channels.

    Signals of known units are converted to SI: to the unit in which they are read, else to the
    base form.

    **Arguments:** `read`: signal to the unit in which a model reads it, empty where it says none;
    `None` without a model; `shortest` window in seconds that the model asks for, if it does.
    Where channels have different times, signals that neither are read nor stand in `selection` do
    not decide where the record begins and at which times it is. Of these, one whose unit may be two
    is left out, with the question which it is.

    **Raises:** `DataError` for an absent or ambiguous column, no time or several, and samples that
    do not make a record (see [`Record.from_samples`][]); `ModelError` for a formula.
    """
    if not channels.columns:
        raise DataError(f"no columns of numbers were found{_first_reason(channels)}.")
    selected = Selected(channels, selection, read)
    selected.convert_as_said()
    time = selected.time("t" if "t" in selection.rename else None, shortest)
    column = selected.held[time.name].column if time else ""
    selected.take_time(time)
    selected.convert()
    if selection.time_step is None and selection.resample is None:
        selected.share_time()
        selected.doubt = time.doubt if time else ""
    try:
        selected.treat()
        selected.make_record()
    except StampError as error:
        if not time:
            raise
        raise DataError(f"column '{column}': {error}") from None
    return selected


class Selected:
    """Signals on their way to a record, and what was decided. Each method is a step.

    **Fields:** `record`, at last; `steps`, what was done, in words; `doubt` in words that time is
    what it is taken for, empty if none; `findings`, on signals that were repaired; `left_out`:
    column to why it is no signal; `held`: name to signal; `units`: signal to the unit in which it
    is read; `formulas` in SI; `asked`: signals that are asked for, by the model or by what the user
    says, and `matter`: these, or all where none is.
    """

    record: Record
    doubt: str = ""

    def __init__(
        self, channels: Channels, selection: Select, read: Mapping[str, str] | None
    ) -> None:
        self.channels, self.selection, self.units = channels, selection, read or {}
        self.steps: list[str] = []
        self.findings: list[Finding] = []
        self.left_out: dict[str, str] = {}
        self.held: dict[str, _Signal] = {}
        self.derived_units: dict[str, str] = {}
        self.formulas = dict(selection.derive)
        rename = {signal: column_named(channels, name) for signal, name in selection.rename.items()}
        count = Counter(channels.short.values())
        # A column is called without its unit in brackets, unless another column is called that.
        names = {
            short if count[short] == 1 else column: column
            for column, short in channels.short.items()
            if column not in rename.values()
        }
        # A new name takes the place of a column that is called so.
        for name, column in (names | rename).items():
            values, said = channels.columns[column], ""
            if not clocks.is_word_of_time(column):
                values, said = unwrapped(values, REGISTERS)
            self.steps += [f"{name}: {said}"] * bool(said)
            unit = channels.named(column)[1]
            if name in rename and not unit:
                unit = clocks.unit_of_time(column) if name == "t" else unit_behind(column)
            if name in rename or not np.isnan(values).all():
                self.held[name] = _Signal(values, column, unit or "")
        words = re.findall(r"\w+", " ".join(selection.derive.values()))
        self.asked = {*self.units, *rename, *selection.scale, *selection.units, *words}
        self.has_model = read is not None

    @property
    def converted(self) -> dict[str, str]:
        """Signals to the units that they were converted from."""
        return {name: signal.converted for name, signal in self.held.items() if signal.converted}

    def time(self, given: str | None = None, shortest: float | None = None) -> TimeColumn | None:
        """The time of all signals, or the `given` one as time."""
        values = {name: signal.values for name, signal in self.held.items()}
        units = {name: signal.unit for name, signal in self.held.items() if signal.unit}
        nameless = not self.channels.time_of
        return find_time(values, units, given, nameless=nameless, shortest=shortest)

    def convert_as_said(self) -> None:
        """Give signals the units that the user says, which go before what the file states, and
        scale others, which no longer have the unit that it states.

        **Raises:** `DataError` for an impossible unit or scale, and for two of one signal.
        """
        said: dict[str, tuple[str, str | float]] = {}
        for name, by in (*self.selection.units.items(), *self.selection.scale.items()):
            wanted = self.units.get(name, "")
            if isinstance(by, str) and name in self.formulas:
                self.derived_units[name] = by
                if found := conversion(name, by, wanted):
                    self.formulas[name] = f"{found.factor!r}*({self.formulas[name]})"
                    self.derived_units[name] = found.unit
                continue
            if isinstance(by, str):
                require_known_unit(name, by)
            elif not (np.isfinite(by) and by != 0):
                raise DataError(f"the scale of '{name}' must be a number other than 0; got {by:g}.")
            for target in self._called(name):
                first, before = said.get(target, (name, None))
                if before is not None:
                    pair, twice = (name, first), "is given both a scale and a unit"
                    if type(by) is type(before):
                        of_kind = "units" if isinstance(by, str) else "scales"
                        pair, twice = (first, name), f"are one column, given two {of_kind}"
                    both = " and ".join(f"'{word}'" for word in dict.fromkeys(pair))
                    raise DataError(f"{both} {twice}; leave out one of them.")
                said[target], signal = (name, by), self.held[target]
                if isinstance(by, str):
                    signal.unit = by
                else:
                    if clocks.is_called_time(target, {}) and by < 0:
                        raise DataError(f"time must increase; '{name}' is scaled by {by:g}.")
                    # Scaled to seconds, whatever its name says.
                    is_time = clocks.is_called_time(target, {}) and clocks.unit_of_time(target)
                    signal.values, signal.unit = signal.values * by, "s" if is_time else ""
            if not isinstance(by, str):
                self.steps.append(f"{name}: column scaled by {by:g}")
        for name in self.selection.rename.keys() - said.keys():
            if not (signal := self.held[name]).unit:
                require_sure_unit(name, signal.column, self.units.get(name, ""))

    def _called(self, name: str) -> list[str]:
        """Signals that are meant by a name of their own, or of their column."""
        if name not in self.channels.columns:
            if name in self.held:
                return [name]
            # What messages and --map call time, whatever its column is called.
            if name == "t" and (time := self.time()):
                return [time.name]
        column = column_named(self.channels, name)
        return [target for target, signal in self.held.items() if signal.column == column]

    def take_time(self, time: TimeColumn | None) -> None:
        """Keep the signals that have a time, each with its own; or those of an even step, of the
        length that most have, whatever a column of time says.

        **Raises:** `DataError` if there is no time, or a signal that is asked for has none.
        """
        step, rename = self.selection.time_step, self.selection.rename
        known = np.zeros(0) if time is None else time.seconds[~np.isnan(time.seconds)]
        is_newest_first = known.size > 1 and bool((np.diff(known) < 0).all())
        if time is not None and is_newest_first:
            time = time._replace(seconds=time.seconds[::-1])
            for signal in self.held.values():
                signal.values = signal.values[::-1]
        held = {name: s for name, s in self.held.items() if time is None or name != time.name}
        if step is not None:
            if time is not None:
                long = np.diff(known)[np.diff(known) > SHORTEST_PAUSE * step]
                said = f"column '{time.name}' is not used: the time step is given"
                more = f", though {long.size} of its steps are longer" if long.size else ""
                self.steps.append(said + more)
            lengths = [held[name].values.size for name in (held.keys() & rename) or held]
            size = max(lengths, key=lambda size: (lengths.count(size), size), default=0)
            axes = dict.fromkeys(held, step * np.arange(size))
        elif time is not None:
            self.steps += time.notes
            axes, size = dict.fromkeys(held, time.seconds), time.seconds.size
        else:
            axes = self._own_times()
            size = max(held[name].values.size for name in axes)
        self.steps += ["rows turned round: the newest stood first"] * is_newest_first
        self.held = {
            name: replace(held[name], time=axis)
            for name, axis in axes.items()
            if held[name].values.size == axis.size
        }
        for name, column in rename.items():
            if name not in self.held and name != "t":
                column = column_named(self.channels, column)
                common = f"{'the time' if step is None else 'the others'}, {size} samples"
                raise DataError(f"column '{column}' has another length than {common}.")

    def _own_times(self) -> dict[str, np.ndarray]:
        """The times of signals whose columns have some of their own.

        **Raises:** `DataError` if none has.
        """
        channels = self.channels
        named = [name for name in dict.fromkeys(channels.time_of.values()) if name in self.held]
        axes = {name: axis.seconds for name in named if (axis := self.time(name))}
        timed = {
            name: axes[channels.time_of[signal.column]]
            for name, signal in self.held.items()
            if signal.column not in axes and channels.time_of.get(signal.column) in axes
        }
        if timed:
            return timed
        other = (
            f"; column '{name}' is in '{unit}', which is no unit of time"
            for name in channels.columns
            if clocks.is_word_of_time(name)
            and (unit := channels.named(name)[1])
            and not seconds_in(unit)
        )
        numbered = NUMBERED.format(1) in channels.columns
        raise DataError(
            f"there is no time column (called 't', 'time' or the like); there are: "
            f"{listed(channels.columns)}. Say which one is time by renaming it to t (on the command"
            f" line: --map t=COLUMN){', name all columns (--columns t,x,...)' * numbered}, or give "
            f"the seconds between samples (--time-step)"
            f"{_first_reason(channels) or next(other, '')}."
        )

    def convert(self) -> None:
        """Convert to SI, and leave out what nobody asks for and cannot be a signal.

        **Raises:** `DataError` for a unit that may be two, and where no signal is left.
        """
        asked = self.held.keys() & self.asked
        for name, signal in [*self.held.items()]:
            try:
                found = conversion(name, signal.unit, self.units.get(name, ""))
            except DataError as error:
                if name in asked or not (self.has_model or asked):
                    raise
                self.left_out[self.held.pop(name).column] = str(error).rstrip(".")
                continue
            if found is not None:
                signal.values = signal.values * found.factor
                signal.unit, signal.converted = found.unit, signal.unit
                self.steps.append(f"{name}: {signal.converted} to {signal.unit}")
        if {*self.selection.rename, *self.formulas} - {"t"}:
            # By-products of the columns that are asked for by name.
            for name in self.held.keys() - asked:
                if np.isinf(self.held[name].values).any():
                    self.left_out[self.held.pop(name).column] = "it holds infinite values"
        if not self.held:
            left_out = self.channels.left_out | self.left_out
            why = _first_reason(replace(self.channels, left_out=left_out))
            raise DataError(f"a record needs at least one signal besides its time{why}.")
        self.matter = asked or {*self.held}

    def share_time(self) -> None:
        """Keep signals of one time, without the rows that are empty in all of them.

        Signals that do not matter and have another time than those that do are left out.

        **Raises:** `DataError` where those that matter have different times.
        """
        first = next(name for name in self.held if name in self.matter)
        time, held = self.held[first].time, {}
        for name, signal in self.held.items():
            if signal.time is time or np.array_equal(signal.time, time):
                held[name] = signal
            elif name in self.matter:
                raise DataError(
                    f"'{first}' and '{name}' have different times; bring them to a common rate (on "
                    "the command line: --resample HZ), or name the time of the signals you need by "
                    "renaming it to t."
                )
        filled = ~np.all([np.isnan(v) for v in (time, *(s.values for s in held.values()))], axis=0)
        time = time[filled]
        self.held = {n: replace(s, values=s.values[filled], time=time) for n, s in held.items()}

    def treat(self) -> None:
        """See to spikes."""
        # What a program hands over as arrays is left as it is.
        how = self.selection.outliers if isinstance(self.selection, Read) else "keep"
        matter = {name: s.values for name, s in self.held.items() if name in self.matter}
        times = {name: signal.time for name, signal in self.held.items()}
        units = {name: signal.unit for name, signal in self.held.items()}
        step = self.selection.time_step
        treated, words, self.findings = treat_all(matter, times, units, step, how, self.formulas)
        for name, values in treated.items():
            self.held[name].values = values
        self.steps += words

    def make_record(self) -> None:
        """Make the record, resampled where that is asked for, with formulas and its noise."""
        values = {name: signal.values for name, signal in self.held.items()}
        step, rate = self.selection.time_step, self.selection.resample
        axis = None if step else next(iter(self.held.values())).time
        measured = {}
        if rate is not None:
            for name, signal in self.held.items():
                known, there = ~np.isnan(signal.time), ~np.isnan(signal.values)
                # A slower channel has blanks in the rows of others, which are no gaps.
                if np.sum(there) > 1 and np.median(np.diff(np.flatnonzero(there))) > 1:
                    self.steps.append(f"{name}: sampled in {np.sum(there)} of {there.size} rows")
                    known &= there
                measured[name] = signal.time[known], signal.values[known]
            axis, values, said = on_grid(measured, rate, self.matter)
            self.steps += [*said, f"resampled to {rate:g} Hz"]
        elif axis is not None:
            self.steps += time_base(axis).words
        clock, raw = {} if axis is None else {"t": axis}, values.copy()
        # Groups of HDF5 are parted by strokes, which divide in a formula.
        scalars = {n.replace("/", "."): np.array(v) for n, v in self.channels.scalars.items()}
        for name, formula in self.formulas.items():
            values[name] = derived(formula, scalars | clock | values)
            self.steps.append(f"{name}: {self.selection.derive[name]}")
        units = {name: signal.unit for name, signal in self.held.items()} | self.derived_units
        step = step if axis is None else None
        record = Record.from_samples(values, time=axis, time_step=step, units=units)
        given = given_noise(self.selection.noise, record.arrays)
        record = record.with_noise(given)
        if rate is not None and axis is not None:
            record = record.with_noise(on_grid_noise(measured, axis, rate, given))
        # What its samples tell of its noise, and of the signals of formulas by their columns, where
        # nothing else says it.
        formulas = {k: f for k, f in self.formulas.items() if k not in record.noise.kernels}
        columns = scalars | values | raw | clock
        replaced = {
            name: replace(record.signal(name), values=raw[name], present=~np.isnan(raw[name]))
            for name in formulas.keys() & raw.keys()
        }
        names = [name for name in record.arrays if name not in formulas or name in replaced]
        noise = judged(record.with_signals(replaced).select(*names)).noise
        for name, formula in formulas.items():
            levels = {n: float(noise.std(n)) for n in columns if n in noise.kernels}
            noise = noise.combined(name, sensitivities(formula, columns, levels))
        self.record = record.with_noise(noise)


def column_named(channels: Channels, name: str) -> str:
    """The column called `name`, or the only one called so but for its unit in brackets.

    Of a column in a group, as `run/force` or `run.force`, the last name will do if it is the only
    one. Columns without names are called by their number from 1.

    **Raises:** `DataError` if there is none, or there are several.
    """
    found = _called(channels.short, name)
    if len(found) == 1:
        return found[0]
    if found:
        raise DataError(f"'{name}' may be any of: {listed(found)}; give the full name.")
    if name in channels.left_out:
        raise DataError(f"column '{name}' cannot be a signal: {channels.left_out[name]}.")
    raise DataError(f"there is no column '{name}'; there are: {listed(channels.columns)}.")


def _called(short: Mapping[str, str], name: str) -> list[str]:
    """Columns that a name may mean, by their names without units."""
    inner = (f"/{name}", f".{name}")
    return (
        [column for column in short if column == name]
        or [column for column in short if short[column] == name]
        or [column for column in short if name.isdigit() and column == NUMBERED.format(name)]
        or [column for column in short if column.endswith(inner) or short[column].endswith(inner)]
    )


def _first_reason(channels: Channels) -> str:
    """Why a column was left out, for a message; a column named as time comes first."""
    named = sorted(channels.left_out, key=lambda name: channels.named(name)[0] not in TIME_COLUMNS)
    return f"; column '{named[0]}' was left out: {channels.left_out[named[0]]}" if named else ""


# Names alone do not tell a recording from a sensor: `Y(1).Data`, `Y(2).Data` are two channels of
# one recording, and `X1.time`, `X1.signals.values` is one of Simulink's. So a part counts as a
# recording where it holds signals with names of their own, and is timed by itself.

_INDEXED = re.compile(
    r"(?P<head>[^(){}\[\]]*[^(){}\[\]\s])(?P<index>[({]\d+[)}])(?P<rest>.*)", re.S
)
_NUMBERED = re.compile(r"(?P<stem>.*?)[ _-]?(?P<number>\d+)", re.S)
_SEPARATOR = re.compile(r"[./]")
GENERIC = frozenset(("data", "value", "values", "signal", "signals", "samples"))
"""What a channel's samples are called in a structure of one channel."""
CHOOSE = "choose one by part='NAME' (on the command line: --part NAME)"
DEEPEST_GROUP = 3
"""Groups within groups in which recordings are looked for."""


class Parts(NamedTuple):
    """Recordings in a file, by name; `""` where the whole file is one. Of `broken` ones, why."""

    held: dict[str, Channels]
    broken: Mapping[str, str] = {}


Members = dict[str, dict[str, str]]
"""Columns of parts that are alike, by a part's name: their names inside it, to those in the file.
"""


def _usual(members: Members) -> frozenset[str]:
    """The columns that most parts have; of equally many, the most columns."""
    kinds = [frozenset(member) for member in members.values()]
    return max(kinds, key=lambda kind: (kinds.count(kind), len(kind)), default=frozenset())


def _families(channels: Channels) -> dict[tuple[str, ...], Members]:
    """Parts that are alike, by their kind and what tells one family from another.

    Sheets with the same columns. Elements of arrays of structures, and of cells with structures in
    them: `runs(1).x`, `runs{1}.x`. Cells of vectors and matrices, where those of as long a first
    one belong together: `T{1}`, `X{1}[0]`. Groups in one group, those with numbers behind one stem
    together: `run1/x`. An empty part is a part, and so what is left out has its place too.
    """
    families: dict[tuple[str, ...], Members] = {}
    for sheet in channels.parts:
        columns = [name for name in channels.columns if name.startswith(f"{sheet}/")]
        inner = {name.removeprefix(f"{sheet}/"): name for name in columns}
        families.setdefault(("sheet", *sorted(inner)), {})[sheet] = inner
    sizes: dict[str, int] = {}
    heads: dict[int, str] = {}
    for name in [*channels.columns, *channels.left_out] if channels.nested else ():
        places: list[tuple[tuple[str, ...], str, str]] = []
        found = _INDEXED.fullmatch(name)
        if found is None:
            stem = ""
            for mark in [*_SEPARATOR.finditer(name)][:DEEPEST_GROUP]:
                group = name[: mark.start()]
                number = _NUMBERED.fullmatch(group)
                family = ("number", number["stem"]) if number else ("name", stem)
                places.append((family, group, name[mark.end() :]))
                stem = group
        elif found["rest"].startswith("."):
            stem = found["head"]
            places = [(("element", stem), stem + found["index"], found["rest"][1:])]
        elif found["index"].startswith("{") and name in channels.columns:
            size = sizes.setdefault(found["head"], channels.columns[name].size)
            stem = heads.setdefault(size, found["head"])
            inner = _SEPARATOR.split(found["head"])[-1] + found["rest"]
            places = [(("cell", stem), stem + found["index"], inner)]
        for family, part, inner in places:
            member = families.setdefault(family, {}).setdefault(part, {})
            member |= {inner: name} if name in channels.columns else {}
    # Groups of HDF5 stand in the order of the alphabet, run10 before run2.
    return {
        family: {n: members[n] for n in sorted(members, key=_number)}
        if family[0] == "number"
        else members
        for family, members in families.items()
    }


def _number(group: str) -> int:
    return int(re.findall(r"\d+", group)[-1])


def _are_recordings(kind: str, members: Members, channels: Channels) -> bool:
    """Whether parts are recordings, and no sensors of one."""
    usual = _usual(members)
    if kind in ("sheet", "name") or min(len(members), len(usual)) < 2:
        return kind == "sheet" and len(channels.parts) > 1
    # The last of their names, without a place in a matrix.
    signals = [_SEPARATOR.split(name)[-1] for name in usual if not _is_time(name)]
    if {name.partition("[")[0].lower() for name in signals} <= GENERIC:
        return False
    held = [[channels.columns[n].size for n in part.values()] for part in members.values() if part]
    return len(signals) < len(usual) or len(set(map(max, held))) > 1


def recordings_in(channels: Channels, named: Collection[str] = (), part: str = "") -> Parts:
    """The recordings that a file holds, each with columns called as if it were alone in its file.

    Columns beside the parts that are as long as a part belong to it too.

    **Arguments:** `named`: columns that are asked for. Where one of them is named in full, as
    `runs(1).x`, the file is read as one recording; else those parts count that have them. `part`:
    the name of the only one that is wanted, which may be any part at all.

    **Raises:** `DataError` if there is no such part, or where it is unclear which parts are meant.
    """
    families = _families(channels)
    every = {n: member for members in families.values() for n, member in members.items()}
    if part:
        if part not in every:
            raise DataError(f"there is no part '{part}'; there are: {listed(every) or 'none'}.")
        return Parts({part: _alone(channels, every[part])})
    found = [m for (kind, *_), m in families.items() if _are_recordings(kind, m, channels)]
    inside = {column for members in found for each in members.values() for column in each.values()}
    if not found or inside & {*named}:
        return Parts({"": channels})
    short = [{name: split_unit(name)[0] for name in _usual(members)} for members in found]
    having = [m for m, own in zip(found, short) if all(_called(own, name) for name in named)]
    found = having or found
    if len({_usual(members) for members in found}) > 1:
        firsts = (next(iter(members.items())) for members in found)
        listing = "; ".join(f"{name} with {listed(member)}" for name, member in firsts)
        raise DataError(f"it holds recordings of several kinds: {listing}; {CHOOSE}.")
    parts = {name: member for members in found for name, member in members.items()}
    lacking = {name: sorted(_usual(found[0]) - member.keys()) for name, member in parts.items()}
    held = {name: _alone(channels, parts[name]) for name in parts if not lacking[name]}
    return Parts(held, {n: f"it lacks {listed(names)}" for n, names in lacking.items() if names})


def _alone(channels: Channels, member: Mapping[str, str]) -> Channels:
    """A part as a file of its own, with what lies beside the parts and is as long."""
    sizes = {channels.columns[name].size for name in member.values()}
    timed = any(map(_is_time, member))
    beside = {
        name: name
        for name, values in channels.columns.items()
        if not (_INDEXED.fullmatch(name) or _SEPARATOR.search(name))
        and values.size in sizes
        and not (timed and _is_time(name))
    }
    inner = {name: own for own, name in (beside | {**member}).items()}
    ends = (name.removesuffix(own) for own, name in member.items() if name.endswith(own))
    prefix = next(ends, "")
    own = {n.removeprefix(prefix): v for n, v in channels.scalars.items() if n.startswith(prefix)}
    scalars = channels.scalars | own
    alone = Channels({}, left_out=channels.left_out, notes=channels.notes, scalars=scalars)
    for name, own in inner.items():
        alone.take(own, channels.columns[name], channels.units.get(name, ""))
        if (time := channels.time_of.get(name)) in inner:
            alone.time_of[own] = inner[time]
    return alone


def _is_time(name: str) -> bool:
    return clocks.is_called_time(_SEPARATOR.split(name)[-1], {})
