"""Text as measurement systems, test stands, vehicles, phones and oscilloscopes export it."""

from pathlib import Path

from benchmarks.zoo.case import COUNT, Texts, Truth, case, lines, save, table, written

MM = ("%.4f", 1e-3)
KN = ("%.7f", 1e3)


@table(t="%.6f", x="%.7f", names=dict(x="Weg", u="Kraft"))
def dewesoft_csv(file: Path, c: Texts) -> None:
    """Dewesoft X, export to CSV: names with units in brackets after a preamble."""
    head = ["Setup name: shaker.dxs", "Start time: 3/1/2024 12:00:00.000", "Sample rate: 200 Hz"]
    save(file, *head, "", '"Time (s)","Weg (m)","Kraft (N)"', *lines(*c.values()))


@table(suffix=".txt", t="%.6f", x=MM, names=dict(x="AI 1", u="AI 2"))
def dewesoft_txt(file: Path, c: Texts) -> None:
    """Dewesoft X, export to text: tabs, names, then a row of units."""
    save(file, "Time\tAI 1\tAI 2", "(s)\t(mm)\t(N)", *lines(*c.values(), sep="\t"))


@table(x=MM, names=dict(x="Weg", u="Kraft"))
def imc_studio_csv(file: Path, c: Texts) -> None:
    """imc STUDIO/FAMOS, ASCII export in German: names, units in brackets, decimal commas."""
    rows = lines(*c.values(), sep=";", decimal=",")
    save(file, "Zeit;Weg;Kraft", "[s];[mm];[N]", *rows, encoding="latin-1", newline="\r\n")


@table(suffix=".txt", t="%.5e", x="%.7e", u="%.7e", names=dict(x="displacement", u="force"))
def famos_txt(file: Path, c: Texts) -> None:
    """imc FAMOS, text by ASCII assistant: units beside the names, tabs."""
    save(file, "t [s]\tdisplacement [m]\tforce [N]", *lines(*c.values(), sep="\t"))


LVM = (
    "LabVIEW Measurement\t", "Writer_Version\t2", "Reader_Version\t2", "Separator\tTab",
    "Decimal_Separator\t.", "Multi_Headings\tNo", "X_Columns\tOne", "Time_Pref\tRelative",
    "Operator\tlab", "Date\t2024/03/01", "Time\t12:00:00.1711249351501464844",
    "***End_of_Header***\t", "", "Channels\t2\t\t", f"Samples\t{COUNT}\t{COUNT}\t",
    "Date\t2024/03/01\t2024/03/01\t", "Time\t12:00:00.17\t12:00:00.17\t",
    "Y_Unit_Label\tMeters\tNewtons\t", "X_Dimension\tTime\tTime\t", "X0\t0.0E+0\t0.0E+0\t",
    "Delta_X\t0.005000\t0.005000\t", "***End_of_Header***\t\t\t",
)  # fmt: skip


@table(suffix=".lvm", t="%.6f", u="%.6f", names=dict(x="Position", u="Force"))
def labview_lvm(file: Path, c: Texts) -> None:
    """NI LabVIEW measurement file, version 2: two headers, `X_Value`, a `Comment` column."""
    save(file, *LVM, "X_Value\tPosition\tForce\tComment", *lines(*c.values(), sep="\t"))


@table(suffix=".txt", t="%.6f", u="%.6f", names=dict(x="Position", u="Force"))
def labview_lvm_as_txt(file: Path, c: Texts) -> None:
    """NI LabVIEW measurement file saved with the ending .txt."""
    save(file, *LVM, "X_Value\tPosition\tForce\tComment", *lines(*c.values(), sep="\t"))


@table(t="%.4f", x="%.7f", u=KN, names=dict(x="Weg", u="Kraft"))
def diadem_csv(file: Path, c: Texts) -> None:
    """NI DIAdem, export to CSV: names, units, semicolons, decimal commas."""
    rows = lines(*c.values(), sep=";", decimal=",")
    save(file, "Zeit;Weg;Kraft", "s;m;kN", *rows, newline="\r\n")


