import equinox as eqx
import jax
import numpy as np
import pytest
from command_line import call

import riecjax as rx
from riecjax.cli.main import ORDER
from riecjax.models.catalogue import LISTED

IDENTIFIED = [name for name, model in LISTED.items() if model.stages]


@pytest.mark.portable
def test_listing(capsys):
    printed, document = call(capsys, "models"), call(capsys, "models", "--json").document
    assert printed.status == 0
    assert printed.err == ""
    assert set(document["models"]) == set(LISTED)
    for name, model in LISTED.items():
        assert name in printed.out
        for quantity in (*model.parameters, *model.signals, *model.inputs):
            assert quantity.name in printed.out
            assert quantity.unit in printed.out


@pytest.mark.parametrize("name", LISTED)
def test_each_is_shown_with_its_equations_if_it_has_any(name, capsys):
    shown = call(capsys, "models", name)
    assert (shown.status, shown.err) == (0, "")
    assert ("equations" in shown.out) == (name in IDENTIFIED)


@pytest.mark.parametrize("pointwise", [False, True], ids=["riec", "dols"])
@pytest.mark.parametrize("name", IDENTIFIED)
def test_listed_signals_are_all_that_the_equations_read(name, pointwise):
    model = rx.find_model(name)
    criterion = rx.DOLS() if pointwise else rx.RIEC(rx.RandomWindows(0.1, 0.5, 10))
    rng = np.random.default_rng(0)
    needed = [q for q in model.signals if pointwise or "DOLS" not in q.meaning]
    record = rx.Record({q.name: rng.normal(size=50) for q in needed}, 0.1)
    for stage in model.stages:
        for equation in stage:
            # Tracing reads every signal and compiles nothing.
            rows = eqx.filter_eval_shape(criterion.rows, equation, record, jax.random.key(0))
            assert rows.columns.shape[0] == 1 + len(equation.parameters)


@pytest.mark.parametrize("arguments", [(), ("-h",), ("--help",)])
def test_help_names_every_command(capsys, arguments):
    result = call(capsys, *arguments)
    assert (result.status, result.out == "") == ((0, False) if arguments else (2, True))
    told = result.out or result.err
    assert told.startswith("Usage: riecjax")
    assert all(command in told for command in ORDER)
