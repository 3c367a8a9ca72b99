"""From the channels of a file to a record: which are signals, which is time, in which units."""

import re
from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from riecjax.errors import DataError
from riecjax.findings import Finding
from riecjax.records.noise_judgement import given_noise, judged
from riecjax.records.preparation.repair import signed, treat_all
from riecjax.records.reading import times as clocks
from riecjax.records.reading.channels import NUMBERED, Channels
from riecjax.records.reading.times import TIME_COLUMNS, TimeColumn, find_time, listed, seconds_in
from riecjax.records.reading.units import (
    conversion,
    require_known_unit,
    require_sure_unit,
    unit_behind,
)
from riecjax.records.record import Record
from riecjax.records.time_base import StampError
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


class _Signals(NamedTuple):
    """Signals by name, with the column each comes from, its unit, the one before conversion, and
    why a column is left out. What is decided changes them in place."""

    values: dict[str, np.ndarray]
    column: dict[str, str]
    units: dict[str, str]
    converted: dict[str, str]
    left_out: dict[str, str]

    def keep(self, names: Iterable[str]) -> None:
        """Drop all other signals."""
        for name in self.values.keys() - {*names}:
            del self.values[name]


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
    signals, registers = _renamed(channels, rename)
    units_read, stated, asked_of = read or {}, dict(signals.units), {}
    formulas, labels = dict(selection.derive), dict(selection.units)
    for name in formulas.keys() & labels.keys():
        found = conversion(name, labels[name], units_read.get(name) or None)
        if found is not None:
            formulas[name], labels[name] = f"{found.factor!r}*({formulas[name]})", found.unit
    selection = replace(selection, derive=formulas, units=labels)
    # What the user says goes before what the file states.
    for name, unit in selection.units.items():
        if name in selection.derive:
            continue
        require_known_unit(name, unit)
        for signal in _signals_called(name, signals, channels):
            if signal in asked_of:
                raise DataError(
                    f"'{asked_of[signal]}' and '{name}' are one column, given two units; leave "
                    f"out one of them."
                )
            stated[signal], asked_of[signal] = unit, name
    signals.units.update(stated)
    for name, column in rename.items():
        if name not in signals.units and not {name, column} & {*selection.scale}:
            require_sure_unit(name, column, units_read.get(name, ""))
    _scale(signals, channels, selection.scale, asked_of)
    time = find_time(
        signals.values,
        signals.units,
        "t" if "t" in rename else None,
        nameless=not channels.time_of,
        shortest=shortest,
    )
    notes, times = (), {}
    if selection.time_step is not None:
        notes = (f"column '{time.name}' is not used: the time step is given",) if time else ()
        _keep_usual_length(signals, rename, time)
    else:
        notes = time.notes if time else ()
        times = _times(signals, channels, time)
        for name in rename:
            if name not in times and name != "t":
                size = max((stamps.size for stamps in times.values()), default=0)
                raise DataError(
                    f"column '{rename[name]}' has another length than the time, {size} samples."
                )
        signals.keep(times)
    # What is read, by the model or by what the user asks for; all where none is.
    words = re.findall(r"\w+", " ".join(selection.derive.values()))
    asked = {*units_read, *rename, *selection.scale, *selection.units, *words}
    asked &= signals.values.keys()
    _convert(signals, units_read, asked or ({*signals.values} if read is None else ()))
    if not signals.values:
        why = _first_reason(replace(channels, left_out={**channels.left_out, **signals.left_out}))
        raise DataError(f"a record needs at least one signal besides its time{why}.")
    matter = asked or {*signals.values}
    step = selection.time_step
    # What a program hands over as arrays is left as it is.
    how = selection.outliers if isinstance(selection, Read) else "keep"
    columns, axis, axes = signals.values, None, times
    try:
        if selection.resample is None:
            columns, axis = _on_one_axis(columns, times, matter)
            axes = {} if axis is None else dict.fromkeys(columns, axis)
        of_matter = {name: values for name, values in columns.items() if name in matter}
        treated, words, findings = treat_all(of_matter, axes, signals.units, step, how, formulas)
        signals = signals._replace(values=columns | treated)
        if selection.resample is not None:
            record = _resampled(signals, times, selection, matter)
        else:
            computed = _finite(_with_derived(signals.values, axis, formulas), selection)
            units = _with_labels(signals, selection)
            record = Record.from_samples(computed, time=axis, time_step=step, units=units)
            clock = {} if axis is None else {"t": axis}
            record = _with_noise(record, selection, clock | computed)
    except StampError as error:
        if not time:
            raise
        column = signals.column.get(time.name, time.name)
        raise DataError(f"column '{column}': {error}") from None
    doubt = time.doubt if times and time and selection.resample is None else ""
    notes = (*notes, *registers, *words)
    return Selected(record, signals.converted, notes, doubt, (*findings,), signals.left_out)


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


