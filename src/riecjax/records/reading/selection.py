"""From the channels of a file to records: which recordings it holds, which channels are signals of
each, which is time, in which units.
"""

import re
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

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
from riecjax.records.time_base import StampError, time_base
from riecjax.settings import Read, Select


class Selected(NamedTuple):
    """A record, and what was decided on selecting it, in words.

    **Fields:** `converted`: signal to the unit that it was converted from; `doubt` in words that
    time is what it is taken for, empty if none; `findings`, on signals that were repaired;
    `left_out`: column to the reason why it is no signal.
    """

    record: Record
    converted: Mapping[str, str] = {}
    notes: tuple[str, ...] = ()
    doubt: str = ""
    findings: tuple[Finding, ...] = ()
    left_out: Mapping[str, str] = {}


@dataclass
class _Signal:
    """Values of a column, which change as it is converted; its unit, and the one before.

    **Fields:** `time` of each value in s, where a column says it.
    """

    values: np.ndarray
    column: str
    unit: str = ""
    converted: str = ""
    time: np.ndarray | None = None


_Signals = dict[str, _Signal]


def record_from_channels(
    channels: Channels,
    selection: Select,
    read: Mapping[str, str] | None = None,
    shortest: float | None = None,
) -> Selected:
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
    rename = {signal: column_named(channels, name) for signal, name in selection.rename.items()}
    taken = set(rename.values())
    short = {name: channels.named(name)[0] for name in channels.columns}
    count = Counter(short.values())
    # A column is called without its unit in brackets, unless another column is called that.
    names = {
        short[name] if count[short[name]] == 1 else name: name
        for name in channels.columns
        if name not in taken
    }
    signals: _Signals = {}
    registers = []
    # A new name takes the place of a column that is called so.
    for name, column in (names | rename).items():
        values, said = channels.columns[column], ""
        if not clocks.is_word_of_time(column):
            values, said = unwrapped(values, REGISTERS)
        registers += [f"{name}: {said}"] * bool(said)
        unit = channels.named(column)[1]
        if name in rename and not unit:
            unit = clocks.unit_of_time(column) if name == "t" else unit_behind(column)
        if name in rename or not np.isnan(values).all():
            signals[name] = _Signal(values, column, unit or "")
    units_read = read or {}
    formulas, formula_units = dict(selection.derive), {}
    for name in formulas.keys() & selection.units.keys():
        formula_units[name] = unit = selection.units[name]
        if found := conversion(name, unit, units_read.get(name, "")):
            formulas[name] = f"{found.factor!r}*({formulas[name]})"
            formula_units[name] = found.unit
    said = _converted_as_said(signals, channels, selection)
    for name, column in rename.items():
        if not signals[name].unit and name not in said:
            require_sure_unit(name, column, units_read.get(name, ""))
    time = _time_of(signals, channels, "t" if "t" in rename else None, shortest)
    known = np.zeros(0) if time is None else time.seconds[~np.isnan(time.seconds)]
    if time is not None and known.size > 1 and (np.diff(known) < 0).all():
        signals = {n: replace(signal, values=signal.values[::-1]) for n, signal in signals.items()}
        notes = (*time.notes, "rows turned round: the newest stood first")
        time = time._replace(seconds=time.seconds[::-1], notes=notes)
    every, step, rate = signals, selection.time_step, selection.resample
    if step is None:
        notes = time.notes if time else ()
        signals = _timed(signals, channels, time)
        size = max((signal.values.size for signal in signals.values()), default=0)
        common = f"the time, {size} samples"
    else:
        # Signals at an even step, whatever a column of time says: those of the length most have.
        notes = (f"column '{time.name}' is not used: the time step is given",) if time else ()
        sizes = {k: s.values.size for k, s in signals.items() if time is None or k != time.name}
        lengths = [size for name, size in sizes.items() if name in rename] or [*sizes.values()]
        usual = max(lengths, key=lambda size: (lengths.count(size), size), default=0)
        signals = {name: signals[name] for name, size in sizes.items() if size == usual}
        common = f"the others, {usual} samples"
    for name, column in rename.items():
        if name not in signals and name != "t":
            raise DataError(f"column '{column}' has another length than {common}.")
    # What is read, by the model or by what the user asks for; all where none is.
    words = re.findall(r"\w+", " ".join(formulas.values()))
    asked = signals.keys() & {*units_read, *rename, *selection.scale, *selection.units, *words}
    left_out = {}
    for name, signal in [*signals.items()]:
        try:
            found = conversion(name, signal.unit, units_read.get(name, ""))
        except DataError as error:
            if name in asked or (read is None and not asked):
                raise
            left_out[signals.pop(name).column] = str(error).rstrip(".")
            continue
        if found is not None:
            signal.values = signal.values * found.factor
            signal.unit, signal.converted = found.unit, signal.unit
    if not signals:
        why = _first_reason(replace(channels, left_out={**channels.left_out, **left_out}))
        raise DataError(f"a record needs at least one signal besides its time{why}.")
    matter = asked or {*signals}
    if step is None and rate is None:
        signals = _on_one_axis(signals, matter)
    axis = next(iter(signals.values())).time
    times = {name: signal.time for name, signal in signals.items() if signal.time is not None}
    units = {name: signal.unit for name, signal in signals.items()}
    values = {name: signal.values for name, signal in signals.items()}
    # What a program hands over as arrays is left as it is.
    how = selection.outliers if isinstance(selection, Read) else "keep"
    try:
        of_matter = {name: values[name] for name in values if name in matter}
        treated, words, findings = treat_all(of_matter, times, units, step, how, formulas)
        values |= treated
        # Infinite by-products of files from which signals are asked for by name are none of them.
        named, by_products = {*rename, *formulas}, set()
        if named - {"t"}:
            by_products = {n for n, v in values.items() if n not in named and np.isinf(v).any()}
        measured = {}
        if rate is not None:
            for name in [name for name in values if name not in by_products]:
                time_of = times[name] if step is None else step * np.arange(values[name].size)
                known = ~np.isnan(time_of)
                measured[name] = time_of[known], values[name][known]
            axis, values, said = on_grid(measured, rate, matter)
            notes = (*notes, *said)
        clock, measured_values = {} if axis is None else {"t": axis}, values.copy()
        # Groups of HDF5 are parted by strokes, which divide in a formula.
        scalars = {n.replace("/", "."): np.array(v) for n, v in channels.scalars.items()}
        for name, formula in formulas.items():
            values[name] = derived(formula, scalars | clock | values)
        values = {name: array for name, array in values.items() if name not in by_products}
        units = {name: unit for name, unit in (units | formula_units).items() if name in values}
        given_step = step if axis is None else None
        record = Record.from_samples(values, time=axis, time_step=given_step, units=units)
        if rate is None and axis is not None:
            notes = (*notes, *time_base(axis).words)
        given = given_noise(selection.noise, record.arrays)
        record = record.with_noise(given)
        if rate is not None and axis is not None:
            record = record.with_noise(on_grid_noise(measured, axis, rate, given))
        # What its samples tell of its noise, and of the signals of formulas by their columns, where
        # nothing else says it.
        formulas = {k: f for k, f in formulas.items() if k not in record.noise.kernels}
        columns = scalars | values | measured_values
        replaced = {
            k: replace(record.signal(k), values=raw, present=~np.isnan(raw))
            for k, raw in measured_values.items()
            if k in formulas and k in record.arrays
        }
        sampled = record.with_signals(replaced)
        names = [name for name in record.arrays if name not in formulas or name in replaced]
        noise = judged(sampled.select(*names)).noise if names else record.noise
        columns |= clock
        for name, formula in formulas.items():
            levels = {n: float(noise.std(n)) for n in columns if n in noise.kernels}
            noise = noise.combined(name, sensitivities(formula, columns, levels))
        record = record.with_noise(noise)
    except StampError as error:
        if not time:
            raise
        raise DataError(f"column '{every[time.name].column}': {error}") from None
    doubt = time.doubt if time and step is None and rate is None else ""
    converted = {name: signal.converted for name, signal in signals.items() if signal.converted}
    notes = (*notes, *registers, *words)
    return Selected(record, converted, notes, doubt, (*findings,), left_out)


