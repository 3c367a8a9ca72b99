"""Units in all spellings are the SI units that standards say they are."""

import re
from typing import Any

import numpy as np
import pytest

import riecjax as rx
from riecjax.equations.quantity import Quantity
from riecjax.records.reading.units import readings, same, split_unit

POUND_FORCE, INCH, DEGREE = 4.4482216152605, 0.0254, np.pi / 180
SPELLED = {
    "m": {"mm": 1e-3, "µm": 1e-6, "micron": 1e-6, "mils": 2.54e-5, "thou": 2.54e-5, "Inches": INCH,
          "feet": 0.3048, "Millimeters": 1e-3, "MM": 1e-3, "metres": 1},
    "m/s": {"mm s^-1": 1e-3, "mm·s⁻¹": 1e-3, "km/hr": 1 / 3.6, "kts": 1852 / 3600, "m/min": 1 / 60,
            "in/sec": INCH, "fps": 0.3048, "m s**-1": 1, "m.s-1": 1},
    "m/s^2": {"m/s/s": 1, "m·s⁻²": 1, "m/(s^2)": 1, "mm/s²": 1e-3, "G": 9.80665,
              "g-force": 9.80665, "Gal": 0.01, "mGal": 1e-5},
    "N": {"kgf": 9.80665, "tf": 9806.65, "kips": 1e3 * POUND_FORCE, "KN": 1e3, "Newtons": 1,
          "µN": 1e-6, "klbf": 1e3 * POUND_FORCE, "dyn": 1e-5, "milliN": 1e-3},
    "N m": {"N·mm": 1e-3, "kN-m": 1e3, "N∙m": 1, "ft-lb": POUND_FORCE * 0.3048,
            "in·lbf": POUND_FORCE * INCH, "lb-in": POUND_FORCE * INCH, "Newton meters": 1,
            "kgf·cm": 0.0980665, "ozf-in": POUND_FORCE * INCH / 16, "mNm": 1e-3},
    "rad": {"°": DEGREE, "º": DEGREE, "Degrees": DEGREE, "revs": 2 * np.pi, "gon": np.pi / 200,
            "arcsec": DEGREE / 3600},
    "rad/s": {"U/min": np.pi / 30, "min⁻¹": np.pi / 30, "1/min": np.pi / 30, "RPM": np.pi / 30,
              "krpm": 1e3 * np.pi / 30, "°/sec": DEGREE, "deg s^-1": DEGREE, "dps": DEGREE},
    "rad/s^2": {"rad/s²": 1, "deg/s^2": DEGREE, "rpm/s": np.pi / 30},
    "Pa": {"N/mm²": 1e6, "kN/m2": 1e3, "PSI": POUND_FORCE / INCH**2, "Bar": 1e5, "KPa": 1e3,
           "kgf/cm²": 98066.5, "mmHg": 133.322387415},
    "N/m": {"kN/mm": 1e6, "lb/in": POUND_FORCE / INCH, "N/cm": 100},
    "N s/m": {"kN·s/m": 1e3, "kNs/m": 1e3, "N/(mm/s)": 1e3, "lbf·s/in": POUND_FORCE / INCH},
    "kg": {"tonnes": 1e3, "grams": 1e-3, "kilograms": 1, "slug": POUND_FORCE / 0.3048},
    "m^3/s": {"l/min": 1e-3 / 60, "m³/h": 1 / 3600},
    "V": {"mV": 1e-3, "Volts": 1, "VDC": 1},
    "W": {"kW": 1e3, "hp": 550 * 0.3048 * POUND_FORCE},
}  # fmt: skip
CASES = [(si, text, factor) for si, table in SPELLED.items() for text, factor in table.items()]


@pytest.mark.parametrize(("si", "text", "factor"), CASES)
def test_spellings(si, text, factor):
    (unit,) = readings(text).values()
    (base,) = readings(si).values()
    assert unit.powers == base.powers
    assert unit.factor == pytest.approx(factor, rel=1e-9)


