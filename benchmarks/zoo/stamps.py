"""Time as loggers tell it: dates, epochs, clocks, rounded stamps, several columns, none."""

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from benchmarks.zoo.case import COUNT, STEP, Texts, Truth, case, lines, motion, save, table, written

NOON = datetime(2024, 3, 1, 12, tzinfo=UTC)
EPOCH = 1_709_294_400


def _moments() -> list[datetime]:
    return [NOON + timedelta(milliseconds=5 * i) for i in range(COUNT)]


def _ms(moment: datetime, form: str) -> str:
    return moment.strftime(form).replace("%", "") + f"{moment.microsecond // 1000:03d}"


def _dated(
    file: Path, stamp: Callable[[datetime], str], name: str, sep: str = ",", decimal: str = "."
) -> Truth:
    """A table by stamps of this form."""
    c, truth = written(x="%.6f", u="%.5f")
    stamps = [stamp(moment) for moment in _moments()]
    rows = lines(*c.values(), sep=sep, decimal=decimal)
    save(file, f"{name}{sep}x{sep}u", *(f"{a}{sep}{b}" for a, b in zip(stamps, rows, strict=True)))
    return truth


@case()
def iso_utc(file: Path) -> Truth:
    """ISO 8601 in UTC: 2024-03-01T12:00:00.005Z."""
    return _dated(file, lambda m: _ms(m, "%Y-%m-%dT%H:%M:%S.") + "Z", "time")


@case()
def iso_offset(file: Path) -> Truth:
    """ISO 8601 with an offset: 2024-03-01T12:00:00.005+01:00."""
    return _dated(file, lambda m: _ms(m, "%Y-%m-%dT%H:%M:%S.") + "+01:00", "Timestamp")


@case()
def iso_basic(file: Path) -> Truth:
    """ISO 8601, basic form: 20240301T120000.005Z."""
    return _dated(file, lambda m: _ms(m, "%Y%m%dT%H%M%S.") + "Z", "timestamp")


@case()
def german_dates(file: Path) -> Truth:
    """01.03.2024 12:00:00,005 between semicolons, as WinCC and Excel write it in German."""
    return _dated(file, lambda m: _ms(m, "%d.%m.%Y %H:%M:%S,"), "Zeitstempel", ";", ",")


@case()
def american_dates(file: Path) -> Truth:
    """3/1/2024 12:00:00.005 PM, as National Instruments and Excel write it in the US."""
    return _dated(file, lambda m: "3/1/2024 " + _ms(m, "%I:%M:%S.") + " PM", "Date/Time")


@case()
def matlab_datetime(file: Path) -> Truth:
    """01-Mar-2024 12:00:00.005, MATLAB's datetime with milliseconds."""
    return _dated(file, lambda m: _ms(m, "%d-%b-%Y %H:%M:%S."), "Time")


@case()
def clock_alone(file: Path) -> Truth:
    """12:00:00.005, the time of day alone."""
    return _dated(file, lambda m: _ms(m, "%H:%M:%S."), "Time")


@case()
def clock_over_midnight(file: Path) -> Truth:
    """A time of day that passes midnight."""
    late = timedelta(hours=12, seconds=-2)
    return _dated(file, lambda m: _ms(m + late, "%H:%M:%S."), "Time")


@case()
def date_and_time_columns(file: Path) -> Truth:
    """Date and time of day in two columns, as data recorders of Yokogawa and Hioki write them."""
    return _dated(file, lambda m: _ms(m, "%Y/%m/%d,%H:%M:%S."), "Date,Time")


@case(step_rtol=1e-4)
def excel_serial_days(file: Path) -> Truth:
    """Excel's days since 1900 with 12 decimals, under a name that says date."""
    days = [f"{45352.5 + i * STEP / 86400:.12f}" for i in range(COUNT)]
    c, truth = written(x="%.6f", u="%.5f")
    save(file, "Date,x,u", *lines(days, *c.values()))
    return truth


