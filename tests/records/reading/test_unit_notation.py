"""How columns say their unit."""

import pytest

from riecjax.records.reading.units import split_unit

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
