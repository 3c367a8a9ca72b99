"""What is said of an object: a title, tables and lines, as text, HTML, Markdown or LaTeX."""

import html
import math
import re
import sys
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

from rich.console import Console
from rich.table import Table as RichTable
from rich.text import Text

from riecjax.findings import Finding

MOST_ROWS = 16
"""Rows of a table that a brief text shows."""
LARGE, SMALL = 6, -4
"""Powers of ten from which on a number is written with one."""
NUMERIC = re.compile(r"([-+\[]*[\d.]|nan|inf|-inf|none|known|\?|$)")
"""How the cells of a column begin that stands to the right."""
CELL = "padding:0.1em 0.7em;border:none;background:none;white-space:nowrap;text-align:"


@dataclass(frozen=True)
class Table:
    """A table: first column left, the others to the right where they are `numeric`.

    **Fields:** `header` and `rows`, as many texts in each; `caption`, and a `note` beneath it.
    """

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""
    note: str = ""
    numeric: bool = True

    @classmethod
    def of(
        cls,
        kind: str,
        entries: Iterable[tuple[str, Any]],
        cells: Mapping[str, Callable[[Any], str]],
        caption: str = "",
    ) -> Self:
        """A row for each name and entry: the name, under the `kind` of thing that it is, and what
        `cells` say of the entry, each under its header."""
        rows = [(name, *(cell(entry) for cell in cells.values())) for name, entry in entries]
        return cls((kind, *cells), rows, caption)

    @property
    def to_the_right(self) -> list[bool]:
        """Whether each column holds numbers."""
        columns = list(zip(*self.rows)) or [()] * len(self.header)
        return [
            all(NUMERIC.match(cell) or cell.startswith("... ") for cell in column) and any(column)
            for column in columns
        ]


@dataclass(frozen=True)
class View:
    """What is said of an object: a `title`, `tables` that have rows, and beneath them `lines`, some
    of which may be findings."""

    title: str
    tables: Sequence[Table] = ()
    lines: Sequence[str | Finding] = ()


def in_text(view: View, *, brief: bool = False) -> str:
    """As plain text; a brief one leaves out the middle of long tables."""
    lines = [view.title] if view.title else []
    for table in (table for table in view.tables if table.rows):
        rows, over = list(table.rows), len(table.rows) - MOST_ROWS
        if brief and over > 1:
            half = MOST_ROWS // 2
            dots = [f"... {over} more", *("" for _ in table.header[1:])]
            rows = [*rows[:half], dots, *rows[-half:]]
        widths = [max(map(len, column)) for column in zip(table.header, *rows)]
        right = Table(table.header, rows).to_the_right
        lines += [table.caption] if table.caption else []
        lines += [
            "  ".join(c.rjust(w) if r else c.ljust(w) for c, w, r in zip(row, widths, right))
            for row in (table.header, *rows)
        ]
    return "\n".join(line.rstrip() for line in (*lines, *map(_said, view.lines)))


def _said(line: str | Finding) -> str:
    return line if isinstance(line, str) else f"warning [{line.code}] {line.message}"


def in_html(view: View) -> str:
    """As HTML that takes its colours from the page around it."""
    parts = [f"<div><strong>{html.escape(view.title)}</strong></div>"] if view.title else []
    for table in (table for table in view.tables if table.rows):
        right = [False, *table.to_the_right[1:]]
        caption = f"<caption>{html.escape(table.caption)}</caption>" if table.caption else ""
        body = "".join(_html_row(row, right, "td") for row in table.rows)
        head = _html_row(table.header, right, "th")
        style = "border-collapse:collapse;color:inherit;font-variant-numeric:tabular-nums"
        shown = f'<table style="{style}">{caption}{head}{body}</table>'
        parts.append(f'<div style="overflow-x:auto">{shown}</div>')
    parts += [f"<div>{html.escape(line)}</div>" for line in view.lines if isinstance(line, str)]
    warnings = [html.escape(_said(line)) for line in view.lines if isinstance(line, Finding)]
    if warnings:
        listed = "".join(f"<div>{line}</div>" for line in warnings)
        count = f"{len(warnings)} warning{'s' if len(warnings) > 1 else ''}"
        parts.append(f"<details><summary>{count}</summary>{listed}</details>")
    return f"<div>{''.join(parts)}</div>"


def in_rich(
    table: Table, right: Collection[str] | None = None, styles: Mapping[str, str] = {}
) -> RichTable:
    """As a table on a terminal.

    **Arguments:** `right`, headers of columns that stand to the right, by default those of numbers;
    `styles` of cells that say these words.
    """
    printed = RichTable(box=None, padding=(0, 2, 0, 0))
    for name, numeric in zip(table.header, table.to_the_right):
        to_the_right = numeric if right is None else name in right
        printed.add_column(Text(name), justify="right" if to_the_right else "left")
    for row in table.rows:
        printed.add_row(*(Text(cell, style=styles.get(cell, "")) for cell in row))
    return printed