def column_named(channels: Channels, name: str) -> str:
    """The column called `name`, or the only one called so but for its unit in brackets.

    Of a column in a group, as `run/force` or `run.force`, the last name will do if it is the only
    one. Columns without names are called by their number from 1.

    **Raises:** `DataError` if there is none, or there are several.
    """
    if name in channels.columns:
        return name
    short = {column: channels.named(column)[0] for column in channels.columns}
    inner = (f"/{name}", f".{name}")
    found = [column for column in short if short[column] == name]
    if not found and name.isdigit() and NUMBERED.format(name) in short:
        return NUMBERED.format(name)
    found = found or [c for c in short if c.endswith(inner) or short[c].endswith(inner)]
    if len(found) == 1:
        return found[0]
    if found:
        raise DataError(f"'{name}' may be any of: {listed(found)}; give the full name.")
    if name in channels.left_out:
        raise DataError(f"column '{name}' cannot be a signal: {channels.left_out[name]}.")
    raise DataError(f"there is no column '{name}'; there are: {listed(channels.columns)}.")


def _first_reason(channels: Channels) -> str:
    """Why a column was left out, for a message; a column named as time comes first."""
    named = sorted(channels.left_out, key=lambda name: channels.named(name)[0] not in TIME_COLUMNS)
    return f"; column '{named[0]}' was left out: {channels.left_out[named[0]]}" if named else ""


