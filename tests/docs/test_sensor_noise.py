"""The page on sensor noise shows what was recorded."""

import pytest
from benchmarks.calibration import noise_table


def test_the_tables_are_what_was_recorded():
    assert noise_table.PAGE.read_text(encoding="utf-8") == noise_table.page()


def test_tables_tell_the_largest_of_all_parameters_and_leave_out_what_is_not_there():
    linear = {
        "bias": {"m": {"value": -2.34}, "k": {"value": 0.5}},
        "coverage": {"pooled": {"value": 0.925}, "m": {"value": 0.9}},
    }
    document = {"auto": {"drag": {"with velocity": {"5 %": {"linear": linear}}}}}
    row = noise_table.drag(document, "with velocity").splitlines()[-1]
    assert row == "| 5 % | - | 2.3 | - | - | - | - | - | 92.5 % |"


@pytest.mark.parametrize("motion", ["with velocity", "position only"])
def test_nothing_measured_is_no_row(motion):
    assert noise_table.drag({}, motion).splitlines()[-1].startswith("| ---")
