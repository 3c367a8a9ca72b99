"""Every file of the zoo is read as the numbers it was made from."""

import json

import pytest
from benchmarks.zoo import __main__ as zoo
from benchmarks.zoo.case import CASES, mapped, outcome
from tests.machines import DRAG_TRUTH as TRUTH

from riecjax.cli.main import run


@pytest.mark.parametrize("name", CASES)
def test_a_loggers_file(tmp_path, name):
    one = CASES[name]
    if one.needs:
        pytest.importorskip(one.needs)
    found = outcome(one, tmp_path)
    assert found.kind == "right", found.said


def test_the_zoo_is_as_large_as_promised():
    plain = [one for one in CASES.values() if not one.options and not one.refused]
    assert len(CASES) >= zoo.ASKED_FILES
    assert len(plain) >= zoo.ASKED_PLAIN


def test_a_factor_of_a_thousand_is_seen(tmp_path):
    one = CASES["matlab_writetable"]
    assert outcome(one._replace(options=("--scale", "x=1000")), tmp_path).kind == "wrong"
    assert outcome(one._replace(options=("--scale", "t=1000")), tmp_path).kind == "wrong"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["excel_german", "german_dates", "dewesoft_txt", "mat_matrix"])
def test_the_whole_command_finds_the_mass(tmp_path, capsys, name):
    one = CASES[name]
    file = tmp_path / (name + one.suffix)
    one.write(file)
    asked = ["identify", str(file), "--model", "drag-oscillator", *mapped(one.rename)]
    assert run([*asked, *one.options, "--no-sweep", "--json"]) == 0
    value = json.loads(capsys.readouterr().out)["parameters"]["m"]["value"]
    assert value == pytest.approx(TRUTH["m"], rel=0.03)
