"""Which column of a file is time, and what its numbers count: seconds, milliseconds, days.

Loggers call time by many names, and call by them what is none (`T`, a temperature; `timestamp`, a
constant). So names propose, and the samples decide: time rises from row to row.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from riecjax.errors import DataError
from riecjax.records.reading.channels import TIME_COLUMNS, Channels, listed
from riecjax.records.reading.dialect import NUMBERED
from riecjax.records.reading.units import SECONDS, split_unit

TIME_WORDS = frozenset(
    """
    t time times timestamp timestamps timest zeit zeitstempel temps tempo tiempo tijd tid
    elapsed elapsedtime timeelapsed reltime relativetime abstime absolutetime systemtime
    testtime runningtime totaltime laptime recordtime sampletime datetime datetimeutc
    dateandtime date datumuhrzeit datumzeit uhrzeit datum utc utctime gpstime clock seconds secs
    sec epoch timesec timeseconds timeutc isotime xtime timeaxis timechannel heure horodatage
    """.split()  # noqa: SIM905
)
"""What loggers call time, in small letters and without what stands between words."""
DATES = frozenset(word for word in TIME_WORDS if word.startswith(("date", "datum")))
"""Those that say that a date is in it."""

DAY = 86400.0
EPOCHS = {1e9: 1.0, 1e12: 1e-3, 1e15: 1e-6, 1e18: 1e-9}
"""From which count on a stamp is taken as of the epoch 1970 (2001 to 2096), and in which unit."""
EPOCH_SPAN = 4.0
SERIAL_DAYS = ((2e4, 8e4), (6.9e5, 8e5))
"""Days as spreadsheets (from 1900) and MATLAB (from year 0) count them: of 1954 to 2119, and
of 1889 to 2190."""
SUBUNITS = {"milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}
SLOWEST = 0.5
"""Seconds between samples of a motion, at the most, where nothing is known of it."""
FASTEST_DAYS = 2e-6
"""Days (0.17 s) below which steps of stamps of that size are days: as seconds, 500 kHz."""


class TimeColumn(NamedTuple):
    """A file's time.

    **Fields:** `name` of the column; `seconds`, shape `(n,)`, NaN where it is missing; `notes`,
    what was decided, in words.
    """

    name: str
    seconds: np.ndarray
    notes: tuple[str, ...] = ()


def find_time(
    values: Mapping[str, np.ndarray],
    units: Mapping[str, str],
    given: str | None,
    nameless: bool = False,
) -> TimeColumn | None:
    """The column of time among columns: the `given` one, else by name and content.

    Of columns with a name of time those count that rise from row to row; of several the first by
    [`TIME_COLUMNS`][riecjax.records.reading.channels.TIME_COLUMNS], then by place. Without such a
    name, the first column counts where it rises and is in a unit of time, or rises evenly and is no
    mere row number.

    **Arguments:** `values` and `units` by name; `nameless`: whether a column may be time without a
    name of time.

    **Raises:** `DataError` for a unit that is no unit of time.
    """
    if given is not None:
        return _timed(given, values, units, ())
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
    return _timed(found, values, units, notes)


def _timed(
    name: str,
    values: Mapping[str, np.ndarray],
    units: Mapping[str, str],
    notes: list[str] | tuple[str, ...],
) -> TimeColumn:
    factor, why = _seconds_each(name, values[name], units.get(name))
    said = (f"time '{name}': {why}",) if why else ()
    if factor == DAY:
        # The 15 digits that spreadsheets write of a date are 9 microseconds of a day.
        since = np.round((values[name] - values[name][0]) * DAY, 5)
    else:
        since = values[name] * factor
    return TimeColumn(name, since, (*notes, *said))


def _seconds_each(name: str, values: np.ndarray, unit: str | None) -> tuple[float, str]:
    """Seconds that one count of a time column is, and why where the file does not state it."""
    stated = unit or _suffix(name)[1]
    if stated:
        # "seconds since 2024-01-01", as NetCDF has it.
        factor = SECONDS.get(stated) or SECONDS.get(stated.split(" since ")[0])
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
    for since, factor in EPOCHS.items():
        if factor < 1 and since <= low and high < EPOCH_SPAN * since:
            word = next(word for word, each in SUBUNITS.items() if each == factor)
            return factor, f"{word} since 1970"
    step = float(np.median(np.diff(known)))
    if any(a < low and high < b for a, b in SERIAL_DAYS) and (
        0 < step < FASTEST_DAYS or _bare(name) in DATES
    ):
        return DAY, "days, as spreadsheets count them"
    return 1.0, ""


def no_time(channels: Channels, reason: str) -> DataError:
    """The error of a file without time, which says what to do."""
    numbered = any(name == NUMBERED.format(1) for name in channels.columns)
    named = ", name all columns (--columns t,x,...)" if numbered else ""
    return DataError(
        f"there is no time column (called 't', 'time' or the like); there are: "
        f"{listed(channels.columns)}. Say which one is time by renaming it to t (on the command "
        f"line: --map t=COLUMN){named}, or give the seconds between samples (--time-step){reason}."
    )


def other_unit(
    time: TimeColumn, units: Mapping[str, str], shortest: float | None
) -> tuple[str, float] | None:
    """What stamps whose unit nothing states may be instead of seconds, and that in seconds.

    Asked where a window of `shortest` seconds would be shorter than a sample, and where stamps are
    whole numbers, one or more apart: the first unit in which the motion would be sampled fast
    enough.
    """
    known = time.seconds[~np.isnan(time.seconds)]
    if time.name in units or _suffix(time.name)[1] or time.notes or known.size < 2:
        return None
    since = known - known[0]
    step = float(np.median(np.diff(known)))
    rounding = 1e-6 * step + 4 * np.spacing(np.abs(known).max())
    whole = step >= 1 - rounding and bool((np.abs(since - np.round(since)) <= rounding).all())
    if not (whole or (shortest is not None and step > shortest)):
        return None
    enough = (one for one in SUBUNITS.items() if step * one[1] <= (shortest or SLOWEST))
    return next(enough, None)


def is_called_time(name: str, units: Mapping[str, str]) -> bool:
    """Whether a column's name and unit are those of a time."""
    if _bare(name) not in TIME_WORDS:
        return False
    # `T [degC]` is a temperature, and `t (mm)` a thickness.
    unit = units.get(name) or split_unit(name)[1]
    return unit is None or unit in SECONDS or unit.split(" since ")[0] in SECONDS


def _is_unnamed_time(name: str, values: Mapping[str, np.ndarray], units: Mapping[str, str]) -> bool:
    if name not in units:
        return _is_even(values[name])
    return units[name] in SECONDS and _rises(values[name])


def _bare(name: str) -> str:
    """A column's name in small letters, without its unit and what stands between words."""
    return "".join(c for c in _suffix(split_unit(name)[0])[0].lower() if c.isalpha())


def _suffix(name: str) -> tuple[str, str | None]:
    """`time_ms` as `time` and `ms`; other names as they are."""
    head, _, tail = name.rpartition("_")
    return (head, tail) if head and tail in SECONDS else (name, None)


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
