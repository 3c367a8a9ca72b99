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
    check_column_count,
    check_unpacked,
    foreign_reader,
    with_structure_times,
    with_units_beside,
    without_common_group,
)
from riecjax.records.reading.times import of_texts

SPARSEST, FEWEST_CHECKED = 100, 10**6
"""Places of a table for each value at most, where it has more places than the second number."""


def read_json_lines(file: Path) -> Channels:
    """Read JSON lines: an object for each sample; blank lines count for nothing.

    Fields of nested objects are called `a.b`, elements of arrays `a[0]`. A field that an object
    lacks, or has as `null`, is a gap there.

    **Raises:** `DataError` naming the line that is no object, and for damaged files.
    """
    notes: list[str] = []
    with foreign_reader("JSON"), file.open("rb") as stream:
        found = _channels({"": _objects(stream, notes)})
    return replace(found, notes=notes + found.notes)


def read_json(file: Path) -> Channels:
    """Read one JSON document: an array of objects, or an object of arrays, perhaps in others.

    Rows may be arrays below one of names; pandas' forms `split` and `columns` are read as well, and
    lines of objects. Names as in [`read_json_lines`][], below the object in which all arrays lie. A
    `unit` beside an array is its unit.

    **Raises:** `DataError` for damaged files.
    """
    with foreign_reader("JSON"):
        content = file.read_bytes()
        try:
            document = json.loads(content)
        except json.JSONDecodeError as error:
            # A second document: lines of objects under the wrong ending.
            if error.msg != "Extra data" or error.lineno != 2:
                raise
            return read_json_lines(file)
        tables = dict(_arrays("", _as_rows(document)))
        return _channels(tables, dict(_texts("", document)))


def _as_rows(document: Any) -> Any:
    """A document with its rows as objects, where their names stand apart."""
    if isinstance(document, dict) and {"columns", "data"} <= document.keys():
        names, rows = document["columns"], document["data"]
        return [dict(zip(names, row, strict=True)) for row in rows]
    # Single values by their row, as pandas writes a column.
    if isinstance(document, dict) and all(
        isinstance(series, dict)
        and len(series) > 2
        and not any(isinstance(value, dict | list) for value in series.values())
        and list(series) == list(map(str, range(len(series))))
        for series in document.values()
    ):
        return {name: list(series.values()) for name, series in document.items()}
    if isinstance(document, list) and len(document) > 2 and isinstance(document[0], list):
        names, *rows = document
        if all(isinstance(name, str) for name in names) and not isinstance(rows[0][0], list):
            return [dict(zip(names, row, strict=True)) for row in rows]
    return document


def _texts(name: str, value: Any) -> Iterator[tuple[str, str]]:
    """Texts of a document that are no rows, by their name."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _texts(f"{name}.{key}" if name else key, inner)
    elif isinstance(value, str):
        yield name, value


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


def _arrays(name: str, value: Any) -> Iterator[tuple[str, list[Any]]]:
    """Arrays of a document by their name."""
    if isinstance(value, list):
        # An object is a recording and no row where its arrays are longer than there are objects.
        if value and all(
            any(
                isinstance(array, list) and len(array) > len(value)
                for array in (inner.values() if isinstance(inner, dict) else ())
            )
            for inner in value
        ):
            for place, inner in enumerate(value):
                yield from _arrays(f"{name or 'part'}({place + 1})", inner)
            return
        wide = bool(value) and all(isinstance(v, list) and len(v) > len(value) for v in value)
        # A signal in each row, where rows are longer than there are rows.
        yield name, list(map(list, zip(*value, strict=True))) if wide else value
    elif isinstance(value, dict):
        for key, inner in value.items():
            yield from _arrays(f"{name}.{key}" if name else key, inner)


def _channels(tables: Mapping[str, Iterable[Any]], texts: Mapping[str, str] = {}) -> Channels:
    """Columns of tables, which are single values, arrays or objects in a row.

    **Arguments:** `texts` beside them, by name, some of which may be units.
    """
    columns: dict[str, np.ndarray] = {}
    units: dict[str, str] = {}
    left_out: dict[str, str] = {}
    for table, rows in tables.items():
        for name, values in gathered(table, rows).items():
            found, why = numbers_of(values)
            if found is None:
                left_out[name] = why
            elif found.size > 1:
                columns[name] = found
                units |= {name: why} if why else {}
    notes = [f"'{name}' left out: {why}" for name, why in left_out.items()]
    found = with_units_beside(Channels(columns, units, {}, left_out, notes), texts)
    return with_structure_times(without_common_group(found, "."))


def gathered(table: str, rows: Iterable[Any]) -> dict[str, list[Any]]:
    """Values of each column of a table, named `table.column`, `None` where a row has none.

    **Arguments:** `rows`, of dictionaries and lists in each other, or of single values.
    """
    columns: dict[str, dict[int, Any]] = {}
    count = filled = 0
    for row in rows:
        for name, value in _fields(table, row):
            column = columns.setdefault(name, {})
            if count in column:
                raise DataError(f"two fields are called '{name}'.")
            column[count] = value
            filled += 1
        count += 1
        check_column_count(len(columns))
    check_unpacked(8 * count * len(columns))
    if filled < count * len(columns) / SPARSEST and count * len(columns) > FEWEST_CHECKED:
        raise DataError(
            f"its {count} rows have {len(columns)} names and only {filled} values; give a field the"
            " same name in each row."
        )
    return {name: list(map(column.get, range(count))) for name, column in columns.items()}


def _fields(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Single values of an object by their name."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _fields(f"{name}.{key}" if name else key, inner)
    elif isinstance(value, list):
        for place, inner in enumerate(value):
            yield from _fields(f"{name}[{place}]", inner)
    else:
        yield name or "values", value


def numbers_of(values: list[Any]) -> tuple[np.ndarray | None, str]:
    """A column as floats and its unit, if known; or `None` and why it holds none."""
    text = next((value for value in values if isinstance(value, str)), None)
    if text is None:
        return np.array([np.nan if v is None else float(v) for v in values]), ""
    found, stamped = of_texts(values)
    return found, f"it holds text, {text[:40]!r}" if found is None else "s" * stamped
