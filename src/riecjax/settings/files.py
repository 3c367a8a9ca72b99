"""Settings of what is read and written: the model, its recordings, a job, the result.

Each setting is said once. A field is a keyword of the verbs in Python, an option of the command
line, a line of the job file that `riecjax init` prints, and an entry of a result's provenance. To
add one is to add a field; what recordings, fits and answers are asked stands in a module each.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import add, mul
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from riecjax.errors import DataError
from riecjax.settings.kinds import (
    CODE,
    ELEMENT,
    FILE,
    FINITE,
    FOLDER,
    HERTZ_OR_AUTO,
    NAMES,
    NOT_NEGATIVE,
    PLACE,
    POSITIVE,
    TEXT,
    choice,
    whole,
)
from riecjax.settings.option import Settings, flag, many, named, setting

if TYPE_CHECKING:
    from riecjax.records.noise_judgement import GivenNoise


@dataclass(frozen=True, kw_only=True)
class ModelName(Settings):
    """Which model."""

    model_name: str = setting("--model", CODE, required=True)
    """A built-in model (see 'riecjax models') or path/to/file.py[:object]."""


@dataclass(frozen=True, kw_only=True)
class Select(Settings):
    """Which columns are signals, and how they are converted.

    A unit in brackets may be left out of a column's name. `units` go before what the file states;
    formulas of `derive` are computed in their order, last of all.
    """

    error: ClassVar = DataError

    rename: Mapping[str, str] = named("--map SIGNAL=COLUMN", TEXT)
    """Call a column by the model's name."""
    scale: Mapping[str, float] = named("--scale COLUMN=FACTOR", FINITE, combine=mul)
    """Multiply a column, to SI units."""
    units: Mapping[str, str] = named("--unit COLUMN=UNIT", TEXT)
    """Convert a column from this unit."""
    derive: Mapping[str, str] = named("--derive SIGNAL=FORMULA", TEXT)
    """Compute a signal from others, as in 'force=35.15*volt'."""
    time_step: float | None = setting("--time-step", POSITIVE)
    """Seconds between samples, for files without time, or with a bad one."""
    resample: float | None = setting("--resample HZ", POSITIVE)
    """Bring unevenly or differently sampled signals to one even rate, anti-aliased."""
    noise: "GivenNoise" = named(
        "--noise auto|none|SIGNAL=SD",
        NOT_NEGATIVE,
        "auto",
        default_in_words="auto",
        alone=("auto", "none"),
        free=True,
    )
    """Standard deviation of the noise on a signal as measured, in SI units, 0 for none; the
    others are judged from their samples."""


@dataclass(frozen=True, kw_only=True)
class Read(Select):
    """How a file is read.

    `outliers` are seen to before anything else is made of a signal.
    """

    columns: Sequence[str] = setting("--columns A,B,...", NAMES, ())
    """Names of a text file's columns, where it has none or others are wanted."""
    parts: Sequence[str] = many("--part NAME", TEXT, default_in_words="all")
    """Of a file with several recordings, use this one, as 'runs(2)'."""
    delimiter: str | None = setting("--delimiter", TEXT, default_in_words="detected")
    """Between columns of a text file."""
    decimal: str | None = setting("--decimal", choice(".", ","), default_in_words="detected")
    """Decimal sign of a text file."""
    outliers: Literal["repair", "missing", "keep"] = setting(
        "--outliers", choice("repair", "missing", "keep"), "repair"
    )
    """Spikes of one to three samples: replace each by what the samples around it say, mark it
    as missing, or keep it, as a pulse that really acted."""


