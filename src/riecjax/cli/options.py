"""Options that several commands share, and their parsing."""

import contextlib
import dataclasses
import inspect
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

if TYPE_CHECKING:
    from riecjax.criteria.criterion import AbstractCriterion
    from riecjax.criteria.test_functions import AbstractTestFunction
    from riecjax.models.model import Model
    from riecjax.records.recording import Recording
    from riecjax.refinement.objective import AbstractObjective
    from riecjax.refinement.optimum import Prior


class Parsed(click.ParamType):
    """What a function makes of a text, whose `ValueError` says what is wrong with it.

    `kind` is that of the value, as a job file writes it.
    """

    def __init__(self, name: str, parse: Callable[[str], Any], kind: type = str):
        self.name, self.parse, self.kind = name, parse, kind

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        try:
            return self.parse(str(value))
        except ValueError as error:
            self.fail(str(error), param, ctx)


def _number(name: str, condition: Callable[[float], bool], words: str) -> Parsed:
    """A number that satisfies a condition, which `words` name after the number in a refusal."""

    def parse(text: str) -> float:
        with _refusing(f"'{text}' is not a number."):
            number = float(text)
        if not condition(number):
            raise ValueError(f"'{text}' must {words}.")
        return number

    return Parsed(name, parse, float)


@contextlib.contextmanager
def _refusing(message: str) -> Iterator[None]:
    """Say this of a text that is no number."""
    try:
        yield
    except ValueError:
        raise ValueError(message) from None


POSITIVE = _number(
    "number",
    lambda number: math.isfinite(number) and number > 0,
    "be a finite number greater than zero",
)
FINITE = _number("number", math.isfinite, "be a finite number")
SHARE = _number("share", lambda number: 0 < number < 1, "lie between 0 and 1")


def _pair(text: str, form: str, hint: str = "") -> tuple[str, str]:
    """What stands before and behind an equals sign, neither of them empty."""
    name, there, value = (part.strip() for part in text.partition("="))
    if not (name and there and value):
        raise ValueError(f"'{text}' is not of the form {form}{hint}.")
    return name, value


def _assignment(form: str, kind: type) -> Parsed:
    """`NAME=VALUE` with a value of this kind."""

    def parse(text: str) -> tuple[str, Any]:
        name, value = _pair(text, form)
        if kind is str:
            return name, value
        said = text.partition("=")[2]
        with _refusing(f"'{said}' in '{text}' is not a number."):
            number = float(value)
        if not math.isfinite(number):
            raise ValueError(f"'{said}' in '{text}' is not a finite number.")
        return name, number

    return Parsed(form, parse, kind)


def pairs_to_dict(
    ctx: click.Context, param: click.Parameter, value: tuple[tuple[str, Any], ...]
) -> dict[str, Any]:
    """Collect assignments; naming one thing twice is an error."""
    names = [name for name, _ in value]
    for name in names:
        if names.count(name) > 1:
            raise click.BadParameter(f"'{name}' is given twice.", ctx, param)
    return dict(value)


def assignments(
    option: str, kind: type[float] | type[str], metavar: str, help_text: str, target: str
) -> Callable[..., Any]:
    """A repeatable option `--option NAME=VALUE` that arrives as a dict."""
    return click.option(
        option,
        target,
        type=_assignment(metavar, kind),
        metavar=metavar,
        multiple=True,
        callback=pairs_to_dict,
        help=help_text + " Repeatable.",
    )


def names_of(options: Sequence[Callable[..., Any]]) -> list[str]:
    """Names under which the values of these options arrive."""

    def command() -> None: ...

    for option in options:
        option(command)
    return [param.name for param in getattr(command, "__click_params__")]  # noqa: B009


