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

OTHER_FORMATS = {
    b"PK\x03\x04": "an Excel workbook or another zip archive",
    b"\x1f\x8b": "packed by gzip",
    b"\x89HDF": "an HDF5 file",
}
"""What a file that begins so is, whatever its name."""


MARKS = {
    codecs.BOM_UTF32_LE: "UTF-32",
    codecs.BOM_UTF32_BE: "UTF-32",
    codecs.BOM_UTF16_LE: "UTF-16",
    codecs.BOM_UTF16_BE: "UTF-16",
}
"""Encodings by what a text in them begins with, the longest first."""
HEAD = 2**12
"""Bytes at the start of a file in which quoted names with line breaks are looked for."""
_BROKEN = re.compile(rb'(?m)(?:^|(?<=[,;\t]))"[^"]*\n[^"]*"(?=[,;\t]|$)')


def as_utf8(content: bytes) -> tuple[bytes, list[str]]:
    """A text file's content in UTF-8 with lines ended by `\\n`, and what was decided.

    UTF-8, and UTF-16 and UTF-32 with a mark, are recognised; any other text is taken as Latin-1,
    which differs from other 8-bit encodings in names but not in numbers. A sign of minus becomes a
    hyphen, a line break within a quoted name a blank; what has no width goes, and so do the quotes
    of spreadsheets around whole rows and of `="0.5"`.

    **Raises:** `DataError` for a binary file.
    """
    for start, kind in OTHER_FORMATS.items():
        if content.startswith(start):
            raise DataError(f"it is {kind}, whatever its name says; unpack, rename or export it.")
    notes: list[str] = []
    if name := next((name for mark, name in MARKS.items() if content.startswith(mark)), ""):
        content = content.decode(name, "replace").encode()
        notes.append(f"read as {name}")
    whole = content.rstrip(b"\0")
    if 0 < len(whole) < len(content):
        notes.append(f"{len(content) - len(whole)} bytes of 0 at the end left out")
        content = whole
    place = content.find(b"\0")
    if place >= 0:
        raise DataError(
            f"not a text file in UTF-8: byte {place} is 0, as in binary files; save text as UTF-8."
        )
    if not content.isascii():
        try:
            text = content.decode()
        except UnicodeDecodeError:
            text = content.decode("latin-1")
            notes.append("read as Latin-1, not being UTF-8")
        text = re.sub("\N{MINUS SIGN}(?=[\\d.,])", "-", re.sub("[\ufeff\u200b]", "", text))
        content = text.encode()
    if b"\r" in content:
        content = content.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    head = content[:HEAD]
    joined = _BROKEN.sub(lambda name: name[0].replace(b"\n", b" "), head)
    if lost := head.count(b"\n") - joined.count(b"\n"):
        # Later lines keep their numbers.
        content = b"\n" * lost + joined + content[HEAD:]
    if b'="' in head:
        content = re.sub(rb'="([^"\n]*)"', rb"\1", content)
    lines = head.split(b"\n")[:-1]
    if lines and all(re.fullmatch(rb'"[^"]*[,;\t][^"]*"', line.strip()) for line in lines):
        content = re.sub(rb'(?m)^[ \t]*"|"[ \t]*$', b"", content)
    return content, notes


NAMES = {",": "comma", ";": "semicolon", "\t": "tab", "|": "bar", " ": "white space"}
SIGNS = tuple(NAMES)[:-1]
"""Delimiters in order of preference; a blank, the last one, stands for any white space."""
ROWS = ("signal", "signals", "name", "names", "channel", "channels")
"""What a row of names calls itself in a field before them."""
REMARKS = ("comment", "comments", "remark", "remarks", "kommentar", "bemerkung")
"""Columns that hold words, if anything."""


class Dialect(NamedTuple):
    """Delimiter (a blank: any white space) and decimal sign."""

    delimiter: str
    decimal: str

    @property
    def comments(self) -> tuple[str, ...]:
        """What makes a line a comment, as patterns; what a spreadsheet's formula gives is none."""
        signs = (rf"#(?!{literals.NO_RESULT[1:]})", "%", "//", ";")
        return signs[:-1] if self.delimiter == ";" else signs

    def comment(self, line: str) -> re.Match[str] | None:
        """The sign that makes this line a comment."""
        return re.match(rf"\s*(?:{'|'.join(self.comments)})+\s*", line)

    def fields(self, line: str) -> list[str]:
        """The fields of one line, stripped."""
        if self.delimiter == " ":
            line = " ".join(line.split())
        if '"' not in line:
            return [field.strip() for field in line.split(self.delimiter)]
        fields = next(csv.reader([line], delimiter=self.delimiter), [])
        return [field.strip().strip('"').strip() for field in fields]


