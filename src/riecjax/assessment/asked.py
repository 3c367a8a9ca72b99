"""What an assessment is asked: model, criterion, and which recordings serve for what."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from jaxtyping import Array, ArrayLike, Key

from riecjax.criteria.criterion import AbstractCriterion
from riecjax.equations.procedure import Procedure
from riecjax.estimation.estimate import Estimate
from riecjax.estimation.identify import identify
from riecjax.models.model import Model
from riecjax.records.record import Record
from riecjax.records.recording import Recording
from riecjax.uncertainty.intervals import AbstractIntervals, Naive
from riecjax.work import REMEDY, Work, expect

SECONDS_PER_SAMPLE = 4e-6
"""Of sums and checks, for each signal; and, for each equation, of tests of what it leaves."""
BYTES_PER_SAMPLE = 110.0
"""The same at the peak of memory."""
SECONDS_OF_MODES = 2e-5
"""Beside them, for each equation of a model with hidden elements."""
WORK_PER_ROW = Work(4e-6, 320.0)
"""Of a criterion that draws its windows, for each window and column."""
CHECKING = 0.25
"""Share of that time that a check takes, which tests no residual and sweeps no length."""


TINY = 1e-300
"""In place of a size of zero, which nothing is a share of."""


def size_of(value: ArrayLike) -> float:
    """Size of a value, for shares of it."""
    return max(abs(float(value)), TINY)


class Asked(NamedTuple):
    """What is asked: a model, a criterion, and recordings to estimate from (`fitted`).

    **Fields:** `procedure`, the model's equations, built once: equations that are built anew may
    hold other functions, and would be compiled anew; `held`, the last parts of recordings if
    those are held out, and `further` recordings, both to validate on; `key` of random windows;
    `settings`, known values and parameters per record; `intervals`.
    """

    model: Model
    procedure: Procedure
    criterion: AbstractCriterion
    fitted: list[Recording]
    held: list[Recording]
    further: list[Recording]
    key: Key[Array, ""] | None
    settings: dict[str, Any]
    intervals: AbstractIntervals

    @property
    def records(self) -> list[Record]:
        """The records to estimate from."""
        return [recording.record for recording in self.fitted]

    def again(self, records: list[Record]) -> Estimate:
        """What is estimated from other records in the same way, without intervals.

        **Raises:** as [`identify`][riecjax.identify].
        """
        return identify(
            self.procedure,
            records,
            self.criterion,
            key=self.key,
            **self.settings,
            intervals=Naive(),
        )


def expect_assessing(
    procedure: Procedure,
    records: Sequence[Record],
    criterion: AbstractCriterion,
    *,
    checking: bool = False,
) -> None:
    """Say what it takes to assess a model on these records, or only to check them, without refining
    it.

    **Raises:** `MemoryError` if the memory does not hold it.
    """
    part = CHECKING if checking else 1.0
    samples = sum(record.sample_count for record in records)
    seconds, peak = 0.0, 0.0
    for record in records:
        equations, signals = len(procedure.equations), len(record.arrays)
        modes = SECONDS_OF_MODES * equations * procedure.has_hidden
        each = SECONDS_PER_SAMPLE * (equations + signals) * part
        seconds += record.sample_count * (each + modes)
        peak += record.sample_count * BYTES_PER_SAMPLE * (equations + signals)
        if criterion.needs_key:
            rows = float(criterion.row_count(record) or 0) * (len(procedure.parameters) + 1)
            seconds += rows * WORK_PER_ROW.seconds * part
            peak += rows * WORK_PER_ROW.bytes
    expect(
        f"{'checking' if checking else 'assessing'} the model on {samples} samples",
        Work(seconds, peak),
        REMEDY,
    )
