"""`riecjax init`: a job file to fill in, from a look at recordings."""

import codecs
import contextlib
import inspect
import json
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import click

from riecjax.cli import identify
from riecjax.cli.job import JobCommand, given, key_of

if TYPE_CHECKING:
    from riecjax.models.model import Model, Quantity
    from riecjax.records.reading.channels import Channels
    from riecjax.records.reading_settings import Selection

NUMBERS = ("number", "share", "float", "integer", "integer range")
"""What types of options call a number."""
BARE = re.compile(r"[A-Za-z0-9_-]+")


def _print_job(**arguments: Any) -> None:
    """Print a job file (TOML) for `riecjax identify --job`: every option has its line there.

    The map of signals to columns is proposed from their names and units; a comment marks a guess.
    """
    from riecjax.models.catalogue import find_model
    from riecjax.records.reading.parts import recordings_in
    from riecjax.records.reading.read import read_channels
    from riecjax.records.reading_settings import Selection

    ctx = click.get_current_context()
    model = find_model(arguments["model_name"])
    dialect = {
        name: arguments[name]
        for name in list(inspect.signature(read_channels).parameters)[1:]
        if name in arguments
    }
    named, part = arguments["rename"].values(), next(iter(arguments["parts"]), "")
    read = [
        channels
        for file in arguments["files"]
        for channels in recordings_in(read_channels(file, **dialect), named, part).held.values()
    ]
    selection = Selection(
        **{key: arguments[key] for key in Selection._fields if key in arguments and key != "noise"}
    )
    notes = {"map": list(_map_lines(model, read[0], selection))}
    if arguments["band"] is None:
        from riecjax.criteria.windows import DEFAULT_BAND

        band = [float(end) for end in model.band or DEFAULT_BAND]
        notes["band"] = [f"# band = {toml_value(band)}  # taken unless another is given"]
    click.echo(_as_printed("\n".join(form(ctx, notes))))


command = JobCommand(
    "init",
    callback=_print_job,
    params=identify.command.params,
    help=inspect.getdoc(_print_job),
    short_help="Propose a job file for recordings and a model.",
)


def _as_printed(job: str) -> str:
    """The job in TOML's UTF-8, or in ASCII with TOML's escapes where output has another encoding.

    Windows redirects in a code page, in which no reader of TOML takes even a comment.
    """
    if codecs.lookup(sys.stdout.encoding or "utf-8").name == "utf-8":
        return job
    signs = ((c, ord(c)) for c in job)
    return "".join(
        c if c.isascii() else f"\\u{n:04x}" if n < 2**16 else f"\\U{n:08x}" for c, n in signs
    )


def form(ctx: click.Context, notes: Mapping[str, Iterable[str]] = {}) -> Iterator[str]:
    """Lines of a job file with all options of the running command, those that are not set as
    comments.

    **Arguments:** `notes`, lines that go below a key's own, or instead of its empty one.
    """
    said = given(ctx)
    yield "# A job for: riecjax identify --job FILE. Paths are relative to this file."
    for param in ctx.command.params:
        key = key_of(param)
        if key == "job":
            continue
        yield ""
        if isinstance(param, click.Option) and param.help:
            yield f"# {' '.join(param.help.split())}"
        lines = [*(assigned(key, said[key]) if key in said else ()), *notes.get(key, ())]
        yield from lines or [f"# {key} = {_example(param)}"]


def _example(param: click.Parameter) -> str:
    """What an option that is not set may be, in the place of its value."""
    if isinstance(param, click.Option) and param.is_flag:
        return "false"
    kind = getattr(param.type, "name", "value")
    words = param.metavar or "|".join(getattr(param.type, "choices", [kind]))
    # In TOML, all but numbers stands in quotes.
    is_number = getattr(param.type, "kind", None) is float or kind in NUMBERS
    sign = "" if is_number else '"'
    if getattr(param, "multiple", False) and "=" in words:
        name, _, value = words.rpartition("|")[2].partition("=")
        return "{ " + f"{name.strip('[')} = {sign}{value.rstrip(']')}{sign}" + " }"
    words = f"{sign}{words}{sign}"
    return f"[{words}]" if param.multiple or param.nargs > 1 else words  # type: ignore[attr-defined]


def assigned(key: str, value: Any) -> Iterator[str]:
    """TOML that gives a key this value: of a table, a line for each name."""
    if not isinstance(value, dict):
        yield f"{key} = {toml_value(value)}"
    else:
        for name, each in value.items():
            yield f"{key}.{_quoted_key(name)} = {toml_value(each)}"


def _quoted_key(name: str) -> str:
    return name if BARE.fullmatch(name) else toml_value(name)


def toml_value(value: Any) -> str:
    """A text, number, truth or list of them in TOML, whose escapes are JSON's but for DEL."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _commented(text: str) -> str:
    """Text of a file, which may hold anything, for a comment of one line."""
    return "".join(c if c.isprintable() else "?" for c in text)


def _map_lines(model: "Model", channels: "Channels", selection: "Selection") -> Iterator[str]:
    """A line for each signal that a model reads: its column, and how it was found."""
    from riecjax.errors import DataError
    from riecjax.records.reading.selection import column_named, record_from_channels
    from riecjax.records.reading.times import is_called_time

    given, read = selection.rename, {}
    times = [c for c in channels.columns if is_called_time(c, channels.units)]
    taken = {*given.values(), *times}
    signals = _signals(model)
    wanted = [s for s in signals if s.name not in given]
    missing = []
    for signal in wanted:
        try:
            column = column_named(channels, signal.name)
        except DataError:
            missing.append(signal)
            continue
        taken.add(column)
        read[column] = signal.unit
        yield _commented(f"# map.{_quoted_key(signal.name)} = {toml_value(column)}  # by its name")
    for signal in missing:
        rest = [column for column in channels.columns if column not in taken]
        found, why = _guess(signal, rest, channels)
        name = f"map.{_quoted_key(signal.name)}"
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
    yield from _unit_lines(channels, selection, read)
    try:
        record_from_channels(channels, selection, units)
    except DataError as error:
        yield _commented(f"# as it stands: {error}")


def _unit_lines(
    channels: "Channels", selection: "Selection", read: Mapping[str, str]
) -> Iterator[str]:
    """The unit of each column, or in which one it is `read` where the file states none."""
    from riecjax.errors import DataError
    from riecjax.records.reading.times import find_time
    from riecjax.records.reading.units import split_unit

    read = dict(read)
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
                f'unit.{_quoted_key(column)} = "UNIT"'
            )


def _signals(model: "Model") -> "list[Quantity]":
    """What a model reads; of a user's own equation, found by asking it."""
    if model.signals:
        return list(model.signals)
    import numpy as np

    from riecjax.errors import MissingSignalError
    from riecjax.models.model import Quantity
    from riecjax.records.record import Record

    names: list[str] = ["t"]
    zeros = np.zeros(8)
    equations = [e for stage in model.build_procedure().stages for e in stage]
    for _ in range(100):
        record = Record.from_samples(dict.fromkeys(names[1:] or ["_"], zeros), time_step=1.0)
        try:
            for equation in equations:
                equation.signals_read(record, 2)
            break
        except MissingSignalError as error:
            names.append(error.signal)
    return [Quantity(name, "", "") for name in names[1:]]


def _guess(signal: "Quantity", columns: list[str], channels: "Channels") -> tuple[str | None, str]:
    """The column that may be a signal, if one alone may, and why."""
    from riecjax.records.reading.units import readings, split_unit, unit_behind

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