@table(t="%.6f", x=MM, names=dict(x="Pos", u="Force"))
def canape_csv(file: Path, c: Texts) -> None:
    """Vector CANape, export to CSV: names, then units in brackets."""
    save(file, "time;Pos;Force", "[s];[mm];[N]", *lines(*c.values(), sep=";"))


@table(t="%.6f", x=MM, names=dict(x="Damper::Position[mm]", u="Damper::Force[N]"))
def canoe_csv(file: Path, c: Texts) -> None:
    """Vector CANoe, logging export: message and signal with the unit behind, quotes."""
    save(file, '"Time[s]","Damper::Position[mm]","Damper::Force[N]"', *lines(*c.values()))


@table(
    t="%.6f",
    x="%.7f",
    names=dict(x="Model Root/Plant/Position [m]", u="Model Root/Plant/Force [N]"),
)
def controldesk_csv(file: Path, c: Texts) -> None:
    """dSPACE ControlDesk, export to CSV: preamble by key, paths as names, semicolons."""
    head = ["descriptor;Recorder_001", "history;2024-03-01", "sampling_period;0.005", ""]
    names = "XAxis [s];Model Root/Plant/Position [m];Model Root/Plant/Force [N]"
    save(file, *head, names, *lines(*c.values(), sep=";"))


@table(suffix=".asc", t="%.4f", x=MM, u=KN, names=dict(x="Weg", u="Kraft"))
def catman_asc(file: Path, c: Texts) -> None:
    """HBM catman, ASCII with channel information: key lines, names, units, Latin-1."""
    head = ["HBM_CATMAN_DATAFILE_40", "", "Prüfstand: Dämpfer", "Anzahl Kanäle: 3"]
    rows = lines(*c.values(), sep="\t", decimal=",")
    save(file, *head, "", "Zeit\tWeg\tKraft", "s\tmm\tkN", *rows, encoding="latin-1")


@table(suffix=".txt", t="%.6e", x="%.8e", u="%.8e", names=dict(x="Channel 1", u="Channel 2"))
def bruel_kjaer_txt(file: Path, c: Texts) -> None:
    """Brüel & Kjær, ASCII: key and value lines, then a table with an index first."""
    head = ["Header Size:\t5", "Version:\t3.00", "Sample rate:\t200", f"Samples:\t{COUNT}", ""]
    index = list(map(str, range(1, COUNT + 1)))
    names = "Index\tTime [s]\tChannel 1 [m]\tChannel 2 [N]"
    save(file, *head, names, *lines(index, *c.values(), sep="\t"))


@table(suffix=".txt", t="%.4f", x=MM, u="%.4f", names=dict(x="Displacement", u="Fz"))
def kistler_txt(file: Path, c: Texts) -> None:
    """Kistler DynoWare, text export: comment lines, names, units, tabs."""
    head = ["% DynoWare export", "% Sampling rate: 200 Hz"]
    rows = lines(*c.values(), sep="\t")
    save(file, *head, "Time\tDisplacement\tFz", "s\tmm\tN", *rows)


@table(suffix=".txt", t="%.4f", x=MM, u=KN, names=dict(x="Axial Displacement", u="Axial Force"))
def mts_txt(file: Path, c: Texts) -> None:
    """MTS TestSuite, text: headers of several words, a unit row, a delimiter at each end."""
    head = ["MTS793|MPT|ENU|1|2|.|/|:|1|0|0|A", "", "Data Acquisition: Timed"]
    names = "Running Time\tAxial Displacement\tAxial Force\t"
    save(file, *head, names, "sec\tmm\tkN\t", *lines(*c.values(), sep="\t", end="\t"))


@table(t="%.4f", x=("%.5f", 1e-3), u=KN, names=dict(x="Extension", u="Load"))
def instron_csv(file: Path, c: Texts) -> None:
    """Instron Bluehill, raw data: names, units in round brackets below, every field quoted."""
    quoted = [[f'"{text}"' for text in column] for column in c.values()]
    save(file, "Time,Extension,Load", "(s),(mm),(kN)", *lines(*quoted))


