"""Time: dates and clocks as text, which column of a file is time, and what its numbers count.

Loggers call time by many names, and call by them what is none (`T`, a temperature; `timestamp`, a
constant). So names propose, and the samples decide: time rises from row to row.
"""

import contextlib
import functools
import itertools
import re
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from riecjax.errors import DataError
from riecjax.records.reading.numerals import all_true, compute, numbers, stripped
from riecjax.records.reading.units import DAY, HOUR, MINUTE, SECONDS, split_unit

_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_ZONE = r"(?:Z|z|(?:UTC|GMT)?[+-]\d{1,2}(?::?\d{2})?|UTC|GMT|[A-Z]{3,4})"
_DATES = (
    r"(?P<year>\d{4})[-/.](?P<month>\d{1,2})[-/.](?P<day>\d{1,2})",
    r"(?P<first>\d{1,2})[-/.](?P<second>\d{1,2})[-/.](?P<year>\d{4}|\d{2})",
    r"(?P<day>\d{1,2})[- ](?P<name>[A-Za-z]{3})[a-z]*\.?[- ,]+(?P<year>\d{4}|\d{2})",
    r"(?P<name>[A-Z][a-z]{2})[a-z]*\.? (?P<day>\d{1,2}), ?(?P<year>\d{4})",
    r"(?P<year>\d{4})(?P<month>\d{2})(?P<day>\d{2})",
    r"(?P<days>\d+) days?",
    "",
)
_TIMES_OF_DAY = (
    r"(?P<hours>\d{1,4}):(?P<minutes>[0-5]?\d)"
    r"(?::(?P<seconds>[0-5]?\d|60)(?P<fraction>[.,:]\d+|\.|,)?)?",
    r"(?P<hours>\d\d)(?P<minutes>\d\d)(?P<seconds>\d\d)(?P<fraction>[.,]\d+)?",
)
PATTERNS = (
    # ISO 8601 (also compact), or as spreadsheets and MATLAB write it; or a time of day, or an
    # elapsed one, alone.
    *(
        rf"^(?:[A-Z][a-z]{{2}},? )?{date}[T ,]*{clock}\s*(?P<half>[AaPp]\.?[Mm]\.?)?"
        rf"\s*(?P<zone>{_ZONE})?(?:\[[^\]]*\])?$"
        for date, clock in itertools.product(_DATES, _TIMES_OF_DAY)
    ),
    # Minutes, seconds and their fraction, all that a spreadsheet's `mm:ss.0` shows of a time.
    r"^(?P<minutes>[0-5]?\d):(?P<seconds>[0-5]\d)(?P<fraction>[.,]\d+)$",
    # Day of the year and time of day, as IRIG and recorders in flight tests have it.
    r"^(?P<days>[0-3]\d\d):(?P<hours>\d\d):(?P<minutes>[0-5]\d):(?P<seconds>[0-5]\d)"
    r"(?P<fraction>[.,]\d+)$",
)
"""Time stamps."""
_COMPILED = tuple(map(re.compile, PATTERNS))
_ANY = re.sub(r"\?P<\w+>", "", "|".join(PATTERNS))
"""The same as one, whose groups have no names, of which each may be there once."""


def is_stamp(text: str) -> bool:
    """Whether a text is a time stamp."""
    # A number of 6 or 14 digits is a number.
    return not text.isdigit() and _match(text) is not None


def are_stamps(text: Any) -> Any:
    """Which of a column of strings are time stamps; null where null."""
    return compute().match_substring_regex(text, _ANY)


def seconds(text: Any) -> np.ndarray:
    """A column of time stamps as seconds from the first, NaN for null.

    Stamps without a date may pass midnight; zones are taken into account, by their shift from UTC,
    where a stamp states it in digits. Whether the day or the month comes first in `1/2/2024`, is
    told by the column: one of them stays below 13, time does not run back, and no logger leaps by a
    month where it could pass midnight.

    **Raises:** `DataError` for dates that do not exist, or that run back.
    """
    matches = [None if stamp is None else _match(stamp) for stamp in text.to_pylist()]
    stamps = [match and match.groupdict(default="") for match in matches]
    days = _days(stamps)
    dial = DAY if any(stamp and "hours" in stamp for stamp in stamps) else HOUR

    def since(places: int) -> np.ndarray:
        clock = np.array([_clock(stamp, places) if stamp else np.nan for stamp in stamps])
        return unwrapped(clock, dial) if days is None else days * DAY + clock

    found = since(0)
    if _runs_back(found):
        # Where the fraction has no leading zeros, `:5` and `:10` count thousandths.
        places = max(len(stamp["fraction"] or ".") for stamp in stamps if stamp) - 1
        counted = since(places)
        found = found if _runs_back(counted) else counted
    return found - _first(found)


