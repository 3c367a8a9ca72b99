"""The page on files has the zoo's table."""

from benchmarks.zoo import __main__ as zoo


def test_the_table_is_that_of_the_zoo():
    assert zoo.PAGE.read_text(encoding="utf-8") == zoo.page()