def _epoch(file: Path, per_second: float, digits: int, name: str = "timestamp") -> Truth:
    c, truth = written(x="%.6f", u="%.5f")
    ns = [EPOCH * 10**9 + 5_000_000 * i for i in range(COUNT)]
    whole = [n * int(per_second) // 10**9 for n in ns]
    stamps = [f"{n / 1e9:.{digits}f}" for n in ns] if digits else list(map(str, whole))
    save(file, f"{name},x,u", *lines(stamps, *c.values()))
    return truth


@case(step_rtol=1e-4)
def epoch_seconds(file: Path) -> Truth:
    """Epoch in seconds with microseconds, as Python's time.time() logs it."""
    return _epoch(file, 1, 6)


@case()
def epoch_milliseconds(file: Path) -> Truth:
    """Epoch in ms, as JavaScript and Android log it; no unit is said."""
    return _epoch(file, 1e3, 0)


@case()
def epoch_microseconds(file: Path) -> Truth:
    """Epoch in µs, as PX4 and many telemetry systems log it."""
    return _epoch(file, 1e6, 0)


@case()
def epoch_nanoseconds(file: Path) -> Truth:
    """Epoch in ns, as ROS 2 and PlotJuggler export it."""
    return _epoch(file, 1e9, 0, "__time")


@table(t=None, refused="32-bit")
def epoch_in_32_bit(file: Path, c: Texts) -> None:
    """Epoch seconds kept in 32-bit floats: steps of 128 s, which nothing can mend."""
    stamps = [f"{np.float32(EPOCH + STEP * i):.1f}" for i in range(COUNT)]
    save(file, "timestamp,x,u", *lines(stamps, *c.values()))


@table(t=None, options=["--time-step", "0.005"])
def epoch_in_32_bit_stepped(file: Path, c: Texts) -> None:
    """The same file with the step that its user knows."""
    stamps = [f"{np.float32(EPOCH + STEP * i):.1f}" for i in range(COUNT)]
    save(file, "timestamp,x,u", *lines(stamps, *c.values()))


@table(t=None, x="%.5g", u="%.5g", step_rtol=1e-4)
def five_digits(file: Path, c: Texts) -> None:
    """Stamps by %.5g that run past 100 s: uneven by rounding alone."""
    stamps = [f"{98 + STEP * i:.5g}" for i in range(COUNT)]
    save(file, "t,x,u", *lines(stamps, *c.values()))


@table(t=("%.0f", 1e-3), options=["--scale", "t=0.001"])
def milliseconds_unsaid(file: Path, c: Texts) -> None:
    """Milliseconds under the name `t`: nothing says so, the user does."""
    save(file, "t,x,u", *lines(*c.values()))


@table(t=None, options=["--time-step", "0.005"])
def no_time(file: Path, c: Texts) -> None:
    """A file without time."""
    save(file, "x,u", *lines(*c.values()))


@table(t=None, options=["--time-step", "0.005"])
def bad_time(file: Path, c: Texts) -> None:
    """A clock that stands still and jumps back; the step is known."""
    stamps = [f"{(i // 7 * 0.02) % 1.5:.2f}" for i in range(COUNT)]
    save(file, "time,x,u", *lines(stamps, *c.values()))


@case(dx="v")
def temperature_called_T(file: Path) -> Truth:
    """`T` is a temperature, `timestamp` an epoch, `t` the seconds since the start."""
    c, truth = written(t="%.3f", x="%.6f", dx="%.5f", u="%.5f")
    epoch = [str(EPOCH + int(STEP * i)) for i in range(COUNT)]
    warm = [f"{21 + np.sin(0.01 * i):.2f}" for i in range(COUNT)]
    save(file, "timestamp,T,t,x,v,u", *lines(epoch, warm, *c.values()))
    return truth


@table(t=None)
def temperature_and_clock(file: Path, c: Texts) -> None:
    """`T` is a temperature; the only time is `Time stamp`."""
    warm = [f"{21 + 0.3 * np.sin(0.01 * i):.2f}" for i in range(COUNT)]
    stamps = [_ms(m, "%Y-%m-%d %H:%M:%S.") for m in _moments()]
    save(file, "T,Time stamp,x,u", *lines(warm, stamps, *c.values()))


@table()
def late_channel(file: Path, c: Texts) -> None:
    """A GPS speed that no equation reads starts late and ends early: it decides nothing."""
    speed = ["" if not 300 < i < 700 else f"{i / 50:.2f}" for i in range(COUNT)]
    save(file, "t,x,u,GPS speed", *lines(*c.values(), speed))


@case()
def missing_values(file: Path) -> Truth:
    """Empty cells, NaN, and dashes where a sensor dropped out."""
    c, truth = written(t="%.3f", x="%.6f", u="%.5f")
    for at, mark in {50: "", 51: "", 300: "NaN", 600: "-"}.items():
        c["x"][at], truth["x"][at] = mark, np.nan
    save(file, "t,x,u", *lines(*c.values()))
    return truth


@case(step_rtol=1e-6)
def pause(file: Path) -> Truth:
    """A logger that paused for a second in the middle."""
    c, truth = written(x="%.6f", u="%.5f")
    stamps = [f"{t + (t > 2):.3f}" for t in motion()["t"]]
    save(file, "t,x,u", *lines(stamps, *c.values()))
    # A pause, however long, takes one sample, which is missing.
    return {name: np.insert(values, 401, np.nan) for name, values in truth.items()}


@table(names=dict(x="x", u="u"))
def comment_lines(file: Path, c: Texts) -> None:
    """Comments before, inside and after the table."""
    rows = lines(*c.values())
    save(file, "# rig 3", "# 200 Hz", "t,x,u", *rows[:9], "# bump", *rows[9:], "# end")


@table(x=("%.4f", 1e-3), names=dict(x="Weg Achse 1", u="Kraft am Stempel"))
def rows_of_units_and_sensors(file: Path, c: Texts) -> None:
    """Names of several words, units, and a row of sensor serial numbers in words."""
    head = ["Zeit;Weg Achse 1;Kraft am Stempel", "s;mm;N", "Uhr;LVDT-17;U9C-2"]
    save(file, *head, *lines(*c.values(), sep=";"))


@table(x=("%.4f", 1e-3), options=["--unit", "x=mm"])
def millimetres_unsaid(file: Path, c: Texts) -> None:
    """Millimetres that the file does not mention."""
    save(file, "t,x,u", *lines(*c.values()))
