"""What a report says, in plain data: sections of text, tables and charts."""

from collections.abc import Sequence
from dataclasses import dataclass


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


@dataclass(frozen=True)
class Section:
    """A part of a page under a heading.

    **Fields:** `text`, paragraphs; `tables`; `charts`, names of those that stand here. A name
    without a chart is passed over, such as of curves that a model does not have, and so is a
    section of which nothing is left.
    """

    heading: str
    text: Sequence[str] = ()
    tables: Sequence[Table] = ()
    charts: Sequence[str] = ()


@dataclass(frozen=True)
class Page:
    """A report; `lead` is what stands under its title. Warnings and provenance come by themselves.

    Texts are plain text: signs that mean something to HTML are shown, not obeyed.
    """

    title: str
    lead: str
    sections: Sequence[Section]
