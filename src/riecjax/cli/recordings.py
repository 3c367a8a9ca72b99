"""Options that say how a recording is read and prepared."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from riecjax.cli.options import FINITE, POSITIVE, Assignment, assignments, collecting, pairs_to_dict

if TYPE_CHECKING:
    from riecjax.models.model import Model
    from riecjax.records.recording import Recording


class NotchType(click.ParamType):
    """`auto`, or a frequency in Hz."""

    name = "HZ|auto"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float | str:
        return value if value == "auto" else POSITIVE.convert(value, param, ctx)


class NoiseType(Assignment):
    """`auto`, `none`, or the standard deviation of one signal's noise."""

    def __init__(self):
        super().__init__(float, "auto|none|SIGNAL=SD")

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, Any]:
        if value in ("auto", "none"):
            return value, None
        name, level = super().convert(value, param, ctx)
        if level < 0:
            self.fail(f"'{value}' is negative; give a standard deviation from 0 on.", param, ctx)
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
        type=NoiseType(),
        metavar="auto|none|SIGNAL=SD",
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
        type=NotchType(),
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


@dataclasses.dataclass(frozen=True)
class RecordingOptions:
    """What the user said of the recordings: their `files`, and how all of them are read.

    The other fields are the keywords of [`read_recording`][riecjax.read_recording], but for
    `parts`, each of which is read from each file, and `allow_duplicates`.
    """

    files: tuple[Path, ...]
    rename: Mapping[str, str]
    scale: Mapping[str, float]
    units: Mapping[str, str]
    derive: Mapping[str, str]
    columns: tuple[str, ...]
    time_step: float | None
    resample: float | None
    parts: tuple[str, ...]
    delimiter: str | None
    decimal: str | None
    noise: str | Mapping[str, float]
    outliers: str
    start: float | None
    stop: float | None
    left_out: tuple[str, ...]
    shifts: Mapping[str, float]
    clocks: Mapping[str, float]
    lags: Mapping[str, float]
    align: str | tuple[str, ...]
    offsets: tuple[str, ...]
    drifts: tuple[str, ...]
    notches: tuple[float | str, ...]
    cutoffs: Mapping[str, float]
    upsample: int
    derivatives: Mapping[str, str]
    every: int
    allow_duplicates: bool

    @property
    def settings(self) -> dict[str, Any]:
        """The keywords of [`read_recording`][riecjax.read_recording], but for `part`."""
        return {
            field.name: getattr(self, field.name)
            for field in dataclasses.fields(self)
            if field.name not in ("files", "parts", "allow_duplicates")
        }

    def read(self, files: Sequence[Path], model: "Model") -> "list[Recording]":
        """What these files hold, read and prepared for a model.

        **Raises:** `DataError` naming the file, or a recording that was given twice.
        """
        from riecjax.records.faults.rows import refuse_duplicates
        from riecjax.records.recording import read_parts

        settings = self.settings
        recordings = [
            one for file in files for one in read_parts(file, self.parts, model=model, **settings)
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
