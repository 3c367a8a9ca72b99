"""How a text file writes its table: delimiter, decimal sign, header and where the numbers begin."""

import csv
import itertools
import re
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

from riecjax.errors import DataError
from riecjax.records.reading.channels import MOST_COLUMNS
from riecjax.records.reading.numerals import is_missing, is_number
from riecjax.records.reading.time_stamps import is_stamp
from riecjax.records.reading.units import SECONDS, bare_unit, is_known, is_unit

DELIMITERS = (",", ";", "\t", "|", " ")
"""In order of preference; a blank stands for any white space."""
NAMES = {",": "comma", ";": "semicolon", "\t": "tab", "|": "bar", " ": "white space"}
MISFIT = 0.3
"""Badness past which a layout is taken only where there is no better one, with names or without."""
NUMBERED = "column {}"
"""What a column without a name is called, by its number from 1."""
ROWS = frozenset(("signal", "signals", "name", "names", "channel", "channels"))
"""What a row of names calls itself in a field before them."""
REMARKS = frozenset(("comment", "comments", "remark", "remarks", "kommentar", "bemerkung"))
"""Columns that hold words, if anything."""
PLACES = ("TS", "RN")
"""What Campbell's TOA5 writes for the unit of a time stamp, and of a record's number."""
_COMMENT = re.compile(r"\s*(?:#|%|//)+\s*")
_SEMICOLON_COMMENT = re.compile(r"\s*(?:#|%|;|//)+\s*")


