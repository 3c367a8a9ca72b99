"""Every file of the zoo is read as the numbers it was made from."""

import pytest
from benchmarks.zoo import __main__ as zoo
from benchmarks.zoo.case import CASES, compared, outcome
from benchmarks.zoo.measured import measured

import riecjax as rx
from riecjax.errors import DataError


@pytest.mark.parametrize("name", CASES)
def test_a_loggers_file(tmp_path, name):
    one = CASES[name]
    if one.needs:
        pytest.importorskip(one.needs)
    found = outcome(one, tmp_path)
    assert found.kind == "right", found.said


def test_recordings_as_their_authors_published_them():
    held = list(measured())
    if not held:
        pytest.skip("the measured recordings are not here")
    found = {file.name: compared(one, file, one.write(file)) for file, one in held}
    assert {name: said for name, (kind, said) in found.items() if kind != "right"} == {}


def test_a_files_infinite_by_products_do_not_stand_in_the_way(tmp_path):
    rows = "".join(f"{i},{i * i},{1 if i > 19 else 'inf'}\n" for i in range(60))
    (tmp_path / "a.csv").write_text("t,F,ratio\n" + rows)
    assert "ratio" not in rx.read_record(tmp_path / "a.csv", rename={"F": "F"}).arrays
    with pytest.raises(DataError, match="'angle' has 20 infinite"):
        rx.read_record(tmp_path / "a.csv", rename={"angle": "ratio"})


def test_the_zoo_is_as_large_as_promised():
    plain = [one for one in CASES.values() if not one.options and not one.refused]
    assert len(CASES) >= zoo.ASKED_FILES
    assert len(plain) >= zoo.ASKED_PLAIN


def test_a_factor_of_a_thousand_is_seen(tmp_path):
    one = CASES["matlab_writetable"]
    assert outcome(one._replace(options=("--scale", "x=1000")), tmp_path).kind == "wrong"
    assert outcome(one._replace(options=("--scale", "t=1000")), tmp_path).kind == "wrong"
