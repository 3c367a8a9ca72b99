"""Which column of a file is time, and what its numbers count: seconds, milliseconds, days.

Loggers call time by many names, and call by them what is none (`T`, a temperature; `timestamp`, a
constant). So names propose, and the samples decide: time rises from row to row.
"""

import re
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from riecjax.errors import DataError
from riecjax.records.reading.channels import TIME_COLUMNS, Channels, listed
from riecjax.records.reading.dialect import NUMBERED
from riecjax.records.reading.time_stamps import unwrapped
from riecjax.records.reading.units import SECONDS, split_unit

TIME_WORDS = frozenset(
    """
    t time times timestamp timestamps timest zeit zeitstempel temps tempo tiempo tijd tid
    elapsed elapsedtime timeelapsed reltime relativetime abstime absolutetime systemtime
    testtime runningtime totaltime laptime recordtime sampletime datetime datetimeutc
    dateandtime date datumuhrzeit datumzeit uhrzeit datum utc utctime gpstime clock seconds secs
    sec epoch timesec timeseconds timeutc isotime xtime timeaxis timechannel heure horodatage
    tout tvec timevector millis micros nanos milliseconds microseconds nanoseconds minutes
    hours days
    """.split()  # noqa: SIM905
)
"""What loggers call time, in small letters and without what stands between words."""
DATES = frozenset(word for word in TIME_WORDS if word.startswith(("date", "datum")))
"""Those that say that a date is in it."""

