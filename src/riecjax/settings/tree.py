"""All settings of reading, preparing, fitting, refining, validating and reporting, each said once.

A field is a keyword of the verbs in Python, an option of the command line, a line of the job file
that `riecjax init` prints, and an entry of a result's provenance. To add one is to add a field.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from operator import add, mul
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from riecjax.errors import DataError, require
from riecjax.settings.kinds import (
    CODE,
    ELEMENT,
    ENDS,
    FILE,
    FINITE,
    FOLDER,
    HERTZ_OR_AUTO,
    MEAN_AND_DEVIATION,
    NAMES,
    NOT_NEGATIVE,
    PLACE,
    POSITIVE,
    SHARE,
    TEST_FUNCTION,
    TEXT,
    WINDOW_COUNT,
    choice,
    whole,
)
from riecjax.settings.option import Settings, flag, many, named, setting

if TYPE_CHECKING:
    from jaxtyping import Array, Key

    from riecjax.criteria.criterion import AbstractCriterion
    from riecjax.criteria.test_functions import AbstractTestFunction
    from riecjax.estimation.estimate import Estimate
    from riecjax.records.noise_judgement import GivenNoise
    from riecjax.records.record import Records
    from riecjax.refinement.objective import AbstractObjective
    from riecjax.uncertainty.intervals import AbstractIntervals
    from riecjax.validation.tests import MakeTest


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

    `align` depends on what is found in the record; see [`align`][riecjax.records.align],
    [`leave_out`][riecjax.records.leave_out], [`set_clocks`][riecjax.records.set_clocks] and
    [`unfilter`][riecjax.records.unfilter].
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

    In Python a model has methods for it: `with_modes`, `with_series_springs`,
    `with_sensor_errors`.
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
    """Add an element of this kind: mode, spring, offset or gain, as the options of these names do,
    or one that an installed package brings."""


@dataclass(frozen=True)
class Fit(Settings):
    """What is fitted: the criterion, by its band or as an object."""

    criterion: "Literal['riec', 'dols'] | AbstractCriterion | None" = setting(
        "--criterion", choice("riec", "dols"), "riec"
    )
    """Windowed integrals of the equation of motion, or the equation at every sample."""
    _: KW_ONLY
    band: tuple[float, float] | None = setting(
        "--band LOW HIGH",
        POSITIVE,
        count=2,
        default_in_words="the model's, else 1 10",
        excludes=("alpha", "beta"),
    )
    """Frequencies in Hz that the model should explain; windows are half their periods long,
    bumps longer."""
    alpha: float | None = setting(
        "--alpha", POSITIVE, default_in_words="half a period of HIGH", excludes=("band",)
    )
    """Shortest window in s."""
    beta: float | None = setting(
        "--beta", POSITIVE, default_in_words="half a period of LOW", excludes=("band",)
    )
    """Longest window in s."""
    windows: int | str | None = setting("--windows", WINDOW_COUNT, default_in_words="all")
    """All windows there are, in closed form, or a number of random ones."""
    test_function: "str | AbstractTestFunction | None" = setting(
        "--test-function",
        TEST_FUNCTION,
        default_in_words="auto, the boxcar, or the bump where no sensor measured a velocity",
    )
    """Weight inside a window, or a class of your own; hat and bump need no velocities."""
    quadrature: Literal["2", "4", "6", "8"] | None = setting(
        "--quadrature",
        choice("2", "4", "6", "8"),
        default_in_words="4; 2, trapezoids, for random windows between samples",
    )
    """Order of the integrals in the time step, for test functions that have one."""

    @property
    def says_of_criterion(self) -> bool:
        """Whether a criterion is asked for, so that it is not the one that suits."""
        return (self.criterion is not None and self.says("criterion")) or self.says_of_windows

    @property
    def says_of_windows(self) -> bool:
        """Whether anything is said of the windows."""
        return self.says("band", "alpha", "beta", "windows", "test_function", "quadrature")

    def contradictions(self) -> Iterator[str]:
        """What belongs to another criterion, or says the same twice."""
        if self.criterion is not None and self.says("criterion") and self.says_of_windows:
            yield (
                "{band}, {alpha}, {beta}, {windows}, {test_function} and {quadrature} belong to "
                "{criterion:riec}."
            )
        if self.band is not None and self.alpha is not None and self.beta is not None:
            yield "{band} sets the same lengths as {alpha} and {beta}: leave out one of them."


@dataclass(frozen=True, kw_only=True)
class Known(Settings):
    """What is known beforehand."""

    known: "Mapping[str, float | Array]" = named("--set NAME=VALUE", FINITE)
    """Hold a parameter at a known value (SI units)."""


@dataclass(frozen=True, kw_only=True)
class Constrained(Settings):
    """What is likely beforehand, of the linear estimate and of a refinement."""

    bounds: Mapping[str, tuple[float | None, float | None]] = named("--bound NAME=LOW:HIGH", ENDS)
    """Keep a parameter between two values, either of which may be left out."""
    priors: Mapping[str, tuple[float, float]] = named("--prior NAME=MEAN±SD", MEAN_AND_DEVIATION)
    """What is known of a parameter beforehand, in SI units: it counts as one more observation."""


@dataclass(frozen=True, kw_only=True)
class Sharing(Settings):
    """Which parameters recordings do not share."""

    per_record: Sequence[str] = many("--per-record NAME", TEXT)
    """Give a parameter a value of its own in each recording (such as an offset)."""


@dataclass(frozen=True, kw_only=True)
class Uncertainty(Settings):
    """How scatter is judged, and what is left out of the sums."""

    intervals: "Literal['bootstrap', 'sandwich', 'naive'] | AbstractIntervals | None" = setting(
        "--intervals", choice("bootstrap", "sandwich", "naive"), "bootstrap"
    )
    """How uncertainty is judged; naive takes overlapping windows for independent ones."""
    at_rest: Literal["mask", "keep"] | None = setting(
        "--at-rest", choice("mask", "keep"), default_in_words="mask"
    )
    """Leave out where a velocity with dry friction rests, or keep it."""


@dataclass(frozen=True, kw_only=True)
class Refine(Settings):
    """Whether and how the linear estimate is refined."""

    refine: "Literal['auto', 'none', 'integral', 'output-error'] | AbstractObjective | None" = (
        setting("--refine", choice("auto", "none", "integral", "output-error"), "auto")
    )
    """Refine the linear estimate: all equations at once over the same windows, or by
    simulation; auto does the latter where it leaves only white noise."""
    horizon: float | None = setting("--horizon SECONDS", POSITIVE)
    """Simulate over windows so long; by default over whole recordings, unless the motion is
    unstable."""
    channels: Sequence[str] = many("--channel SIGNAL", TEXT)
    """Signal to compare with its simulation; by default every recorded state."""
    loss: Literal["squares", "huber"] = setting("--loss", choice("squares", "huber"), "squares")
    """What is made small of simulated minus recorded: squares, or Huber's loss, in which what
    no noise explains pulls less."""

    def contradictions(self) -> Iterator[str]:
        """What the refinement that is asked for does not use."""
        by = self.refine
        if not (by is None or isinstance(by, str) or hasattr(type(by), "residuals")):
            require("refine", by, (), "refine=rx.OutputError(), 'auto' or None")
        if self.channels and self.refine != "output-error":
            yield "{channels} goes with {refine:output-error}."
        if self.loss not in (None, "squares") and self.refine != "output-error":
            yield "{loss} goes with {refine:output-error}."


@dataclass(frozen=True, kw_only=True)
class Validate(Settings):
    """What tests the answer beside its own residuals."""

    hold_out: float | None = setting("--hold-out SHARE", SHARE)
    """Keep this share at the end of each recording for validation by simulation."""
    validate_on: "Records | Sequence[Path]" = many("--validate RECORD", FILE, free=True)
    """Simulate the identified model on this recording."""
    sweep: bool = flag("--sweep/--no-sweep", True)
    """Estimates against window length, which show an inexact model."""


@dataclass(frozen=True, kw_only=True)
class Seed(Settings):
    """What random draws begin with."""

    seed: int = setting("--seed", whole(0, 2**63 - 1), 0)
    """Seed of all random draws."""


@dataclass(frozen=True, kw_only=True)
class Sums(Fit):
    """What only Python says of sums: `key` of random windows, and the `noise` of bare records."""

    key: "Key[Array, ''] | None" = None
    noise: "GivenNoise" = "auto"


@dataclass(frozen=True, kw_only=True)
class Check(Sharing, Known, Sums):
    """Keywords of [`check`][riecjax.check]."""


@dataclass(frozen=True, kw_only=True)
class Identify(Uncertainty, Sharing, Known, Constrained, Sums):
    """Keywords of [`identify`][riecjax.identify]."""


@dataclass(frozen=True, kw_only=True)
class Assess(Validate, Uncertainty, Sharing, Known, Constrained, Refine, Sums):
    """Keywords of [`assess`][riecjax.assess].

    **Fields:** also `tests` of a user's own, each a function that makes one of the model, the
    records and the answer; `on_estimate`, called with the estimate before all that is slow, unless
    refinement answers; `progress`, called with the sum of squares after each step of a refinement
    that was asked for.
    """

    tests: "Sequence[MakeTest]" = ()
    on_estimate: "Callable[[Estimate], None] | None" = None
    progress: Callable[[float], None] | None = None

    def contradictions(self) -> Iterator[str]:
        """What nothing uses, and parameters without a value."""
        validates = self.hold_out is not None or bool(self.validate_on)
        if self.horizon is not None and self.refine in (None, "none", "integral") and not validates:
            yield (
                "{horizon} goes with {refine:auto} or {refine:output-error}, or with {hold_out} or "
                "{validate_on}: nothing else is simulated."
            )
        if self.per_record and self.validate_on:
            yield (
                "{per_record} gives a parameter no value on the recordings of {validate_on}: use "
                "one of the two."
            )


@dataclass(frozen=True)
class Offered(Settings):
    """Which terms a model may lack."""

    candidates: object = setting(
        "--candidates FILE.py:OBJECT",
        CODE,
        default_in_words="friction, springs, dead zones, offsets and the like of its motions",
    )
    """Terms that it may lack, a list of your own."""


@dataclass(frozen=True, kw_only=True)
class Discover(Seed, Uncertainty, Known, Fit, Offered):
    """How terms are looked for.

    Keywords of [`discover`][riecjax.discover].
    """

    hold_out: float | None = setting("--hold-out SHARE", SHARE)
    """Choose without this share at the end of each recording, and take values and intervals
    from it alone."""
    least: float = setting("--least SHARE", SHARE, 0.01)
    """Of what is unexplained, the share that a term must make up for."""
    smallest: float = setting("--smallest SHARE", SHARE, 2e-5)
    """Of the target's energy, the share that a term must make up for: less for exact data."""
    resamples: int = 40
    """Times that terms are searched for in data drawn again."""
    noise: "GivenNoise" = "auto"


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
