"""Reading JSON: lines of objects (.jsonl, .ndjson), or one document of arrays (.json)."""

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from riecjax.errors import DataError
from riecjax.records.reading.channels import (
    Channels,
    check_declared,
    foreign_reader,
    with_structure_times,
    with_units_beside,
    without_common_group,
)
from riecjax.records.reading.literals import of_texts

SPARSEST, FEWEST_CHECKED = 100, 10**6
"""Places of a table for each value at most, where it has more places than the second number."""


@foreign_reader("JSON")
def read_json_lines(file: Path) -> Channels:
    """Read JSON lines: an object for each sample; blank lines count for nothing.

    Fields of nested objects are called `a.b`, elements of arrays `a[0]`. A field that an object
    lacks, or has as `null`, is a gap there.

    **Raises:** `DataError` naming the line that is no object, and for damaged files.
    """
    notes: list[str] = []
    with file.open("rb") as stream:
        found = _channels({"": _objects(stream, notes)})
    return replace(found, notes=notes + found.notes)


@foreign_reader("JSON")
def read_json(file: Path) -> Channels:
    """Read one JSON document: an array of objects, or an object of arrays, perhaps in others.

    What pandas writes of a frame by itself is read as well, and lines of objects. Names as in
    [`read_json_lines`][], below the object in which all arrays lie. A `unit` beside an array is its
    unit. Single values are scalars.

    **Raises:** `DataError` for damaged files.
    """
    content = file.read_bytes()
    try:
        document = json.loads(content)
    except json.JSONDecodeError as error:
        # A second document: lines of objects under the wrong ending.
        if error.msg != "Extra data" or error.lineno != 2:
            raise
        return read_json_lines(file)
    tables = dict(_tables("", _as_arrays(document)))
    return _channels(tables, {n: v for n, v in _leaves("", document) if isinstance(v, str)})


def _as_arrays(document: Any) -> Any:
    """A document with arrays for objects of rows by their number, as pandas writes a frame."""
    if isinstance(document, dict) and all(
        isinstance(series, dict) and list(series) == list(map(str, range(max(len(series), 3))))
        for series in document.values()
    ):
        return {name: list(series.values()) for name, series in document.items()}
    return document


def _objects(lines: Iterable[bytes], notes: list[str]) -> Iterator[dict[str, Any]]:
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        try:
            found = json.loads(line)
        except ValueError as error:
            if number > 1 and not line.endswith(b"\n"):
                notes.append("the last line is cut off and left out")
                return
            raise DataError(f"line {number} is not JSON: {error}.") from None
        if not isinstance(found, dict):
            raise DataError(f"line {number} is no object, such as {{'t': 0.1, 'x': 2}}.")
        yield found


def _tables(name: str, document: Any) -> Iterator[tuple[str, list[Any]]]:
    """Arrays of a document by their name, and single values as arrays of one."""
    for inner, rows in _leaves(name, document):
        if isinstance(rows, int | float):
            yield inner, [rows]
        if not isinstance(rows, list):
            continue

        def is_longer(value: Any, count: int = len(rows)) -> bool:
            return isinstance(value, list) and len(value) > count

        # A signal in each row, or a recording in each object, where their arrays are longer than
        # there are rows.
        objects = (row.values() if isinstance(row, dict) else () for row in rows)
        if rows and all(any(map(is_longer, values)) for values in objects):
            for place, row in enumerate(rows):
                yield from _tables(f"{inner or 'part'}({place + 1})", row)
        elif rows and all(map(is_longer, rows)):
            yield inner, list(map(list, zip(*rows, strict=True)))
        else:
            yield inner, rows


def _leaves(name: str, value: Any, in_lists: bool = False) -> Iterator[tuple[str, Any]]:
    """What objects in each other hold, and lists if asked for, by name."""
    if isinstance(value, dict):
        inside = ((f"{name}.{key}" if name else key, inner) for key, inner in value.items())
    elif in_lists and isinstance(value, list):
        inside = ((f"{name}[{place}]", inner) for place, inner in enumerate(value))
    else:
        yield name, value
        return
    for inner, held in inside:
        yield from _leaves(inner, held, in_lists)


def _channels(tables: Mapping[str, Iterable[Any]], texts: Mapping[str, str] = {}) -> Channels:
    """Columns of tables, which are single values, arrays or objects in a row.

    **Arguments:** `texts` beside them, by name, some of which may be units.
    """
    whole = Channels({})
    for table, rows in tables.items():
        part = gathered(table, rows)
        columns = {k: v for k, v in part.columns.items() if v.size > 1}
        scalars = {k: float(v[0]) for k, v in part.columns.items() if v.size == 1}
        whole.take_all(replace(part, columns=columns, scalars=scalars))
        check_declared(len(whole.columns))
    whole.note_left_out("")
    return with_structure_times(without_common_group(with_units_beside(whole, texts), "."))


def gathered(table: str, rows: Iterable[Any]) -> Channels:
    """Columns of a table, named `table.column`, NaN where a row has none; stamps are in seconds.

    **Arguments:** `rows`, of dictionaries and lists in each other, or of single values.
    """
    columns: dict[str, dict[int, Any]] = {}
    count = 0
    for count, row in enumerate(rows, start=1):
        for name, value in _leaves(table, row, in_lists=True):
            column = columns.setdefault(name or "values", {})
            if count in column:
                raise DataError(f"two fields are called '{name or 'values'}'.")
            column[count] = value
        check_declared(len(columns))
    check_declared(unpacked=8 * count * len(columns))
    filled = sum(map(len, columns.values()))
    if filled < count * len(columns) / SPARSEST and count * len(columns) > FEWEST_CHECKED:
        raise DataError(
            f"its {count} rows have {len(columns)} names and only {filled} values; give a field the"
            " same name in each row."
        )
    found = Channels({})
    for name, column in columns.items():
        own = [*column.values()]
        text = next((value for value in own if isinstance(value, str)), None)
        read, unit = of_texts(own) if text is not None else (np.array(own, float), "")
        values = None if read is None else np.full(count, np.nan)
        if values is not None:
            values[np.array([*column]) - 1] = read
        found.take(name, values, unit, why=f"it holds text, {str(text)[:40]!r}")
    return found
