"""`--add-mode` and `--add-spring`: what a model leaves out, and advice that fits a command line."""

from pathlib import Path

import numpy as np
import pytest
from command_line import call, write_csv
from tests import machines

from riecjax.cli.options import HiddenOptions

FAST = ("--refine", "none", "--no-sweep", "--intervals", "sandwich")
MODEL = """
import riecjax as rx
from tests.machines import BODY as body

mapped = rx.Equation(
    rx.Term("m", "v", derivative=1, unit="kg"),
    rx.Terms("F", rx.roof([-1.0, 0.0, 1.0]), "v", unit="N"),
    -rx.Term(1.0, "F"),
    name="mapped",
)
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("hidden")
    (path / "body.py").write_text(MODEL)
    recorded = {
        "mode": machines.body_with_mode(),
        "none": machines.body_with_mode(False),
        "lag": machines.body_with_lag(),
    }
    rng = np.random.default_rng(1)
    for name, signals in recorded.items():
        columns = {"t": machines.STANDARD.times}
        for each, values in signals.items():
            noise = rng.standard_normal(values.size)
            columns[each] = values + 0.003 * np.std(values) * noise
        write_csv(path / f"{name}.csv", columns)
    return path


def asked(capsys, folder: Path, command: str, record: str, *options: str, model: str = "body"):
    named = f"{folder / 'body.py'}:{model}"
    return call(capsys, command, folder / f"{record}.csv", "--model", named, *options)


@pytest.mark.slow
def test_a_mode_found_elsewhere_is_said_without_being_asked(capsys, folder):
    result = asked(capsys, folder, "identify", "mode", "--add-mode", "v=25", *FAST)
    assert result.status == 0, result.err
    said = " ".join(result.out.split())
    assert "no mode near 25 Hz: the search for M_mode ended at 9.4" in said


@pytest.mark.slow
def test_a_mode_that_is_not_there_is_not_to_be_held(capsys, folder):
    result = asked(capsys, folder, "check", "none", "--add-mode", "v")
    assert result.status == 1
    assert "without --add-mode" in result.err
    assert "--set M_mode" not in result.err


def test_a_spring_is_found(capsys, folder):
    result = asked(capsys, folder, "identify", "lag", "--add-spring", "c", *FAST, "--json")
    assert result.status == 0, result.err
    found = result.document["parameters"]["K_series"]
    assert found["value"] == pytest.approx(machines.LAG_TRUTH["K_series"], rel=0.05)
    assert found["unit"] == "N/m"


@pytest.mark.parametrize(
    ("model", "of", "words"),
    [
        ("body", "m", "'m' is of an acceleration, a mass"),
        ("body", "k", "only a softer spring"),
        ("body", "b", "no equation has a coefficient 'b'"),
        ("mapped", "F_1", "without --add-spring), and refine it from there, in Python"),
    ],
)
def test_a_spring_that_cannot_be_is_refused(capsys, folder, model, of, words):
    result = asked(capsys, folder, "identify", "lag", "--add-spring", of, *FAST, model=model)
    assert result.status == 1
    assert words in result.err


@pytest.mark.parametrize(
    "options", [("--quadrature", "6"), ("--test-function", "hat"), ("--criterion", "dols")]
)
def test_windows_that_modes_cannot_have_are_refused_in_words_of_the_command_line(
    capsys, folder, options
):
    result = asked(capsys, folder, "identify", "mode", "--add-mode", "v", *FAST, *options)
    assert result.status == 1
    advice = result.err.split("on the command line: leave out")[1]
    assert options[0] in advice
    assert "--band, --alpha and --beta may stay" in advice


@pytest.mark.slow
def test_a_band_may_stay(capsys, folder):
    result = asked(
        capsys, folder, "identify", "mode", "--add-mode", "v", "--band", "1", "8", *FAST, "--json"
    )
    assert result.status == 0, result.err
    assert result.document["parameters"]["M_mode"]["value"] == pytest.approx(6.0, rel=0.02)


def test_a_sensor_named_twice_counts_once():
    once, twice = (
        HiddenOptions((), (), offsets, ()).added_to("drag-oscillator")
        for offsets in (("u",), ("u", "u"))
    )
    assert twice.parameters == once.parameters