class Dialect(NamedTuple):
    """Delimiter (a blank: any white space) and decimal sign."""

    delimiter: str
    decimal: str

    def comment(self, line: str) -> re.Match[str] | None:
        """The sign that makes this line a comment."""
        return (_COMMENT if self.delimiter == ";" else _SEMICOLON_COMMENT).match(line)

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
    first row of numbers; `width`, fields in a row; `header`, the line of the names; `badness`,
    the share of rows and fields that do not fit; `numbered`: whether the names are numbers of
    columns, the file having none.
    """

    dialect: Dialect
    names: list[str]
    units: list[str]
    start: int
    width: int
    header: int
    badness: float
    numbered: bool = False

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
    _refuse_too_wide(lines)
    found = [_layout(lines, dialect) for dialect in _dialects(lines, delimiter, decimal)]
    layouts = [one for one in found if one is not None and _plausible(one, lines, delimiter)]
    if not layouts:
        raise _no_numbers(lines)
    best = min(
        layouts,
        key=lambda one: (one.badness > MISFIT, not one.named, round(one.badness, 3), -one.width),
    )
    if columns or (not best.names and best.header < 0):
        best = _named(best, columns)
    if not best.named:
        raise DataError(
            f"{len(best.names)} column names but {best.width} columns of numbers"
            f" ({best.dialect}; line {best.start + 1}).{_of_commas(best)}"
        )
    if decimal is None and delimiter is None:
        _refuse_bare_commas(best, lines)
    return best


def _no_numbers(lines: list[str]) -> DataError:
    """The error of lines without one that holds numbers."""
    filled = [place for place, line in enumerate(lines) if line.strip()]
    if not filled:
        return DataError("the file is empty; the first row must name the columns.")
    if len(filled) == 1:
        return DataError("there are no samples below the column names.")
    place = filled[min(len(filled) - 1, len(filled) // 2)]
    return DataError(
        f"no line holds numbers between delimiters; line {place + 1} is {lines[place][:60]!r}. Name"
        " delimiter and decimal sign (on the command line: --delimiter, --decimal), or export the"
        " file otherwise."
    )


def _of_commas(best: Layout) -> str:
    """A remedy where commas may be decimal signs, too."""
    if best.dialect.delimiter != "," or best.width != 2 * len(best.names):
        return ""
    return " If commas are decimal signs too, export the file with another delimiter."


def _named(found: Layout, columns: Sequence[str]) -> Layout:
    """The same table with these names, or with numbers for names."""
    if columns and len(columns) != found.width:
        raise DataError(f"{len(columns)} names are given for {found.width} columns of numbers.")
    names = list(columns) or [NUMBERED.format(place + 1) for place in range(found.width)]
    units = found.units if len(found.units) == found.width else []
    return found._replace(names=names, units=units, numbered=not columns)


def _dialects(lines: list[str], delimiter: str | None, decimal: str | None) -> list[Dialect]:
    text = "\n".join(lines)
    delimiters = [delimiter] if delimiter else [d for d in DELIMITERS if d == " " or d in text]
    # A comma can be both only where quotes tell the two apart.
    return [
        Dialect(d, c)
        for c in ([decimal] if decimal else [".", ","])
        for d in delimiters
        if c != d or '"' in text
    ]


def _plausible(found: Layout, lines: list[str], delimiter: str | None) -> bool:
    """One column only where its name holds no delimiter: else the file has more columns."""
    if found.width > 1 or delimiter or found.header < 0:
        return True
    return not any(sign in lines[found.header] for sign in DELIMITERS[:-1])


def _refuse_bare_commas(best: Layout, lines: list[str]) -> None:
    if best.width > 1 or best.dialect.decimal == ".":
        return
    for place in range(best.start, len(lines)):
        if "," in lines[place] and not best.dialect.comment(lines[place]):
            raise DataError(
                f"line {place + 1}: {lines[place].strip()[:40]!r} is one number with a decimal"
                " comma, or two columns; pass decimal=',' or delimiter=','."
            )


def _layout(lines: list[str], dialect: Dialect) -> Layout | None:
    rows = {
        place: dialect.fields(line)
        for place, line in enumerate(lines)
        if line.strip() and not dialect.comment(line)
    }
    kinds = {place: _kinds(fields, dialect.decimal) for place, fields in rows.items()}
    usual = Counter(kind for kind in kinds.values() if "N" in kind or "S" in kind)
    if not usual:
        return None
    # The usual row is data; of equally usual ones the one with fewest texts.
    pattern = max(usual, key=lambda kind: (usual[kind], -kind.count("T"), len(kind)))
    first = next(place for place, kind in kinds.items() if _fits(kind, pattern))
    header, units, start = _header(rows, kinds, first, pattern)
    if header is None:
        header, names, units = _commented_header(lines, dialect, first, len(pattern))
    else:
        names = rows[header]
    names = _trimmed(names, pattern, dialect)
    data = [kind for place, kind in kinds.items() if place >= start]
    ragged = sum(len(kind) != len(pattern) for kind in data) / len(data)
    texts = sum(kind.count("T") for kind in data) / max(sum(map(len, data)), 1)
    return Layout(dialect, names, units, start, len(pattern), header, ragged + texts)


def _kinds(fields: list[str], decimal: str) -> str:
    """One letter for each field, as `kind_of` gives them."""
    return "".join(kind_of(field, decimal) for field in fields)


def kind_of(field: str, decimal: str) -> str:
    """What a field holds: `M`, nothing; `N`, a number; `S`, a time stamp; `T`, any other text."""
    if is_missing(field):
        return "M"
    if is_number(field, decimal):
        return "N"
    return "S" if is_stamp(field) else "T"


def _fits(kind: str, pattern: str) -> bool:
    return len(kind) == len(pattern) and all(a == b or "M" in (a, b) for a, b in zip(kind, pattern))


def _header(
    rows: dict[int, list[str]], kinds: dict[int, str], first: int, pattern: str
) -> tuple[int | None, list[str], int]:
    """Line of the names, the units by position, and the line where data begins."""
    preceding = [place for place in reversed(rows) if place < first]
    # A word alone, such as DATA or [data], heads a table and names no column of several.
    while len(pattern) > 1 and len(preceding) > 1 and _is_heading(rows[preceding[0]]):
        del rows[preceding.pop(0)]
    above = list(itertools.takewhile(lambda place: _as_wide(rows[place], pattern), preceding))
    # Where no row above is as wide, the last one tells how many names there are instead.
    above = above or preceding[:1]
    # A row that is partly numbers below a row of names is data that went wrong, not a header.
    texts = [place for place in above if "T" in kinds[place] and not set(kinds[place]) & {"N", "S"}]
    fallback = [place for place in above if "T" in kinds[place]]
    if not texts and not fallback:
        return None, [], first
    if _is_below_units(texts, rows):
        above = [place for place in above if place < texts[0]]
        del rows[texts.pop(0)]
    last = (texts or fallback)[0]
    between = [place for place in above if place > last]
    if between and _is_unit_row(rows[between[-1]]):
        return last, [bare_unit(field) for field in rows[between[-1]]], _after(rows, between[-1])
    # Above units, names may be numbers, as of channels 1 and 2.
    upper = next((place for place in fallback if place < last), None)
    if upper is not None and len(rows[upper]) == len(rows[last]) and _is_unit_row(rows[last]):
        return upper, [bare_unit(field) for field in rows[last]], _after(rows, last)
    return last, [], _after(rows, last)


def _is_below_units(texts: list[int], rows: dict[int, list[str]]) -> bool:
    """Whether the last row of words stands below one of units: of sensors, or how values were
    taken."""
    if len(texts) < 3 or _is_unit_row(rows[texts[0]]):
        return False
    return _is_unit_row(rows[texts[1]])


def _is_heading(fields: list[str]) -> bool:
    return len(_without_empty_end(fields)) == 1 and not is_known(bare_unit(fields[0]))


def _as_wide(fields: list[str], pattern: str) -> bool:
    """Whether a row has a field for each column; a delimiter at the end of a row makes none."""
    filled = len(_without_empty_end(fields))
    width = len(pattern)
    return width in (filled, len(fields)) or (filled < width and set(pattern[filled:]) == {"M"})


def _after(rows: dict[int, list[str]], place: int) -> int:
    return min(other for other in rows if other > place)


def _is_unit_row(fields: list[str]) -> bool:
    """Whether all fields are units, or most of them below one of time, which no name is."""
    known = [not field or is_unit(field) or field in PLACES for field in fields]
    timed = bare_unit(fields[0]).lower() in SECONDS and sum(known) > len(fields) / 2
    return any(fields) and (all(known) or timed)


def _commented_header(
    lines: list[str], dialect: Dialect, first: int, width: int
) -> tuple[int, list[str], list[str]]:
    """Line, names and units of the last comment above the numbers that names each column."""
    found: list[tuple[int, list[str]]] = []
    for place in range(first - 1, -1, -1):
        sign = dialect.comment(lines[place])
        if sign:
            fields = dialect.fields(lines[place][sign.end() :])
            found.append((place, _joined(fields, dialect, width)))
        if len(found) == 2 or (lines[place].strip() and not sign):
            break
    named = [
        one for one in found if len(one[1]) == width and "T" in _kinds(one[1], dialect.decimal)
    ]
    if len(named) == 2 and _is_unit_row(named[0][1]):
        return (*named[1], [bare_unit(field) for field in named[0][1]])
    return (*named[0], []) if named and named[0] is found[0] else (-1, [], [])


def _without_empty_end(fields: list[str]) -> list[str]:
    width = len(fields)
    while width and not fields[width - 1]:
        width -= 1
    return fields[:width]


def _joined(names: list[str], dialect: Dialect, width: int) -> list[str]:
    """Names delimited by blanks with their units: the blank before a bracket delimits none."""
    if dialect.delimiter != " " or len(names) <= width:
        return names
    joined = re.sub(r"\s+(?=[\[(])", "\0", " ".join(names))
    return [name.replace("\0", " ") for name in joined.split(" ")]


def _trimmed(names: list[str], pattern: str, dialect: Dialect) -> list[str]:
    """Names for `pattern`: a delimiter at the end of a row makes no column."""
    names = _without_empty_end(names)
    width = len(pattern)
    if len(names) == width + 1 > 2:
        # What the row is, before its names, or a column of remarks that stayed empty.
        first, last = (names[place].lower() in WORDS for place, WORDS in ((0, ROWS), (-1, REMARKS)))
        names = names[1:] if first else names[:-1] if last else names
    names = _joined(names, dialect, width)
    if names and len(names) < width and set(pattern[len(names) :]) == {"M"}:
        names = [*names, *[""] * (width - len(names))]
    return names


def _refuse_too_wide(lines: list[str]) -> None:
    for line in lines:
        if len(line) > MOST_COLUMNS:
            widest = max(len(line.split()), *(line.count(sign) + 1 for sign in DELIMITERS[:-1]))
            if widest > MOST_COLUMNS:
                raise DataError(f"has {widest} columns; at most {MOST_COLUMNS} are read.")
