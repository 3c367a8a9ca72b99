"""Tables in text files as data loggers write them: encoding, dialect, header, columns."""

import codecs
import contextlib
import csv
import io
import itertools
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from pyarrow import csv as pa_csv

from riecjax.errors import DataError
from riecjax.records.reading import literals
from riecjax.records.reading.channels import (
    MOST_COLUMNS,
    NUMBERED,
    Channels,
    check_declared,
    first_sentence,
)
from riecjax.records.reading.literals import compute, kinds_of
from riecjax.records.reading.times import is_called_time
from riecjax.records.reading.units import (
    BRACKETS,
    SECONDS,
    bare_unit,
    contradict,
    is_known,
    split_unit,
)

QUOTED = 2**12
"""Bytes at the start of a file that tell its encoding, and whether whole rows are quoted."""
MOSTLY = 0.9
"""Share of numbers in a column from which a text in it is an error, not a sign of a text column."""
OTHER_FORMATS = {
    b"PK\x03\x04": "an Excel workbook or another zip archive",
    b"\x1f\x8b": "packed by gzip",
    b"\xd0\xcf\x11\xe0": "a workbook of Excel before 2007 (.xls)",
    b"\x89HDF": "an HDF5 file",
    b"MATLAB": "a MATLAB file",
    b"TDSm": "a TDMS file",
    b"PAR1": "a Parquet file",
}
"""What a file that begins so is, whatever its name."""
_ARABIC = str.maketrans("٠١٢٣٤٥٦٧٨٩۰۱۲۳۴۵۶۷۸۹٫", "01234567890123456789.", "٬")
_IN_ARABIC = re.compile(rb"\xd9[\xa0-\xa9]|\xdb[\xb0-\xb9]")
_CHUNK = 2**20
_CONTROLS = re.compile(rb"[\x01-\x08\x0e-\x1a\x1c-\x1f\x7f]")


def as_utf8(content: bytes) -> tuple[bytes, list[str]]:
    """A text file's content in UTF-8 with lines ended by `\\n`, and what was decided.

    UTF-8, UTF-16, and UTF-32 with a mark are recognised; any other text is taken as Latin-1, which
    differs from other 8-bit encodings in names but not in numbers. Digits of Arabic and Persian
    become those of ASCII, the sign of minus a hyphen; what has no width goes.

    **Raises:** `DataError` for a binary file.
    """
    for start, kind in OTHER_FORMATS.items():
        if content.startswith(start):
            raise DataError(f"it is {kind}, whatever its name says; unpack, rename or export it.")
    notes: list[str] = []
    even, odd = content[:QUOTED:2], content[1:QUOTED:2]

    def are_wide(zeros: bytes, letters: bytes) -> bool:
        return len(zeros) > 1 and zeros.count(0) > MOSTLY * len(zeros) and 0 not in letters

    encodings = {
        "utf-32": content.startswith((codecs.BOM_UTF32_LE, codecs.BOM_UTF32_BE)),
        "utf-16": content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)),
        # Without a mark: digits and delimiters have a zero as every other byte.
        "utf-16-le": are_wide(odd, even),
        "utf-16-be": are_wide(even, odd),
    }
    if wide := next((name for name, holds in encodings.items() if holds), ""):
        called = wide[:6].upper()
        try:
            content = content.decode(wide).encode()
        except UnicodeError:
            raise DataError(f"not a text file in {called}; it is damaged.") from None
        notes.append(f"read as {called}")
    whole = content.rstrip(b"\0")
    if 0 < len(whole) < len(content):
        notes.append(f"{len(content) - len(whole)} bytes of 0 at the end left out")
        content = whole
    place = content.find(b"\0")
    if place >= 0:
        raise DataError(f"not a text file in UTF-8: byte {place} is 0, as in binary files.")
    try:
        content.decode()
    except UnicodeDecodeError:
        if _CONTROLS.search(content[:_CHUNK]):
            raise DataError(
                "not a text file in UTF-8: it holds binary control characters."
            ) from None
        content = content.decode("latin-1").encode()
        notes.append("read as Latin-1, not being UTF-8")
    content = content.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    content = content.replace(codecs.BOM_UTF8, b"").replace("\u200b".encode(), b"")
    if b"\xe2\x88\x92" in content:
        content = re.sub(rb"\xe2\x88\x92(?=[\d.,])", b"-", content)
    if _IN_ARABIC.search(content[:_CHUNK]):
        content = content.decode().translate(_ARABIC).encode()
    return content, notes