def of_texts(values: Any) -> tuple[np.ndarray | None, str]:
    """Numbers or time stamps that stand there as text, and their unit where they are stamps.

    `None` for other text, and where there is none.

    **Arguments:** `values`: a list, or a column of strings (PyArrow).
    """
    import pyarrow as pa

    if isinstance(values, list):
        values = pa.array([None if v is None else str(v) for v in values], pa.string())
    texts = stripped(values)
    if texts.null_count == len(texts):
        return None, ""
    found = numbers(texts, ".", False)
    if found is None and all_true(are_stamps(texts)):
        return seconds(texts), "s"
    return found, ""


def _runs_back(since: np.ndarray) -> bool:
    return bool((np.diff(since[~np.isnan(since)]) < 0).any())


def unwrapped(clock: np.ndarray, dial: float = DAY) -> np.ndarray:
    """Seconds of the day, carried on past midnight, or of another dial; NaN stays."""
    known = ~np.isnan(clock)
    steps = np.diff(clock[known], prepend=clock[known][:1])
    carried = clock.copy()
    carried[known] += dial * np.cumsum(steps < -0.5 * dial)
    return carried


def _match(text: str) -> re.Match[str] | None:
    return next(filter(None, (pattern.fullmatch(text) for pattern in _COMPILED)), None)


def _first(values: np.ndarray) -> float:
    known = values[~np.isnan(values)]
    return known[0] if known.size else 0.0


def _days(stamps: list[dict[str, str] | None]) -> np.ndarray | None:
    """Days since the first of each stamp, NaN for none; `None` for times of day alone."""
    said = {part for stamp in stamps if stamp for part in stamp}
    if not said & {"year", "days"}:
        return None
    # Elapsed times show no days where there are none.
    dateless = np.nan if "year" in said else 0.0
    orders = []
    for day_first in (False, True) if "first" in said else (False,):
        with contextlib.suppress(ValueError):
            each = [_day(stamp, day_first, dateless) if stamp else np.nan for stamp in stamps]
            days = np.array(each) - _first(np.array(each))
            orders += [] if _runs_back(days) else [days]
    if not orders:
        raise DataError("it holds dates that do not exist, or that run back.")
    # Where both orders make sense, one passes midnight and the other leaps by a month.
    return min(orders, key=lambda days: days[~np.isnan(days)][-1])


def _day(stamp: dict[str, str], day_first: bool, dateless: float) -> float:
    """Days since 1970; of an elapsed time, its days.

    **Raises:** `ValueError` for a date that does not exist.
    """
    if "year" not in stamp:
        return float(stamp.get("days", dateless))
    year = int(stamp["year"]) + (2000 if len(stamp["year"]) == 2 else 0)
    name = stamp.get("name", "").lower()
    month, day = stamp.get("first", stamp.get("month")), stamp.get("second", stamp.get("day"))
    if "first" in stamp and day_first:
        month, day = day, month
    return _days_since_1970(year, int(month or (*_MONTHS, name).index(name) + 1), int(day or 0))


@functools.lru_cache
def _days_since_1970(year: int, month: int, day: int) -> float:
    return float(np.datetime64(f"{year:04d}-{month:02d}-{day:02d}", "D").astype(int))


def _clock(stamp: dict[str, str], places: int = 0) -> float:
    """Seconds of the day, as of UTC where the stamp states a zone's shift.

    **Arguments:** `places`: of the fraction, where that is a count of its last one.
    """
    hours, minutes, full = (int(stamp.get(part) or 0) for part in ("hours", "minutes", "seconds"))
    if half := stamp.get("half", "")[:1].lower():
        hours = hours % 12 + (12 if half == "p" else 0)
    since = HOUR * hours + MINUTE * minutes + full
    # How far a zone is ahead of UTC; one that is a name says nothing.
    if ahead := re.search(r"([+-])(\d\d?):?(\d\d)?$", stamp.get("zone", "")):
        since -= float(f"{ahead[1]}1") * (HOUR * int(ahead[2]) + MINUTE * int(ahead[3] or 0))
    digits = stamp["fraction"][1:].zfill(places)
    return since + (float(f"0.{digits}") if digits else 0.0)


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
    if name not in (*called, given) and not stated and bare not in UNSAID:
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