def _converted_as_said(signals: _Signals, channels: Channels, selection: Select) -> set[str]:
    """Give signals the units that the user says, which go before what the file states, and scale
    others, which no longer have the unit that it states.

    **Returns:** the names of all of these.

    **Raises:** `DataError` for an impossible unit or scale, and for two of one signal.
    """
    units = {name: unit for name, unit in selection.units.items() if name not in selection.derive}
    said: dict[str, tuple[str, str | float]] = {}
    for name, by in (*units.items(), *selection.scale.items()):
        if isinstance(by, str):
            require_known_unit(name, by)
        elif not (np.isfinite(by) and by != 0):
            raise DataError(f"the scale of '{name}' must be a number other than 0; got {by:g}.")
        is_column = name in channels.columns
        if name in signals and not is_column:
            targets = [name]
        # What messages and --map call time, whatever its column is called.
        elif name == "t" and not is_column and (time := _time_of(signals, channels)):
            targets = [time.name]
        else:
            column = column_named(channels, name)
            targets = [target for target, signal in signals.items() if signal.column == column]
        for target in targets:
            if target in said:
                first, before = said[target]
                pair, twice = (name, first), "is given both a scale and a unit"
                if type(by) is type(before):
                    of_kind = "units" if isinstance(by, str) else "scales"
                    pair, twice = (first, name), f"are one column, given two {of_kind}"
                both = " and ".join(f"'{word}'" for word in dict.fromkeys(pair))
                raise DataError(f"{both} {twice}; leave out one of them.")
            said[target], signal = (name, by), signals[target]
            if isinstance(by, str):
                signal.unit = by
            else:
                # Scaled to seconds, whatever its name says.
                is_time = clocks.is_called_time(target, {}) and clocks.unit_of_time(target)
                signal.values, signal.unit = signal.values * by, "s" if is_time else ""
    return {*said}


