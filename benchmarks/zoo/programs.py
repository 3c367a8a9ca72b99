"""Text as programs, spreadsheets and libraries write it."""

from pathlib import Path

from benchmarks.zoo.case import COUNT, Texts, Truth, case, lines, save, table, written


@table(t="%.15g", x="%.15g", u="%.15g")
def matlab_writetable(file: Path, c: Texts) -> None:
    """MATLAB writetable: names, 15 significant digits."""
    save(file, "t,x,u", *lines(*c.values()))


@table(t="%.5g sec", x="%.15g", u="%.15g")
def matlab_timetable(file: Path, c: Texts) -> None:
    """MATLAB writetimetable: durations with their unit behind each number."""
    save(file, "Time,x,u", *lines(*c.values()))


@table(t="%.5g", x="%.5g", u="%.5g", options=["--columns", "t,x,u"])
def matlab_writematrix(file: Path, c: Texts) -> None:
    """MATLAB writematrix: numbers alone, stamps of 5 significant digits."""
    save(file, *lines(*c.values()))


@table(suffix=".txt", t="%16.7e", x="%16.7e", u="%16.7e", options=["--columns", "t,x,u"])
def matlab_save_ascii(file: Path, c: Texts) -> None:
    """MATLAB save -ascii: 8 digits, columns of fixed width, no names."""
    save(file, *lines(*c.values(), sep=""))


@case(x="Weg", u="Kraft")
def excel_us(file: Path) -> Truth:
    """Excel, US: saved as CSV, byte order mark, thousands in quotes."""
    c, truth = written(t="%.3f", x="%.6f", u="%.3f")
    c["u"] = [f'"{1000 + float(u):,.3f}"' for u in c["u"]]
    save(file, "Time (s),Weg (m),Kraft (N)", *lines(*c.values()), encoding="utf-8-sig")
    return {**truth, "u": truth["u"] + 1000}


@table(x="%.4f", u="%.3f", names=dict(x="Weg", u="Kraft"))
def excel_german(file: Path, c: Texts) -> None:
    """Excel, German: saved as CSV, semicolons, decimal commas, Windows line ends."""
    rows = lines(*c.values(), sep=";", decimal=",")
    save(file, "Zeit (s);Weg (m);Kraft (N)", *rows, newline="\r\n", encoding="cp1252")


@case(x="déplacement", u="force")
def excel_french(file: Path) -> Truth:
    """Excel, French: narrow no-break spaces between thousands, decimal commas."""
    c, truth = written(t="%.3f", x="%.4f", u="%.2f")
    c["u"] = [f"{1000 + float(u):,.2f}".replace(",", "\u202f") for u in c["u"]]
    rows = lines(*c.values(), sep=";", decimal=",")
    save(file, "temps (s);déplacement (m);force (N)", *rows, encoding="utf-8-sig")
    return {**truth, "u": truth["u"] + 1000}


@case(x="Weg", u="Kraft")
def excel_swiss(file: Path) -> Truth:
    """Excel, Swiss German: apostrophes between thousands, semicolons, decimal points."""
    c, truth = written(t="%.3f", x="%.4f", u="%.2f")
    c["u"] = [f"{1000 + float(u):,.2f}".replace(",", "’") for u in c["u"]]
    save(file, "Zeit [s];Weg [m];Kraft [N]", *lines(*c.values(), sep=";"), encoding="utf-8-sig")
    return {**truth, "u": truth["u"] + 1000}


@table(suffix=".txt", x="%.5f", u="%.3f", names=dict(x="Weg", u="Kraft"))
def excel_unicode_text(file: Path, c: Texts) -> None:
    """Excel, saved as Unicode text: UTF-16 and tabs."""
    save(file, "Zeit\tWeg\tKraft", *lines(*c.values(), sep="\t"), encoding="utf-16")


@table(t="%.6f", x="%.15g", u="%.15g", options=["--columns", "sec,nsec,t,x,u"])
def ros2_topic_echo(file: Path, c: Texts) -> None:
    """`ros2 topic echo --csv`: no names, seconds and nanoseconds apart, then the fields."""
    sec = [str(1709294400 + i // 200) for i in range(COUNT)]
    nsec = [str(i % 200 * 5_000_000) for i in range(COUNT)]
    save(file, *lines(sec, nsec, *c.values()))


@table(t="%.17g", x="%.17g", u="%.17g")
def pandas_index(file: Path, c: Texts) -> None:
    """pandas to_csv with its unnamed index."""
    save(file, ",t,x,u", *lines(list(map(str, range(COUNT))), *c.values()))


@table(t=None, x="%.17g", u="%.17g")
def pandas_datetime_index(file: Path, c: Texts) -> None:
    """pandas to_csv of a frame by time: the unnamed index is the time."""
    stamps = [f"2024-03-01 12:00:{0.005 * i:09.6f}+00:00" for i in range(COUNT)]
    save(file, ",x,u", *lines(stamps, *c.values()))


@table(t=None, x="%.16g", u="%.16g")
def polars_csv(file: Path, c: Texts) -> None:
    """Polars write_csv: date-time stamps with T and microseconds."""
    stamps = [f"2024-03-01T12:00:{0.005 * i:09.6f}" for i in range(COUNT)]
    save(file, "timestamp,x,u", *lines(stamps, *c.values()))


@case()
def r_write_csv(file: Path) -> Truth:
    """R write.csv: quoted row numbers under an empty name, NA for a missing value."""
    c, truth = written(t="%.15g", x="%.15g", u="%.15g")
    c["x"][100] = "NA"
    save(file, '"","t","x","u"', *lines([f'"{i + 1}"' for i in range(COUNT)], *c.values()))
    truth["x"][100] = float("nan")
    return truth


@case()
def julia_csv(file: Path) -> Truth:
    """Julia CSV.write: shortest digits, missing values as `missing`."""
    c, truth = written(t="%.15g", x="%.17g", u="%.17g")
    c["u"][7] = "missing"
    truth["u"][7] = float("nan")
    save(file, "t,x,u", *lines(*c.values()))
    return truth


@table(suffix=".txt", t="%.18e", x="%.18e", u="%.18e")
def numpy_savetxt(file: Path, c: Texts) -> None:
    """NumPy savetxt with a header: names behind `# `, spaces, 18 digits."""
    save(file, "# t x u", *lines(*c.values(), sep=" "))


@table(suffix=".txt", refused="Take off brackets and labels, name delimiter")
def table_in_brackets(file: Path, c: Texts) -> None:
    """A script's print of a list of lists: brackets around the table and each row."""
    rows = [f"[{row}]," for row in lines(*c.values(), sep=", ")]
    save(file, '[["t", "x", "u"],', *rows[:-1], rows[-1][:-1] + "]")


@table()
def rows_in_quotes(file: Path, c: Texts) -> None:
    """A spreadsheet that took each line for one cell: quotes around every whole line."""
    save(file, *(f'"{row}"' for row in ["t,x,u", *lines(*c.values())]))