DAY = 86400.0
EPOCHS = (
    (1e9, 4e9, 1.0, 1970), (1e12, 4e12, 1e-3, 1970), (1e15, 4e15, 1e-6, 1970),
    (1e18, 4e18, 1e-9, 1970), (1.26e17, 1.56e17, 1e-7, 1601), (6.31e17, 6.61e17, 1e-7, 1),
)  # fmt: skip
"""Stamps from which count to which one are of an epoch, in which unit, since which year: of 2001
to 2096 for all, the last two being those of Windows and of .NET."""
COUNTER = 2**32
"""Where counters of 32 bits, of milliseconds or microseconds, begin anew."""
UNSAID = frozenset(("", "column", "x", "xvalue", "xaxis", "index", "unnamed", "abscissa"))
"""What a first column is called that says nothing against being time."""
SERIAL_DAYS = ((2e4, 8e4), (6.9e5, 8e5))
"""Days as spreadsheets (from 1900) and MATLAB (from year 0) count them: of 1954 to 2119, and
of 1889 to 2190."""
SUBUNITS = {"milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}
SLOWEST = 0.5
"""Seconds between samples of a motion, at the most, where nothing is known of it."""
FASTEST_DAYS = 2e-6
"""Days (0.17 s) below which steps of stamps of that size are days: as seconds, 500 kHz."""

AMBIGUOUS = frozenset(("min", "h", "d"))
"""Units that, as a whole name, may be something else: the least, a height, a distance."""
_BEHIND = re.compile(
    r"(?P<name>.*[^\W_])(?:[ _.-]+(?P<unit>[^\W\d_]+)|(?<=[a-z])(?P<capital>[A-Z][a-z]+|[MUN]S))"
)


class TimeColumn(NamedTuple):
    """A file's time.

    **Fields:** `name` of the column; `seconds`, shape `(n,)`, NaN where it is missing; `notes`,
    what was decided, in words; `doubt`, in words, that it is time, or in this unit; empty if none.
    """

    name: str
    seconds: np.ndarray
    notes: tuple[str, ...] = ()
    doubt: str = ""


def find_time(
    values: Mapping[str, np.ndarray],
    units: Mapping[str, str],
    given: str | None,
    nameless: bool = False,
    shortest: float | None = None,
) -> TimeColumn | None:
    """The column of time among columns: the `given` one, else by name and content.

    Of columns with a name of time those count that rise from row to row; of several the first by
    [`TIME_COLUMNS`][riecjax.records.reading.channels.TIME_COLUMNS], then by place. Without such a
    name, the first column counts where it rises and is in a unit of time, or rises evenly and is no
    mere row number.

    **Arguments:** `values` and `units` by name; `nameless`: whether a column may be time without a
    name of time; `shortest` window in seconds that the motion asks for, if that is known.

    **Raises:** `DataError` for a unit that is no unit of time.
    """
    if given is not None:
        return _timed(given, values, units, (), shortest)
    called = [name for name in values if is_called_time(name, units)]
    rising = [name for name in called if _rises(values[name])]
    found = min(rising, key=_preference, default=None)
    notes = []
    first = next(iter(values), "")
    if found is None and nameless and first and _is_unnamed_time(first, values, units):
        found = first
        notes.append(f"time is column '{found}', the first, which rises")
    elif found is not None and len(called) > 1:
        others = listed(name for name in called if name != found)
        notes.append(f"time is column '{found}', not {others}")
    found = found or min(called, key=_preference, default=None)
    if found is None:
        return None
    time = _timed(found, values, units, notes, shortest)
    # `rec.X.Data`, as ControlDesk writes it, is an X as well.
    bare = _bare(found.removesuffix(".Data").rpartition(".")[2])
    guessed = found not in called and not unit_of_time(found, units) and bare not in UNSAID
    return time._replace(doubt=_GUESSED.format(found)) if guessed and not time.doubt else time


def _timed(
    name: str,
    values: Mapping[str, np.ndarray],
    units: Mapping[str, str],
    notes: list[str] | tuple[str, ...],
    shortest: float | None,
) -> TimeColumn:
    factor, why = _seconds_each(name, values[name], units)
    said = (f"time '{name}': {why}",) if why else ()
    counts = _carried_on(values[name])
    # The 15 digits that spreadsheets write of a date are 9 microseconds of a day.
    since = np.round((counts - counts[0]) * DAY, 5) if factor == DAY else counts * factor
    stated = why or unit_of_time(name, units)
    doubt = "" if stated else _other_unit(name, since, shortest)
    return TimeColumn(name, since, (*notes, *said), doubt)


_IN_ANOTHER_UNIT = (
    "nothing states the unit of time '{0}'; it is taken as seconds, one sample every {1:g} s for "
    "{2}. If it is {3}: scale={{'{0}': {4:g}}} (on the command line: --scale {0}={4:g})."
)
_GUESSED = (
    "nothing says that '{0}' is time; it is taken so, in seconds, as it is the first column and "
    "rises evenly. If it is not: rename the column of time to t (on the command line: --map "
    "t=COLUMN), or give the seconds between samples (--time-step)."
)


def _carried_on(counts: np.ndarray) -> np.ndarray:
    """Counts past the end of a counter of 32 bits."""
    known = counts[~np.isnan(counts)]
    wraps = known.size > 1 and known.max() < COUNTER and (np.diff(known) < -0.99 * COUNTER).any()
    return unwrapped(counts, COUNTER) if wraps else counts


def unit_of_time(name: str, units: Mapping[str, str] = {}) -> str:
    """The unit of a column of time, as the file or its name states it; empty if none does."""
    alone = name.lower() if name.lower() in {*SECONDS} - AMBIGUOUS else ""
    return units.get(name) or split_unit(name)[1] or _suffix(name)[1] or alone


def counts_in_its_name(name: str) -> bool:
    """Whether a name is that of a time and states its unit, as `time_ms`."""
    return is_called_time(name, {}) and bool(unit_of_time(name))


def seconds_in(unit: str) -> float | None:
    """Seconds in a unit of time, `None` if it is none."""
    # "seconds since 2024-01-01", as NetCDF has it.
    word = unit.split(" since ")[0]
    return SECONDS.get(word) or SECONDS.get(word.lower())


def _seconds_each(name: str, values: np.ndarray, units: Mapping[str, str]) -> tuple[float, str]:
    """Seconds that one count of a time column is, and why where the file does not state it."""
    stated = unit_of_time(name, units)
    if stated:
        factor = seconds_in(stated)
        if factor is None:
            raise DataError(
                f"time '{name}' is in '{stated}', which is not known; scale it to seconds (on the"
                f" command line: --scale {name}=FACTOR)."
            )
        return factor, ""
    known = values[~np.isnan(values)]
    if known.size < 2:
        return 1.0, ""
    low, high = float(known.min()), float(known.max())
    for first, last, factor, year in EPOCHS:
        if factor < 1 and first <= low and high < last:
            words = {each: word for word, each in SUBUNITS.items()}
            word = words.get(factor, f"ticks of {1e9 * factor:g} nanoseconds")
            return factor, f"{word} since {year}"
    step = float(np.median(np.diff(known)))
    if any(a < low and high < b for a, b in SERIAL_DAYS) and (
        0 < step < FASTEST_DAYS or _bare(name) in DATES
    ):
        return DAY, "days, as spreadsheets count them"
    return 1.0, ""


def no_time(channels: Channels, reason: str) -> DataError:
    """The error of a file without time, which says what to do."""
    other = [
        f"column '{name}' is in '{unit}', which is no unit of time"
        for name in channels.columns
        if _bare(name) in TIME_WORDS and (unit := channels.named(name)[1]) and not seconds_in(unit)
    ]
    reason = f"; {other[0]}" if other and not reason else reason
    numbered = any(name == NUMBERED.format(1) for name in channels.columns)
    named = ", name all columns (--columns t,x,...)" if numbered else ""
    return DataError(
        f"there is no time column (called 't', 'time' or the like); there are: "
        f"{listed(channels.columns)}. Say which one is time by renaming it to t (on the command "
        f"line: --map t=COLUMN){named}, or give the seconds between samples (--time-step){reason}."
    )


def _other_unit(name: str, seconds: np.ndarray, shortest: float | None) -> str:
    """What stamps whose unit nothing states may be instead of seconds, in words; empty if nothing.

    Asked where a window of `shortest` seconds would be shorter than a sample, and where stamps are
    whole numbers, one or more apart: the first unit in which the motion would be sampled fast
    enough.
    """
    known = seconds[~np.isnan(seconds)]
    if known.size < 2:
        return ""
    since = known - known[0]
    step = float(np.median(np.diff(known)))
    rounding = 1e-6 * step + 4 * np.spacing(np.abs(known).max())
    whole = step >= 1 - rounding and bool((np.abs(since - np.round(since)) <= rounding).all())
    if not (whole or (shortest is not None and step > shortest)):
        return ""
    for unit, factor in SUBUNITS.items():
        if step * factor <= (shortest or SLOWEST):
            return _IN_ANOTHER_UNIT.format(name, step, _in_time(float(since[-1])), unit, factor)
    return ""


def _in_time(seconds: float) -> str:
    """Seconds in two digits, in the unit that suits."""
    for unit, size in (("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * size:
            return f"{float(f'{seconds / size:.2g}'):g} {unit}"
    return f"{float(f'{seconds:.2g}'):g} s"


def is_called_time(name: str, units: Mapping[str, str]) -> bool:
    """Whether a column's name and unit are those of a time."""
    if _bare(name) not in TIME_WORDS:
        return False
    # `T [degC]` is a temperature, and `t (mm)` a thickness.
    unit = units.get(name) or split_unit(name)[1]
    return unit is None or seconds_in(unit) is not None


def _is_unnamed_time(name: str, values: Mapping[str, np.ndarray], units: Mapping[str, str]) -> bool:
    if name not in units:
        return _is_even(values[name])
    return seconds_in(units[name]) is not None and _rises(values[name])


def _bare(name: str) -> str:
    """A column's name in small letters, without its unit and what stands between words."""
    return "".join(c for c in _suffix(split_unit(name)[0])[0].lower() if c.isalpha())


def _suffix(name: str) -> tuple[str, str]:
    """`time_ms`, `time.ms` and `timeMs` as `time` and `ms`; other names as they are."""
    found = _BEHIND.fullmatch(name)
    unit = (found["unit"] or found["capital"]).lower() if found else ""
    return (found["name"], unit) if found and unit in SECONDS and unit != "d" else (name, "")


def _preference(name: str) -> int:
    short = split_unit(name)[0]
    return TIME_COLUMNS.index(short) if short in TIME_COLUMNS else len(TIME_COLUMNS)


def _rises(values: np.ndarray) -> bool:
    known = values[~np.isnan(values)]
    return known.size > 1 and bool((np.diff(known) > 0).all())


def _is_even(values: np.ndarray) -> bool:
    """Whether a column rises by equal steps, other than those of a row number."""
    if values.size < 3 or not _rises(values) or np.isnan(values).any():
        return False
    steps = np.diff(values)
    usual = float(steps.mean())
    even = np.abs(steps - usual).max() <= 1e-3 * usual + 4 * np.spacing(np.abs(values).max())
    return bool(even and usual != 1)
