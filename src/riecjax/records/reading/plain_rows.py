"""Rows of text without what stands around their numbers: brackets, quotes, labels, thousands."""

import re
from typing import NamedTuple

from riecjax.records.reading.units import is_known

QUOTED = 2**12
"""Bytes at the start of a file that tell whether its rows are quoted as a whole."""

_OPENED = re.compile(rb"(?m)^[ \t]*(?:\w+[ \t]*=[ \t]*)?[\[({]+(?=[\s\d.,;+\-\[\"]|$)")
_CLOSED = re.compile(rb"(?m)(?<=[\d.,;\s\])\"])[\])}]+[,;]?[ \t]*$")
_LABEL = re.compile(rb"([A-Za-z_]\w*)[ \t]*[:=][ \t]*(?=[+-]?[.\d])")
_GROUPED = re.compile(
    rb"(?<![\d.,])(\d{1,3})('|\xe2\x80\x99|\xe2\x80\xaf|\xc2\xa0|\xc2\x92)(\d{3}(?:\2\d{3})*)(?!\d)"
)
_MEASURED = re.compile(r"[+-]?[\d.,]*\d(?:[eE][+-]?\d+)? ?(?P<unit>[^\s\d,;.+-][^,;\t]*)")


_RULE = re.compile(rb"(?m)^[ \t]*[|+:]?-{3,}[-+|=: ]*$")
_FIRST_NUMBER = re.compile(rb"(?m)^[ \t|\"]*[+-]?[.\d]")
_BARRED = re.compile(rb"(?m)^[ \t]*\|(.*)\|[ \t]*$")
_AS_TEXT = re.compile(rb"(?m)(^|[,;\t])(?:=\"([^\"\n]*)\"|'([^'\n]*)')(?=[,;\t]|$)")
_OPEN = re.compile(rb'(?:^|[,;\t])[ ]*"[^"]*$')
FEWEST_MEASURED = 5
"""Rows on which it is decided that units stand behind numbers."""
MOST_HEADINGS, MOST_BREAKS = 40, 6
"""Lines in which names with a line break are looked for, and lines of one such row."""


class Plain(NamedTuple):
    """A text's content, what was removed from it in words, and labels that named its columns; of
    columns with a unit behind each number, the units, by position."""

    content: bytes
    notes: list[str]
    labels: list[str]
    units: list[str]


def plain_rows(content: bytes) -> Plain:
    """Rows without what stands around each of them, or around each of their numbers.

    Around rows: brackets, as MATLAB and Python print a matrix (`x = [0 1; 2 3];`,
    `[[0, 1], [2, 3]]`), quotes of spreadsheets that took a row for one cell (`"0,1"`), semicolons
    at the end of every line. Around numbers: labels, as for the plotter of an Arduino
    (`t:0.5,x:1`), which name the columns; units, as of MATLAB's durations (`0.5 sec`);
    apostrophes and blanks that do not break, between thousands (`1'234.5`); single quotes, and
    what keeps a number from Excel (`="0.5"`). Lines of a table's frame go (`|---|---|`), and
    breaks within quoted names.
    """
    content = _without_breaks(_without_rules(content))
    if any(sign in content[:QUOTED] for sign in (b'="', b"'")):
        content = _AS_TEXT.sub(rb"\1\2\3", content)
    content, notes = _without_frames(content)
    content, labels = _without_labels(content)
    if labels:
        notes.append("column names taken from labels in the rows")
    content, units = _without_units(content)
    if any(sign in content for sign in (b"'", b"\xe2\x80", b"\xc2")):
        content, count = _GROUPED.subn(lambda found: found[0].replace(found[2], b""), content)
        if count:
            notes.append("signs between thousands removed")
    return Plain(content, notes, labels, units)


def _without_rules(content: bytes) -> bytes:
    """Without the lines of hyphens and bars around a table and below its names."""
    if b"---" not in content[:QUOTED]:
        return content
    first = _FIRST_NUMBER.search(content)
    head = content[: first.start() if first else QUOTED]
    if not _RULE.search(head):
        return content
    last = max(content.rstrip().rfind(b"\n") + 1, len(head))
    content = _RULE.sub(b"", head) + content[len(head) : last] + _RULE.sub(b"", content[last:])
    lines = [line for line in content[:QUOTED].split(b"\n")[:-1] if line.strip()]
    barred = sum(_BARRED.fullmatch(line) is not None for line in lines)
    return _BARRED.sub(rb"\1", content) if barred > 0.9 * len(lines) else content


def _without_breaks(content: bytes) -> bytes:
    """Rows of names on one line, where quoted names hold line breaks; later lines keep their
    numbers."""
    if b'"' not in content[:QUOTED]:
        return content
    lines = content.split(b"\n", MOST_HEADINGS)
    for place in range(len(lines) - 1):
        for count in range(1, MOST_BREAKS):
            row = b" ".join(lines[place : place + count])
            if not _OPEN.search(re.sub(rb'"[^"]*"', b"", row)):
                lines[place : place + count] = [row, *[b""] * (count - 1)]
                break
            if place + count >= len(lines) - 1:
                break
    return b"\n".join(lines)


def _without_labels(content: bytes) -> tuple[bytes, list[str]]:
    """Rows of numbers without their labels, where all rows begin with the same ones."""
    lines = [line for line in content[:QUOTED].split(b"\n")[:-1] if line.strip()]
    labels = _LABEL.findall(lines[-1]) if lines else []
    if len(labels) < 2 or any(_LABEL.findall(line) != labels for line in lines):
        return content, []
    return _LABEL.sub(b"", content), [label.decode() for label in labels]


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


def _without_frames(content: bytes) -> tuple[bytes, list[str]]:
    """Rows without brackets, quotes and semicolons around them, and what was removed."""
    notes = []
    tail = content[-64:].rstrip()
    closed = tail.endswith((b"]", b"];", b"],", b"}", b"};", b")"))
    # `(9 rows)` below a table opens none.
    if closed and _OPENED.search(content[: min(QUOTED, len(content) // 2)]):
        content = _CLOSED.sub(b"", _OPENED.sub(b"", content))
        notes.append("brackets around rows removed")
    lines = [line for line in content[:QUOTED].split(b"\n")[:-1] if line.strip()]
    if lines and all(re.fullmatch(rb'[ \t]*"[^"]*[,;\t][^"]*"[ \t]*', line) for line in lines):
        content = re.sub(rb'(?m)^[ \t]*"|"[ \t]*$', b"", content)
        notes.append("quotes around rows removed")
    if tail.endswith(b";") or notes:
        rows = [line.rstrip() for line in content.split(b"\n") if line.strip()]
        if sum(row.endswith(b";") for row in rows) >= len(rows) - 1:
            content = re.sub(rb"(?m);[ \t]*$", b"", content)
    return content, notes
