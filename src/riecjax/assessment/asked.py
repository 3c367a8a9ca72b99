"""What an assessment is asked: model, criterion, and which recordings serve for what."""

from typing import Any, NamedTuple

from jaxtyping import Array, Key

from riecjax.criteria.criterion import AbstractCriterion
from riecjax.equations.procedure import Procedure
from riecjax.models.model import Model
from riecjax.records.record import Record
from riecjax.records.recording import Recording
from riecjax.uncertainty.intervals import AbstractIntervals


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
