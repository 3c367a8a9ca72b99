"""Dates and times of day as text, one by one and by the column, as seconds from the first."""

import functools
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from riecjax.errors import DataError
from riecjax.records.reading.numerals import compute, numbers, stripped

_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_ZONE = r"(?:Z|z|(?:UTC|GMT)?[+-]\d{1,2}(?::?\d{2})?|UTC|GMT|[A-Z]{3,4})"
_FRACTION = r"[.,:]\d+|\.|,"
STAMP = (
    r"^(?:[A-Z][a-z]{2},? )?(?:"
    r"(?P<year>\d{4})[-/.](?P<month>\d{1,2})[-/.](?P<day>\d{1,2})"
    r"|(?P<first>\d{1,2})[-/.](?P<second>\d{1,2})[-/.](?P<late>\d{4}|\d{2})"
    r"|(?P<named_day>\d{1,2})[- ](?P<name>[A-Za-z]{3})[a-z]*\.?[- ,]+(?P<named_year>\d{4}|\d{2})"
    r"|(?P<us_name>[A-Z][a-z]{2})[a-z]*\.? (?P<us_day>\d{1,2}), ?(?P<us_year>\d{4})"
    r"|(?P<compact>\d{8})"
    r"|(?P<days>\d+) days?"
    r")?[T ,]*(?:"
    r"(?P<hours>\d{1,4}):(?P<minutes>[0-5]?\d)"
    rf"(?::(?P<seconds>[0-5]?\d|60)(?P<fraction>{_FRACTION})?)?"
    r"|(?P<clock>\d{6})(?P<clock_fraction>[.,]\d+)?"
    rf")\s*(?P<half>[AaPp]\.?[Mm]\.?)?\s*(?P<zone>{_ZONE})?(?:\[[^\]]*\])?$"
)
"""A time stamp: ISO 8601 (also compact), or as spreadsheets and MATLAB write it; or a time of day,
or an elapsed one, alone."""
MINUTES = r"^(?P<minutes>[0-5]?\d):(?P<seconds>[0-5]\d)(?P<fraction>[.,]\d+)$"
"""Minutes, seconds and their fraction, all that a spreadsheet's `mm:ss.0` shows of a time."""
OF_YEAR = (
    r"^(?P<of_year>[0-3]\d\d):(?P<hours>\d\d):(?P<minutes>[0-5]\d):(?P<seconds>[0-5]\d)"
    r"(?P<fraction>[.,]\d+)$"
)
"""Day of the year and time of day, as IRIG and recorders in flight tests have it."""
PATTERNS = (STAMP, MINUTES, OF_YEAR)
_COMPILED = tuple(map(re.compile, PATTERNS))
DAY, HOUR = 86400.0, 3600.0


def is_stamp(text: str) -> bool:
    """Whether a text is a time stamp."""
    # A number of 6 or 14 digits is a number.
    return not text.isdigit() and _match(text) is not None


def are_stamps(text: Any) -> Any:
    """Which of a column of strings are time stamps; null where null."""
    pc = compute()
    found = [pc.match_substring_regex(text, pattern) for pattern in PATTERNS]
    return functools.reduce(pc.or_, found)


def seconds(text: Any) -> np.ndarray:
    """A column of time stamps as seconds from the first, NaN for null.

    Stamps without a date may pass midnight; zones are taken into account, by their shift from UTC,
    where a stamp states it in digits. Whether the day or the month comes first in `1/2/2024`, is
    told by the column: one of them stays below 13, time does not run back, and no logger leaps by a
    month where it could pass midnight.

    **Raises:** `DataError` for dates that do not exist, or that run back.
    """
    found = [None if stamp is None else _match(stamp) for stamp in text.to_pylist()]
    days = _days(found)
    since = _since(found, days, 0)
    if _runs_back(since):
        # Where the fraction has no leading zeros, `:5` and `:10` count thousandths.
        counted = _since(found, days, max(len(_digits(match)) for match in found if match))
        since = since if _runs_back(counted) else counted
    return since - _first(since)


def of_texts(values: Sequence[object]) -> tuple[np.ndarray | None, bool]:
    """Numbers or time stamps that stand there as text, and whether they are stamps.

    `None` for other text.
    """
    import pyarrow as pa

    texts = [None if v is None else str(v) for v in values]
    return of_text_column(pa.array(texts, pa.string()))


def of_text_column(column: Any) -> tuple[np.ndarray | None, bool]:
    """As [`of_texts`][], of a column of strings (PyArrow); `None` where all are missing."""
    texts = stripped(column)
    if texts.null_count == len(texts):
        return None, False
    found = numbers(texts, ".", False)
    if found is None and all(valid in (True, None) for valid in are_stamps(texts).to_pylist()):
        return seconds(texts), True
    return found, False


