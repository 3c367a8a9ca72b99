"""How a file is read and its record prepared: the keywords of reading."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import fields
from typing import Any, Literal, NamedTuple, TypedDict

from riecjax.errors import DataError, require
from riecjax.records.faults.spikes import Treatment
from riecjax.records.noise_judgement import GivenNoise
from riecjax.records.preparation.steps import Preparation


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


class ReadingSettings(TypedDict, total=False):
    """How a file is read, and how its record is prepared: keywords of [`read_recording`][].

    How the file is read:

    - `rename`: new signal name to column name, as in `{"q": "qm"}`; columns that are not named
      keep their names. A unit in brackets may be left out of a column's name.
    - `scale`: column name (as in the file) or signal name to the factor that turns it into SI
      units.
    - `units`: column or signal name to its unit, before the one that the file states, to be
      converted from; of a signal of `derive`, the unit it has.
    - `derive`: signal name to a formula of signals, as in `{"force": "35.15 * vir"}`; see
      [`derived`][]. Formulas are computed in their order, last of all.
    - `time_step`: seconds between samples, for files without time.
    - `resample`: rate in Hz of the even grid to which all signals are brought: for uneven
      samples, and for files in which signals have different times.
    - `delimiter`, `decimal`: of a text file, instead of detecting them.
    - `columns`: names of a text file's columns, in place of those it has or has not.
    - `part`: the recording that is wanted, of a file with several; see [`read_recordings`][].
    - `noise`: on the signals as measured, in SI units: `"auto"`, judged from their samples;
      `"none"`; or a standard deviation by signal (0 for none), the others are judged. Steps of
      preparation carry it on. See [`Noise`][riecjax.Noise].
    - `outliers`: what becomes of spikes of one to three samples, before anything else is made of a
      signal: `"repair"` (the default) by a polynomial through the samples around, `"missing"` to
      mark them as missing, or `"keep"`. See [`repair_outliers`][riecjax.records.repair_outliers].

    What is done to the record then, in this order:

    - `start`, `stop`: cut it at these seconds from its first sample.
    - `left_out`: signals of which what is stuck or at the end of its range becomes missing. See
      [`leave_out`][riecjax.records.leave_out].
    - `shifts`: signal to the seconds by which it is advanced, since it is late by as much.
    - `clocks`: signal to the millionths of the time by which it falls behind. See
      [`set_clocks`][riecjax.records.set_clocks].
    - `lags`: signal to the time constant in seconds of a first-order low-pass in front of it, which
      is undone. See [`unfilter`][riecjax.records.unfilter].
    - `align`: `"auto"` advances what is late against its recorded derivative or integral, as the
      `model` names them; `"none"`; or the signals to shift. See [`align`][riecjax.records.align].
    - `offsets`, `drifts`: signals to remove the mean or a straight line from.
    - `notches`: lines of the mains to take off all signals, in Hz, with their harmonics, or
      `"auto"` for those that stand out.
    - `cutoffs`: signal to cut-off in Hz of a zero-phase low-pass.
    - `upsample`: factor of a band-limited interpolation.
    - `derivatives`: new signal to the signal whose central differences it is.
    - `every`: use every n-th sample.
    """

    rename: Mapping[str, str] | None
    scale: Mapping[str, float] | None
    units: Mapping[str, str] | None
    derive: Mapping[str, str] | None
    time_step: float | None
    resample: float | None
    delimiter: str | None
    decimal: str | None
    columns: Sequence[str]
    part: str | None
    noise: GivenNoise
    outliers: Treatment
    start: float | None
    stop: float | None
    left_out: Sequence[str]
    shifts: Mapping[str, float] | None
    clocks: Mapping[str, float] | None
    lags: Mapping[str, float] | None
    align: str | Sequence[str]
    offsets: Sequence[str]
    drifts: Sequence[str]
    notches: Sequence[float | Literal["auto"]]
    cutoffs: Mapping[str, float] | None
    upsample: int
    derivatives: Mapping[str, str] | None
    every: int


MAPPINGS = (
    "rename",
    "scale",
    "units",
    "derive",
    "cutoffs",
    "derivatives",
    "shifts",
    "clocks",
    "lags",
)
TEXTS = ("rename", "units", "derive", "derivatives")
"""Those mappings whose values are names, units or formulas."""
NAMES = ("offsets", "drifts", "columns", "notches", "left_out")


def sorted_settings(
    settings: ReadingSettings,
) -> tuple[Selection, Preparation, dict[str, Any]]:
    """The settings by what they are for: choice of channels, preparation, and a text's dialect.

    **Raises:** `TypeError` for an unknown keyword, `DataError` for what is no mapping or no names.
    """
    if unknown := [name for name in settings if name not in ReadingSettings.__annotations__]:
        raise TypeError(f"read_recording() got an unexpected keyword argument '{unknown[0]}'")
    given: dict[str, Any] = {"outliers": "repair", **settings}
    for name in (n for n in MAPPINGS if n in given):
        given[name] = given[name] or {}
        require(name, given[name], Mapping, f"{name}={{'x': ...}}, by the signal's name", DataError)
        for signal, value in given[name].items():
            require(f"a name in {name}", signal, str, "names as text, 'x'", DataError)
            if name in TEXTS:
                require(f"{name} of '{signal}'", value, str, "it as text, 'x'", DataError)
    for name in (n for n in NAMES if n in given):
        require(name, given[name], (list, tuple), f"{name}=('x',), a tuple of names", DataError)
        given[name] = tuple(given[name])
        for signal in given[name] if name != "notches" else ():
            require(f"a name in {name}", signal, str, "names as text, 'x'", DataError)
    if not isinstance(given.get("align", ""), str):
        given["align"] = tuple(given["align"])

    def of(names: Collection[str]) -> dict[str, Any]:
        return {name: value for name, value in given.items() if name in names}

    prepared = {field.name for field in fields(Preparation)}
    return (
        Selection(**of(Selection._fields)),
        Preparation(**of(prepared)),
        of(("delimiter", "decimal", "columns")),
    )
