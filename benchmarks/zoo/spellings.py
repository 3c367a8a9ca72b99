"""Text with units, times, numbers, names and ends as people and programs spell them."""

import itertools
from pathlib import Path

import numpy as np

from benchmarks.zoo.case import COUNT, STEP, Texts, Truth, case, lines, save, table, written

MM = ("%.4f", 1e-3)
INCH = ("%.6f", 0.0254)
POUND = ("%.5f", 4.4482216152605)


@table(x=INCH, u=POUND, names=dict(x="Pos (inches)", u="Load (lbs)"))
def imperial(file: Path, c: Texts) -> None:
    """A test stand in the US: inches and pounds in round brackets."""
    save(file, "Time (sec),Pos (inches),Load (lbs)", *lines(*c.values()))


@table(x=MM, u=POUND, names=dict(x="Position", u="Load"))
def units_in_words(file: Path, c: Texts) -> None:
    """A row of units in words: Seconds, Millimeters, Pounds."""
    save(file, "Time,Position,Load", "Seconds,Millimeters,Pounds", *lines(*c.values()))


@table(t=("%.0f", 1e-3), x=MM, u=("%.7f", 1e3), names=dict(x="pos_mm", u="F.kN"))
def units_behind_names(file: Path, c: Texts) -> None:
    """A script's names with units behind them: `timeMs`, `pos_mm`, `F.kN`."""
    save(file, "timeMs,pos_mm,F.kN", *lines(*c.values()))


@table(x=MM)
def units_behind_numbers(file: Path, c: Texts) -> None:
    """Home automation: every number with its unit behind."""
    units = zip(c.values(), ("s", "mm", "N"), strict=True)
    save(file, "t,x,u", *lines(*([f"{text} {unit}" for text in c] for c, unit in units)))


@table(t=("%.9f", 60.0), x=MM, step_rtol=1e-5)
def time_in_minutes(file: Path, c: Texts) -> None:
    """A fatigue rig: time in minutes by the row of units."""
    save(file, "Time,x,u", "Minutes,mm,N", *lines(*c.values()))


@table(t=("%.12f", 86400.0), step_rtol=1e-5)
def time_in_days(file: Path, c: Texts) -> None:
    """A long test: elapsed days."""
    save(file, "Elapsed (days),x,u", *lines(*c.values()))


def _clocked(file: Path, stamps: list[str], sep: str = ",") -> Truth:
    c, truth = written(x="%.6f", u="%.5f")
    save(file, f"Time{sep}x{sep}u", *lines(stamps, *c.values(), sep=sep))
    return truth


@case()
def clock_not_padded(file: Path) -> Truth:
    """C's `%d:%d:%d:%d`: 12:0:0:5 is 5 ms past noon."""
    return _clocked(file, [f"12:0:{5 * i // 1000}:{5 * i % 1000}" for i in range(COUNT)])


@case()
def clock_of_irig(file: Path) -> Truth:
    """IRIG, flight tests: the day of the year, then the time of day."""
    stamps = [f"061:12:00:{5 * i // 1000:02d}.{5 * i % 1000:03d}" for i in range(COUNT)]
    return _clocked(file, stamps)


@case()
def american_month_names(file: Path) -> Truth:
    """Mar 1, 2024 12:00:00.005, between semicolons."""
    stamps = [f"Mar 1, 2024 12:00:{5 * i // 1000:02d}.{5 * i % 1000:03d}" for i in range(COUNT)]
    return _clocked(file, stamps, ";")


@case(step_rtol=1e-5)
def ticks_of_windows(file: Path) -> Truth:
    """Windows FILETIME: counts of 100 ns since 1601."""
    return _clocked(file, [str(133_537_680 * 10**9 + 50_000 * i) for i in range(COUNT)])


@table(t=None)
def arduino_micros(file: Path, c: Texts) -> None:
    """Arduino, `micros()`, whose 32 bits begin anew."""
    stamps = [str((2**32 - 2_000_000 + 5000 * i) % 2**32) for i in range(COUNT)]
    save(file, "micros,x,u", *lines(stamps, *c.values()))


@case(step=1 / 700, step_rtol=1e-4)
def milliseconds_at_700_hz(file: Path) -> Truth:
    """700 Hz with stamps in whole milliseconds: steps of 1 and of 2 ms."""
    return _clocked(file, [f"{i / 700:.3f}" for i in range(COUNT)])


@case()
def overload(file: Path) -> Truth:
    """Recorders: +OVER, stars and dashes where a channel is past its range."""
    c, truth = written(t="%.3f", x="%.6f", u="%.5f")
    words = ("+OVER", "*****", "----", "1.#QNAN0", "#DIV/0!")
    for place, word in zip((100, 300, 301, 500, 700), words, strict=True):
        c["x"][place], truth["x"][place] = word, float("nan")
    save(file, "t,x,u", *lines(*c.values()))
    return truth


@table(refused="has 1 values for 3 columns; take off that line")
def mean_and_extremes(file: Path, c: Texts) -> None:
    """A report: mean and extremes below the table, then who made it."""
    below = ["", "Mean,0.01,2.5", "Max,0.4,20", "Std. Dev.,0.1,9", "", "End of test"]
    save(file, "t,x,u", *lines(*c.values()), *below)