def _time_of(
    signals: _Signals, channels: Channels, given: str | None = None, shortest: float | None = None
) -> TimeColumn | None:
    """The time of all signals, or the `given` one as time."""
    values = {name: signal.values for name, signal in signals.items()}
    units = {name: signal.unit for name, signal in signals.items() if signal.unit}
    return find_time(values, units, given, nameless=not channels.time_of, shortest=shortest)


def _timed(signals: _Signals, channels: Channels, time: TimeColumn | None) -> _Signals:
    """The signals that have a time, each with its own."""
    if time is not None:
        size = time.seconds.size
        return {
            name: replace(signal, time=time.seconds)
            for name, signal in signals.items()
            if name != time.name and signal.values.size == size
        }
    named = [name for name in dict.fromkeys(channels.time_of.values()) if name in signals]
    axes = {name: _time_of(signals, channels, name) for name in named}
    timed = {
        name: replace(signal, time=axis.seconds)
        for name, signal in signals.items()
        if signal.column not in axes and (axis := axes.get(channels.time_of.get(signal.column, "")))
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
        f"{listed(channels.columns)}. Say which one is time by renaming it to t (on the command "
        f"line: --map t=COLUMN){', name all columns (--columns t,x,...)' * numbered}, or give the "
        f"seconds between samples (--time-step){_first_reason(channels) or next(other, '')}."
    )


def _on_one_axis(signals: _Signals, matter: Collection[str]) -> _Signals:
    """Signals of one time, without the rows that are empty in all of them.

    Signals that do not matter and have another time than those that do are left out.
    """
    times = {name: signal.time for name, signal in signals.items() if signal.time is not None}
    first = next(name for name in times if name in matter)
    time = times[first]
    same = {
        name: signals[name]
        for name, other in times.items()
        if other is time or np.array_equal(other, time)
    }
    if name := next((name for name in times if name not in same and name in matter), ""):
        raise DataError(
            f"'{first}' and '{name}' have different times; bring them to a common rate (on the"
            " command line: --resample HZ), or name the time of the signals you need by"
            " renaming it to t."
        )
    filled = ~np.all([np.isnan(v) for v in (time, *(s.values for s in same.values()))], axis=0)
    time = time[filled]
    return {n: replace(s, values=s.values[filled], time=time) for n, s in same.items()}


# Names alone do not tell a recording from a sensor: `Y(1).Data`, `Y(2).Data` are two channels of
# one recording, and `X.time`, `X.signals.values` is one of Simulink's. So a part counts as a
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
UNLIKE = 0.05
"""Share by which lengths of groups without numbers differ, if they are recordings, not sensors."""


class Parts(NamedTuple):
    """Recordings in a file, by name; `""` where the whole file is one. Of `broken` ones, why."""

    held: dict[str, Channels]
    broken: Mapping[str, str] = {}


Member = dict[str, str]
"""Columns of a part: their names inside it, to those in the file."""


class _Family(NamedTuple):
    """Parts that may be recordings, by name. `kind`: what tells them apart."""

    members: dict[str, Member]
    kind: Literal["sheet", "element", "number", "name"]

    def usual(self) -> frozenset[str]:
        """The columns that most members have; of equally many, the most columns."""
        kinds = [frozenset(member) for member in self.members.values()]
        return max(kinds, key=lambda kind: (kinds.count(kind), len(kind)), default=frozenset())

    @property
    def differs(self) -> bool:
        """Whether these are sheets of different kinds."""
        return self.kind == "sheet" and len({frozenset(m) for m in self.members.values()}) > 1

    def has(self, names: Iterable[str]) -> bool:
        """Whether columns may be meant by all of these names; see [`column_named`][]."""
        return all(
            any(n in (c, split_unit(c)[0]) or c.endswith((f".{n}", f"/{n}")) for c in self.usual())
            for n in names
        )


