"""From a record as read to the record that a model's equations read."""

from typing import NamedTuple

from riecjax.models.model import Model
from riecjax.records.preparation import differentiate, every, low_pass
from riecjax.records.record import Record


class Preparation(NamedTuple):
    """What a user asks to be done to a record: cut-offs in Hz by signal, and thinning."""

    cutoffs: dict[str, float]
    every: int = 1

    def describe(self, model: Model) -> list[str]:
        """The steps in words, in the order in which they are taken."""
        steps = [
            f"{name}: zero-phase 4th-order Butterworth low-pass at {cutoff:g} Hz"
            for name, cutoff in self.cutoffs.items()
        ]
        steps += [
            f"{name}: central differences of {of}, if not recorded"
            for name, of in model.derived.items()
        ]
        if self.every > 1:
            ending = {1: "st", 2: "nd", 3: "rd"}.get(self.every % 10, "th")
            ending = "th" if 10 < self.every % 100 < 14 else ending
            steps.append(f"every {self.every}{ending} sample")
        return steps


def prepare(record: Record, model: Model, preparation: Preparation) -> Record:
    """Filter, add the model's derived signals where they are missing, and thin out.

    **Raises:** `DataError` for a missing signal or settings that the record does not allow.
    """
    if preparation.cutoffs:
        record = low_pass(record, preparation.cutoffs)
    for name, of in model.derived.items():
        if name not in record.signals:
            record = differentiate(record, of, name)
    return every(record, preparation.every) if preparation.every > 1 else record
