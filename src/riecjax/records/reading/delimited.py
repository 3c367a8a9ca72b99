"""Reading tables in text files: CSV, TSV and what data loggers write."""

import csv
import io
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from riecjax.errors import DataError
from riecjax.records.reading.channels import (
    Channels,
    check_column_count,
    first_sentence,
)
from riecjax.records.reading.dialect import NAMES, Dialect, Layout, layout
from riecjax.records.reading.numerals import (
    GROUPED,
    compute,
    is_numeric,
    numbers,
    stripped,
)
from riecjax.records.reading.plain_rows import plain_rows
from riecjax.records.reading.repetitions import (
    distinct,
    without_end,
    without_headings,
)
from riecjax.records.reading.text_encoding import as_utf8
from riecjax.records.reading.time_stamps import are_stamps, seconds
from riecjax.records.reading.unit_expressions import readings, same
from riecjax.records.reading.units import split_unit

SAMPLE = 2**16
"""Bytes at the start of a file on which its dialect is decided."""
LONGEST_LINE = 2**22
"""Bytes of a line past which a file is no table."""
FEWEST_LINES, MOST_LINES = 6, 400
"""Lines on which the dialect is decided."""
MOSTLY = 0.9
"""Share of numbers in a column from which a text in it is an error, not a sign of a text column."""


class Table(NamedTuple):
    """A text file's rows below the header, their layout, and how the decimal sign was found.

    `body` is in UTF-8, comments blanked.
    """

    body: bytes
    layout: Layout
    decimal_given: bool

    def line_of(self, row: int) -> int:
        """The line, counted from 1 as in an editor, of a row counted from 0."""
        return next(line for place, (line, _) in enumerate(self.rows()) if place == row)

    def rows(self) -> Iterator[tuple[int, list[str]]]:
        """Line number and fields of each row that is not blank; slow, for messages only."""
        text = io.StringIO(self.body.decode(), newline="\n")
        reader = csv.reader(text, delimiter=self.layout.dialect.delimiter)
        for fields in reader:
            if fields or self.layout.width == 1:
                yield self.layout.start + reader.line_num, fields


def read_delimited(
    file: Path,
    delimiter: str | None = None,
    decimal: str | None = None,
    columns: Sequence[str] = (),
) -> Channels:
    """Read a text file of columns.

    Delimiter, decimal sign, header, a row of units, comments, lines above the header and below the
    rows, and brackets or quotes around rows are recognised; what could be read in two ways is
    refused. Columns without a header are called `column 1`, `column 2`, ..., or by `columns`, and
    those of one name `x #1`, `x #2`, ...

    **Raises:** `DataError` naming the line and the text that is no number, for rows of unequal
    length, and for files that are not text or have no samples.
    """
    content, notes = as_utf8(file.read_bytes())
    plain = plain_rows(content)
    found = read_table(plain.content, delimiter, decimal, columns or plain.labels, plain.units)
    return replace(found, notes=[*notes, *plain.notes, *found.notes])


def read_table(
    content: bytes,
    delimiter: str | None,
    decimal: str | None,
    columns: Sequence[str] = (),
    units: Sequence[str] = (),
) -> Channels:
    """Read a table in text, in UTF-8 with lines ended by `\\n`; see [`read_delimited`][].

    **Arguments:** `units` by position, where the table has no row of them.
    """
    lines = _first_lines(content)
    found = layout(lines, delimiter, decimal, columns)
    check_column_count(found.width)
    content, ended = without_end(content, found, lines[found.start])
    body, comments = _body(content, found)
    head = lines[max(found.header, 0) : found.start]
    body, repeated = without_headings(body, head, found.dialect)
    table = Table(body, found, decimal is not None)
    parsed = _parse(table)
    names, kept, numbered = distinct(_names(found.names), parsed)
    read, left_out, stamped = _columns(table, parsed.select(kept), names)
    by_place = found.units or units
    row = [by_place[place] for place in kept if place < len(by_place)]
    stated = _units(names, row) | dict.fromkeys(stamped, "s")
    notes = _notes(found, lines, comments, stamped, delimiter is not None)
    notes += [*ended, *repeated, *numbered]
    notes += [f"column '{name}' left out: {why}" for name, why in left_out.items()]
    return Channels(read, {k: u for k, u in stated.items() if k in read}, {}, left_out, notes)