def recordings_in(channels: Channels, named: Collection[str] = (), part: str = "") -> Parts:
    """The recordings that a file holds, each with columns called as if it were alone in its file.

    Columns beside the parts that are as long as a part belong to it too.

    **Arguments:** `named`: columns that are asked for. Where one of them is named in full, as
    `runs(1).x`, the file is read as one recording; else those parts count that have them. `part`:
    the name of the only one that is wanted, which may be any part at all.

    **Raises:** `DataError` if there is no such part, or where it is unclear which parts are meant.
    """
    if channels.parts:
        members = {
            sheet: {
                name.removeprefix(f"{sheet}/"): name
                for name in channels.columns
                if name.startswith(f"{sheet}/")
            }
            for sheet in channels.parts
        }
        families = [_Family(members, "sheet")]
    elif channels.nested:
        families = [*_structures(channels), *_cells(channels), *_groups(channels)]
    else:
        families = []
    if part:
        for family in families:
            if part in family.members:
                return Parts({part: _alone(channels, family.members[part])})
        names = dict.fromkeys(name for family in families for name in family.members)
        raise DataError(f"there is no part '{part}'; there are: {listed(names) or 'none'}.")
    found = [family for family in families if _are_recordings(family, channels)]
    inside = {column for f in found for member in f.members.values() for column in member.values()}
    if not found or inside & {*named}:
        return Parts({"": channels})
    found = [f for f in found if f.has(named)] or found
    if len({family.usual() for family in found}) > 1 or any(family.differs for family in found):
        kinds = (
            item for f in found for item in list(f.members.items())[: None if f.differs else 1]
        )
        listing = "; ".join(f"{name} with {listed(member)}" for name, member in kinds)
        raise DataError(f"it holds recordings of several kinds: {listing}; {CHOOSE}.")
    held, broken = {}, {}
    for family in found:
        for name, member in family.members.items():
            if lacking := sorted(family.usual() - member.keys()):
                broken[name] = f"it lacks {listed(lacking)}"
            else:
                held[name] = _alone(channels, member)
    return Parts(held, broken)


def _alone(channels: Channels, member: Member) -> Channels:
    """A part as a file of its own, with what lies beside the parts and is as long."""
    columns = {inner: channels.columns[name] for inner, name in member.items()}
    sizes = {values.size for values in columns.values()}
    timed = any(map(_is_time, columns))
    source = dict(member)
    for name, values in channels.columns.items():
        beside = not (_INDEXED.fullmatch(name) or _SEPARATOR.search(name))
        if beside and values.size in sizes and not (timed and _is_time(name)):
            source.setdefault(name, name)
    alone = Channels({}, left_out=channels.left_out, notes=channels.notes)
    inner = {name: own for own, name in source.items()}
    prefixes = (name.removesuffix(own) for own, name in member.items() if name.endswith(own))
    prefix = next(prefixes, "")
    own_scalars = {
        n.removeprefix(prefix): v for n, v in channels.scalars.items() if n.startswith(prefix)
    }
    alone.scalars.update(channels.scalars | own_scalars)
    for name, own in inner.items():
        alone.take(own, channels.columns[name], channels.units.get(name, ""))
        if (time := channels.time_of.get(name)) in inner:
            alone.time_of[own] = inner[time]
    return alone


def _structures(channels: Channels) -> Iterator[_Family]:
    """Arrays of structures, and cells with structures in them: `runs(1).x`, `runs{1}.x`."""
    heads: dict[str, dict[str, Member]] = {}
    for name in _every_name(channels):
        found = _INDEXED.fullmatch(name)
        if found and found["rest"].startswith("."):
            members = heads.setdefault(found["head"], {})
            member = members.setdefault(found["head"] + found["index"], {})
            if name in channels.columns:
                member[found["rest"][1:]] = name
    return (_Family(members, "element") for members in heads.values())


