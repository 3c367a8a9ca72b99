"""Time: which column of a file it is, and what its numbers count.

Loggers call time by many names, and call by them what is none (`T`, a temperature; `timestamp`, a
constant). So names propose, and the samples decide: time rises from row to row.
"""

import re
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

from riecjax.errors import DataError
from riecjax.records.reading.units import DAY, HOUR, MINUTE, SECONDS, split_unit

TIME_COLUMNS = ("t", "time", "Time", "time_s", "t_s", "TIME", "timestamp", "Timestamp", "T")
"""Column names taken as time, in this order of preference; `--map t=COLUMN` names another."""
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

SUBUNITS = {word: SECONDS[word] for word in ("milliseconds", "microseconds", "nanoseconds")}
TICK = 1e-7
EPOCHS = {
    **{f"{word} since 1970": (factor, 0.0) for word, factor in SUBUNITS.items()},
    "ticks of 100 nanoseconds since 1601": (TICK, 11644473600.0),
    "ticks of 100 nanoseconds since 1": (TICK, 62135596800.0),
}
"""Seconds in a count, and from its epoch to 1970; the last two are of Windows and .NET."""
RECENT = (1e9, 4e9)
"""Seconds since 1970 of the stamps that are taken for those of an epoch: of 2001 to 2096."""
COUNTER, ENDS = 2**32, 0.99
"""Where counters of 32 bits, of milliseconds or microseconds, begin anew, and the share of it by
which they then fall at least."""
UNSAID = frozenset(("", "column", "x", "xvalue", "xaxis", "index", "unnamed", "abscissa"))
"""What a first column is called that says nothing against being time."""
SERIAL_DAYS = ((2e4, 8e4), (6.9e5, 8e5))
"""Days as spreadsheets (from 1900) and MATLAB (from year 0) count them: of 1954 to 2119, and
of 1889 to 2190."""
SLOWEST = 0.5
"""Seconds between samples of a motion, at the most, where nothing is known of it."""
FASTEST_DAYS = 2e-6
"""Days (0.17 s) below which steps of stamps of that size are days: as seconds, 500 kHz."""

AMBIGUOUS = frozenset(("min", "h", "d"))
"""Units that, as a whole name, may be something else: the least, a height, a distance."""
_BEHIND = re.compile(
    r"(?P<name>.*[^\W_])(?:[ _.-]+(?P<unit>[^\W\d_]+)|(?<=[a-z])(?P<capital>[A-Z][a-z]+|[MUN]S))"
)


MOST_LISTED = 30
"""Names in a message past which the rest is counted."""


def listed(names: Iterable[str]) -> str:
    """Names for a message, the first thirty of them."""
    every = list(names)
    more = len(every) - MOST_LISTED
    return ", ".join(every[:MOST_LISTED]) + (f" and {more} more" if more > 0 else "")


class TimeColumn(NamedTuple):
    """A file's time.

    **Fields:** `name` of the column; `seconds`, shape `(n,)`, NaN in gaps; `notes`,
    what was decided, in words; `doubt`, in words, that it is time, or in this unit; empty if none.
    """

    name: str
    seconds: np.ndarray
    notes: tuple[str, ...] = ()
    doubt: str = ""


def unwrapped(clock: np.ndarray, dial: float = DAY) -> np.ndarray:
    """Seconds of the day, carried on past midnight, or of another dial; NaN stays."""
    known = ~np.isnan(clock)
    steps = np.diff(clock[known], prepend=clock[known][:1])
    carried = clock.copy()
    carried[known] += dial * np.cumsum(steps < -0.5 * dial)
    return carried


