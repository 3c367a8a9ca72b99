"""What is said of an object: a title, tables and lines, as text, HTML, Markdown or LaTeX.

Text is printed by rich. Markdown, LaTeX and HTML are tabulate's: rich's HTML is preformatted text,
tabulate makes tables that a notebook aligns and wraps, and that can be copied into a sheet.
"""

import html
import math
import re
import sys
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import tabulate
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
        note: str = "",
    ) -> Self:
        """A row for each name and entry: the name, under the `kind` of thing that it is, and what
        `cells` say of the entry, each under its header."""
        rows = [(name, *(cell(entry) for cell in cells.values())) for name, entry in entries]
        return cls((kind, *cells), rows, caption, note)

    @property
    def to_the_right(self) -> list[bool]:
        """Whether each column holds numbers."""
        columns = list(zip(*self.rows)) or [()] * len(self.header)
        return [
            all(NUMERIC.match(cell) or cell.startswith("... ") for cell in column) and any(column)
            for column in columns
        ]

    def brief(self) -> Self:
        """The table without its middle, if it is long."""
        over, half = len(self.rows) - MOST_ROWS, MOST_ROWS // 2
        if over <= 1:
            return self
        dots = (f"... {over} more", *("" for _ in self.header[1:]))
        return replace(self, rows=[*self.rows[:half], dots, *self.rows[-half:]])

    def markdown(self) -> str:
        """As a table of Markdown."""
        return self._tabulated("pipe", lambda _, cell: " ".join(cell.split()).replace("|", "\\|"))

    def html(self) -> str:
        """As a table of HTML, without the caption."""
        return self._tabulated("html", lambda _, cell: cell, [False, *self.to_the_right[1:]])

    def latex(self) -> str:
        """As a `tabular`: first column names of parameters, `unit` units, the others numbers."""

        def cell_of(header: str, cell: str) -> str:
            if header in (self.header[0], "unit"):
                return latex_name(cell) if header == self.header[0] else latex_unit(cell)
            if not re.match(r"[-(]?\d", cell):
                return _latex_text(cell)
            plain = cell.replace("±", "\\pm").replace("×", "\\times").replace("%", "\\%")
            return "$" + re.sub(r"10\^(-?\d+)", r"10^{\1}", plain) + "$"

        right = [name not in (self.header[0], "unit") for name in self.header]
        return self._tabulated("latex_raw", cell_of, right, _latex_text)

    def _tabulated(
        self,
        form: str,
        cell_of: Callable[[str, str], str],
        right: Sequence[bool] | None = None,
        header_of: Callable[[str], str] | None = None,
    ) -> str:
        """In a format of tabulate's: cells, under their headers, and headers as it takes them."""
        headers = [header_of(h) if header_of else cell_of("", h) for h in self.header]
        return tabulate.tabulate(
            [[*map(cell_of, self.header, row)] for row in self.rows],
            headers,
            tablefmt=form,
            disable_numparse=True,
            colalign=["right" if each else "left" for each in right or self.to_the_right],
        )


@dataclass(frozen=True)
class View:
    """What is said of an object: a `title`, `tables` that have rows, and beneath them `lines`, some
    of which may be findings."""

    title: str
    tables: Sequence[Table] = ()
    lines: Sequence[str | Finding] = ()

    def text(self, *, brief: bool = False) -> str:
        """As plain text; a brief one leaves out the middle of long tables."""
        # In a notebook a console fills a cell of its own, captured or not.
        console = Console(color_system=None, width=sys.maxsize, force_jupyter=False)
        with console.capture() as printed:
            say(console, *filter(None, [self.title]))
            for table in (table for table in self.tables if table.rows):
                say(console, *filter(None, [table.caption]))
                console.print(in_rich(table.brief() if brief else table))
            say(console, *map(_said, self.lines))
        return "\n".join(line.rstrip() for line in printed.get().splitlines())

    def html(self) -> str:
        """As HTML that takes its colours from the page around it."""
        parts = [f"<div><strong>{html.escape(self.title)}</strong></div>"] if self.title else []
        for table in (table for table in self.tables if table.rows):
            caption = f"<div>{html.escape(table.caption)}</div>" if table.caption else ""
            parts.append(f'{caption}<div style="overflow-x:auto">{table.html()}</div>')
        said = [html.escape(_said(line)) for line in self.lines]
        listed = [
            (isinstance(line, Finding), f"<div>{s}</div>") for line, s in zip(self.lines, said)
        ]
        parts += [words for is_finding, words in listed if not is_finding]
        if warnings := [words for is_finding, words in listed if is_finding]:
            count = f"{len(warnings)} warning{'s' if len(warnings) > 1 else ''}"
            parts.append(f"<details><summary>{count}</summary>{''.join(warnings)}</details>")
        return f"<div>{''.join(parts)}</div>"


def _said(line: str | Finding) -> str:
    return line if isinstance(line, str) else f"warning [{line.code}] {line.message}"


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
        text = Text(line, style=style)
        console.print(text, highlight=False, soft_wrap=not wrapped)


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
    if not unit or not re.fullmatch(r"[\w\s^*/.()·%-]+", unit):
        return _latex_text(unit)
    raised = re.sub(r"\^(-?\d+)", r"^{\1}", unit.replace("²", "^2").replace("³", "^3"))
    spaced = raised.replace("·", "\\cdot ").replace("*", "\\cdot ").replace("%", "\\%")
    spaced = spaced.replace(" ", "\\,")
    return f"$\\mathrm{{{spaced}}}$"


def _latex_text(text: str) -> str:
    rules = {"±": "$\\pm$", "Δ": "$\\Delta$", **tabulate.LATEX_ESCAPE_RULES}
    return "".join(rules.get(sign, sign) for sign in " ".join(text.split()))


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
