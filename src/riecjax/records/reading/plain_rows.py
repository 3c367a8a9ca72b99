"""Rows of text without what stands around their numbers: brackets, quotes, labels, thousands."""

import re
from typing import NamedTuple

QUOTED = 2**12
"""Bytes at the start of a file that tell whether its rows are quoted as a whole."""

_OPENED = re.compile(rb"(?m)^[ \t]*(?:\w+[ \t]*=[ \t]*)?[\[({]+(?=[\s\d.,;+\-\[\"]|$)")
_CLOSED = re.compile(rb"(?m)(?<=[\d.,;\s\])\"])[\])}]+[,;]?[ \t]*$")
_LABEL = re.compile(rb"([A-Za-z_]\w*)[ \t]*[:=][ \t]*(?=[+-]?[.\d])")
_GROUPED = re.compile(
    rb"(?<![\d.,])(\d{1,3})('|\xe2\x80\x99|\xe2\x80\xaf|\xc2\xa0|\xc2\x92)(\d{3}(?:\2\d{3})*)(?!\d)"
)
_SECONDS = re.compile(rb"(?m)(?<=[\d.]) sec(?=[,;\t]|$)")


class Plain(NamedTuple):
    """A text's content, what was removed from it in words, and labels that named its columns."""

    content: bytes
    notes: list[str]
    labels: list[str]


def plain_rows(content: bytes) -> Plain:
    """Rows without what stands around each of them, or around each of their numbers.

    Around rows: brackets, as MATLAB and Python print a matrix (`x = [0 1; 2 3];`,
    `[[0, 1], [2, 3]]`), quotes of spreadsheets that took a row for one cell (`"0,1"`), semicolons
    at the end of every line. Around numbers: labels, as for the plotter of an Arduino
    (`t:0.5,x:1`), which name the columns; the seconds of MATLAB's durations (`0.5 sec`);
    apostrophes and blanks that do not break, between thousands (`1'234.5`).
    """
    content, notes = _without_frames(content)
    content, labels = _without_labels(content)
    if labels:
        notes.append("column names taken from labels in the rows")
    if b" sec" in content:
        content = _SECONDS.sub(b"", content)
    if any(sign in content for sign in (b"'", b"\xe2\x80", b"\xc2")):
        content, count = _GROUPED.subn(lambda found: found[0].replace(found[2], b""), content)
        if count:
            notes.append("signs between thousands removed")
    return Plain(content, notes, labels)


def _without_labels(content: bytes) -> tuple[bytes, list[str]]:
    """Rows of numbers without their labels, where all rows begin with the same ones."""
    lines = [line for line in content[:QUOTED].split(b"\n")[:-1] if line.strip()]
    labels = _LABEL.findall(lines[-1]) if lines else []
    if len(labels) < 2 or any(_LABEL.findall(line) != labels for line in lines):
        return content, []
    return _LABEL.sub(b"", content), [label.decode() for label in labels]


def _without_frames(content: bytes) -> tuple[bytes, list[str]]:
    """Rows without brackets, quotes and semicolons around them, and what was removed."""
    notes = []
    tail = content[-64:].rstrip()
    if tail.endswith((b"]", b"];", b"],", b"}", b"};", b")")):
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