def _cells(channels: Channels) -> Iterator[_Family]:
    """Cells of vectors and matrices, those of equal lengths together: `T{1}`, `X{1}[0]`, ..."""
    heads: dict[str, dict[str, Member]] = {}
    for name in channels.columns:
        found = _INDEXED.fullmatch(name)
        if found and found["index"][0] == "{" and not found["rest"].startswith("."):
            inner = _SEPARATOR.split(found["head"])[-1] + found["rest"]
            heads.setdefault(found["head"], {}).setdefault(found["index"], {})[inner] = name
    gathered: list[tuple[str, dict[str, Member]]] = []
    for head, members in heads.items():
        for _, family in gathered:
            common = family.keys() & members.keys()
            if len(common) == min(len(family), len(members)) and all(
                _size(channels, family[index]) == _size(channels, members[index])
                for index in common
            ):
                for index, member in members.items():
                    family.setdefault(index, {}).update(member)
                break
        else:
            gathered.append((head, members))
    for head, members in gathered:
        yield _Family({head + index: member for index, member in members.items()}, "element")


def _groups(channels: Channels) -> Iterator[_Family]:
    """Groups within one group, those with numbers behind one stem together: `run1/x`, `run2/x`."""
    names = [name for name in _every_name(channels) if not _INDEXED.fullmatch(name)]
    for depth in range(DEEPEST_GROUP):
        families: dict[tuple[str, bool], dict[str, Member]] = {}
        for name in names:
            marks = [mark.start() for mark in _SEPARATOR.finditer(name)]
            if len(marks) <= depth:
                continue
            group, inner = name[: marks[depth]], name[marks[depth] + 1 :]
            found = _NUMBERED.fullmatch(group)
            stem = found["stem"] if found else name[: marks[depth - 1]] if depth else ""
            member = families.setdefault((stem, bool(found)), {}).setdefault(group, {})
            if name in channels.columns:
                member[inner] = name
        for (_, numbered), members in families.items():
            # Groups of HDF5 stand in the order of the alphabet, run10 before run2.
            number = {g: match for g in members if (match := _NUMBERED.fullmatch(g))}
            order = sorted(members, key=lambda g: int(number[g]["number"])) if numbered else members
            yield _Family({g: members[g] for g in order}, "number" if numbered else "name")


def _every_name(channels: Channels) -> list[str]:
    """Names of columns, and of what was left out: an empty part is a part."""
    return [*channels.columns, *channels.left_out]


def _are_recordings(family: _Family, channels: Channels) -> bool:
    if len(family.members) < 2 or family.kind == "sheet":
        return len(family.members) >= 2
    usual = family.usual()
    signals = [name for name in usual if not _is_time(name)]
    # The last of their names, without a place in a matrix.
    bare = [_SEPARATOR.split(name)[-1].partition("[")[0].lower() for name in signals]
    if len(usual) < 2 or {*bare} <= {*GENERIC}:
        return False
    members = [member for member in family.members.values() if member]
    sizes = {_size(channels, member) for member in members}
    if len(signals) < len(usual):
        # Sensors record for as long as each other, tests rarely.
        spans = [_span(channels, member) for member in members]
        apart = len(signals) > 1 and max(spans) > (1 + UNLIKE) * min(spans)
        return family.kind != "name" or apart
    if family.kind != "element":
        return family.kind == "number" and len(sizes) > 1
    beside = {channels.columns[name].size for name in channels.columns if _is_time(name)}
    return not (len(sizes) == 1 and sizes <= beside)


def _is_time(name: str) -> bool:
    return clocks.is_called_time(_SEPARATOR.split(name)[-1], {})


def _size(channels: Channels, member: Member) -> int:
    return max((channels.columns[name].size for name in member.values()), default=0)


def _span(channels: Channels, member: Member) -> float:
    """How long a part lasts, in the units of its time; 0 without one."""
    times = [channels.columns[name] for inner, name in member.items() if _is_time(inner)]
    return max((float(np.nanmax(time) - np.nanmin(time)) for time in times), default=0.0)
