import subprocess
import sys

import equinox as eqx
import jax
import numpy as np
import pytest
from command_line import call

from riecjax.cli.main import COMMANDS
from riecjax.criteria.criterion import DOLS, RIEC
from riecjax.criteria.windows import RandomWindows
from riecjax.models.catalogue import MODELS
from riecjax.records.record import Record

NAMES = (
    "quarter-car",
    "quarter-car-source",
    "two-mass",
    "emps",
    "emps-asymmetric",
    "duffing",
    "drag-oscillator",
    "pendulum",
)
IDENTIFIED = [name for name, model in MODELS.items() if model.procedure is not None]


@pytest.mark.portable
def test_listing(capsys):
    result = call(capsys, "models")
    assert result.status == 0
    assert result.err == ""
    for name in NAMES:
        assert name in result.out
    for model in MODELS.values():
        for quantity in (*model.parameters, *model.signals, *model.inputs):
            assert quantity.name in result.out
            assert quantity.unit in result.out


@pytest.mark.portable
def test_json(capsys):
    document = call(capsys, "models", "--json").document
    assert document["schema"] == 2
    assert set(NAMES) <= set(document["models"])
    duffing = document["models"]["duffing"]
    units = {entry["name"]: entry["unit"] for entry in duffing["parameters"]}
    assert units == {"m": "kg", "d": "N s/m", "k1": "N/m", "k2": "N/m^2", "k3": "N/m^3"}
    assert [entry["name"] for entry in duffing["inputs"]] == ["u"]


@pytest.mark.parametrize("name", IDENTIFIED)
def test_listed_parameters_are_those_of_the_equations(name):
    model = MODELS[name]
    procedure = model.build_procedure()
    assert {q.name: q.unit for q in model.parameters} == procedure.units
    assert tuple(q.name for q in model.parameters) == procedure.parameters


def criterion(name: str) -> DOLS | RIEC:
    return DOLS() if name == "dols" else RIEC(RandomWindows(0.1, 0.5, 10))


@pytest.mark.parametrize("criterion_name", ["riec", "dols"])
@pytest.mark.parametrize("name", IDENTIFIED)
def test_listed_signals_are_all_that_the_equations_read(name, criterion_name):
    model = MODELS[name]
    rng = np.random.default_rng(0)
    needed = [q for q in model.signals if criterion_name == "dols" or "DOLS" not in q.meaning]
    record = Record({q.name: rng.normal(size=50) for q in needed}, 0.1)
    for stage in model.build_procedure().stages:
        for equation in stage:
            # Tracing reads every signal and compiles nothing.
            rows = eqx.filter_eval_shape(
                criterion(criterion_name).rows, equation, record, jax.random.key(0)
            )
            assert rows.columns.shape[0] == 1 + len(equation.parameters)


@pytest.mark.parametrize("name", [name for name, model in MODELS.items() if model.system])
def test_listed_inputs_are_those_of_the_system(name):
    model = MODELS[name]
    system = model.build_system({})
    assert tuple(q.name for q in model.inputs) == system.input_names


def run_python(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


@pytest.mark.parametrize(
    "arguments",
    [["models"], ["models", "--json"], ["--version"], *([c, "--help"] for c in COMMANDS)],
    ids=" ".join,
)
def test_listing_and_help_import_no_jax(arguments):
    done = run_python(
        "import sys\n"
        "from riecjax.cli.main import run\n"
        f"assert run({arguments!r}) == 0\n"
        "heavy = {'jax', 'equinox', 'scipy', 'matplotlib'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout
    assert done.stderr == ""


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_each_command(capsys, command):
    result = call(capsys, command, "--help")
    assert result.status == 0
    assert result.err == ""
    assert result.out.startswith(f"Usage: riecjax {command}")
    assert "--json" in result.out


def test_help_names_every_option_of_the_contract(capsys):
    options = {
        "reproduce": ("--seed", "--roads", "--full", "--quick", "--out", "--json"),
        "identify": (
            *("--model", "--criterion", "--alpha", "--beta", "--windows", "--test-function"),
            *("--refine", "--seed", "--set", "--map", "--scale", "--out", "--json", "RECORD..."),
        ),
        "simulate": ("MODEL", "--input", "--set", "--duration", "--rate", "--seed", "--out"),
    }
    for command, names in options.items():
        page = call(capsys, command, "--help").out
        for name in names:
            assert name in page


def test_without_arguments(capsys):
    result = call(capsys)
    assert result.status == 2
    assert result.out == ""
    assert result.err.startswith("Usage: riecjax")
    for command in COMMANDS:
        assert command in result.err


@pytest.mark.parametrize("flag", ["-h", "--help"])
def test_help(capsys, flag):
    result = call(capsys, flag)
    assert result.status == 0
    for command in COMMANDS:
        assert command in result.out


def test_version(capsys):
    from importlib.metadata import version

    result = call(capsys, "--version")
    assert result.status == 0
    assert result.out == f"riecjax, version {version('riecjax')}\n"
