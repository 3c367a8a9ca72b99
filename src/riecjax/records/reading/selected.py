"""What is asked of a file's channels, and the record that they make."""

from collections.abc import Mapping
from typing import NamedTuple

from riecjax.findings import Finding
from riecjax.records.faults.spikes import Treatment
from riecjax.records.noise_judgement import GivenNoise
from riecjax.records.record import Record


class Selection(NamedTuple):
    """Which of a file's channels a user wants as signals, and how they are converted.

    **Fields:** `rename`, signal to column; `scale`, column or signal to factor; `units`, signal to
    unit; `derive`, signal to formula; `time_step` in s; `resample` in Hz; `noise`, on the signals
    as measured; `outliers`, what becomes of spikes, before anything else is made of a signal.
    """

    rename: Mapping[str, str] = {}
    scale: Mapping[str, float] = {}
    units: Mapping[str, str] = {}
    derive: Mapping[str, str] = {}
    time_step: float | None = None
    resample: float | None = None
    noise: GivenNoise = "auto"
    outliers: Treatment = "keep"


class Selected(NamedTuple):
    """A record, and what was decided on selecting it, in words.

    **Fields:** `converted`: signal to the unit that it was converted from; `doubt` in words that
    time is what it is taken for, empty if none; `findings`, on signals that were repaired.
    """

    record: Record
    converted: Mapping[str, str] = {}
    notes: tuple[str, ...] = ()
    doubt: str = ""
    findings: tuple[Finding, ...] = ()
