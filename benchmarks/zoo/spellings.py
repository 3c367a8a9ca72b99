"""Text with units, times, numbers, names and ends as people and programs spell them."""

import itertools
from pathlib import Path

import numpy as np

from benchmarks.zoo.case import COUNT, STEP, Truth, case, lines, save, written

MM = ("%.4f", 1e-3)
INCH = ("%.6f", 0.0254)
POUND = ("%.5f", 4.4482216152605)


@case(x="Pos (inches)", u="Load (lbs)")
def imperial(file: Path) -> Truth:
    """A test stand in the US: inches and pounds in round brackets."""
    c, truth = written(t="%.3f", x=INCH, u=POUND)
    save(file, "Time (sec),Pos (inches),Load (lbs)", *lines(*c.values()))
    return truth


@case(x="Position", u="Load")
def units_in_words(file: Path) -> Truth:
    """A row of units in words: Seconds, Millimeters, Pounds."""
    c, truth = written(t="%.3f", x=MM, u=POUND)
    save(file, "Time,Position,Load", "Seconds,Millimeters,Pounds", *lines(*c.values()))
    return truth


@case(x="pos_mm", u="F.kN")
def units_behind_names(file: Path) -> Truth:
    """A script's names with units behind them: `timeMs`, `pos_mm`, `F.kN`."""
    c, truth = written(t=("%.0f", 1e-3), x=MM, u=("%.7f", 1e3))
    save(file, "timeMs,pos_mm,F.kN", *lines(*c.values()))
    return truth


@case()
def units_behind_numbers(file: Path) -> Truth:
    """Home automation: every number with its unit behind."""
    c, truth = written(t="%.3f", x=MM, u="%.5f")
    units = zip(c.values(), ("s", "mm", "N"), strict=True)
    save(file, "t,x,u", *lines(*([f"{text} {unit}" for text in c] for c, unit in units)))
    return truth


@case(step_rtol=1e-5)
def time_in_minutes(file: Path) -> Truth:
    """A fatigue rig: time in minutes by the row of units."""
    c, truth = written(t=("%.9f", 60.0), x=MM, u="%.5f")
    save(file, "Time,x,u", "Minutes,mm,N", *lines(*c.values()))
    return truth


@case(step_rtol=1e-5)
def time_in_days(file: Path) -> Truth:
    """A long test: elapsed days."""
    c, truth = written(t=("%.12f", 86400.0), x="%.6f", u="%.5f")
    save(file, "Elapsed (days),x,u", *lines(*c.values()))
    return truth


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


@case()
def arduino_micros(file: Path) -> Truth:
    """Arduino, `micros()`, whose 32 bits begin anew."""
    c, truth = written(x="%.6f", u="%.5f")
    stamps = [str((2**32 - 2_000_000 + 5000 * i) % 2**32) for i in range(COUNT)]
    save(file, "micros,x,u", *lines(stamps, *c.values()))
    return truth


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


@case(refused="has 1 values for 3 columns; take off that line")
def mean_and_extremes(file: Path) -> Truth:
    """A report: mean and extremes below the table, then who made it."""
    c, truth = written(t="%.3f", x="%.6f", u="%.5f")
    below = ["", "Mean,0.01,2.5", "Max,0.4,20", "Std. Dev.,0.1,9", "", "End of test"]
    save(file, "t,x,u", *lines(*c.values()), *below)
    return truth


@case()
def power_lost(file: Path) -> Truth:
    """A logger that lost its power: half a line, and the file filled with zero bytes."""
    c, truth = written(t="%.3f", x="%.6f", u="%.5f")
    text = "\n".join(["t,x,u", *lines(*c.values())])
    file.write_bytes(text.rpartition(",")[0].encode() + bytes(500))
    return {name: values[:-1] for name, values in truth.items()}


@case(refused="line 303: 't' is not a number; take off that line")
def appended(file: Path) -> Truth:
    """A logger that writes its names again where it opens its file again."""
    c, truth = written(t="%.3f", x=MM, u="%.5f")
    rows, head = lines(*c.values()), ["t,x,u", "s,mm,N"]
    save(file, *head, *rows[:300], *head, *rows[300:])
    return truth


@case(u="u")
def repeated_columns(file: Path) -> Truth:
    """Two tables side by side, with the time in each and two channels of one name."""
    c, truth = written(t="%.3f", x="%.6f", u="%.5f")
    columns = (c["t"], c["x"], c["u"], c["t"], c["u"], c["x"])
    save(file, "Time,x,Temp,Time,u,Temp", *lines(*columns))
    return truth


@case(x="Weg")
def names_with_line_breaks(file: Path) -> Truth:
    """Excel: header cells with a line break between name and unit."""
    c, truth = written(t="%.3f", x=MM, u="%.5f")
    save(file, '"t\n[s]","Weg\n[mm]","u\n[N]"', *lines(*c.values()))
    return truth