class Layout(NamedTuple):
    """A table in a text file, as read in one dialect.

    **Fields:** `names` of the columns; `units` by position; `start`, the line (from 0) with the
    first row of numbers; `pattern`, what the usual row holds, by
    [`kinds_of`][riecjax.records.reading.literals.kinds_of]; `header`, the line of the names, -1 if
    there is none; `badness`, the share of rows and fields that do not fit; `kinds` of the
    fields of each row, by its line.
    """

    dialect: Dialect
    names: list[str]
    units: list[str]
    start: int
    pattern: str
    header: int
    badness: float
    kinds: dict[int, str]

    @property
    def width(self) -> int:
        """Fields in a row."""
        return len(self.pattern)

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

    **Raises:** `DataError` where there is none, where commas may mean two things, and for rows of
    numbers above the column names.
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
            sure = delimiter or table is None or table.width > 1 or table.header < 0
            if table and (sure or not any(d in lines[table.header] for d in SIGNS)):
                layouts.append(table)
    if not layouts:
        filled = [place for place, line in enumerate(lines) if line.strip()]
        if len(filled) < 2:
            raise DataError(
                "there are no samples below the column names; the first row must name the columns."
            )
        place = filled[len(filled) // 2]
        raise DataError(
            f"no line holds numbers between delimiters; line {place + 1} is {lines[place][:60]!r}."
            " Take off brackets and labels, name delimiter and decimal sign (on the command line:"
            " --delimiter, --decimal), or export the file otherwise."
        )
    best = min(layouts, key=lambda one: (not one.named, one.badness, -one.width))
    dialect, width = best.dialect, best.width
    if columns and len(columns) not in (width, len(best.pattern.rstrip("M"))):
        raise DataError(f"{len(columns)} names are given for {width} columns of numbers.")
    if columns or best.header < 0:
        # Behind a delimiter at the end of each row there may be an empty column.
        names = list(columns) or [NUMBERED.format(place + 1) for place in range(width)]
        best = best._replace(names=names + [""] * (width - len(names)))
    if not best.named:
        raise DataError(
            f"{len(best.names)} column names but {width} columns of numbers (line"
            f" {best.start + 1}). Name all columns (on the command line: --columns A,B,...). If"
            " commas are decimal signs too, export the file with another delimiter."
        )
    skipped = [n for n, k in best.kinds.items() if n < best.header and "NN" in k and not _texts(k)]
    if len(skipped) > 2:
        raise DataError(
            f"line {skipped[0] + 1} and {len(skipped) - 1} more hold numbers above the column names"
            f" on line {best.header + 1}; split the file there."
        )
    if decimal or dialect.decimal == ".":
        return best
    commas = [
        (place, literals.bare_number(field))
        for place, kind in best.kinds.items()
        for field, letter in zip(dialect.fields(lines[place]), kind, strict=True)
        if place >= best.start and letter == "N" and "," in field
    ]
    alone = width == 1 and not delimiter
    if commas and (alone or all(re.fullmatch(literals.GROUPED["."], f) for _, f in commas)):
        place, field = commas[0]
        others = "two columns" if alone else "commas between thousands"
        raise DataError(
            f"line {place + 1}: {field!r} has a decimal comma, or {others}; pass decimal=',' or"
            f" {'delimiter=' if alone else 'decimal='}'{',' if alone else '.'}'."
        )
    return best


def _layout(lines: list[str], dialect: Dialect) -> Layout | None:
    rows = {
        place: dialect.fields(line)
        for place, line in enumerate(lines)
        if line.strip() and not dialect.comment(line)
    }
    kinds = {place: kinds_of(fields, dialect.decimal) for place, fields in rows.items()}
    numeric = {place: kind for place, kind in kinds.items() if {*kind} & {*"NS"}}
    # Brackets and labels are to be taken off.
    usual = Counter(k for place, k in numeric.items() if lines[place].lstrip()[0] not in "[({")
    if not usual:
        return None
    # The usual row is data; of equally usual ones the one with fewest texts.
    pattern = max(usual, key=lambda kind: (usual[kind], -_texts(kind), len(kind)))
    width = len(pattern)
    first = next(
        place
        for place, kind in kinds.items()
        if len(kind) == width
        and all(a == b or "M" in (a, b) for a, b in zip(kind, pattern, strict=True))
    )
    header, names, units, start = _header(rows, dialect, first, pattern)
    if header < 0:
        # Comments directly above, each of which names every column, or states its unit.
        said = {first: rows[first]}
        above = [place for place in range(first) if lines[place].strip()]
        while above and (sign := dialect.comment(lines[above[-1]])):
            names = _joined(dialect.fields(lines[above[-1]][sign.end() :]), dialect, width)
            if len(names) != width:
                break
            said = {above.pop(): names} | said
        header, names, units, _ = _header(said, dialect, first, pattern)
        # Rows of numbers above the first that fits, or of its width, are no preamble.
        start = next(
            place
            for place, kind in kinds.items()
            if place == first
            or (place > header and "T" not in kind and kind.strip("M"))
            or (place > header and len(kind) == width and kind[0] in "NSD")
        )
    names = _without_empty_end(names)
    # What the row is, before its names, or a column of remarks that stayed empty.
    if len(names) == width + 1 > 2:
        names = names[names[0].lower() in ROWS :]
        names = names[: width + (names[-1].lower() not in REMARKS)]
    names = _joined(names, dialect, width)
    if names and set(pattern[len(names) :]) == {"M"}:
        names = [*names, *[""] * (width - len(names))]
    data = [kind for place, kind in kinds.items() if place >= start]
    ragged = sum(len(kind) != width for kind in data) / len(data)
    texts = sum(map(_texts, data)) / sum(map(len, data))
    return Layout(dialect, names, units, start, pattern, header, ragged + texts, kinds)


def _texts(kind: str) -> int:
    """How many fields of a row are no numbers."""
    return kind.count("T") + kind.count("D")


def _header(
    rows: dict[int, list[str]], dialect: Dialect, first: int, pattern: str
) -> tuple[int, list[str], list[str], int]:
    """Line of the names, -1 for none; names and units by position; the line where data begins."""
    preceding = [place for place in reversed(rows) if place < first]
    kinds = {place: kinds_of(rows[place], dialect.decimal) for place in preceding}
    width = len(pattern)
    # A word alone, such as DATA or [data], heads a table and names no column of several.
    while (
        width > 1
        and len(preceding) > 1
        and kinds[preceding[0]].rstrip("M") == "T"
        and not is_known(bare_unit(rows[preceding[0]][0]))
    ):
        del rows[preceding.pop(0)]

    def is_as_wide(place: int) -> bool:
        # A delimiter at the end of a row makes no column.
        filled = len(kinds[place].rstrip("M"))
        return width in (filled, len(kinds[place])) or {*pattern[filled:]} == {"M"}

    # Where no row above is as wide, the last one tells how many names there are instead.
    above = [*itertools.takewhile(is_as_wide, preceding)] or preceding[:1]
    units = [place for place in above if _is_unit_row(rows[place])]
    # A row that begins with a number is data that went wrong, not a header.
    said = [p for p in above if p in units or ("T" in kinds[p] and kinds[p][0] not in "NS")]
    # So is one that is partly numbers below a row of names.
    texts = [place for place in said if not {*kinds[place]} & {*"NS"}]
    if not said:
        return -1, [], [], first
    # Below a row of units there may be one of sensors, or of how values were taken.
    unit = next((place for place in said[:2] if place in units and place != said[-1]), None)
    if unit is None:
        named = stated = (texts or said)[0]
        stated_units = []
    else:
        named, stated = said[said.index(unit) + 1], max(unit, *texts[:1])
        stated_units = [bare_unit(text) for text in rows[unit]]
    return named, rows[named], stated_units, min(place for place in rows if place > stated)


def _is_unit_row(fields: list[str]) -> bool:
    """Whether all fields are units, or most of them below one of time, which no name is."""
    # In brackets anything is a unit, and no name; Campbell's TOA5 has TS and RN for those of a time
    # stamp and of a record's number.
    known = [f in ("", "TS", "RN") or is_known(f) or BRACKETS.fullmatch(f) for f in fields]
    timed = bare_unit(fields[0]).lower() in SECONDS and sum(map(bool, known)) > len(fields) / 2
    return any(fields) and (all(known) or timed)


def _without_empty_end(fields: list[str]) -> list[str]:
    return fields[: max((place for place, field in enumerate(fields, 1) if field), default=0)]


def _joined(names: list[str], dialect: Dialect, width: int) -> list[str]:
    """Names delimited by blanks with their units: the blank before a bracket delimits none."""
    if dialect.delimiter != " " or len(names) <= width:
        return names
    return re.findall(r"\S+(?: [\[(]\S*)*", " ".join(names))


MOSTLY = 0.9
"""Share of numbers in a column from which a text in it is an error, not a sign of a text column."""
SAMPLE, MOST_LINES, FEWEST_LINES = 2**16, 400, 6
"""Bytes and lines at the start of a file on which its dialect is decided, at the most, but for as
many lines at the least."""
LONGEST_LINE = 2**22
"""Bytes of a line past which a file is no table."""


class _Misfit(DataError):
    """A row, by its line, that the dialect of the rows above does not fit."""

    def __init__(self, line: int, message: str):
        self.line = line
        super().__init__(message)


class Table(NamedTuple):
    """A text file's rows below the header.

    **Fields:** `content` in UTF-8, comments blanked; `place` of the first row's first byte;
    `layout`; `comments`, and `copies` of the names, how many.
    """

    content: bytes
    place: int
    layout: Layout
    comments: int
    copies: int

    def rows(self) -> Iterator[tuple[int, list[str]]]:
        """Line, from 1, and fields of each row that is not blank; slow, for messages only."""
        text = io.StringIO(self.content[self.place :].decode(), newline="\n")
        reader = csv.reader(text, delimiter=self.layout.dialect.delimiter)
        for fields in reader:
            if fields or self.layout.width == 1:
                yield self.layout.start + reader.line_num, fields

    def parsed(self) -> Any:
        """The fields of all rows, a column of floats where PyArrow takes all of it for numbers.

        **Raises:** `DataError` for rows of unequal length, and for quotes around line ends.
        """
        (delimiter, decimal), width = self.layout.dialect, self.layout.width
        is_quoted = self.content.find(b'"', self.place) >= 0
        rows = self.content[self.place :].split(b"\n") if is_quoted else []
        texts = {str(place): pa.string() for place in range(width)}
        numbers = {k: pa.float64() for k, kind in zip(texts, self.layout.pattern) if kind in "NM"}
        failed = "quotes in it go on over line ends."
        for types in (texts | numbers, texts):
            try:
                table = pa_csv.read_csv(
                    pa.BufferReader(pa.py_buffer(self.content).slice(self.place)),
                    # Blocks that hold the longest line are also fast.
                    pa_csv.ReadOptions(column_names=[*texts], block_size=2 * LONGEST_LINE),
                    pa_csv.ParseOptions(
                        delimiter=delimiter,
                        newlines_in_values=is_quoted,
                        # In a single column a blank line is a gap.
                        ignore_empty_lines=width > 1,
                    ),
                    pa_csv.ConvertOptions(
                        column_types=types,
                        null_values=literals.MISSING,
                        strings_can_be_null=True,
                        decimal_point=decimal,
                    ),
                )
            except pa.ArrowInvalid as error:
                failed = first_sentence(error)
            else:
                if table.num_rows >= sum(map(bool, rows)):
                    return table
        with contextlib.suppress(csv.Error):
            for line, fields in self.rows():
                if any("\n" in field for field in fields):
                    raise DataError(
                        f"line {line}: a text in quotes goes on from a line above; take off the"
                        " quotes, or the line ends in them."
                    )
                if len(fields) != width:
                    raise _Misfit(
                        line,
                        f"line {line} has {len(fields)} values for {width} columns; take off that"
                        " line, correct it, or name the delimiter (on the command line:"
                        " --delimiter).",
                    )
        raise DataError(failed)


def table_of(content: bytes, head: list[bytes], found: Layout) -> Table:
    """The rows below the header in this layout, of which `head` holds the first lines."""
    dialect, place, comments = found.dialect, sum(map(len, head[: found.start])), 0

    def holds(*signs: bytes) -> bool:
        # To search for a byte is so much faster than for two, or a pattern, that clean files pay
        # nothing.
        return any(content.find(s[:1], place) >= 0 and content.find(s, place) >= 0 for s in signs)

    # Comments are blanked so that lines keep their numbers.
    if holds(*(sign.partition("(")[0].encode() for sign in dialect.comments)):
        pattern = rf"(?m)^[ \t]*(?:{'|'.join(dialect.comments)})[^\n]*".encode()
        (content, comments), place = re.subn(pattern, b"", content[place:]), 0
    if dialect.delimiter == " ":
        content, place = content[place:].replace(b"\t", b" "), 0
        while b"  " in content:
            content = content.replace(b"  ", b" ")
        content = content.replace(b"\n ", b"\n").replace(b" \n", b"\n").strip(b" ")
    elif dialect.delimiter != "\t" and holds(b" ", b"\t") and holds(b"\n ", b"\n\t"):
        content, place = re.sub(rb"(?m)^[ \t]+$", b"", content[place:]), 0
    if found.width == 1:
        content = content.rstrip(b"\n")
    # A logger that opens its file again writes the names again.
    again = b"".join(head[found.header : found.start]) if found.header >= 0 else b""
    if copies := content.count(again, place) if again else 0:
        blank = b"\n" * again.count(b"\n")
        content, place = content[place:].replace(again, blank), 0
    return Table(content, place, found, comments, copies)


def read_delimited(
    file: Path,
    delimiter: str | None = None,
    decimal: str | None = None,
    columns: Sequence[str] = (),
) -> Channels:
    """Read a text file of columns.

    Delimiter, decimal sign, header, a row of units, comments and lines above the header are
    recognised; what could be read in two ways is refused. Columns without a header are called
    `column 1`, `column 2`, ..., or by `columns`, and further ones of one name `x #2`, `x #3`, ....

    **Raises:** `DataError` naming the line and the text that is no number, for rows of unequal
    length, for two times of one name, and for files that are not text or have no samples.
    """
    content, notes = as_utf8(file.read_bytes())
    table = read_table(content, delimiter, decimal, columns)
    return replace(table, notes=notes + table.notes)


def read_table(
    content: bytes,
    delimiter: str | None,
    decimal: str | None,
    columns: Sequence[str] = (),
) -> Channels:
    """Read a table in text, in UTF-8 with lines ended by `\\n`; see [`read_delimited`][]."""
    stream = io.BytesIO(content)
    head = [*stream.readlines(SAMPLE), *itertools.islice(stream, FEWEST_LINES)][:MOST_LINES]
    lines = [line.rstrip(b"\n").decode(errors="replace") for line in head]
    found, notes = layout(lines, delimiter, decimal, columns), []
    check_declared(found.width)
    last = content[content.rfind(b"\n") + 1 :].decode()
    fields = found.dialect.fields(last)
    is_row = last.strip() and not found.dialect.comment(last)
    if is_row and len(fields) < found.width and kinds_of(fields[:1], found.dialect.decimal) != "T":
        content = content[: -len(last.encode())]
        notes.append("the last line is cut off and left out")
    try:
        table = table_of(content, head, found)
        read = _columns(table, decimal is not None, surely=False)
    except _Misfit as misfit:
        # Decided anew with rows from there on, fewer than the first ones, at lines of their own.
        line, count = max(misfit.line - 1, len(lines)), len(lines) // 2
        more = [row.decode() for row in content.split(b"\n", line + count)[line:][:count]]
        gap = [""] * (line - len(lines))
        sign = delimiter or (found.dialect.delimiter if found.width > 1 else None)
        found = layout([*lines, *gap, *more], sign, decimal, columns)
        if found.start >= len(lines):
            raise
        table = table_of(content, head, found)
        read = _columns(table, decimal is not None, surely=True)
    sign, header = found.dialect.delimiter, found.header
    above = sum(bool(line.strip()) for line in lines[: found.start if header < 0 else header])
    what = "numbers" if header < 0 else "column names"
    decided = {
        f"delimiter {NAMES.get(sign, sign)}": sign != "," and delimiter is None,
        "decimal comma": found.dialect.decimal == ",",
        "columns without names, called by their number": header < 0 and not columns,
        f"{above} line{'s' * (above > 1)} above the {what} skipped": above,
        "column names taken from a comment": header >= 0 and header not in found.kinds,
        "units taken from the row below the column names": found.units,
        f"{table.comments} comment line{'s' * (table.comments > 1)} skipped": table.comments,
        f"{table.copies} further row{'s' * (table.copies > 1)} of names left out": table.copies,
    }
    notes = [*(note for note, holds in decided.items() if holds), *read.notes, *notes]
    whole = replace(read, notes=notes)
    whole.note_left_out("column")
    return whole


def _names(found: Layout) -> list[str]:
    """Names of all columns; empty behind the last one."""
    # A spreadsheet takes what follows this mark for a text and no formula.
    names = [re.sub(r"(^|[;|,\t]\s*)'(?=[=+@-])", r"\1", name) for name in found.names]
    filled = len(_without_empty_end(names))
    names[:filled] = [name or NUMBERED.format(k + 1) for k, name in enumerate(names[:filled])]
    return names


def _columns(table: Table, decimal_given: bool, surely: bool) -> Channels:
    """Columns of numbers and of time stamps, and the others with the reason.

    **Arguments:** `surely`: whether a text where the first rows have a number is an error, and no
    sign of another dialect.
    """
    parsed, found = table.parsed(), Channels({})
    if not parsed.num_rows:
        raise DataError("there are no samples below the column names.")
    names, how = _names(table.layout), (table.layout.dialect.decimal, decimal_given)
    units = itertools.chain(table.layout.units, itertools.repeat(""))
    called: dict[str, list[str]] = {}

    def take(name: str, values: np.ndarray, unit: str) -> None:
        same, (bare, stated) = called.setdefault(name, []), split_unit(name)
        if any(np.array_equal(values, found.columns[one], equal_nan=True) for one in same):
            found.notes.append(f"a copy of column '{name}' left out")
            return
        if same and is_called_time(name, {}):
            raise DataError(
                f"two columns are called '{name}' and differ; name all columns (on the command"
                " line: --columns A,B,...)."
            )
        number = f"{bare} #{len(same) + 1}" + (f" [{stated}]" if stated else "")
        same.append(number if same else name)
        found.take(same[-1], values, unit)

    for name, unit, kind, text in zip(names, units, table.layout.pattern, parsed.columns):
        values, behind = literals.measured(text, *how)
        if not name and (values is None or not np.isnan(values).all()):
            raise DataError("there are columns of numbers without a name.")
        if not name:
            continue
        if values is not None:
            stated, unit = split_unit(name)[1] or "", behind or unit
            both = f"{stated} or {unit}" if contradict(stated, unit) else unit or stated
            take(name, values, both)
            continue
        text = literals.stripped(text)
        stamps, numeric = literals.are_stamps(text), literals.is_numeric(text, *how)
        if literals.all_true(stamps):
            first = next((stamp.as_py() for stamp in text if stamp.is_valid), "the first")
            take(name, literals.seconds(text), "s")
            found.notes.append(f"column '{name}': time stamps, as seconds from {first}")
            continue
        best = max(numeric, stamps, key=lambda valid: compute.mean(valid).as_py())
        row = best.to_pylist().index(False)
        said = repr(text[row].as_py()[:40])
        line, _ = next(itertools.islice(table.rows(), row, None))
        message = (
            f"line {line}: {said} is not a number; take off that line, correct it, leave the field"
            " empty, or name the decimal sign (on the command line: --decimal)."
        )
        if kind in "NM" and not surely:
            raise _Misfit(line, message)
        is_other = kind == "N" and kinds_of([text[row].as_py()], how[0]) == "D"
        if is_other or compute.mean(best).as_py() >= MOSTLY:  # of those that are not null
            raise DataError(message)
        found.left_out[name] = f"it holds text, {said} on line {line}"
    # Spreadsheets leave empty rows at the end.
    empty = [np.isnan(values) for values in found.columns.values()] or [np.zeros(1)]
    filled = np.flatnonzero(~np.logical_and.reduce(empty))
    stop = filled[-1] + 1 if filled.size else None
    return replace(found, columns={name: v[:stop] for name, v in found.columns.items()})
