"""Every file of the zoo is read as the numbers it was made from."""

import pytest

from benchmarks.zoo import __main__ as zoo
from benchmarks.zoo.case import CASES, outcome


@pytest.mark.parametrize("name", CASES)
def test_a_loggers_file(tmp_path, name):
    one = CASES[name]
    if one.needs:
        pytest.importorskip(one.needs)
    found = outcome(one, tmp_path)
    assert found.kind == "right", found.said


def test_the_zoo_is_as_large_as_promised():
    plain = [one for one in CASES.values() if not one.options]
    assert len(CASES) >= zoo.ASKED_FILES and len(plain) >= zoo.ASKED_PLAIN


def test_a_factor_of_a_thousand_is_seen(tmp_path):
    one = CASES["matlab_writetable"]
    assert outcome(one._replace(options=("--scale", "x=1000")), tmp_path).kind == "wrong"
    assert outcome(one._replace(options=("--scale", "t=1000")), tmp_path).kind == "wrong"
