"""Ends of intervals in print: as many digits as tell them apart."""

import pytest

from riecjax.reporting.document import ends_of


@pytest.mark.parametrize(
    ("interval", "said"),
    [
        ((19.98634, 20.02816), ["19.9863", "20.0282"]),
        # Half the width, 1.2e-6, has two digits down to the seventh decimal.
        ((11.9999988, 12.0000012), ["11.9999988", "12.0000012"]),
        ((-1e5 - 0.003, -1e5 + 0.003), ["-100000.003", "-99999.997"]),
        ((12.0, 12.0), ["12", "12"]),
        ((None, 3.0), ["none", "3"]),
        ((float("-inf"), 2.0), ["-inf", "2"]),
        # Beyond twelve digits numbers are rounding.
        ((1.0, 1.0 + 1e-15), ["1", "1"]),
        ((-0.5, 0.25), ["-0.5", "0.25"]),
    ],
)
def test_ends_differ_in_print(interval, said):
    assert ends_of(interval) == said
