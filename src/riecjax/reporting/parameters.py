"""The table of parameters: whatever shows some is made by one function, of columns by their names.

A column says of each row what its header promises; of what a row lacks, nothing.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from riecjax.assessment.verdict import percent
from riecjax.errors import ModelError
from riecjax.estimation.estimate import Estimate
from riecjax.reporting.answer import (
    Answer,
    Ends,
    Judgement,
    Known,
    Parameter,
    part_of,
)
from riecjax.reporting.document import ends_of, number
from riecjax.reporting.tables import Table, rounded


class Row(NamedTuple):
    """What is known of a parameter.

    **Fields:** `entry`; `judgement`, of a verdict; `other`, what it was identified as where it was
    refined, or the other way round; `interval`, ends in words.
    """

    entry: Known
    judgement: Judgement | None
    other: Parameter | None
    interval: Callable[[Ends], str]

    def of_estimate(self, said: Callable[[Parameter], str], known: str = "") -> str:
        """What is said of an estimated parameter, or that it is known."""
        return said(self.entry) if isinstance(self.entry, Parameter) else known

    def of_judgement(self, said: Callable[[Judgement], str]) -> str:
        """What is said of a parameter that a verdict judges."""
        return "" if self.judgement is None else said(self.judgement)


def _other(row: Row) -> str:
    return "" if row.other is None else number(row.other.value)


def _rounded(row: Row) -> tuple[str, str]:
    """Value and standard error for a paper, by the error's digits."""
    error = row.entry.std_error if isinstance(row.entry, Parameter) else None
    value, error, power = rounded(row.entry.value, error)
    return f"{value}{power}", row.of_estimate(lambda _: f"{error}{power}", "known")


COLUMNS: dict[str, Callable[[Row], str]] = {
    "value": lambda row: number(row.entry.value),
    "identified": _other,
    "refined": _other,
    "std error": lambda row: row.of_estimate(lambda entry: number(entry.std_error, 2)),
    "95 % interval": lambda row: row.of_estimate(lambda e: row.interval(e.interval95), "known"),
    "unit": lambda row: row.entry.unit,
    "doubt": lambda row: row.of_judgement(lambda j: "?" if j.share is None else percent(j.share)),
    "from .. to": lambda row: row.of_judgement(lambda judgement: row.interval(judgement.doubt)),
    "verdict": lambda row: row.of_judgement(lambda judgement: judgement.level),
    "because of": lambda row: row.of_judgement(lambda judgement: judgement.reason),
}
"""What each column says of a row."""
USUAL = ("value", "std error", "95 % interval", "unit")
"""What is told of a parameter where nothing else is asked for."""
PAPER = {
    "value": lambda row: _rounded(row)[0],
    "±": lambda row: _rounded(row)[1],
    "unit": COLUMNS["unit"],
}


def dotted(ends: Sequence[float | None]) -> str:
    """An interval on a terminal."""
    return " .. ".join(ends_of(ends))


def bracketed(ends: Sequence[float | None]) -> str:
    """An interval where objects show themselves."""
    return f"[{', '.join(ends_of(ends))}]"


def parameter_table(
    source: Answer,
    columns: Sequence[str] | Mapping[str, Callable[[Row], str]] = (),
    interval: Callable[[Ends], str] = dotted,
) -> Table:
    """What columns say of each parameter, known ones last; `interval` in words.

    **Arguments:** `columns` by name, or what else they say; by default the usual ones, and of an
    answer that was refined, identified and refined values side by side: standard errors and
    intervals are of the answer.
    """
    others: Mapping[str, Parameter] = {}
    judgements, refinement = source.verdict.parameters, source.refinement
    if refinement is not None and refinement.refined is not None:
        others = refinement.identified if refinement.chosen else refinement.refined
        if not columns:
            values = ("value", "std error", "95 % interval")
            columns = ("identified", *USUAL) if refinement.chosen else (*values, "refined", "unit")
    named = columns or USUAL
    cells = named if isinstance(named, Mapping) else {header: COLUMNS[header] for header in named}
    rows = [
        (name, Row(entry, judgements.get(name), others.get(name), interval))
        for name, entry in (*source.parameters.items(), *source.known.items())
    ]
    return Table.of("parameter", rows, cells)


def paper_table(source: Any) -> Table:
    """Value, standard error and unit of each parameter, rounded by the error.

    **Raises:** `ModelError` for a batch, of which a paper has no room.
    """
    if shape := source.batch_shape if isinstance(source, Estimate) else ():
        raise ModelError(
            f"a table shows one estimate, not a batch of shape {shape}: take one out by member(0), "
            f"or all of them by to_frame()."
        )
    return parameter_table(part_of(source), PAPER)