FEWEST_MEASURED = 5
"""Rows on which it is decided that units stand behind numbers."""
MOST_HEADINGS, MOST_BREAKS = 40, 6
"""Lines in which names with a line break are looked for, and lines of one such row."""
_GROUPED = re.compile(
    rb"(?<![\d.,])(\d{1,3})('|\xe2\x80\x99|\xe2\x80\xaf|\xc2\xa0|\xc2\x92)(\d{3}(?:\2\d{3})*)(?!\d)"
)
_MEASURED = re.compile(r"[+-]?[\d.,]*\d(?:[eE][+-]?\d+)? ?(?P<unit>[^\s\d,;.+-][^,;\t]*)")
_AS_TEXT = re.compile(rb"(?m)(^|[,;\t])(?:=\"([^\"\n]*)\"|'([^'\n]*)')(?=[,;\t]|$)")
_OPEN = re.compile(rb'(?:^|[,;\t])[ ]*"[^"]*$')


def plain_rows(content: bytes) -> tuple[bytes, list[str], list[str]]:
    """A text without what stands around its numbers, what was taken off, and units behind numbers.

    Quotes around rows that a spreadsheet took for one cell (`"0,1"`), semicolons at the end of
    every line; units behind numbers, as of MATLAB's durations (`0.5 sec`); apostrophes and blanks
    that do not break, between thousands (`1'234.5`); single quotes, and what keeps a number from
    Excel (`="0.5"`); breaks within quoted names.

    **Returns:** the units by position.
    """
    notes = []
    if b'"' in content[:QUOTED]:
        # Rows of names on one line, where quoted names hold line breaks; later lines keep their
        # numbers.
        lines = content.split(b"\n", MOST_HEADINGS)
        for place in range(len(lines) - 1):
            for count in range(1, min(MOST_BREAKS, len(lines) - place)):
                row = b" ".join(lines[place : place + count])
                if not _OPEN.search(re.sub(rb'"[^"]*"', b"", row)):
                    lines[place : place + count] = [row, *[b""] * (count - 1)]
                    break
        content = b"\n".join(lines)
    if any(sign in content[:QUOTED] for sign in (b'="', b"'")):
        content = _AS_TEXT.sub(rb"\1\2\3", content)
    lines = [line for line in content[:QUOTED].split(b"\n")[:-1] if line.strip()]
    if lines and all(re.fullmatch(rb'[ \t]*"[^"]*[,;\t][^"]*"[ \t]*', line) for line in lines):
        content = re.sub(rb'(?m)^[ \t]*"|"[ \t]*$', b"", content)
        notes.append("quotes around rows removed")
    if content.rstrip().endswith(b";"):
        rows = [line.rstrip() for line in content.split(b"\n") if line.strip()]
        if sum(row.endswith(b";") for row in rows) >= len(rows) - 1:
            content = re.sub(rb"(?m);[ \t]*$", b"", content)
    content, units = _without_units(content)
    if any(sign in content for sign in (b"'", b"\xe2\x80", b"\xc2")):
        content, count = _GROUPED.subn(lambda match: match[0].replace(match[2], b""), content)
        notes += ["signs between thousands removed"] if count else []
    return content, notes, units


def _without_units(content: bytes) -> tuple[bytes, list[str]]:
    """Rows of numbers without the units behind them, where all rows have the same ones."""
    lines = content[: 4 * QUOTED].decode(errors="replace").split("\n")[:-1]
    rows = [line for line in lines if line.strip()][-FEWEST_MEASURED:]
    sign = next((sign for sign in ";\t," if all(sign in row for row in rows)), "")
    if len(rows) < FEWEST_MEASURED or not sign:
        return content, []
    found = [[_MEASURED.fullmatch(field.strip()) for field in row.split(sign)] for row in rows]
    units = [[match["unit"] if match else "" for match in row] for row in found]
    if any(row != units[0] for row in units) or not any(map(is_known, units[0])):
        return content, []
    behind = b"|".join(re.escape(unit.encode()) for unit in {*units[0]} if is_known(unit))
    pattern = rb"(?m)(?<=[\d.]) ?(?:" + behind + rb")(?=[ ]*(?:" + sign.encode() + rb"|$))"
    return re.sub(pattern, b"", content), [unit if is_known(unit) else "" for unit in units[0]]


