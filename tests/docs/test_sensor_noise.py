"""The page on sensor noise shows what was recorded."""

from benchmarks.calibration import noise_table


def test_the_tables_are_what_was_recorded():
    assert noise_table.PAGE.read_text(encoding="utf-8") == noise_table.page()