def _renamed(channels: Channels, rename: Mapping[str, str]) -> tuple[_Signals, list[str]]:
    """Signals as the file holds them, and which were signed numbers read as unsigned, in words."""
    taken = set(rename.values())
    short = {name: channels.named(name)[0] for name in channels.columns}
    count = Counter(short.values())
    # A column is called without its unit in brackets, unless another column is called that.
    column = {
        short[name] if count[short[name]] == 1 else name: name
        for name in channels.columns
        if name not in taken
    }
    # A new name takes the place of a column that is called so.
    column |= rename
    values, units, registers = {}, {}, []
    for name, source in column.items():
        timed = clocks.is_word_of_time(source)
        recorded = channels.columns[source]
        values[name], bits = (recorded, 0) if timed else signed(recorded)
        if bits:
            registers.append(f"{name}: signed numbers of {bits} bits, read as unsigned, put right")
        behind = clocks.unit_of_time(source) if name == "t" else unit_behind(source)
        unit = channels.named(source)[1] or (behind if name in rename else None)
        units |= {name: unit} if unit else {}
        if name not in rename and np.isnan(values[name]).all():
            del values[name]
    return _Signals(values, column, units, {}, {}), registers


def _with_labels(signals: _Signals, selection: Select) -> dict[str, str]:
    """The signals' units, and those that the user says of formulas."""
    return signals.units | {k: u for k, u in selection.units.items() if k in selection.derive}


def _convert(signals: _Signals, read: Mapping[str, str], matter: Collection[str]) -> None:
    """To SI units; of those that do not matter, one whose unit is in doubt is left out."""
    for name in [name for name in signals.values if name in signals.units]:
        unit = signals.units[name]
        try:
            found = conversion(name, unit, read.get(name) or None)
        except DataError as error:
            if name in matter:
                raise
            del signals.values[name]
            signals.left_out[signals.column[name]] = str(error).rstrip(".")
            continue
        if found is not None:
            signals.values[name] = signals.values[name] * found.factor
            signals.units[name], signals.converted[name] = found.unit, unit


def _signals_called(name: str, signals: _Signals, channels: Channels) -> list[str]:
    """The signal of this name, or those that the column of this name became."""
    if name in signals.values and name not in channels.columns:
        return [name]
    if name == "t" and name not in channels.columns:
        # What messages and --map call time, whatever its column is called.
        time = find_time(signals.values, signals.units, None, nameless=not channels.time_of)
        if time is not None:
            return [time.name]
    source = column_named(channels, name)
    return [signal for signal in signals.values if signals.column[signal] == source]


def _scale(
    signals: _Signals,
    channels: Channels,
    scale: Mapping[str, float],
    asked_of: Mapping[str, str],
) -> None:
    """What is scaled no longer has the unit that the file states.

    **Arguments:** `asked_of`, under which names signals were given a unit.
    """
    called = {name: _signals_called(name, signals, channels) for name in scale}
    done = set()
    for name, factor in scale.items():
        if not (np.isfinite(factor) and factor != 0):
            raise DataError(f"the scale of '{name}' must be a number other than 0; got {factor:g}.")
        for target in called[name]:
            if target in done:
                raise DataError(f"'{target}' is scaled twice.")
            if target in asked_of:
                both = " and ".join(f"'{word}'" for word in dict.fromkeys((name, asked_of[target])))
                raise DataError(f"{both} is given both a scale and a unit; leave out one of them.")
            signals.values[target] = signals.values[target] * factor
            signals.units.pop(target, None)
            # Scaled to seconds, whatever its name says.
            if clocks.is_called_time(target, {}) and clocks.unit_of_time(target):
                signals.units[target] = "s"
            done.add(target)


def _times(signals: _Signals, channels: Channels, time: TimeColumn | None) -> dict[str, np.ndarray]:
    """Signal to its time in s, for each signal that has one."""
    if time is not None:
        seconds, values = time.seconds, signals.values
        return {n: seconds for n in values if n != time.name and values[n].size == seconds.size}
    named = [name for name in dict.fromkeys(channels.time_of.values()) if name in signals.values]
    found = {name: find_time(signals.values, signals.units, name) for name in named}
    axes = {name: axis.seconds for name, axis in found.items() if axis}
    times = {
        name: axes[channels.time_of[column]]
        for name, column in signals.column.items()
        if name in signals.values
        and column in channels.time_of
        and column not in axes
        and channels.time_of[column] in axes
    }
    if times:
        return times
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