NAMES = {",": "comma", ";": "semicolon", "\t": "tab", "|": "bar", " ": "white space"}
SIGNS = tuple(NAMES)[:-1]
"""Delimiters in order of preference; a blank, the last one, stands for any white space."""
MISFIT = 0.3
"""Badness past which a layout is taken only where there is no better one, with names or without."""
ROWS = frozenset(("signal", "signals", "name", "names", "channel", "channels"))
"""What a row of names calls itself in a field before them."""
REMARKS = frozenset(("comment", "comments", "remark", "remarks", "kommentar", "bemerkung"))
"""Columns that hold words, if anything."""
PLACES = ("TS", "RN")
"""What Campbell's TOA5 writes for the unit of a time stamp, and of a record's number."""
_FRAMED = re.compile(r"\s*(?:\w+\s*=\s*)?[\[({]+(?=[\s\d.,;+\-\"]|$)")


class Dialect(NamedTuple):
    """Delimiter (a blank: any white space) and decimal sign."""

    delimiter: str
    decimal: str

    @property
    def comment_signs(self) -> str:
        """Pattern of what makes a line a comment."""
        return "#|%|//" if self.delimiter == ";" else "#|%|;|//"

    def comment(self, line: str) -> re.Match[str] | None:
        """The sign that makes this line a comment."""
        return re.match(rf"\s*(?:{self.comment_signs})+\s*", line)

    def fields(self, line: str) -> list[str]:
        """The fields of one line, stripped."""
        if self.delimiter == " ":
            line = " ".join(line.split())
        if '"' not in line:
            return [field.strip() for field in line.split(self.delimiter)]
        fields = next(csv.reader([line], delimiter=self.delimiter), [])
        return [field.strip().strip('"').strip() for field in fields]

    def __str__(self) -> str:
        return f"delimiter {NAMES.get(self.delimiter, self.delimiter)}, decimal {self.decimal!r}"


class Layout(NamedTuple):
    """A table in a text file, as read in one dialect.

    **Fields:** `names` of the columns; `units` by position; `start`, the line (from 0) with the
    first row of numbers; `width`, fields in a row; `filled`, those up to the last that usually
    holds something; `header`, the line of the names; `badness`, the share of rows and fields that
    do not fit.
    """

    dialect: Dialect
    names: list[str]
    units: list[str]
    start: int
    width: int
    filled: int
    header: int
    badness: float

    @property
    def named(self) -> bool:
        """Whether there is a name for each column."""
        return len(self.names) == self.width