def _first_lines(content: bytes) -> list[str]:
    end = SAMPLE
    while True:
        head = content[:end]
        whole = len(head) == len(content)
        lines = head.decode(errors="replace").split("\n")
        if whole or len(lines) > FEWEST_LINES or end > FEWEST_LINES * LONGEST_LINE:
            break
        end *= 4
    longest = max(map(len, lines))
    if longest > LONGEST_LINE:
        raise DataError(
            f"a line has more than {LONGEST_LINE} characters; the file is no table of numbers."
        )
    return (lines if whole else lines[:-1])[:MOST_LINES]


def _body(content: bytes, found: Layout) -> tuple[bytes, int]:
    """The rows below the header, comments blanked so that lines keep their numbers."""
    start = 0
    for _ in range(found.start):
        start = content.index(b"\n", start) + 1
    body = content[start:]
    comments = 0
    signs = (b"#", b"%", b"//") if found.dialect.delimiter == ";" else (b"#", b"%", b"//", b";")
    # Searching for a byte is so much faster than for a pattern that clean files pay nothing.
    if any(sign in body for sign in signs):
        body, comments = re.subn(rb"(?m)^[ \t]*(?:" + b"|".join(signs) + rb")[^\n]*", b"", body)
    if found.dialect.delimiter == " ":
        body = re.sub(rb"[ \t]+", b" ", body)
        body = re.sub(rb"(?m)^ | $", b"", body)
    elif found.dialect.delimiter != "\t" and (b"\n " in body or b"\n\t" in body):
        body = re.sub(rb"(?m)^[ \t]+$", b"", body)
    if found.width == 1:
        body = body.rstrip(b"\n")
    return body, comments


def _parse(table: Table) -> Any:
    import pyarrow as pa
    from pyarrow import csv as pa_csv

    width = table.layout.width
    keys = [str(place) for place in range(width)]
    try:
        return pa_csv.read_csv(
            pa.BufferReader(table.body),
            read_options=pa_csv.ReadOptions(column_names=keys, block_size=2 * LONGEST_LINE),
            parse_options=pa_csv.ParseOptions(
                delimiter=table.layout.dialect.delimiter,
                newlines_in_values=b'"' in table.body,
                # In a single column a blank line is a sample that is missing.
                ignore_empty_lines=width > 1,
            ),
            convert_options=pa_csv.ConvertOptions(
                column_types=dict.fromkeys(keys, pa.string()), strings_can_be_null=False
            ),
        )
    except pa.ArrowInvalid as error:
        raise DataError(_ragged_row(table) or first_sentence(error)) from None


def _ragged_row(table: Table) -> str:
    """In words, the first row that has not one value for each column."""
    try:
        for line, fields in table.rows():
            if len(fields) != table.layout.width:
                return f"line {line} has {len(fields)} values for {table.layout.width} columns."
    except csv.Error as error:
        return first_sentence(error)
    return ""


def _columns(
    table: Table, parsed: Any, names: list[str]
) -> tuple[dict[str, np.ndarray], dict[str, str], dict[str, str]]:
    """Columns of numbers, the other columns with the reason, and of time stamps the first."""
    if not parsed.num_rows:
        raise DataError("there are no samples below the column names.")
    texts = {name: stripped(parsed.column(place)) for place, name in enumerate(names) if name}
    _refuse_nameless(parsed, names)
    if table.layout.dialect.decimal == "," and not table.decimal_given:
        _refuse_thousands(table, texts)
    columns: dict[str, np.ndarray] = {}
    left_out: dict[str, str] = {}
    stamped: dict[str, str] = {}
    for name, text in texts.items():
        values = numbers(text, table.layout.dialect.decimal, table.decimal_given)
        if values is None and _all_valid(table, are_stamps(text), text):
            values = seconds(text)
            stamped[name] = next((stamp.as_py() for stamp in text if stamp.is_valid), "the first")
        if values is None:
            valid = is_numeric(text, table.layout.dialect.decimal, table.decimal_given)
            _all_valid(table, valid, text)
            row = valid.to_pylist().index(False)
            left_out[name] = (
                f"it holds text, {text[row].as_py()[:40]!r} on line {table.line_of(row)}"
            )
        else:
            columns[name] = values
    return _without_blank_end(columns), left_out, stamped


