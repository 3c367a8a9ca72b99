"""A test function is one class: here one that the package does not know."""

import json
from pathlib import Path

import click
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import riecjax as rx
from riecjax.cli.main import run
from riecjax.cli.options import TEST_FUNCTION_NAMES, CriterionOptions
from riecjax.criteria.plain_data import TEST_FUNCTIONS
from riecjax.models.model import Model

KEY = jax.random.key(0)
MODEL = Model("any", "Any model.")


class Cosine(rx.criteria.AbstractSmoothTestFunction):
    """The weight (T / 2) cos^4(pi tau / 2) in seconds, tau from -1 to 1 over a window of length T.

    Three derivatives of it vanish at both ends, so that sums over samples are of order 4.
    """

    name = "cosine"
    row_seconds = 2  # the weight's second and the integral's

    def weight(self, tau, length):
        return 0.5 * length * jnp.cos(0.5 * jnp.pi * tau) ** 4


def oscillator() -> tuple[rx.Equation, rx.Record]:
    """m x'' + d x' + k x = u with m = 2, d = 0.7, k = 30, of which only x and u are recorded."""
    t = np.linspace(0.0, 8.0, 3201)
    x = np.sin(3 * t) + 0.3 * np.cos(11 * t)
    dx = 3 * np.cos(3 * t) - 3.3 * np.sin(11 * t)
    ddx = -9 * np.sin(3 * t) - 36.3 * np.cos(11 * t)
    force = 2 * ddx + 0.7 * dx + 30 * x
    equation = rx.Equation(
        rx.Term("m", "x", derivative=2),
        rx.Term("d", "x", derivative=1),
        rx.Term("k", "x"),
        -rx.Term(1.0, "u", unit="N"),
        unit="N",
        name="oscillator",
    )
    return equation, rx.Record({"x": x, "u": force}, t[1] - t[0])


@pytest.mark.parametrize("power", [1, 2])
def test_its_expected_gain_is_the_mean_of_its_fourier_integrals(power):
    frequency = np.array([0.0, 1.3, 9.0])
    found = rx.criteria.expected_gain(frequency, 0.1, 0.5, Cosine(), power=power)
    lengths, tau = np.linspace(0.1, 0.5, 4001), np.linspace(-1.0, 1.0, 1001)
    weight = np.cos(0.5 * np.pi * tau) ** 4
    for f, mean in zip(frequency, found):
        waves = np.cos(np.pi * f * np.outer(lengths, tau)) * weight
        # The weight's half second and the half length of tau: (T / 2)^2.
        size = 0.25 * lengths**2 * np.abs(np.trapezoid(waves, tau, axis=1))
        # |H| has kinks where a window is blind, between which 256 lengths are close enough.
        assert mean == pytest.approx(np.trapezoid(size**power, lengths) / 0.4, rel=1e-5)


@pytest.mark.parametrize("windows", [rx.AllWindows(0.2, 0.8), rx.RandomWindows(0.2, 0.8, 300)])
def test_it_identifies_from_positions(windows):
    equation, record = oscillator()
    estimate = rx.identify(equation, record, rx.RIEC(windows, Cosine()), key=KEY)
    assert [float(estimate[name]) for name in "mdk"] == pytest.approx([2.0, 0.7, 30.0], rel=1e-4)
    assert estimate.criterion.describe()["test_function"] == "cosine"


def options(**given: str) -> CriterionOptions:
    names = ("criterion", "band", "alpha", "beta", "count", "test_function", "quadrature")
    return CriterionOptions(**{**dict.fromkeys(names), "criterion": "riec", **given})


def test_the_command_line_offers_the_test_functions_that_are_there():
    assert set(TEST_FUNCTION_NAMES) == set(TEST_FUNCTIONS)
    for name in TEST_FUNCTION_NAMES:
        criterion = options(test_function=name).build(MODEL)
        assert criterion.describe()["test_function"] == name
    finer = options(test_function="hat", quadrature="6").build(MODEL)
    assert finer == rx.RIEC.of_band((1.0, 10.0), rx.Hat(6))


def test_the_command_line_takes_it_from_the_table_and_sees_that_it_has_no_quadrature(monkeypatch):
    monkeypatch.setitem(TEST_FUNCTIONS, Cosine.name, Cosine)
    criterion = options(test_function="cosine").build(MODEL)
    assert criterion == rx.RIEC.of_band((1.0, 10.0), Cosine())
    with pytest.raises(click.UsageError, match="belongs to the boxcar and the hat"):
        options(test_function="cosine", quadrature="4").build(MODEL)


OWN_FILE = """
import jax.numpy as jnp
import riecjax as rx

class Cosine(rx.criteria.AbstractSmoothTestFunction):
    name = "cosine"

    def weight(self, tau, length):
        return jnp.cos(0.5 * jnp.pi * tau) ** 4

oscillator = rx.Equation(
    rx.Term("m", "x", derivative=2), rx.Term("d", "x", derivative=1), rx.Term("k", "x"),
    -rx.Term(1.0, "u"),
)
"""


def test_the_command_line_takes_it_from_a_file(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    _, record = oscillator()
    columns = np.column_stack([record.time, record["x"], record["u"]])
    np.savetxt("drive.csv", columns, delimiter=",", header="t,x,u", comments="")
    (tmp_path / "own.py").write_text(OWN_FILE)
    call = [
        "identify",
        "drive.csv",
        "--model",
        "own.py:oscillator",
        "--json",
        "--refine",
        "none",
        "--test-function",
    ]
    assert run([*call, "own.py:Cosine"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["criterion"]["test_function"] == "cosine"
    found = [document["parameters"][name]["value"] for name in "mdk"]
    assert found == pytest.approx([2.0, 0.7, 30.0], rel=1e-3)
    assert run([*call, "own.py:oscillator"]) == 1
    assert "is no test function" in capsys.readouterr().err
    assert run([*call, "cosine"]) == 2


FAULTY_FILE = """
import riecjax as rx

class NeedsArgument(rx.criteria.AbstractSmoothTestFunction):
    name = "needs"
    width: float

class Nameless(rx.criteria.AbstractSmoothTestFunction):
    def weight(self, tau, length):
        return 1 - tau**2

class Raises(rx.criteria.AbstractSmoothTestFunction):
    name = "raises"

    def weight(self, tau, length):
        raise RuntimeError("no weight today")

Criterion = rx.RIEC
"""


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("NeedsArgument", "width"),
        ("Nameless", "name"),
        ("Raises", "no weight today"),
        ("Criterion", "is no test function"),
    ],
)
def test_a_faulty_class_is_one_line(tmp_path, monkeypatch, name, words):
    monkeypatch.chdir(tmp_path)
    Path("faulty.py").write_text(FAULTY_FILE)
    with pytest.raises(rx.ModelError, match=words):
        options(test_function=f"faulty.py:{name}").build(MODEL)