@case(".txt", refused="has 1 values for 5 columns; take off that line")
def table_of_a_database(file: Path) -> Truth:
    """mysql: bars and a frame around the table."""
    c, truth = written(t="%.3f", x="%.6f", u="%.5f")
    frame = "+-------+----------+----------+"
    rows = [f"| {row} |" for row in lines(*c.values(), sep=" | ")]
    save(file, frame, "| t     | x        | u        |", frame, *rows, frame)
    return truth


@case(".txt")
def gnuplot(file: Path) -> Truth:
    """gnuplot: a comment of names with units in brackets, columns between blanks."""
    c, truth = written(t="%.3f", x=MM, u="%.5f")
    save(file, "# rig 3", "# t [s]   x [mm]   u [N]", *lines(*c.values(), sep="   "))
    return truth


@case(".dat")
def comments_of_names_and_units(file: Path) -> Truth:
    """A Fortran program: comments of names and of units, exponents with D."""
    c, truth = written(t="%.6E", x=("%.9E", 1e-3), u="%.9E")
    rows = [row.replace("E", "D") for row in lines(*c.values(), sep=" ")]
    save(file, "# t x u", "# s mm N", *rows)
    return truth


@case()
def numbers_kept_from_excel(file: Path) -> Truth:
    """A web page's export: every number as `="0.5"`."""
    c, truth = written(t="%.3f", x="%.6f", u="%.5f")
    save(file, "t,x,u", *lines(*([f'="{text}"' for text in column] for column in c.values())))
    return truth


@case()
def arabic_digits(file: Path) -> Truth:
    """Excel, Arabic: digits and decimal sign of its own, between semicolons."""
    c, truth = written(t="%.3f", x="%.6f", u="%.5f")
    digits = str.maketrans("0123456789.", "٠١٢٣٤٥٦٧٨٩٫")
    save(file, "t;x;u", *(row.translate(digits) for row in lines(*c.values(), sep=";")))
    return truth


@case()
def typographic_minus(file: Path) -> Truth:
    """LibreOffice, Swedish: U+2212 before negative numbers."""
    c, truth = written(t="%.3f", x="%.6f", u="%.5f")
    save(
        file, "t;x;u", *(row.replace("-", "\N{MINUS SIGN}") for row in lines(*c.values(), sep=";"))
    )
    return truth


@case()
def indian_thousands(file: Path) -> Truth:
    """Excel, India: 1,23,456.75 in quotes."""
    c, truth = written(t="%.3f", x="%.6f", u="%.5f")
    count = [f"{123456 + i}" for i in range(COUNT)]
    quoted = [f'"{text[0]},{text[1:3]},{text[3:]}.75"' for text in count]
    save(file, "t,x,u,pulses", *lines(*c.values(), quoted))
    return {**truth, "pulses": 123456.75 + np.arange(COUNT)}


@case()
def utf_32(file: Path) -> Truth:
    """UTF-32 with its mark."""
    c, truth = written(t="%.3f", x="%.6f", u="%.5f")
    save(file, "t,x,u", *lines(*c.values()), encoding="utf-32")
    return truth


@case()
def three_line_ends(file: Path) -> Truth:
    """Parts joined on three systems: three kinds of line ends, two byte order marks."""
    c, truth = written(t="%.3f", x="%.6f", u="%.5f")
    ends = itertools.cycle(("\n", "\r\n", "\r"))
    rows = ["\ufeff\ufefft,x,u", *lines(*c.values())]
    file.write_bytes("".join(row + end for row, end in zip(rows, ends)).encode())
    return truth


@case(refused="the name of 'x' and the row of units say mm or m")
def contradictory_units(file: Path) -> Truth:
    """A name that says mm above a row of units that says m."""
    c, truth = written(t="%.3f", x=MM, u="%.5f")
    save(file, "t,x [mm],u", "s,m,N", *lines(*c.values()))
    return truth


@case(refused="A second recording begins there")
def two_runs_in_one_table(file: Path) -> Truth:
    """Two recordings one below the other: time begins anew."""
    c, truth = written(t="%.3f", x="%.6f", u="%.5f")
    save(file, "t,x,u", *lines(c["t"][:400] + c["t"][:401], c["x"], c["u"]))
    return truth


@case(refused="turn the rows round")
def newest_first(file: Path) -> Truth:
    """A web page's export: the newest row first."""
    c, truth = written(t="%.3f", x="%.6f", u="%.5f")
    save(file, "t,x,u", *lines(*c.values())[::-1])
    return truth


@case(refused="where summer time ends")
def summer_time_ends(file: Path) -> Truth:
    """Local time without its zone, on the night when summer time ends."""
    hours = ["02:59", "02:00"]
    stamps = [f"{hours[i >= 400]}:{(58 + i * STEP) % 60:06.3f}" for i in range(COUNT)]
    return _clocked(file, [f"2024-10-27 {stamp}" for stamp in stamps])