def _all_valid(table: Table, valid: Any, text: Any) -> bool:
    """Whether all texts are valid; up to a tenth that are not raise an error naming the first."""
    flags = np.array([flag for flag in valid.to_pylist() if flag is not None], dtype=bool)
    if flags.size and flags.all():
        return True
    if flags.size and flags.mean() >= MOSTLY:
        row = valid.to_pylist().index(False)
        raise DataError(
            f"line {table.line_of(row)}: {text[row].as_py()[:40]!r} is not a number; correct it, or"
            " leave the field empty."
        )
    return False


def _refuse_nameless(parsed: Any, names: list[str]) -> None:
    for place, name in enumerate(names):
        if not name and stripped(parsed.column(place)).null_count < parsed.num_rows:
            filled = sum(bool(each) for each in names)
            raise DataError(f"{filled} column names but {len(names)} columns of numbers.")


def _refuse_thousands(table: Table, texts: dict[str, Any]) -> None:
    """Refuse a file whose commas may all separate thousands as well as decimals."""
    pc = compute()

    doubtful = None
    for text in texts.values():
        valid = pc.fill_null(is_numeric(text, ",", False), False)
        with_comma = pc.and_(valid, pc.fill_null(pc.match_substring(text, ","), False))
        grouped = pc.fill_null(pc.match_substring_regex(text, GROUPED["."]), False)
        if pc.any(pc.and_not(with_comma, grouped)).as_py():
            return
        if doubtful is None and pc.any(with_comma).as_py():
            doubtful = with_comma.to_pylist().index(True), text
    if doubtful:
        row, text = doubtful
        raise DataError(
            f"line {table.line_of(row)}: {text[row].as_py()!r} has a decimal comma or"
            " commas between thousands; pass decimal=',' or decimal='.'."
        )


def _without_blank_end(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Without the empty rows at the end that spreadsheets leave."""
    if not columns:
        return columns
    filled = np.flatnonzero(np.any([~np.isnan(values) for values in columns.values()], axis=0))
    stop = filled[-1] + 1 if filled.size else None
    return {name: values[:stop] for name, values in columns.items()}


def _names(header: list[str]) -> list[str]:
    """Names of the columns; those at the end without a name stay empty."""
    last = max((place for place, name in enumerate(header) if name), default=-1)
    # With this mark a spreadsheet takes what follows for a text and no formula.
    header = [re.sub(r"(^|[;|,\t]\s*)'(?=[=+@-])", r"\1", name) for name in header]
    return [
        name or (f"column {place + 1}" if place < last else "") for place, name in enumerate(header)
    ]


def _units(names: list[str], row: list[str]) -> dict[str, str]:
    units = {name: unit for name in names if (unit := split_unit(name)[1])}
    for name, unit in zip(names, row):
        other = units.get(name, "")
        differ = readings(other) and readings(unit) and not same(other, unit)
        units |= {name: f"{other} or {unit}" if differ else unit} if unit else {}
    return units


def _notes(
    found: Layout, lines: list[str], comments: int, stamped: dict[str, str], given: bool
) -> list[str]:
    notes = []
    if found.dialect.delimiter != "," and not given:
        notes.append(f"delimiter {NAMES.get(found.dialect.delimiter, found.dialect.delimiter)}")
    if found.dialect.decimal == ",":
        notes.append("decimal comma")
    if found.header < 0 and found.numbered:
        notes.append("columns without names, called by their number")
    above = sum(bool(line.strip()) for line in lines[: max(found.header, 0)])
    if above:
        notes.append(f"{above} line{'s' * (above > 1)} above the column names skipped")
    if found.header >= 0 and Dialect(",", ".").comment(lines[found.header]):
        notes.append("column names taken from a comment")
    if found.units:
        notes.append("units taken from the row below the column names")
    if comments:
        notes.append(f"{comments} comment line{'s' * (comments > 1)} skipped")
    return notes + [
        f"column '{name}': time stamps, as seconds from {first}" for name, first in stamped.items()
    ]