NAMES = ["x", "left", "Mm", "m/s*s", "N/m s", "°C", "mms-1x", "m//s", "(m", "m)", "", "2", "2 m",
         "(" * 2000 + "m" + ")" * 2000,
         "km^999999", "fin", "damp", "m" * 10**5, "1if", "m/"]  # fmt: skip


@pytest.mark.parametrize("text", NAMES)
def test_what_is_no_unit_or_could_be_two(text):
    assert not readings(text)


@pytest.mark.parametrize("text", ["g", "lb", "oz", "mg", "grad", "Pounds", "g " * 60])
def test_a_spelling_with_two_meanings(text):
    assert len(readings(text)) == 2


def test_the_same_unit():
    assert same("m/s^2", "m s-2")
    assert same("furlong", "furlong")
    assert not same("mm", "m")
    assert not same("Hz", "rad/s")


def read(tmp_path, head, unit, *, row="", **settings):
    path = tmp_path / "a.csv"
    rows = [f"{0.01 * i:.2f};{i + 1}" for i in range(60)]
    path.write_text("\n".join([f"t;{head}", *([f"s;{row}"] if row else []), *rows]) + "\n")
    model = rx.Model("m", "", signals=(Quantity("x", unit, ""),)) if unit else None
    return rx.read_recording(path, model=model, **settings)


@pytest.mark.parametrize(
    ("head", "factor"),
    [("x_mm", 1e-3), ("x.mm", 1e-3), ("pos mm", 1e-3), ("w_deg_s", DEGREE), ("v_km_h", 1 / 3.6),
     ("v_kmph", 1 / 3.6), ("w_degps", DEGREE), ("p_kPa", 1e3), ("a_mm_s2", 1e-3), ("x_fl", 1),
     ("x_m", 1), ("a_ms", 1), ("x_bar", 1)],
)  # fmt: skip
def test_a_unit_behind_a_name_that_is_mapped(tmp_path, head, factor):
    record = read(tmp_path, head, "", rename={"x": head}).record
    np.testing.assert_allclose(record["x"][0], factor, rtol=1e-12)
    scaled = read(tmp_path, head, "", rename={"x": head}, scale={"x": 2.0}).record
    assert float(scaled["x"][0]) == 2


@pytest.mark.parametrize(
    ("head", "unit"), [("x_cm", "m"), ("a_g", "m/s^2"), ("x in", "m"), ("p_psi", "Pa")]
)
def test_what_may_be_a_unit_behind_a_name_is_asked(tmp_path, head, unit):
    tail = head[2:]
    with pytest.raises(rx.DataError, match=rf"may be in {tail}.*--unit x={tail} or --unit 'x="):
        read(tmp_path, head, unit, rename={"x": head})
    assert (
        float(read(tmp_path, head, unit, rename={"x": head}, units={"x": unit}).record["x"][0]) == 1
    )
    assert float(read(tmp_path, head, "V", rename={"x": head}).record["x"][0]) == 1


def test_a_name_and_a_row_of_units_that_differ_are_asked_about(tmp_path):
    with pytest.raises(rx.DataError, match=r"say mm or m; say which.*--unit x=mm"):
        read(tmp_path, "x [mm]", "m", row="m")
    assert read(tmp_path, "x [mm]", "m", row="mm").converted == {"x": "mm"}
    assert float(read(tmp_path, "x [mm]", "m", row="m", units={"x": "m"}).record["x"][0]) == 1


def test_an_unknown_unit_that_is_typed_is_refused(tmp_path):
    with pytest.raises(rx.DataError, match=r"unit 'furlong' of 'x' is not known.*--scale x=FACTOR"):
        read(tmp_path, "x", "m", units={"x": "furlong"})