@dataclass(frozen=True, kw_only=True)
class Prepare(Settings):
    """What is done to a record as read, in this order.

    `align` depends on what is found in the record; see [`align`][riecjax.doubts.align],
    [`leave_out`][riecjax.records.leave_out], [`set_clocks`][riecjax.records.set_clocks],
    [`unfilter`][riecjax.records.unfilter] and [`remove_line`][riecjax.records.remove_line].
    """

    error: ClassVar = DataError

    start: float | None = setting("--from S", FINITE)
    """Use the record from this time on, in seconds from its first sample."""
    stop: float | None = setting("--to S", FINITE)
    """Use the record up to this time, in seconds from its first sample."""
    left_out: Sequence[str] = many("--leave-out SIGNAL", TEXT)
    """Take as missing what this signal shows while it is stuck or at the end of its range."""
    shifts: Mapping[str, float] = named("--shift SIGNAL=SECONDS", FINITE, combine=add)
    """Advance a signal that is late by so much."""
    clocks: Mapping[str, float] = named("--clock SIGNAL=PPM", FINITE, combine=add)
    """Set the clock of a signal that falls behind by so many millionths of the time."""
    lags: Mapping[str, float] = named("--unfilter SIGNAL=SECONDS", FINITE, combine=add)
    """Undo a first-order low-pass with this time constant in front of a signal."""
    zeros: Mapping[str, float] = named("--zero SIGNAL=VALUE", FINITE, combine=add)
    """Subtract what a signal reads at zero."""
    slopes: Mapping[str, float] = named("--slope SIGNAL=PER_SECOND", FINITE, combine=add)
    """Subtract what a signal drifts by, counted from the recording's first sample."""
    align: str | Sequence[str] = many(
        "--align auto|none|SIGNAL", TEXT, "auto", default_in_words="auto", alone=("auto", "none")
    )
    """Advance what is late against its recorded derivative or integral: where that is certain,
    never, or this signal."""
    offsets: Sequence[str] = many("--remove-offset SIGNAL", TEXT)
    """Subtract a signal's mean."""
    drifts: Sequence[str] = many("--remove-drift SIGNAL", TEXT)
    """Subtract a signal's straight line."""
    notches: Sequence[float | Literal["auto"]] = many("--notch HZ|auto", HERTZ_OR_AUTO)
    """Take the mains' hum at this frequency, 50 or 60, and its harmonics off all signals."""
    cutoffs: Mapping[str, float] = named("--low-pass SIGNAL=HZ", FINITE)
    """Filter a signal first: zero-phase 4th-order Butterworth."""
    upsample: int = setting("--upsample N", whole(1, 1000), 1)
    """Interpolate N times as many samples, band-limited: for few samples per period."""
    derivatives: Mapping[str, str] = named("--differentiate NEW=SIGNAL", TEXT)
    """Add a signal's central differences."""
    every: int = setting("--every N", whole(1), 1)
    """Use every N-th sample, after all other steps."""

    def contradictions(self) -> Iterator[str]:
        """A record that ends before it begins."""
        if self.start is not None and self.stop is not None and self.start >= self.stop:
            yield "{start} must lie before {stop}."


@dataclass(frozen=True, kw_only=True)
class Reading(Prepare, Read):
    """How a file is read, and how its record is prepared: keywords of [`read_recording`][].

    **Fields:** those of [`Select`][riecjax.settings.Select], [`Read`][riecjax.settings.Read] and
    [`Prepare`][riecjax.settings.Prepare];
    `model`, whose units the signals get, and which says which signals are derivatives of others;
    `part`, one of `parts`.
    """

    model: Any = None
    part: str | None = None


@dataclass(frozen=True, kw_only=True)
class Frame(Select):
    """Keywords of [`from_dataframe`][riecjax.from_dataframe] and of
    [`from_dataset`][riecjax.from_dataset]; `time`, the name of the time's column or coordinate."""

    time: str | None = None


@dataclass(frozen=True, kw_only=True)
class Recordings(Prepare, Read):
    """Recordings, and how all of them are read."""

    files: Sequence[Path] = many("RECORD...", FILE, required=True)
    allow_duplicates: bool = flag("--allow-duplicates")
    """Take recordings that hold the same samples, which are refused otherwise."""


@dataclass(frozen=True, kw_only=True)
class Elements(Settings):
    """What a model leaves out, and what its sensors get wrong.

    In Python `model.with_elements(...)` adds it.
    """

    modes: Sequence[tuple[str, float | None]] = many("--add-mode SIGNAL[=HZ]", PLACE)
    """Find an oscillator that the model leaves out, on the body with this velocity, everywhere
    or near a frequency."""
    springs: Sequence[str] = many("--add-spring TERM", TEXT)
    """Find a spring that the model leaves out, in series with the damper of this linear
    coefficient."""
    offsets_of: Sequence[str] = many("--unknown-offset SIGNAL", TEXT)
    """Estimate the zero of this signal's sensor as well."""
    gains_of: Sequence[str] = many("--unknown-gain SIGNAL", TEXT)
    """Estimate the factor by which this signal's readings are to be multiplied."""
    added: Sequence[tuple[str, str, float | None]] = many("--add KIND:SIGNAL[=HZ]", ELEMENT)
    """Add an element of this kind: mode, spring, zero or gain, as the options above do; backlash,
    of the coefficient of a spring; one that another package brings, or FILE.py:CLASS of your own.
    A number is that near which it is looked for, hertz of a mode, play of backlash."""
    together: bool = flag("--together")
    """Solve the equations of all stages at once, for the parameters that they share."""


@dataclass(frozen=True, kw_only=True)
class Seed(Settings):
    """What random draws begin with."""

    seed: int = setting("--seed", whole(0, 2**63 - 1), 0)
    """Seed of all random draws."""


@dataclass(frozen=True, kw_only=True)
class Report(Settings):
    """How a result is shown."""

    verbose: bool = flag("--verbose", of_result=True)
    """Tell everything, not the verdict alone."""


@dataclass(frozen=True, kw_only=True)
class Job(Settings):
    """A job to run again."""

    job: Path | None = setting("--job", FILE, of_result=True)
    """Options and recordings from a TOML file (see 'riecjax init') or a results.json (or its
    folder); what is given beside it wins."""


@dataclass(frozen=True, kw_only=True)
class Document(Settings):
    """What is printed."""

    as_json: bool = flag("--json", of_result=True)
    """Print one JSON document instead of tables."""


@dataclass(frozen=True, kw_only=True)
class Output(Document):
    """Where a result goes."""

    out: Path | None = setting("--out", FOLDER, of_result=True)
    """Folder for results.json, figures and report.html."""
