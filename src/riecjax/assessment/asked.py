"""What an assessment is asked: model, criterion, and which recordings serve for what."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import ArrayLike

from riecjax.criteria.criterion import AbstractCriterion
from riecjax.equations.model import Model
from riecjax.estimation.estimate import Estimate
from riecjax.estimation.identify import estimated
from riecjax.estimation.parameters import ParameterTable
from riecjax.memory import REMEDY, require_memory
from riecjax.records.record import Record
from riecjax.records.recording import Recording
from riecjax.settings import Assess
from riecjax.summaries.summarise import summarise
from riecjax.uncertainty.intervals import AbstractIntervals, Naive

BYTES_PER_SAMPLE = 110.0
"""Of sums and checks at the peak of memory, for each signal; and, for each equation, of tests of
what it leaves."""
BYTES_PER_ROW = 320.0
"""Of a criterion that draws its windows, for each window and column."""
TINY = 1e-300
"""In place of a size of zero, which nothing is a share of."""


def size_of(value: ArrayLike) -> float:
    """Size of a value, for shares of it."""
    return max(float(np.abs(value)), TINY)


Numbered = Sequence[tuple[int | None, Recording]]
"""Recordings, each with the number of the one whose own parameters it takes, if it has some."""


class Asked(NamedTuple):
    """What is asked: a model, a criterion, and recordings to estimate from (`fitted`).

    **Fields:** `held`, the last parts of recordings if those are held out, and `further`
    recordings, both to validate on; `table` of the parameters; `intervals`, how uncertainty is
    estimated; `settings`, what else was said.
    """

    model: Model
    criterion: AbstractCriterion
    fitted: list[Recording]
    held: list[Recording]
    further: list[Recording]
    table: ParameterTable
    intervals: AbstractIntervals
    settings: Assess

    @property
    def records(self) -> list[Record]:
        """The records to estimate from."""
        return [recording.record for recording in self.fitted]

    @property
    def seen(self) -> Numbered:
        """What the model is fitted to."""
        return list(enumerate(self.fitted))

    @property
    def unseen(self) -> Numbered:
        """What it is not fitted to: last parts that were held out, and further recordings."""
        return [*enumerate(self.held), *((None, recording) for recording in self.further)]

    def again(self, records: list[Record]) -> Estimate:
        """What is estimated from other records in the same way, without intervals.

        **Raises:** as [`identify`][riecjax.identify].
        """
        summary = summarise(self.model, records, self.criterion, key=self.settings.key)
        return estimated(self.model, summary, self.table, Naive())

    def otherwise(self, model: Model) -> Estimate:
        """What is estimated by other equations from the same records.

        **Raises:** as [`identify`][riecjax.identify].
        """
        summary = summarise(model, self.records, self.criterion, key=self.settings.key)
        return estimated(model, summary, self.table, self.intervals)


def require_memory_to_assess(
    model: Model,
    records: Sequence[Record],
    criterion: AbstractCriterion,
    *,
    checking: bool = False,
) -> None:
    """Refuse to assess a model on these records, or only to check them, without refining it, where
    the memory does not hold it.

    **Raises:** `MemoryError`.
    """
    samples = sum(record.sample_count for record in records)
    peak = 0.0
    for record in records:
        columns = len(model.equations) + len(record.arrays)
        peak += record.sample_count * BYTES_PER_SAMPLE * columns
        if criterion.needs_key:
            rows = float(criterion.row_count(record) or 0) * (len(model.parameter_names) + 1)
            peak += rows * BYTES_PER_ROW
    verb = "checking" if checking else "assessing"
    require_memory(f"{verb} the model on {samples} samples", peak, REMEDY)