def _keep_usual_length(
    signals: _Signals, rename: Mapping[str, str], time: TimeColumn | None
) -> None:
    """Signals at an even step, whatever a column of time says: those of the length most have."""
    sizes = {k: v.size for k, v in signals.values.items() if time is None or k != time.name}
    lengths = [size for name, size in sizes.items() if name in rename] or [*sizes.values()]
    if not lengths:
        raise DataError("a record needs at least one signal besides its time.")
    usual = max(lengths, key=lambda length: (lengths.count(length), length))
    signals.keep(name for name, size in sizes.items() if size == usual)
    for name in rename:
        if name not in signals.values and name != "t":
            raise DataError(
                f"column '{rename[name]}' has another length than the others, {usual} samples."
            )


def _on_one_axis(
    values: dict[str, np.ndarray], times: dict[str, np.ndarray], matter: Collection[str]
) -> tuple[dict[str, np.ndarray], np.ndarray | None]:
    """Signals and their one time, without the rows that are empty in all of them.

    Signals that do not matter and have another time than those that do are left out.
    """
    if not times:
        return values, None
    first = next(name for name in times if name in matter)
    same = {n: t is times[first] or np.array_equal(t, times[first]) for n, t in times.items()}
    for name in times:
        if not same[name] and name in matter:
            raise DataError(
                f"'{first}' and '{name}' have different times; bring them to a common rate (on the"
                " command line: --resample HZ), or name the time of the signals you need by"
                " renaming it to t."
            )
    values = {name: array for name, array in values.items() if same[name]}
    time = times[first]
    filled = ~np.isnan(time) | np.any([~np.isnan(each) for each in values.values()], axis=0)
    if filled.all():
        return values, time
    return {name: array[filled] for name, array in values.items()}, time[filled]


def _resampled(
    signals: _Signals,
    times: dict[str, np.ndarray],
    selection: Select,
    matter: Collection[str],
) -> Record:
    from riecjax.records.preparation.resampling import on_grid, on_grid_noise

    pairs = {}
    step = selection.time_step
    for name, values in _finite(signals.values, selection).items():
        time = times[name] if step is None else step * np.arange(values.size)
        known = ~np.isnan(time)
        pairs[name] = time[known], values[known]
    rate = float(selection.resample or 0.0)
    time, values = on_grid(pairs, rate, matter)
    computed = _with_derived(values, time, selection.derive)
    record = Record.from_samples(computed, time=time, units=_with_labels(signals, selection))
    given = given_noise(selection.noise, record.arrays)
    record = record.with_noise(on_grid_noise(pairs, time, rate, given))
    return _with_noise(record, selection, {"t": time, **computed})


def _with_derived(
    values: dict[str, np.ndarray], time: np.ndarray | None, derive: Mapping[str, str]
) -> dict[str, np.ndarray]:
    """Columns, and those of formulas of them and of the time `t`; shapes `(n,)`."""
    values = dict(values)
    for name, formula in derive.items():
        from riecjax.records.derived import derived

        known = values if time is None or "t" in values else {**values, "t": time}
        values[name] = derived(formula, known)
    return values


def _with_noise(record: Record, selection: Select, columns: Mapping[str, np.ndarray]) -> Record:
    """The record with what is known of its noise, of the signals of formulas by these columns.

    What is said of a signal goes before what its samples and formulas tell.
    """
    known = record.noise
    record = record.with_noise(given_noise(selection.noise, record.arrays)).with_noise(known)
    formulas = {k: f for k, f in selection.derive.items() if k not in record.noise.kernels}
    measured = [name for name in record.arrays if name not in formulas]
    noise = judged(record.select(*measured)).noise if measured else record.noise
    for name, formula in formulas.items():
        from riecjax.records.derived import sensitivities

        levels = {n: float(noise.std(n)) for n in columns if n in noise.kernels}
        noise = noise.combined(name, sensitivities(formula, columns, levels))
    return record.with_noise(noise)


def _finite(values: dict[str, np.ndarray], selection: Select) -> dict[str, np.ndarray]:
    """Without the infinite by-products of files from which signals are asked for by name."""
    wanted = {*selection.rename, *selection.derive}
    if not wanted - {"t"}:
        return values
    return {k: v for k, v in values.items() if k in wanted or not np.isinf(v).any()}