def collecting(
    options: Sequence[Callable[..., Any]], kind: Callable[..., Any], name: str
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """A decorator that adds options to a command and hands them over as one argument.

    **Arguments:** `kind`, which is made of their values by name; `name` of the argument.
    """
    names = names_of(options)

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        def collected(**arguments: Any) -> Any:
            own = {each: arguments.pop(each) for each in names}
            return command(**{name: kind(**own)}, **arguments)

        collected.__doc__ = command.__doc__
        # Options that stand on the command itself are listed after these.
        collected.__click_params__ = getattr(command, "__click_params__", [])  # type: ignore[attr-defined]
        for option in reversed(options):
            collected = option(collected)
        return collected

    return decorate


model_option = click.option(
    "--model",
    "model_name",
    required=True,
    help="A built-in model (see 'riecjax models') or path/to/file.py[:object].",
)
at_rest_option = click.option(
    "--at-rest",
    type=click.Choice(["mask", "keep"]),
    help="Leave out where a velocity with dry friction rests, or keep it.  [default: mask]",
)
set_option = assignments(
    "--set", float, "NAME=VALUE", "Hold a parameter at a known value (SI units).", "known"
)
seed_option = click.option(
    "--seed",
    type=click.IntRange(min=0, max=2**63 - 1),
    default=0,
    show_default=True,
    help="Seed of all random draws.",
)


def _old_name(
    ctx: click.Context, param: click.Parameter, value: tuple[str, ...]
) -> tuple[str, ...]:
    if value:
        click.echo("riecjax: --own is called --per-record now.", err=True)
    ctx.meta["own"] = value
    return value


def per_record_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """`--per-record NAME`, and for one version its old name `--own`."""
    old = click.option(
        "--own",
        multiple=True,
        metavar="NAME",
        is_eager=True,
        expose_value=False,
        callback=_old_name,
        help="Old name of --per-record, which goes in the next version.",
    )
    return click.option(
        "--per-record",
        "per_record",
        multiple=True,
        metavar="NAME",
        callback=lambda ctx, param, value: (*value, *ctx.meta["own"]),
        help="Give a parameter a value of its own in each recording (such as an offset). "
        "Repeatable.",
    )(old(command))


json_option = click.option(
    "--json", "as_json", is_flag=True, help="Print one JSON document instead of tables."
)
out_option = click.option(
    "--out",
    "out",
    type=click.Path(file_okay=False, path_type=Path),
    help="Folder for results.json, figures and report.html.",
)


@dataclasses.dataclass(frozen=True)
class HiddenOptions:
    """What a model leaves out, as asked for."""

    modes: tuple[tuple[str, float | None], ...]
    springs: tuple[str, ...]
    offsets_of: tuple[str, ...]
    gains_of: tuple[str, ...]

    def added_to(self, name: str) -> "Model":
        """The model of this name, with these modes, springs, and errors of sensors."""
        from riecjax.equations.hidden_elements import HiddenMode, SeriesSpring
        from riecjax.models.catalogue import find_model

        offsets, gains = (tuple(dict.fromkeys(of)) for of in (self.offsets_of, self.gains_of))
        model = find_model(name).with_sensor_errors(offsets, gains)
        model = model.with_modes(*(HiddenMode(*each) for each in self.modes))
        return model.with_series_springs(*map(SeriesSpring, self.springs))


def _hidden_mode(text: str) -> tuple[str, float | None]:
    name, equals, frequency = text.partition("=")
    if not name.strip() or (equals and not frequency.strip()):
        raise ValueError(f"'{text}' is not of the form SIGNAL[=HZ].")
    return name.strip(), POSITIVE.parse(frequency) if equals else None


hidden_options = collecting(
    (
        click.option(
            "--add-mode",
            "modes",
            type=Parsed("SIGNAL[=HZ]", _hidden_mode),
            metavar="SIGNAL[=HZ]",
            multiple=True,
            help="Find an oscillator that the model leaves out, on the body with this velocity, "
            "everywhere or near a frequency. Repeatable.",
        ),
        click.option(
            "--add-spring",
            "springs",
            metavar="TERM",
            multiple=True,
            help="Find a spring that the model leaves out, in series with the damper of this "
            "linear coefficient. Repeatable.",
        ),
        click.option(
            "--unknown-offset",
            "offsets_of",
            metavar="SIGNAL",
            multiple=True,
            help="Estimate the zero of this signal's sensor as well. Repeatable.",
        ),
        click.option(
            "--unknown-gain",
            "gains_of",
            metavar="SIGNAL",
            multiple=True,
            help="Estimate the factor by which this signal's readings are to be multiplied. "
            "Repeatable.",
        ),
    ),
    HiddenOptions,
    "hidden",
)
"""Options that add what a model leaves out; they arrive as one `hidden`."""


TEST_FUNCTION_NAMES = ("boxcar", "hat", "bump")
"""As in `criteria.plain_data`, whose import takes JAX; the first is the default."""


TEST_FUNCTIONS = ("auto", *TEST_FUNCTION_NAMES)
FORM_OF_TEST_FUNCTION = "|".join((*TEST_FUNCTIONS, "FILE.py:CLASS"))
MOST_WINDOWS = 100_000_000


def _window_count(text: str) -> int | str:
    """A number of random windows, or all of them."""
    if text == "all":
        return text
    with _refusing(f"'{text}' is neither a whole number nor 'all'."):
        count = int(text)
    if not 1 <= count <= MOST_WINDOWS:
        raise ValueError(f"{count} is not between 1 and {MOST_WINDOWS}.")
    return count


def _test_function(text: str) -> str:
    """The name of a test function, or a class of the user's own in a file."""
    if text not in TEST_FUNCTIONS and not text.rpartition(":")[0].endswith(".py"):
        listed = ", ".join(f"'{name}'" for name in TEST_FUNCTIONS)
        raise ValueError(f"'{text}' is not one of {listed}, nor FILE.py:CLASS.")
    return text


CRITERION_OPTIONS = (
    click.option(
        "--criterion",
        type=click.Choice(["riec", "dols"]),
        default="riec",
        show_default=True,
        help="Windowed integrals of the equation of motion, or the equation at every sample.",
    ),
    click.option(
        "--band",
        type=(POSITIVE, POSITIVE),
        metavar="LOW HIGH",
        help="Frequencies in Hz that the model should explain; windows are half their periods "
        "long, bumps longer. [default: the model's, else 1 10]",
    ),
    click.option(
        "--alpha", type=POSITIVE, help="Shortest window in s. [default: half a period of HIGH]"
    ),
    click.option(
        "--beta", type=POSITIVE, help="Longest window in s. [default: half a period of LOW]"
    ),
    click.option(
        "--windows",
        "count",
        type=Parsed("N|all", _window_count),
        help="All windows there are, in closed form, or a number of random ones. [default: all]",
    ),
    click.option(
        "--test-function",
        type=Parsed(FORM_OF_TEST_FUNCTION, _test_function),
        metavar=FORM_OF_TEST_FUNCTION,
        help="Weight inside a window, or a class of your own; hat and bump need no velocities. "
        "[default: auto, the boxcar, or the bump where no sensor measured a velocity]",
    ),
    click.option(
        "--quadrature",
        type=click.Choice(["2", "4", "6", "8"]),
        help="Order of the integrals in the time step, for test functions that have one. "
        "[default: 4; 2, trapezoids, for random windows between samples]",
    ),
)


@dataclasses.dataclass(frozen=True)
class CriterionOptions:
    """What the user said of the criterion."""

    criterion: str
    band: tuple[float, float] | None
    alpha: float | None
    beta: float | None
    count: int | str | None
    test_function: str | None
    quadrature: str | None

    @property
    def is_given(self) -> bool:
        """Whether anything was said of it, so that it is not the one that suits."""
        return self.criterion != "riec" or self._says_of_windows

    @property
    def _says_of_windows(self) -> bool:
        own = (
            *(self.band, self.alpha, self.beta, self.count),
            *(self.test_function, self.quadrature),
        )
        return any(value is not None for value in own)

    def require_sense(self) -> None:
        """Raise `click.UsageError` for options that do not go together."""
        if self.criterion == "dols" and self._says_of_windows:
            raise click.UsageError(
                "--band, --alpha, --beta, --windows, --test-function and --quadrature belong to "
                "--criterion riec."
            )
        if self.band is not None and self.alpha is not None and self.beta is not None:
            raise click.UsageError(
                "--band sets the same lengths as --alpha and --beta: leave out one of them."
            )

    def build(self, model: "Model", recordings: "Sequence[Recording]" = ()) -> "AbstractCriterion":
        """The criterion, for a model's band unless another is asked for.

        Raises `click.UsageError` for a quadrature where the test function has none.
        """
        from riecjax.criteria.criterion import DOLS, RIEC
        from riecjax.criteria.suited import suited
        from riecjax.criteria.windows import DEFAULT_BAND, RandomWindows

        if self.criterion == "dols":
            return DOLS()
        band = self.band or model.band or DEFAULT_BAND
        # Bumps have no quadrature: to ask for one is to ask for boxcars.
        if self.test_function in (None, "auto") and self.quadrature is None:
            records = [recording.record for recording in recordings]
            found = suited(model.build_procedure(), band, records)
        else:
            found = RIEC.of_band(band, self._build_test_function())
        own: Any = (found.windows.alpha, found.windows.beta)
        asked = self.alpha, self.beta
        alpha, beta = (b if a is None else a for a, b in zip(asked, own))
        if isinstance(self.count, int):
            return RIEC(RandomWindows(alpha, beta, self.count), found.test_function, found.why)
        return found.between(alpha, beta)

    def _build_test_function(self) -> "AbstractTestFunction":
        import numpy as np

        from riecjax.criteria.plain_data import TEST_FUNCTIONS
        from riecjax.criteria.test_functions import AbstractTestFunction
        from riecjax.errors import ModelError, users_code
        from riecjax.models.catalogue import object_of_file

        weights = {name: kind() for name, kind in TEST_FUNCTIONS.items()}
        given = self.test_function in (None, "auto")
        name = TEST_FUNCTION_NAMES[0] if given else str(self.test_function)
        if name in weights:
            weight: Any = weights[name]
        else:
            found = object_of_file(name)
            kind = found if isinstance(found, type) else type(found)
            if not issubclass(kind, AbstractTestFunction) or inspect.isabstract(kind):
                raise ModelError(
                    f"{name} is no test function: derive the class from "
                    f"riecjax.criteria.AbstractSmoothTestFunction."
                )
            # Whatever the class lacks shows here, and not in the middle of a fit.
            with users_code(name):
                weight = found() if isinstance(found, type) else found
                weight.describe()
                weight.gain(np.array([1.0]), np.array([0.5]))
                _ = weight.smoothness, weight.row_seconds
        if self.quadrature is None:
            return weight
        if not hasattr(weight, "quadrature"):
            having = [f"the {n}" for n, one in weights.items() if hasattr(one, "quadrature")]
            raise click.UsageError(f"--quadrature belongs to {' and '.join(having)}.")
        return dataclasses.replace(weight, quadrature=int(self.quadrature))


criterion_options = collecting(CRITERION_OPTIONS, CriterionOptions, "criteria")
"""The criterion's options; they arrive as one `criteria`."""


def _notch(text: str) -> float | str:
    return text if text == "auto" else POSITIVE.parse(text)


NOISE = "auto|none|SIGNAL=SD"


def _noise_of(text: str) -> tuple[str, Any]:
    """`auto`, `none`, or the standard deviation of one signal's noise."""
    if text in ("auto", "none"):
        return text, None
    name, level = _assignment(NOISE, float).parse(text)
    if level < 0:
        raise ValueError(f"'{text}' is negative; give a standard deviation from 0 on.")
    return name, level


def _noise(
    ctx: click.Context, param: click.Parameter, value: tuple[tuple[str, Any], ...]
) -> str | dict[str, float]:
    words = [name for name, level in value if level is None]
    if words and len(value) > 1:
        raise click.BadParameter(
            f"'{words[0]}' is for all signals; give it alone, or SIGNAL=SD for some.", ctx, param
        )
    return words[0] if words else pairs_to_dict(ctx, param, value) or "auto"


def _align(
    ctx: click.Context, param: click.Parameter, value: tuple[str, ...]
) -> str | tuple[str, ...]:
    words = [word for word in value if word in ("auto", "none")]
    if words and len(value) > 1:
        raise click.BadParameter(f"'{words[0]}' is for all signals; give it alone.", ctx, param)
    return words[0] if words else value or "auto"


def _names(ctx: click.Context, param: click.Parameter, value: str | None) -> tuple[str, ...]:
    return tuple(name.strip() for name in value.split(",")) if value else ()


RECORD_OPTIONS = (
    click.argument(
        "files", metavar="RECORD...", nargs=-1, required=True, type=click.Path(path_type=Path)
    ),
    assignments("--map", str, "SIGNAL=COLUMN", "Call a column by the model's name.", "rename"),
    assignments("--scale", float, "COLUMN=FACTOR", "Multiply a column, to SI units.", "scale"),
    assignments("--unit", str, "COLUMN=UNIT", "Convert a column from this unit.", "units"),
    assignments(
        "--derive",
        str,
        "SIGNAL=FORMULA",
        "Compute a signal from others, as in 'force=35.15*volt'.",
        "derive",
    ),
    click.option(
        "--columns",
        metavar="A,B,...",
        callback=_names,
        help="Names of a text file's columns, where it has none or others are wanted.",
    ),
    click.option(
        "--time-step",
        type=POSITIVE,
        help="Seconds between samples, for files without time, or with a bad one.",
    ),
    click.option(
        "--resample",
        type=POSITIVE,
        metavar="HZ",
        help="Bring unevenly or differently sampled signals to one even rate, anti-aliased.",
    ),
    click.option(
        "--part",
        "parts",
        multiple=True,
        metavar="NAME",
        help="Of a file with several recordings, use this one, as 'runs(2)'. Repeatable. "
        "[default: all]",
    ),
    click.option("--delimiter", help="Between columns of a text file. [default: detected]"),
    click.option(
        "--decimal",
        type=click.Choice([".", ","]),
        help="Decimal sign of a text file. [default: detected]",
    ),
    click.option(
        "--noise",
        type=Parsed(NOISE, _noise_of, float),
        metavar=NOISE,
        multiple=True,
        callback=_noise,
        help="Standard deviation of the noise on a signal as measured, in SI units, 0 for none; "
        "the others are judged from their samples. Repeatable. [default: auto]",
    ),
    click.option(
        "--outliers",
        type=click.Choice(["repair", "missing", "keep"]),
        default="repair",
        show_default=True,
        help="Spikes of one to three samples: replace each by what the samples around it say, "
        "mark it as missing, or keep it, as a pulse that really acted.",
    ),
    click.option(
        "--from",
        "start",
        type=FINITE,
        metavar="S",
        help="Use the record from this time on, in seconds from its first sample.",
    ),
    click.option(
        "--to",
        "stop",
        type=FINITE,
        metavar="S",
        help="Use the record up to this time, in seconds from its first sample.",
    ),
    click.option(
        "--leave-out",
        "left_out",
        multiple=True,
        metavar="SIGNAL",
        help="Take as missing what this signal shows while it is stuck or at the end of its range. "
        "Repeatable.",
    ),
    assignments(
        "--shift", float, "SIGNAL=SECONDS", "Advance a signal that is late by so much.", "shifts"
    ),
    assignments(
        "--clock",
        float,
        "SIGNAL=PPM",
        "Set the clock of a signal that falls behind by so many millionths of the time.",
        "clocks",
    ),
    assignments(
        "--unfilter",
        float,
        "SIGNAL=SECONDS",
        "Undo a first-order low-pass with this time constant in front of a signal.",
        "lags",
    ),
    click.option(
        "--align",
        metavar="auto|none|SIGNAL",
        multiple=True,
        callback=_align,
        help="Advance what is late against its recorded derivative or integral: where that is "
        "certain, never, or this signal. Repeatable. [default: auto]",
    ),
    click.option(
        "--remove-offset",
        "offsets",
        multiple=True,
        metavar="SIGNAL",
        help="Subtract a signal's mean. Repeatable.",
    ),
    click.option(
        "--remove-drift",
        "drifts",
        multiple=True,
        metavar="SIGNAL",
        help="Subtract a signal's straight line. Repeatable.",
    ),
    click.option(
        "--notch",
        "notches",
        type=Parsed("HZ|auto", _notch),
        multiple=True,
        metavar="HZ|auto",
        help="Take the mains' hum at this frequency, 50 or 60, and its harmonics off all signals. "
        "Repeatable.",
    ),
    assignments(
        "--low-pass",
        float,
        "SIGNAL=HZ",
        "Filter a signal first: zero-phase 4th-order Butterworth.",
        "cutoffs",
    ),
    click.option(
        "--upsample",
        type=click.IntRange(min=1, max=1000),
        default=1,
        metavar="N",
        help="Interpolate N times as many samples, band-limited: for few samples per period.",
    ),
    assignments(
        "--differentiate", str, "NEW=SIGNAL", "Add a signal's central differences.", "derivatives"
    ),
    click.option(
        "--every",
        type=click.IntRange(min=1),
        default=1,
        metavar="N",
        help="Use every N-th sample, after all other steps.",
    ),
    click.option(
        "--allow-duplicates",
        is_flag=True,
        help="Take recordings that hold the same samples, which are refused otherwise.",
    ),
)


class RecordingOptions:
    """What the user said of the recordings: their `files`, and how all of them are read.

    `settings` are the keywords of [`read_recording`][riecjax.read_recording], but for `parts`, each
    of which is read from each file, and `allow_duplicates`.
    """

    def __init__(
        self,
        files: tuple[Path, ...],
        parts: tuple[str, ...],
        allow_duplicates: bool,
        **settings: Any,
    ):
        self.files, self.parts, self.allow_duplicates = files, parts, allow_duplicates
        self.settings = settings

    def read(self, files: Sequence[Path], model: "Model") -> "list[Recording]":
        """What these files hold, read and prepared for a model.

        **Raises:** `DataError` naming the file, or a recording that was given twice.
        """
        from riecjax.records.faults.rows import refuse_duplicates
        from riecjax.records.recording import read_parts

        recordings = [
            recording
            for file in files
            for recording in read_parts(file, self.parts, model=model, **self.settings)
        ]
        if not self.allow_duplicates:
            refuse_duplicates(recordings)
        return recordings


record_options = collecting(RECORD_OPTIONS, RecordingOptions, "recordings")
"""The RECORD... argument and its options; they arrive as one `recordings`."""

SMALL_FILES = 2**24
"""Bytes of all recordings below which compiling code takes longer than running it."""


def are_small(files: Sequence[Path]) -> bool:
    """Whether these recordings are so short that what works on them runs in no time."""
    return sum(file.stat().st_size for file in files if file.exists()) < SMALL_FILES


BOUND, PRIOR = "NAME=LOW:HIGH", "NAME=MEAN±SD"


def _bound(text: str) -> tuple[str, tuple[float | None, float | None]]:
    """Both ends, either of which may be left out."""
    name, ends = _pair(text, BOUND)
    low, colon, high = ends.partition(":")
    if not colon:
        raise ValueError(f"'{text}' is not of the form {BOUND}.")
    with _refusing(f"the ends in '{text}' are not numbers."):
        return name, (float(low) if low.strip() else None, float(high) if high.strip() else None)


def _prior(text: str) -> tuple[str, tuple[float, float]]:
    """Mean and standard deviation, with `+-` between them too."""
    hint = " (or MEAN+-SD)"
    name, said = _pair(text, PRIOR, hint)
    mean, sign, std = said.replace("+-", "±").partition("±")
    if not sign:
        raise ValueError(f"'{text}' is not of the form {PRIOR}{hint}.")
    return name, (FINITE.parse(mean), POSITIVE.parse(std))


@dataclasses.dataclass(frozen=True)
class RefinementOptions:
    """What was asked for on the command line."""

    refine: str
    horizon: float | None
    channels: tuple[str, ...]
    bounds: tuple[tuple[str, tuple[float | None, float | None]], ...]
    priors: Mapping[str, tuple[float, float]]
    loss: Literal["squares", "huber"]

    def require_sense(self, *, validates: bool) -> None:
        """**Raises:** `click.UsageError` for options that nothing would come of."""
        if self.channels and self.refine != "output-error":
            raise click.UsageError("--channel goes with --refine output-error.")
        if self.loss != "squares" and self.refine != "output-error":
            raise click.UsageError("--loss goes with --refine output-error.")
        simulates = validates or self.refine in ("auto", "output-error")
        if self.horizon is not None and not simulates:
            raise click.UsageError(
                "--horizon goes with --refine auto or output-error, or with --hold-out or "
                "--validate: nothing else is simulated."
            )
        if self.bounds and self.refine == "none":
            raise click.UsageError("--bound goes with --refine auto, integral or output-error.")
        if self.priors and self.refine not in ("integral", "output-error"):
            raise click.UsageError(
                "--prior goes with --refine integral or output-error: the linear estimate knows of "
                "none."
            )

    @property
    def validation_horizon(self) -> float | None:
        """Seconds after which simulations start anew; None for as the motion asks."""
        return None if self.refine == "output-error" else self.horizon

    def known_before(self) -> "dict[str, Prior]":
        """Priors by name."""
        from riecjax.refinement.optimum import Prior

        return {name: Prior(*each) for name, each in self.priors.items()}

    def objective(self) -> "AbstractObjective | Literal['auto'] | None":
        """What is to be made small; `None` for no refinement."""
        if self.refine == "none":
            return None
        if self.refine == "auto":
            return "auto"
        from riecjax.refinement.integral_error import IntegralError
        from riecjax.refinement.output_error import OutputError, Tiles, WholeRecord

        if self.refine == "integral":
            return IntegralError()
        shooting = WholeRecord() if self.horizon is None else Tiles(seconds=self.horizon)
        return OutputError(shooting, channels=self.channels or None, loss=self.loss)


refinement_options: Callable[[Callable[..., Any]], Callable[..., Any]] = collecting(
    [
        click.option(
            "--refine",
            type=click.Choice(["auto", "none", "integral", "output-error"]),
            default="auto",
            show_default=True,
            help="Refine the linear estimate: all equations at once over the same windows, or by "
            "simulation; auto does the latter where it leaves only white noise.",
        ),
        click.option(
            "--horizon",
            type=POSITIVE,
            metavar="SECONDS",
            help="Simulate over windows so long; by default over whole recordings, unless the "
            "motion is unstable.",
        ),
        click.option(
            "--channel",
            "channels",
            multiple=True,
            metavar="SIGNAL",
            help="Signal to compare with its simulation; by default every recorded state. "
            "Repeatable.",
        ),
        click.option(
            "--bound",
            "bounds",
            multiple=True,
            type=Parsed(BOUND, _bound),
            help="Keep a refined parameter between two values, either of which may be left out. "
            "Repeatable.",
        ),
        click.option(
            "--prior",
            "priors",
            multiple=True,
            type=Parsed(PRIOR, _prior),
            callback=pairs_to_dict,
            help="What is known of a refined parameter beforehand, in SI units: it counts as one "
            "more observation. Repeatable.",
        ),
        click.option(
            "--loss",
            type=click.Choice(["squares", "huber"]),
            default="squares",
            show_default=True,
            help="What is made small of simulated minus recorded: squares, or Huber's loss, in "
            "which what no noise explains pulls less.",
        ),
    ],
    RefinementOptions,
    "refining",
)
