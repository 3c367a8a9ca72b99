"""What text files hold twice, or below their table: names, headings, columns, sums, a cut line."""

from collections import Counter
from collections.abc import Sequence
from typing import Any

from riecjax.errors import DataError
from riecjax.records.reading.channels import check_names
from riecjax.records.reading.dialect import Dialect, Layout, kind_of
from riecjax.records.reading.time_columns import is_called_time
from riecjax.records.reading.units import split_unit

MOST_BELOW = 20
"""Lines below a table, of means, extremes or remarks, that are skipped."""


def without_end(content: bytes, found: Layout, first: str) -> tuple[bytes, list[str]]:
    """A table without the lines below it, or without its last line where that is cut off.

    Below it are lines that begin with a word, where rows begin with a number or a stamp.

    **Arguments:** `first`, the first row.
    """
    dialect, end = found.dialect, len(content)

    def line_before(end: int) -> tuple[int, list[str]]:
        start = content.rfind(b"\n", 0, max(end - 1, 0)) + 1
        line = content[start:end].decode()
        empty = not line.strip() or dialect.comment(line)
        return start, [] if empty else dialect.fields(line.strip("\n"))

    def is_text(fields: list[str]) -> bool:
        return kind_of(fields[0], dialect.decimal) == "T"

    if kind_of(dialect.fields(first)[0], dialect.decimal) not in "NS":
        return content, []
    start, fields = line_before(end)
    if 0 < len(fields) < found.width and not content.endswith(b"\n") and not is_text(fields):
        return content[:start], ["the last line is cut off and left out"]
    below = 0
    for _ in range(2 * MOST_BELOW):
        start, fields = line_before(end)
        if fields and not is_text(fields):
            break
        below += bool(fields)
        end = start
    return (content[:end], [f"{below} lines below the table skipped"]) if below else (content, [])


def without_headings(
    body: bytes, header: Sequence[str], dialect: Dialect
) -> tuple[bytes, list[str]]:
    """Rows without names and units that stand there again, as where a logger restarted."""
    count = 0
    for line in header:
        # Names that are numbers may be a row as well.
        if "T" not in {kind_of(field, dialect.decimal) for field in dialect.fields(line)}:
            continue
        again = b"\n" + line.encode() + b"\n"
        count += body.count(again)
        body = body.replace(again, b"\n\n")
    return body, [f"{count} repeated lines of names skipped"] if count else []


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
    check_names(filter(None, found))
    notes = [f"columns called '{name}' are numbered" for name in twice]
    if len(kept) < len(names):
        notes.append(f"{len(names) - len(kept)} copies of columns left out")
    return found, kept, notes