@table(x=MM, u="%.4f", names=dict(x="Damper Pos FL", u="Damper Force FL"))
def motec_csv(file: Path, c: Texts) -> None:
    """MoTeC i2, export to CSV: session lines in quotes, names, units, blank lines."""
    head = ['"Format","MoTeC CSV File",,,"Workbook",""', '"Venue","Track",,,"Worksheet",""',
            '"Log Date","01/03/2024",,,"Origin Time","0.000","s"', '"Sample Rate","200.000","Hz"',
            '"Duration","4.000","s",,"Segment","session"', "", ""]  # fmt: skip
    names = ['"Time","Damper Pos FL","Damper Force FL"', '"s","mm","N"', ""]
    quoted = [[f'"{text}"' for text in column] for column in c.values()]
    save(file, *head, *names, "", *lines(*quoted), newline="\r\n")


@table(x=MM, u="%.4f", names=dict(x="Susp Pos", u="Susp Force"))
def aim_csv(file: Path, c: Texts) -> None:
    """AiM RaceStudio, CSV: session lines, names, units, blank line."""
    head = ['"Format","AiM CSV File"', '"Session","test"', '"Sample Rate","200"', ""]
    names = ['"Time","Susp Pos","Susp Force"', '"sec","mm","N"', ""]
    save(file, *head, *names, *lines(*([f'"{v}"' for v in k] for k in c.values())))


@table(
    suffix=".txt",
    t=None,
    x="%+.6f",
    u="%+.5f",
    options=["--time-step", "0.005"],
    names=dict(x="position", u="force"),
)
def vbox_txt(file: Path, c: Texts) -> None:
    """RaceLogic VBOX as text: sections in brackets, time as HHMMSS.SS, too coarse for 200 Hz."""
    head = ["File created on 01/03/2024 at 12:00:00", "", "[header]", "time", "position", "force",
            "", "[comments]", "Racelogic", "", "[column names]", "time position force", "",
            "[data]"]  # fmt: skip
    clock = [f"1200{i * 0.005:05.2f}" for i in range(COUNT)]
    save(file, *head, *lines(clock, *c.values(), sep=" "))


@table(suffix=".txt", x="%.5f", u="%.4f", options=["--columns", "t,x,u"])
def arduino_bare(file: Path, c: Texts) -> None:
    """Arduino, Serial.print by commas: a greeting, then seconds, position and force, no names."""
    save(file, "Starting...", *lines(*c.values()))


@table(suffix=".txt", x="%.5f", u="%.4f", refused="Take off brackets and labels")
def arduino_plotter(file: Path, c: Texts) -> None:
    """Arduino serial plotter: `name:value` pairs in each line."""
    save(file, *lines(*([f"{name}:{v}" for v in column] for name, column in c.items())))


@table(t=("%.0f", 1e-3), x="%.5f", u="%.4f")
def arduino_millis(file: Path, c: Texts) -> None:
    """Arduino, `millis()` with its unit in the name."""
    save(file, "time_ms,x,u", *lines(*c.values()))


@table(t="%.9E", x="%.9E", u="%.9E", names=dict(x="Displacement", u="Force"))
def phyphox_csv(file: Path, c: Texts) -> None:
    """phyphox, CSV with decimal points: every name quoted, scientific numbers."""
    save(file, '"Time (s)","Displacement (m)","Force (N)"', *lines(*c.values()))


@table(t="%.9f", x="%.7f", u="%.6f", step_rtol=1e-5, names=dict(x="x", u="z"))
def sensor_logger_csv(file: Path, c: Texts) -> None:
    """Sensor Logger for phones: epoch in ns beside the seconds elapsed."""
    epoch = [f"{1709294400000000000 + 5000000 * i}" for i in range(COUNT)]
    save(file, "time,seconds_elapsed,z,x", *lines(epoch, c["t"], c["u"], c["x"]))


