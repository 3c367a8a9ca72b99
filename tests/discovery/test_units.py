import pytest

from riecjax.equations.motions import per


@pytest.mark.parametrize(
    ("unit", "of", "power", "found"),
    [
        ("N", "m/s", 1, "N s/m"),
        ("N", "m/s", 2, "N s^2/m^2"),
        ("N", "m", 3, "N/m^3"),
        ("N m", "rad/s", 1, "N m s/rad"),
        ("rad/s^2", "rad/s", 1, "1/s"),
        ("rad/s^2", "rad/s", 2, "1/rad"),
        ("N/m", "m/s", 1, "N s/m^2"),
        ("N", "N", 1, ""),
        ("V/(m s)", "m", 1, "V/(m^2 s)"),
        ("N", "", 1, ""),
        ("N", "", 0, "N"),
        ("", "m", 1, ""),
        ("m/s", "1/s", 1, "m"),
    ],
)
def test_units_of_coefficients(unit, of, power, found):
    assert per(unit, of, power) == found