def find_time(
    values: Mapping[str, np.ndarray],
    units: Mapping[str, str],
    given: str | None,
    nameless: bool = False,
    shortest: float | None = None,
) -> TimeColumn | None:
    """The column of time among columns: the `given` one, else by name and content.

    Of columns with a name of time those count that rise from row to row; of several the first by
    [`TIME_COLUMNS`][riecjax.records.reading.times.TIME_COLUMNS], then by place. Without such a
    name, the first column counts where it rises and is in a unit of time, or rises evenly and is no
    mere row number.

    **Arguments:** `values` and `units` by name; `nameless`: whether a column may be time without a
    name of time; `shortest` window in seconds that the motion asks for, if that is known.

    **Raises:** `DataError` for a unit that is no unit of time.
    """
    called, name, notes = [], given, ()
    if given is None:
        called = [name for name in values if is_called_time(name, units)]
        preferred = {name: place - len(TIME_COLUMNS) for place, name in enumerate(TIME_COLUMNS)}
        called.sort(key=lambda name: preferred.get(split_unit(name)[0], 0))
        name = next((name for name in called if _rises(values[name])), None)
        if name is not None and len(called) > 1:
            others = [other for other in values if other in called and other != name]
            notes = (f"time is column '{name}', not {listed(others)}",)
        elif name is None and nameless and values:
            first = next(iter(values))
            in_time = seconds_in(units.get(first, "")) is not None
            if _rises(values[first]) if in_time else first not in units and _is_even(values[first]):
                name = first
                notes = (f"time is column '{first}', the first, which rises",)
        name = name or next(iter(called), None)
    if name is None:
        return None
    counts, stated = values[name], unit_of_time(name, units)
    known = counts[~np.isnan(counts)]
    factor, why = (seconds_in(stated), "") if stated else _seconds_each(name, known)
    if factor is None:
        raise DataError(
            f"time '{name}' is in '{stated}', which is not known; scale it to seconds (on the"
            f" command line: --scale {name}=FACTOR)."
        )
    # Past the end of a counter of 32 bits.
    if known.size > 1 and known.max() < COUNTER and (np.diff(known) < -ENDS * COUNTER).any():
        counts = unwrapped(counts, COUNTER)
    # The 15 digits that spreadsheets write of a date are 9 microseconds of a day.
    since = np.round((counts - counts[0]) * DAY, 5) if factor == DAY else counts * factor
    notes = (*notes, f"time '{name}': {why}") if why else notes
    doubt = "" if why or stated else _other_unit(name, since, shortest)
    # `rec.X.Data`, as ControlDesk writes it, is an X as well.
    bare = _bare(name.removesuffix(".Data").rpartition(".")[2])
    if name not in (*called, given) and not (stated or why or bare in UNSAID):
        doubt = doubt or _GUESSED.format(name)
    return TimeColumn(name, since, notes, doubt)


_IN_ANOTHER_UNIT = (
    "nothing states the unit of time '{0}'; it is taken as seconds, one sample every {1:g} s for "
    "{2}. If it is {3}: scale={{'{0}': {4:g}}} (on the command line: --scale {0}={4:g})."
)
_GUESSED = (
    "nothing says that '{0}' is time; it is taken so, in seconds, as it is the first column and "
    "rises evenly. If it is not: rename the column of time to t (on the command line: --map "
    "t=COLUMN), or give the seconds between samples (--time-step)."
)


def unit_of_time(name: str, units: Mapping[str, str] = {}) -> str:
    """The unit of a column of time, as the file or its name states it; empty if none does."""
    alone = name.lower() if name.lower() in {*SECONDS} - AMBIGUOUS else ""
    return units.get(name) or split_unit(name)[1] or _suffix(name)[1] or alone


def seconds_in(unit: str) -> float | None:
    """Seconds in a unit of time, `None` if it is none."""
    # "seconds since 2024-01-01", as NetCDF has it.
    word = unit.split(" since ")[0]
    return SECONDS.get(word) or SECONDS.get(word.lower())


def _seconds_each(name: str, known: np.ndarray) -> tuple[float, str]:
    """Seconds that one count of a time of no stated unit is, by its samples, and why."""
    if known.size < 2:
        return 1.0, ""
    low, high = float(known.min()), float(known.max())
    for words, (factor, earlier) in EPOCHS.items():
        if RECENT[0] <= low * factor - earlier and high * factor - earlier < RECENT[1]:
            return factor, words
    step = float(np.median(np.diff(known)))
    if any(a < low and high < b for a, b in SERIAL_DAYS) and (
        0 < step < FASTEST_DAYS or _bare(name) in DATES
    ):
        return DAY, "days, as spreadsheets count them"
    return 1.0, ""


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
    quick = (unit for unit, factor in SUBUNITS.items() if step * factor <= (shortest or SLOWEST))
    if (unit := next(quick, None)) is None:
        return ""
    # How long it lasts in two digits, in the unit that suits.
    sizes = {"days": DAY, "h": HOUR, "min": MINUTE, "s": 0.0}
    suits = next(suits for suits, size in sizes.items() if since[-1] >= 2 * size)
    lasts = f"{float(f'{since[-1] / (sizes[suits] or 1.0):.2g}'):g} {suits}"
    return _IN_ANOTHER_UNIT.format(name, step, lasts, unit, SUBUNITS[unit])


def is_word_of_time(name: str) -> bool:
    """Whether loggers call time so, whatever its unit is."""
    return _bare(name) in TIME_WORDS


def is_called_time(name: str, units: Mapping[str, str]) -> bool:
    """Whether a column's name and unit are those of a time."""
    if not is_word_of_time(name):
        return False
    # `T [degC]` is a temperature, and `t (mm)` a thickness.
    unit = units.get(name) or split_unit(name)[1]
    return unit is None or seconds_in(unit) is not None


def _bare(name: str) -> str:
    """A column's name in small letters, without its unit and what stands between words."""
    return "".join(c for c in _suffix(split_unit(name)[0])[0].lower() if c.isalpha())


def _suffix(name: str) -> tuple[str, str]:
    """`time_ms`, `time.ms` and `timeMs` as `time` and `ms`; other names as they are."""
    found = _BEHIND.fullmatch(name)
    unit = (found["unit"] or found["capital"]).lower() if found else ""
    return (found["name"], unit) if found and unit in SECONDS and unit != "d" else (name, "")


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
