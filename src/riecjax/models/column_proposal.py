"""Which column of a file may be which signal of a model: a proposal for a job file.

Lines of TOML: what is certain stands in them, what is guessed has a comment that says so.
"""

import contextlib
import re
from collections.abc import Iterator

from riecjax.equations.expressions import signals_read
from riecjax.equations.model import Model
from riecjax.equations.quantity import Quantity
from riecjax.errors import DataError
from riecjax.records.reading.channels import Channels
from riecjax.records.reading.selection import column_named, record_from_channels
from riecjax.records.reading.times import find_time, is_called_time
from riecjax.records.reading.units import readings, split_unit, unit_behind
from riecjax.settings import Select
from riecjax.settings.toml import quoted_key, toml_value


def _commented(text: str) -> str:
    """Text of a file, which may hold anything, for a comment of one line."""
    return "".join(c if c.isprintable() else "?" for c in text)


def map_lines(model: "Model", channels: "Channels", selection: Select) -> Iterator[str]:
    """A line for each signal that a model reads: its column, and how it was found."""
    given, read = selection.rename, {}
    taken = {c for c in channels.columns if is_called_time(c, channels.units)} | {*given.values()}
    # Of a user's own equation, what its expressions read.
    every = (of for e in model.equations for of in (*(term.of for term in e.terms), e.where) if of)
    names = dict.fromkeys(name for of in every for name in signals_read(of))
    signals = model.signals or tuple(Quantity(name, "", "") for name in names)
    wanted = [s for s in signals if s.name not in given]
    of_name = {}
    for signal in wanted:
        with contextlib.suppress(DataError):
            of_name[signal] = column_named(channels, signal.name)
    for signal, column in of_name.items():
        read[column] = signal.unit
        yield _commented(f"# map.{quoted_key(signal.name)} = {toml_value(column)}  # by its name")
    taken |= {*read}
    for signal in (s for s in wanted if s not in of_name):
        rest = [column for column in channels.columns if column not in taken]
        found, why = _guess(signal, rest, channels)
        name = f"map.{quoted_key(signal.name)}"
        if found is not None:
            taken.add(found)
            read[found] = signal.unit
            yield f"{name} = {toml_value(found)}  # {why}"
        elif signal.name not in model.derived:
            unit = f" in {signal.unit}" if signal.unit else ""
            listed = ", ".join(map(toml_value, rest)) or "no column is left"
            yield _commented(f'# {name} = "COLUMN"  # {signal.name}{unit}, one of: {listed}')
    units = {signal.name: signal.unit for signal in signals}
    read |= {column: units.get(name, "") for name, column in given.items()}
    # The unit of each column, or in which one it is read where the file states none.
    with contextlib.suppress(DataError):
        time = find_time(channels.columns, channels.units, selection.rename.get("t"))
        if time is not None and not time.notes:
            read[time.name] = "s"
    for column in channels.columns:
        unit = channels.units.get(column) or split_unit(column)[1]
        name = toml_value(column)
        if unit:
            yield _commented(f"# {name} is in {unit}, as the file says")
        elif read.get(column) and column not in {*selection.units, *selection.scale}:
            yield _commented(
                f"# {name} states no unit and is read in {read[column]}; where that is wrong: "
                f'unit.{quoted_key(column)} = "UNIT"'
            )
    try:
        record_from_channels(channels, selection, units)
    except DataError as error:
        yield _commented(f"# as it stands: {error}")


def _guess(signal: "Quantity", columns: list[str], channels: "Channels") -> tuple[str | None, str]:
    """The column that may be a signal, if one alone may, and why."""

    def plain(name: str) -> str:
        return re.sub(r"[\W_]", "", split_unit(name)[0].lower())

    def fits(column: str) -> bool:
        stated = channels.named(column)[1] or unit_behind(column) or ""
        same_kind = {unit.powers for unit in readings(stated).values()}
        return any(unit.powers in same_kind for unit in readings(signal.unit).values())

    words = {word for word in re.findall(r"\w+", signal.meaning.lower()) if len(word) > 3}
    rules = {
        "by its name but for spelling": [c for c in columns if plain(c) == plain(signal.name)],
        "a guess, by its meaning": [c for c in columns if plain(c) and plain(c) in words],
        "a guess, by its unit": [c for c in columns if signal.unit and fits(c)],
    }
    for why, found in rules.items():
        if len(found) == 1:
            return found[0], why
    return None, ""