def _since(found: list[re.Match[str] | None], days: np.ndarray | None, places: int) -> np.ndarray:
    clock = np.array([_clock(match, places) if match else np.nan for match in found], dtype=float)
    if days is not None:
        return (days - _first(days)) * DAY + clock
    dial = DAY if any(match and "hours" in match.groupdict() for match in found) else HOUR
    return unwrapped(clock, dial)


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


def _days(found: list[re.Match[str] | None]) -> np.ndarray | None:
    """Days since 1970 of each stamp, NaN for none; `None` for times of day alone."""
    dates = [_date(match.groupdict()) if match else None for match in found]
    if not any(dates):
        return None
    if all(date[:2] == (0, 0) for date in filter(None, dates)):
        # Elapsed times show no days where there are none.
        dates = [date or ((0, 0, 0, False) if match else None) for date, match in zip(dates, found)]
    orders = [(0, 1)]
    if any(date and date[3] for date in dates):
        orders.append((1, 0))
    # Days repeat for thousands of stamps.
    known: dict[Any, float] = {None: np.nan}
    readings = []
    for order in orders:
        try:
            known = {None: np.nan} | {date: _day(date, order) for date in {*dates} if date}
        except ValueError:
            continue
        days = np.array([known[date] for date in dates])
        if not _runs_back(days):
            readings.append(days - _first(days))
    if not readings:
        raise DataError("it holds dates that do not exist, or that run back.")
    # Where both orders make sense, one passes midnight and the other leaps by a month.
    return min(readings, key=lambda days: days[~np.isnan(days)][-1])


def _date(stamp: dict[str, str | None]) -> tuple[int, int, int, bool] | None:
    """Year, two numbers of month and day, and whether their order is unknown."""
    if stamp.get("year"):
        return int(stamp["year"] or 0), int(stamp["month"] or 0), int(stamp["day"] or 0), False
    if stamp.get("first"):
        return _year(stamp["late"]), int(stamp["first"] or 0), int(stamp["second"] or 0), True
    if name := (stamp.get("name") or stamp.get("us_name") or "").lower():
        month = _MONTHS.index(name) + 1 if name in _MONTHS else 0
        day = int(stamp["named_day"] or stamp["us_day"] or 0)
        return _year(stamp["named_year"] or stamp["us_year"]), month, day, False
    if stamp.get("compact"):
        whole = stamp["compact"] or ""
        return int(whole[:4]), int(whole[4:6]), int(whole[6:]), False
    if stamp.get("days") or stamp.get("of_year"):
        return 0, 0, int(stamp.get("days") or stamp.get("of_year") or 0), False
    return None


def _year(digits: str | None) -> int:
    return int(digits or 0) + (2000 if len(digits or "") == 2 else 0)


def _day(date: tuple[int, int, int, bool], order: tuple[int, int]) -> float:
    """Days since 1970; of an elapsed time, its days.

    **Raises:** `ValueError` for a date that does not exist.
    """
    year, pair, unordered = date[0], date[1:3], date[3]
    month, day = (pair[order[0]], pair[order[1]]) if unordered else pair
    if not (year or month):
        return float(day)
    return float(np.datetime64(f"{year:04d}-{month:02d}-{day:02d}", "D").astype(int))


def _digits(match: re.Match[str]) -> str:
    """The digits of a fraction of a second."""
    stamp = match.groupdict()
    return (stamp.get("clock_fraction") or stamp["fraction"] or "")[1:]


def _clock(match: re.Match[str], places: int = 0) -> float:
    """Seconds of the day, as of UTC where the stamp states a zone's shift.

    **Arguments:** `places`: of the fraction, where that is a count of its last one.
    """
    stamp = match.groupdict()
    if stamp.get("clock"):
        whole = stamp["clock"] or ""
        hours, minutes, full = int(whole[:2]), int(whole[2:4]), int(whole[4:])
    else:
        hours, minutes = int(stamp.get("hours") or 0), int(stamp["minutes"] or 0)
        full = int(stamp["seconds"] or 0)
    half = (stamp.get("half") or "")[:1].lower()
    if half:
        hours = hours % 12 + (12 if half == "p" else 0)
    digits = _digits(match).zfill(places)
    since = 3600 * hours + 60 * minutes + full - _shift(stamp.get("zone") or "")
    return since + (float(f"0.{digits}") if digits else 0.0)


def _shift(zone: str) -> float:
    """Seconds that a zone is ahead of UTC, 0 where it is a name."""
    digits = zone.removeprefix("UTC").removeprefix("GMT")
    if digits[:1] not in ("+", "-"):
        return 0.0
    bare = digits[1:].replace(":", "")
    hours, minutes = (bare, "0") if len(bare) <= 2 else (bare[:-2], bare[-2:])
    return (1 if digits[0] == "+" else -1) * (3600.0 * int(hours) + 60.0 * int(minutes))