def print_table(table: RichTable, console: Console) -> None:
    """Print a table in full: a number that loses its exponent to a narrow terminal is another."""
    narrow = console.width
    whole = console.options.update(max_width=sys.maxsize)
    console.width = max(narrow, console.measure(table, options=whole).maximum)
    console.print(table)
    console.width = narrow


def say(console: Console, *lines: str, style: str = "", wrapped: bool = True) -> None:
    """Print lines as they are, broken where the terminal ends if `wrapped`."""
    for line in lines:
        console.print(line, style=style, highlight=False, markup=False, soft_wrap=not wrapped)


def _html_row(row: Sequence[str], right: Sequence[bool], tag: str) -> str:
    cells = zip(row, right, strict=True)
    inner = "".join(
        f'<{tag} style="{CELL}{"right" if r else "left"}">{html.escape(c)}</{tag}>'
        for c, r in cells
    )
    return f"<tr>{inner}</tr>"


def in_markdown(table: Table) -> str:
    """As a table of Markdown."""
    rule = ["---:" if right else ":---" for right in table.to_the_right]
    rows = [[cell.replace("|", "\\|") for cell in row] for row in (table.header, *table.rows)]
    return "\n".join(f"| {' | '.join(row)} |" for row in (rows[0], rule, *rows[1:]))


def in_latex(table: Table) -> str:
    """As a `tabular`: the first column names of parameters, `unit` units, the others numbers."""

    def latex(header: str, cell: str) -> str:
        if header == "unit":
            return latex_unit(cell)
        if not re.match(r"[-(]?\d", cell):
            return _latex_text(cell)
        plain = cell.replace("±", "\\pm").replace("×", "\\times").replace("%", "\\%")
        return "$" + re.sub(r"10\^(-?\d+)", r"10^{\1}", plain) + "$"

    cells = ((latex_name(row[0]), *map(latex, table.header[1:], row[1:])) for row in table.rows)
    rows = [f"{' & '.join(row)} \\\\" for row in cells]
    align = "".join("l" if h in (table.header[0], "unit") else "r" for h in table.header)
    head = f"{' & '.join(map(_latex_text, table.header))} \\\\"
    body = [f"\\begin{{tabular}}{{{align}}}", "\\hline", head, "\\hline", *rows, "\\hline"]
    return "\n".join([*body, "\\end{tabular}"])


def latex_name(name: str) -> str:
    """A parameter's name as a symbol: `M_s` as `$M_\\mathrm{s}$`; words as they stand."""
    if not re.fullmatch(r"[A-Za-z]\w*(\[\d+\])?", name):
        return _latex_text(name)
    base, _, index = name.partition("_")
    symbol = base if len(base) == 1 else f"\\mathrm{{{base}}}"
    below = index.replace("_", "\\_")
    return f"${symbol}_\\mathrm{{{below}}}$" if below else f"${symbol}$"


def latex_unit(unit: str) -> str:
    """A unit in upright letters: `N s^2/m` as `$\\mathrm{N\\,s^{2}/m}$`."""
    if not unit:
        return ""
    raised = re.sub(r"\^(-?\d+)", r"^{\1}", unit.replace("²", "^2").replace("³", "^3"))
    spaced = raised.replace("·", "\\cdot ").replace("*", "\\cdot ").replace("%", "\\%")
    spaced = spaced.replace(" ", "\\,")
    return f"$\\mathrm{{{spaced}}}$"


def _latex_text(text: str) -> str:
    text = text.replace("±", "$\\pm$").replace("Δ", "$\\Delta$")
    return re.sub(r"([_%&#])", r"\\\1", text)


def rounded(value: float | None, error: float | None) -> tuple[str, str, str]:
    """A value and its standard error, both rounded to the error's second digit, and the power of
    ten that they are of, if it is far from none."""
    value = math.nan if value is None else value
    if error is None or not (math.isfinite(value) and math.isfinite(error) and error > 0):
        return f"{value:.6g}", "" if error is None else f"{error:.2g}", ""
    size = math.floor(math.log10(max(abs(value), error)))
    power = size if size >= LARGE or size <= SMALL else 0
    value, error = value / 10.0**power, error / 10.0**power
    places = 1 - int(f"{error:.1e}".partition("e")[2])
    digits, wide = (f"{round(x, places):.{max(places, 0)}f}" for x in (value, error))
    return digits, wide, f" × 10^{power}" if power else ""


def with_error(value: float | None, error: float | None) -> str:
    """A value and its standard error, rounded, in one text."""
    digits, wide, power = rounded(value, error)
    both = " ± ".join(filter(None, (digits, wide)))
    return f"({both}){power}" if power else both