STATED = {
    "Force [kN]": ("Force", "kN"),
    "Force (daN)": ("Force", "daN"),
    "Force / kN": ("Force", "kN"),
    "F/kN": ("F", "kN"),
    "Force in daN": ("Force", "daN"),
    "Spring travel, mm": ("Spring travel", "mm"),
    "v / (m/s)": ("v", "m/s"),
    "Speed, km/h": ("Speed", "km/h"),
    "front/left/mm": ("front/left", "mm"),
    "t/ms": ("t", "ms"),
}
PLAIN = ["m/s", "rad/s", "N/m", "speed, left", "left/right", "speed (left)", "x[3]", "a in b", "x"]


@pytest.mark.parametrize("column", STATED)
def test_units_in_names(column):
    assert split_unit(column) == STATED[column]


@pytest.mark.parametrize("column", PLAIN)
def test_names_without_a_unit(column):
    assert split_unit(column) == (column, None)


def test_a_unit_with_two_meanings_is_asked_about_and_never_dropped(tmp_path):
    """Of a model that does not say what it reads, as of one that does."""
    asked = r"'x' is in g, which may be gn \(m/s\^2\) or gram \(kg\); say which.*--unit x=gn or"
    every: list[dict[str, Any]] = [{"units": {"x": "g"}}, {"rename": {"x": "x"}}, {}]
    for given in every:
        with pytest.raises(rx.DataError, match=asked):
            read(tmp_path, "x [g]", "", **given)
    silent = rx.Model("m", "")
    path = tmp_path / "a.csv"
    path.write_text("t;x [g];y [m]\n" + "".join(f"{i / 100};{i};{i}\n" for i in range(60)))
    recording = rx.read_recording(path, model=silent)
    assert list(recording.record.arrays) == ["y"]
    other = rx.read_recording(path, rename={"y": "y"})
    assert list(other.record.arrays) == ["y"]
    assert re.match(asked, other.left_out["x [g]"])
    with pytest.raises(rx.DataError, match=rf"column 'x \[g\]' was left out: {asked}"):
        rx.check(rx.Equation(rx.Term("k", "x"), -rx.Term(1.0, "y")), recording)
    record = rx.read_recording(path, model=silent, units={"x": "gn"}).record
    np.testing.assert_allclose(record["x"], 9.80665 * np.arange(60), rtol=1e-12)


@pytest.mark.parametrize(("head", "unit", "factor"), [("g", "m/s^2", 9.80665), ("g", "kg", 1e-3),
                                                      ("Gal", "m/s^2", 0.01), ("tf", "N", 9806.65),
                                                      ("lb", "N", POUND_FORCE)])  # fmt: skip
def test_a_model_that_says_what_it_reads_decides(tmp_path, head, unit, factor):
    recording = read(tmp_path, f"x [{head}]", unit)
    np.testing.assert_allclose(recording.record["x"][0], factor, rtol=1e-9)


@pytest.mark.parametrize("bits", [16, 32])
def test_signed_numbers_that_were_read_as_unsigned_are_put_right(tmp_path, bits):
    i = np.arange(400)
    current = np.round(900 * np.sin(i / 20) + 400 * np.sin(i / 7)).astype(np.int64)
    others = {
        "counter": (i * 2**bits // 300) % 2**bits,
        "on and off": np.where(i % 40 < 20, 0, 2**bits - 1),
        "fractions": (current + 0.5) % 2**bits,
        "never below zero": np.abs(current) + 1,
    }
    wrapped = current % 2**bits
    names = ["t", "i [mA]", *others]
    columns = [i, wrapped, *others.values()]
    rows = ["\t".join(map(repr, row)) for row in zip(*(c.tolist() for c in columns))]
    (tmp_path / "a.csv").write_text("\n".join(["\t".join(names), *rows]) + "\n")
    recording = rx.read_recording(tmp_path / "a.csv", outliers="keep")
    np.testing.assert_allclose(recording.record["i"], 1e-3 * current, atol=1e-12)
    assert f"i: signed numbers of {bits} bits, read as unsigned, put right" in recording.steps
    for name, values in others.items():
        np.testing.assert_array_equal(recording.record[name], values.astype(float))