@case()
def power_lost(file: Path) -> Truth:
    """A logger that lost its power: half a line, and the file filled with zero bytes."""
    c, truth = written(t="%.3f", x="%.6f", u="%.5f")
    text = "\n".join(["t,x,u", *lines(*c.values())])
    file.write_bytes(text.rpartition(",")[0].encode() + bytes(500))
    return {name: values[:-1] for name, values in truth.items()}


@table(x=MM)
def appended(file: Path, c: Texts) -> None:
    """A logger that writes its names again where it opens its file again."""
    rows, head = lines(*c.values()), ["t,x,u", "s,mm,N"]
    save(file, *head, *rows[:300], *head, *rows[300:])


@table(names=dict(u="u"))
def repeated_columns(file: Path, c: Texts) -> None:
    """Two tables side by side, with the time in each and two channels of one name."""
    columns = (c["t"], c["x"], c["u"], c["t"], c["u"], c["x"])
    save(file, "Time,x,Temp,Time,u,Temp", *lines(*columns))


@table(x=MM, names=dict(x="Weg"))
def names_with_line_breaks(file: Path, c: Texts) -> None:
    """Excel: header cells with a line break between name and unit."""
    save(file, '"t\n[s]","Weg\n[mm]","u\n[N]"', *lines(*c.values()))


@table(suffix=".txt", refused="has 1 values for 5 columns; take off that line")
def table_of_a_database(file: Path, c: Texts) -> None:
    """mysql: bars and a frame around the table."""
    frame = "+-------+----------+----------+"
    rows = [f"| {row} |" for row in lines(*c.values(), sep=" | ")]
    save(file, frame, "| t     | x        | u        |", frame, *rows, frame)


@table(suffix=".txt", x=MM)
def gnuplot(file: Path, c: Texts) -> None:
    """gnuplot: a comment of names with units in brackets, columns between blanks."""
    save(file, "# rig 3", "# t [s]   x [mm]   u [N]", *lines(*c.values(), sep="   "))


@table(suffix=".dat", t="%.6E", x=("%.9E", 1e-3), u="%.9E")
def comments_of_names_and_units(file: Path, c: Texts) -> None:
    """A Fortran program: comments of names and of units, exponents with D."""
    rows = [row.replace("E", "D") for row in lines(*c.values(), sep=" ")]
    save(file, "# t x u", "# s mm N", *rows)


@table()
def numbers_kept_from_excel(file: Path, c: Texts) -> None:
    """A web page's export: every number as `="0.5"`."""
    save(file, "t,x,u", *lines(*([f'="{text}"' for text in column] for column in c.values())))


@table(refused="name delimiter and decimal sign (on the command line: --delimiter")
def arabic_digits(file: Path, c: Texts) -> None:
    """Excel, Arabic: digits and decimal sign of its own, between semicolons."""
    digits = str.maketrans("0123456789.", "٠١٢٣٤٥٦٧٨٩٫")
    save(file, "t;x;u", *(row.translate(digits) for row in lines(*c.values(), sep=";")))


@table()
def typographic_minus(file: Path, c: Texts) -> None:
    """LibreOffice, Swedish: U+2212 before negative numbers."""
    save(
        file, "t;x;u", *(row.replace("-", "\N{MINUS SIGN}") for row in lines(*c.values(), sep=";"))
    )


@case()
def indian_thousands(file: Path) -> Truth:
    """Excel, India: 1,23,456.75 in quotes."""
    c, truth = written(t="%.3f", x="%.6f", u="%.5f")
    count = [f"{123456 + i}" for i in range(COUNT)]
    quoted = [f'"{text[0]},{text[1:3]},{text[3:]}.75"' for text in count]
    save(file, "t,x,u,pulses", *lines(*c.values(), quoted))
    return {**truth, "pulses": 123456.75 + np.arange(COUNT)}


@table()
def utf_32(file: Path, c: Texts) -> None:
    """UTF-32 with its mark."""
    save(file, "t,x,u", *lines(*c.values()), encoding="utf-32")


@table()
def three_line_ends(file: Path, c: Texts) -> None:
    """Parts joined on three systems: three kinds of line ends, two byte order marks."""
    ends = itertools.cycle(("\n", "\r\n", "\r"))
    rows = ["\ufeff\ufefft,x,u", *lines(*c.values())]
    file.write_bytes("".join(row + end for row, end in zip(rows, ends)).encode())


@table(x=MM, refused="the name of 'x' and the row of units say mm or m")
def contradictory_units(file: Path, c: Texts) -> None:
    """A name that says mm above a row of units that says m."""
    save(file, "t,x [mm],u", "s,m,N", *lines(*c.values()))


@table(refused="A second recording begins there")
def two_runs_in_one_table(file: Path, c: Texts) -> None:
    """Two recordings one below the other: time begins anew."""
    save(file, "t,x,u", *lines(c["t"][:400] + c["t"][:401], c["x"], c["u"]))


@table()
def newest_first(file: Path, c: Texts) -> None:
    """A web page's export: the newest row first."""
    save(file, "t,x,u", *lines(*c.values())[::-1])


@case(refused="where summer time ends")
def summer_time_ends(file: Path) -> Truth:
    """Local time without its zone, on the night when summer time ends."""
    hours = ["02:59", "02:00"]
    stamps = [f"{hours[i >= 400]}:{(58 + i * STEP) % 60:06.3f}" for i in range(COUNT)]
    return _clocked(file, [f"2024-10-27 {stamp}" for stamp in stamps])