def layout(
    lines: list[str], delimiter: str | None, decimal: str | None, columns: Sequence[str] = ()
) -> Layout:
    """The one way to read these lines, the first of a file, as a table with named columns.

    Every dialect is tried; the one that gives the same number of names and numbers, with fewest
    fields that are no numbers, is taken. Where no row above the numbers can name them, or
    `columns` do, the first row of numbers is the first sample.

    **Raises:** `DataError` where there is none, or where two are equally good.
    """
    for line in lines:
        if len(line) > MOST_COLUMNS:
            check_declared(max(len(line.split()), *(line.count(d) + 1 for d in SIGNS)))
    text = "\n".join(lines)
    marks = [delimiter] if delimiter else [d for d in NAMES if d == " " or d in text]
    layouts = []
    for sign, mark in itertools.product([decimal] if decimal else [".", ","], marks):
        # A comma can be both only where quotes tell the two apart.
        if sign != mark or '"' in text:
            table = _layout(lines, Dialect(mark, sign))
            # One column only where its name holds no delimiter: else the file has more columns.
            alone = table and table.width == 1 and not delimiter and table.header >= 0
            if table and not (alone and any(d in lines[table.header] for d in SIGNS)):
                layouts.append(table)
    if not layouts:
        filled = [place for place, line in enumerate(lines) if line.strip()]
        if not filled:
            raise DataError("the file is empty; the first row must name the columns.")
        if len(filled) == 1:
            raise DataError("there are no samples below the column names.")
        place = filled[len(filled) // 2]
        raise DataError(
            f"no line holds numbers between delimiters; line {place + 1} is {lines[place][:60]!r}."
            " Take off brackets and labels, name delimiter and decimal sign (on the command line:"
            " --delimiter, --decimal), or export the file otherwise."
        )
    best = min(
        layouts,
        key=lambda one: (one.badness > MISFIT, not one.named, round(one.badness, 3), -one.width),
    )
    if columns and len(columns) not in (best.width, best.filled):
        raise DataError(f"{len(columns)} names are given for {best.width} columns of numbers.")
    if columns or best.header < 0:
        # Behind a delimiter at the end of each row there may be an empty column.
        names = list(columns) or [NUMBERED.format(place + 1) for place in range(best.width)]
        names += [""] * (best.width - len(names))
        units = best.units if len(best.units) == best.width else []
        best = best._replace(names=names, units=units)
    for place in [best.start] if best.named else [best.header, best.start]:
        if framed := _FRAMED.match(lines[place]):
            raise DataError(
                f"line {place + 1}: {framed[0].strip()!r} stands before the numbers; take brackets"
                " and labels off the rows."
            )
    if not best.named:
        twice = best.dialect.delimiter == "," and best.width == 2 * len(best.names)
        remedy = " If commas are decimal signs too, export the file with another delimiter."
        raise DataError(
            f"{len(best.names)} column names but {best.width} columns of numbers"
            f" ({best.dialect}; line {best.start + 1}).{remedy * twice}"
        )
    if (decimal, delimiter, best.width, best.dialect.decimal) == (None, None, 1, ","):
        for place in range(best.start, len(lines)):
            if "," in lines[place] and not best.dialect.comment(lines[place]):
                raise DataError(
                    f"line {place + 1}: {lines[place].strip()[:40]!r} is one number with a decimal"
                    " comma, or two columns; pass decimal=',' or delimiter=','."
                )
    return best


def _layout(lines: list[str], dialect: Dialect) -> Layout | None:
    rows = {
        place: dialect.fields(line)
        for place, line in enumerate(lines)
        if line.strip() and not dialect.comment(line)
    }
    kinds = {place: kinds_of(fields, dialect.decimal) for place, fields in rows.items()}
    usual = Counter(kind for kind in kinds.values() if "N" in kind or "S" in kind)
    if not usual:
        return None
    # The usual row is data; of equally usual ones the one with fewest texts.
    pattern = max(usual, key=lambda kind: (usual[kind], -_texts(kind), len(kind)))
    first = next(
        place
        for place, kind in kinds.items()
        if len(kind) == len(pattern)
        and all(a == b or "M" in (a, b) for a, b in zip(kind, pattern, strict=True))
    )
    width = len(pattern)
    header, units, start = _header(rows, kinds, first, pattern)
    names = [] if header is None else rows[header]
    if header is None:
        # The last comment above the numbers that names each column, or the one above its units.
        header, filled = -1, (place for place in reversed(range(first)) if lines[place].strip())
        signs = ((place, dialect.comment(lines[place])) for place in filled)
        comments = [
            (place, _joined(dialect.fields(lines[place][sign.end() :]), dialect, width))
            for place, sign in itertools.islice(itertools.takewhile(lambda s: s[1], signs), 2)
            if sign
        ]
        named = [len(n) == width and "T" in kinds_of(n, dialect.decimal) for _, n in comments]
        if named == [True, True] and _is_unit_row(comments[0][1]):
            (header, names), units = comments[1], list(map(bare_unit, comments[0][1]))
        elif named and named[0]:
            header, names = comments[0]
    names = _without_empty_end(names)
    if len(names) == width + 1 > 2:
        # What the row is, before its names, or a column of remarks that stayed empty.
        before, behind = names[0].lower() in ROWS, names[-1].lower() in REMARKS
        names = names[1:] if before else names[:-1] if behind else names
    names = _joined(names, dialect, width)
    if names and set(pattern[len(names) :]) == {"M"}:
        names = [*names, *[""] * (width - len(names))]
    # Rows of numbers above the first that fits are none to skip: the dialect is another one.
    data = [k for place, k in kinds.items() if place >= start or ("D" in k and "T" not in k)]
    ragged = sum(len(kind) != len(pattern) for kind in data) / len(data)
    texts = sum(map(_texts, data)) / max(sum(map(len, data)), 1)
    filled = len(pattern.rstrip("M"))
    return Layout(dialect, names, units, start, width, filled, header, ragged + texts)


def _texts(kind: str) -> int:
    """How many fields of a row are no numbers."""
    return kind.count("T") + kind.count("D")


def _header(
    rows: dict[int, list[str]], kinds: dict[int, str], first: int, pattern: str
) -> tuple[int | None, list[str], int]:
    """Line of the names, the units by position, and the line where data begins."""
    preceding = [place for place in reversed(rows) if place < first]
    width = len(pattern)
    filled = {place: len(_without_empty_end(rows[place])) for place in preceding}
    # A word alone, such as DATA or [data], heads a table and names no column of several.
    while (
        width > 1
        and len(preceding) > 1
        and filled[preceding[0]] == 1
        and not is_known(bare_unit(rows[preceding[0]][0]))
    ):
        del rows[preceding.pop(0)]

    def is_as_wide(place: int) -> bool:
        # A delimiter at the end of a row makes no column.
        return width in (filled[place], len(rows[place])) or {*pattern[filled[place] :]} == {"M"}

    above = [*itertools.takewhile(is_as_wide, preceding)]
    # Where no row above is as wide, the last one tells how many names there are instead.
    above = above or preceding[:1]
    # A row that is partly numbers below a row of names is data that went wrong, not a header.
    fallback = [place for place in above if "T" in kinds[place]]
    texts = [place for place in fallback if not set(kinds[place]) & {"N", "S"}]
    if not fallback:
        return None, [], first
    # Below a row of units there may be one of sensors, or of how values were taken.
    if len(texts) > 2 and [_is_unit_row(rows[place]) for place in texts[:2]] == [False, True]:
        above = [place for place in above if place < texts[0]]
        del rows[texts.pop(0)]
    named = stated = (texts or fallback)[0]
    below = [place for place in above if place > named]
    # Above units, names may be numbers, as of channels 1 and 2.
    upper = next((place for place in fallback if place < named), None)
    units: list[str] = []
    if below and _is_unit_row(rows[below[-1]]):
        stated, units = below[-1], rows[below[-1]]
    elif upper is not None and len(rows[upper]) == len(rows[named]) and _is_unit_row(rows[named]):
        named, units = upper, rows[named]
    return named, list(map(bare_unit, units)), min(place for place in rows if place > stated)


def _is_unit_row(fields: list[str]) -> bool:
    """Whether all fields are units, or most of them below one of time, which no name is."""
    # In brackets anything is a unit, and no name.
    known = [f in ("", *PLACES) or is_known(f) or BRACKETS.fullmatch(f) for f in fields]
    timed = bare_unit(fields[0]).lower() in SECONDS and sum(map(bool, known)) > len(fields) / 2
    return any(fields) and (all(known) or timed)


def _without_empty_end(fields: list[str]) -> list[str]:
    return fields[: max((place for place, field in enumerate(fields, 1) if field), default=0)]


def _joined(names: list[str], dialect: Dialect, width: int) -> list[str]:
    """Names delimited by blanks with their units: the blank before a bracket delimits none."""
    if dialect.delimiter != " " or len(names) <= width:
        return names
    return re.findall(r"\S+(?: [\[(]\S*)*", " ".join(names))


SAMPLE = 2**16
"""Bytes at the start of a file on which its dialect is decided."""
LONGEST_LINE = 2**22
"""Bytes of a line past which a file is no table."""
FEWEST_LINES, MOST_LINES = 6, 400
"""Lines on which the dialect is decided."""


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

    Delimiter, decimal sign, header, a row of units, comments, lines above the header and quotes
    around rows are recognised; what could be read in two ways is refused. Columns without a header
    are called `column 1`, `column 2`, ..., or by `columns`, and those of one name `x #1`, `x #2`,
    ...

    **Raises:** `DataError` naming the line and the text that is no number, for rows of unequal
    length, and for files that are not text or have no samples.
    """
    content, notes = as_utf8(file.read_bytes())
    content, taken_off, units = plain_rows(content)
    table = read_table(content, delimiter, decimal, columns, units)
    return replace(table, notes=notes + taken_off + table.notes)


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
    end = SAMPLE
    most = min(len(content), FEWEST_LINES * LONGEST_LINE)
    while end < most and content.count(b"\n", 0, end) < FEWEST_LINES:
        end *= 4
    lines = content[:end].decode(errors="replace").split("\n")
    if max(map(len, lines)) > LONGEST_LINE:
        raise DataError(
            f"a line has more than {LONGEST_LINE} characters; the file is no table of numbers."
        )
    lines = (lines if end >= len(content) else lines[:-1])[:MOST_LINES]
    found = layout(lines, delimiter, decimal, columns)
    check_declared(found.width)
    notes = []
    last = content[content.rfind(b"\n") + 1 :].decode()
    if last.strip() and not found.dialect.comment(last):
        fields = found.dialect.fields(last)
        if len(fields) < found.width and kinds_of(fields[:1], found.dialect.decimal) != "T":
            content = content[: -len(last.encode())]
            notes.append("the last line is cut off and left out")
    # Comments are blanked so that lines keep their numbers. To search for a byte is so much faster
    # than for a pattern that clean files pay nothing.
    body, comments = content.split(b"\n", found.start)[-1], 0
    signs = found.dialect.comment_signs.encode()
    if any(sign in body for sign in signs.split(b"|")):
        body, comments = re.subn(rb"(?m)^[ \t]*(?:" + signs + rb")[^\n]*", b"", body)
    if found.dialect.delimiter == " ":
        body = re.sub(rb"[ \t]+", b" ", body)
        body = re.sub(rb"(?m)^ | $", b"", body)
    elif found.dialect.delimiter != "\t" and (b"\n " in body or b"\n\t" in body):
        body = re.sub(rb"(?m)^[ \t]+$", b"", body)
    if found.width == 1:
        body = body.rstrip(b"\n")
    table = Table(body, found, decimal is not None)
    keys = [str(place) for place in range(found.width)]
    try:
        parsed = pa_csv.read_csv(
            pa.BufferReader(body),
            read_options=pa_csv.ReadOptions(column_names=keys, block_size=2 * LONGEST_LINE),
            parse_options=pa_csv.ParseOptions(
                delimiter=found.dialect.delimiter,
                newlines_in_values=b'"' in body,
                # In a single column a blank line is a gap.
                ignore_empty_lines=found.width > 1,
            ),
            convert_options=pa_csv.ConvertOptions(
                column_types=dict.fromkeys(keys, pa.string()), strings_can_be_null=False
            ),
        )
    except pa.ArrowInvalid as error:
        with contextlib.suppress(csv.Error):
            if ragged := next((row for row in table.rows() if len(row[1]) != found.width), None):
                raise DataError(
                    f"line {ragged[0]} has {len(ragged[1])} values for {found.width} columns; take"
                    " off that line, or correct it."
                ) from None
        raise DataError(first_sentence(error)) from None
    # A spreadsheet takes what follows this mark for a text and no formula.
    names = [re.sub(r"(^|[;|,\t]\s*)'(?=[=+@-])", r"\1", name) for name in found.names]
    filled = len(_without_empty_end(names))
    names[:filled] = [name or NUMBERED.format(k + 1) for k, name in enumerate(names[:filled])]
    names, kept, numbered = distinct(names, parsed)
    read = _columns(table, parsed.select(kept), names)
    stated = {name: unit for name in names if (unit := split_unit(name)[1])}
    by_place = found.units or units
    for name, place in zip(names, kept):
        unit = by_place[place] if place < len(by_place) else ""
        other = stated.get(name, "")
        both = f"{other} or {unit}" if contradict(other, unit) else unit
        stated |= {name: both} if unit else {}
    sign, header = found.dialect.delimiter, found.header
    above = sum(bool(line.strip()) for line in lines[: max(header, 0)])
    decided = {
        f"delimiter {NAMES.get(sign, sign)}": sign != "," and delimiter is None,
        "decimal comma": found.dialect.decimal == ",",
        "columns without names, called by their number": header < 0 and not columns,
        f"{above} line{'s' * (above > 1)} above the column names skipped": above,
        "column names taken from a comment": header >= 0
        and Dialect(",", ".").comment(lines[header]),
        "units taken from the row below the column names": found.units,
        f"{comments} comment line{'s' * (comments > 1)} skipped": comments,
    }
    notes = [*(note for note, holds in decided.items() if holds), *read.notes, *notes, *numbered]
    stated = {name: unit for name, unit in (stated | read.units).items() if name in read.columns}
    whole = replace(read, units=stated, notes=notes)
    whole.note_left_out("column")
    return whole


def _columns(table: Table, parsed: Any, names: list[str]) -> Channels:
    """Columns of numbers and of time stamps, and the others with the reason."""
    if not parsed.num_rows:
        raise DataError("there are no samples below the column names.")
    texts = {
        name: literals.stripped(parsed.column(place)) for place, name in enumerate(names) if name
    }
    for place, name in enumerate(names):
        if not name and literals.stripped(parsed.column(place)).null_count < parsed.num_rows:
            raise DataError(f"{len(texts)} column names but {len(names)} columns of numbers.")
    found, how = Channels({}), (table.layout.dialect.decimal, table.decimal_given)
    # Commas that may all separate thousands as well as decimals are refused.
    doubtful = None
    for text in texts.values() if how == (",", False) else ():
        with_comma = compute.and_(
            literals.is_numeric(text, *how), compute.match_substring(text, ",")
        )
        grouped = compute.match_substring_regex(text, literals.GROUPED["."])
        if compute.any(compute.and_not(with_comma, grouped)).as_py():
            break
        if doubtful is None and compute.any(with_comma).as_py():
            doubtful = with_comma.to_pylist().index(True), text
    else:
        if doubtful:
            row, text = doubtful
            raise DataError(
                f"line {table.line_of(row)}: {text[row].as_py()!r} has a decimal comma or"
                " commas between thousands; pass decimal=',' or decimal='.'."
            )
    for name, text in texts.items():
        values = literals.numbers(text, *how)
        if values is not None:
            found.take(name, values)
        elif not _first_other(table, literals.are_stamps(text), text):
            first = next((stamp.as_py() for stamp in text if stamp.is_valid), "the first")
            found.take(name, literals.seconds(text), "s")
            found.notes.append(f"column '{name}': time stamps, as seconds from {first}")
        else:
            other = _first_other(table, literals.is_numeric(text, *how), text)
            found.left_out[name] = f"it holds text, {other}"
    # Spreadsheets leave empty rows at the end.
    is_filled = np.any([~np.isnan(v) for v in found.columns.values()] or [[True]], axis=0)
    stop = np.flatnonzero(is_filled)[-1] + 1 if is_filled.any() else None
    return replace(found, columns={name: v[:stop] for name, v in found.columns.items()})


def _first_other(table: Table, valid: Any, text: Any) -> str:
    """The first text that is not valid, and its line; up to a tenth of such raise an error."""
    if literals.all_true(valid):
        return ""
    row = valid.to_pylist().index(False)
    said, line = repr(text[row].as_py()[:40]), table.line_of(row)
    if compute.mean(valid).as_py() >= MOSTLY:  # of those that are not null
        raise DataError(
            f"line {line}: {said} is not a number; take off that line, correct it, or leave the"
            " field empty."
        )
    return f"{said} on line {line}"


def distinct(names: list[str], table: Any) -> tuple[list[str], list[int], list[str]]:
    """Names of a table's columns (PyArrow), which of them to read, and what was decided.

    Of columns with one name and the same content, the first is read; others get a number: `x #1`,
    `x #2 [mm]`.

    **Raises:** `DataError` for two times of one name that differ, as nothing tells which signals
    are of which.
    """
    kept: list[int] = []
    for place, name in enumerate(names):
        same = (other for other in kept if name and names[other] == name)
        if not any(table.column(place).equals(table.column(other)) for other in same):
            kept.append(place)
    count = Counter(names[place] for place in kept)
    twice = [name for name, times in count.items() if name and times > 1]
    if times := [name for name in twice if is_called_time(name, {})]:
        raise DataError(
            f"two columns are called '{times[0]}' and differ; name all columns (on the command"
            " line: --columns A,B,...)."
        )
    seen: Counter[str] = Counter()
    found = []
    for place in kept:
        name, (bare, unit) = names[place], split_unit(names[place])
        seen[name] += 1
        number = f"{bare} #{seen[name]}" + (f" [{unit}]" if unit else "")
        found.append(number if name in twice else name)
    check_declared(names=filter(None, found))
    notes = [f"columns called '{name}' are numbered" for name in twice]
    if len(kept) < len(names):
        notes.append(f"{len(names) - len(kept)} copies of columns left out")
    return found, kept, notes