@table(t=("%.8f", 1e-3), x="%.8f", u="%.8f", names=dict(x="Channel A", u="Channel B"))
def picoscope_csv(file: Path, c: Texts) -> None:
    """PicoScope, CSV: names, units in round brackets in milliseconds, a blank line."""
    save(file, "Time,Channel A,Channel B", "(ms),(m),(N)", "", *lines(*c.values()))


@table(t="%.6e", x="%.6e", u="%.6e", names=dict(x="CH1", u="CH2"))
def tektronix_csv(file: Path, c: Texts) -> None:
    """Tektronix, CSV of the MSO series: key lines, a blank line, TIME and channels."""
    head = ["Model,MSO44", "Firmware Version,1.20", "Waveform Type,ANALOG", "Horizontal Units,s",
            "Sample Interval,5.00000E-03", f"Record Length,{COUNT}", ""]  # fmt: skip
    save(file, *head, "Labels,,", "TIME,CH1,CH2", *lines(*c.values()))


@case(u="2", options=["--scale", "u=100"])
def keysight_csv(file: Path) -> Truth:
    """Keysight InfiniiVision, CSV: `x-axis,1,2`, then units; a load cell of 100 N/V."""
    c, truth = written(t="%+.6E", x="%+.7E", u=("%+.7E", 100.0))
    save(file, "x-axis,1,2", "second,Volt,Volt", *lines(*c.values()))
    return {"u": truth["u"]}


@table(suffix=".txt", t="%.6e", x="%.7e", u="%.7e", names=dict(x="Displ", u="Force"))
def oros_txt(file: Path, c: Texts) -> None:
    """OROS NVGate, text: tabs, names and units with trailing tabs."""
    rows = lines(*c.values(), sep="\t", end="\t")
    save(file, "OROS NVGate export", "Time\tDispl\tForce\t", "s\tm\tN\t", *rows)


@table(suffix=".dat", t=None, u="%.4f", names=dict(x="Pos", u="Force"))
def campbell_toa5(file: Path, c: Texts) -> None:
    """Campbell Scientific TOA5: four header lines, quoted date-time stamps, record numbers."""
    stamps = [f'"2024-03-01 12:00:{0.005 * i:06.3f}"' for i in range(COUNT)]
    head = ['"TOA5","CR1000","CR1000","1031","CR1000.Std.00.60","CPU:Test.CR1","4062","Test"',
            '"TIMESTAMP","RECORD","Pos","Force"', '"TS","RN","m","N"',
            '"","","Smp","Smp"']  # fmt: skip
    number = list(map(str, range(COUNT)))
    save(file, *head, *lines(stamps, number, *c.values()))


@table(x=MM, u=("%.5f", 10.0))
def trailing_semicolons(file: Path, c: Texts) -> None:
    """A PLC's log: semicolons at the end of every line, blank lines between blocks."""
    rows = lines(*c.values(), sep=";", end=";")
    save(file, "t [s];x [mm];u (daN);", *rows[:300], "", *rows[300:])


@table(x=MM, u=KN, names=dict(x="Position / mm", u="Kraft / kN"))
def units_behind_slashes(file: Path, c: Texts) -> None:
    """Test stands by DIN 1313: quantity / unit."""
    save(file, "Zeit / s;Position / mm;Kraft / kN", *lines(*c.values(), sep=";"))


@table(suffix=".txt", t="%.4E", x="%+.7E", u="%+.7E", names=dict(x="ACH1", u="ACH2"))
def hioki_txt(file: Path, c: Texts) -> None:
    """Hioki 8807, text: quoted key lines, names behind `"SIGNAL"`, numbers below `"DATA"`."""
    head = ['"COMMENT", "8807 MEM DATA"', '"DATE", "01-01-1999"', '"TIME", "15:26:55"',
            '"NUM_SIGS", 3', '"INTERVAL", 5.000E-03', '"HORZ_UNITS", "S"',
            '"VERT_UNITS", "S", "m", "N"', '"SIGNAL", "TIME", "ACH1", "ACH2"',
            '"DATA"']  # fmt: skip
    save(file, *head, *lines(*c.values(), sep=", "))
