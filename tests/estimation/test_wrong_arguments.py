"""Slips in calls of the verbs: each is a `ModelError` that says what to write."""
# pyright: reportArgumentType=false

import jax
import numpy as np
import pytest

import riecjax as rx

TIME = np.arange(400) / 100
RECORD = rx.Record.from_samples({"x": np.sin(9 * TIME), "F": np.cos(5 * TIME)}, time_step=0.01)
TERMS = (rx.Term("k", "x"), -rx.Term(1.0, "F"))
EQUATION = rx.Equation(*TERMS)
ALL = rx.RIEC(rx.AllWindows(0.05, 0.5))
SYSTEM = rx.find_model("duffing").build_system({})

ASKED = {
    "a name": (("quarter-car", RECORD), {}, "rx.find_model('quarter-car')"),
    "a file": (("mine.py", RECORD), {}, "rx.find_model('mine.py')"),
    "swapped": ((RECORD, EQUATION), {}, "the model first, then its records"),
    "a class of model": ((rx.Equation, RECORD), {}, "the class Equation, not an object of it"),
    "a list of equations": (([EQUATION], RECORD), {}, r"rx.staged(*equations)"),
    "no model": ((3.0, RECORD), {}, "rx.find_model('quarter-car')"),
    "a path": ((EQUATION, "run.csv"), {}, "rx.read_record('run.csv')"),
    "a dictionary": ((EQUATION, {"x": TIME}), {}, "rx.Record.from_samples({'x': samples, ...}"),
    "paths": ((EQUATION, ["a.csv", "b.csv"]), {}, "one of the records is the text 'a.csv'"),
    "an array": ((EQUATION, TIME), {}, "the record is a ndarray"),
    "a criterion's name": ((EQUATION, RECORD, "riec"), {}, "rx.RIEC(rx.AllWindows(0.05, 0.5))"),
    "a criterion's class": ((EQUATION, RECORD, rx.RIEC), {}, "the class RIEC, not an object"),
    "windows alone": ((EQUATION, RECORD, rx.AllWindows(0.1, 1)), {}, "the criterion is an AllW"),
    "a seed": ((EQUATION, RECORD, ALL), {"key": 3}, "key=jax.random.key(3)"),
    "known names": ((EQUATION, RECORD, ALL), {"known": ["k"]}, "known={'m': 2.0}"),
    "own, one name": ((EQUATION, RECORD, ALL), {"own": "k"}, "own=('k',)"),
}


@pytest.mark.parametrize("verb", [rx.identify, rx.check])
@pytest.mark.parametrize("case", ASKED)
def test_identify_and_check(case, verb):
    arguments, settings, words = ASKED[case]
    if verb is rx.check and len(arguments) == 2:
        arguments = (*arguments, ALL)
    with pytest.raises(rx.ModelError) as refused:
        verb(*arguments, **settings)
    assert words in str(refused.value)


def test_intervals_are_an_object():
    with pytest.raises(rx.ModelError, match=r"the class Sandwich.*rx\.BlockBootstrap\(\)"):
        rx.identify(EQUATION, RECORD, ALL, intervals=rx.Sandwich)


MADE = {
    "terms in a list": (lambda: rx.Equation(list(TERMS)), "rx.Equation(*terms) of a list"),
    "a term's name": (lambda: rx.Equation("k x"), "a term is the text 'k x'"),
    "equations in a list": (lambda: rx.staged([EQUATION]), "rx.staged(*equations) of a list"),
    "together in a list": (lambda: rx.simultaneous([EQUATION]), "rx.simultaneous(*equations)"),
    "no equation": (lambda: rx.staged(), "at least one equation"),
    "a number as signal": (lambda: rx.Term("k", 3.0), "rx.Term('m', 'x')"),
    "measured as text": (lambda: rx.Term("k", "x", measured="dx"), "measured=('dx',)"),
    "points as basis": (lambda: rx.Terms("F", [0.0, 1.0], "x"), "rx.roof("),
    "a class of windows": (lambda: rx.RIEC(rx.AllWindows), "rx.RIEC(rx.AllWindows(0.05, 0.5))"),
    "lengths as windows": (lambda: rx.RIEC(0.05), "rx.RIEC(rx.AllWindows(0.05, 0.5))"),
    "a class of hats": (lambda: rx.RIEC(rx.AllWindows(0.1, 1), rx.Hat), "rx.Hat()"),
    "a model as name": (lambda: rx.find_model(EQUATION), "rx.find_model('quarter-car')"),
}


@pytest.mark.parametrize("case", MADE)
def test_parts_of_a_model(case):
    make, words = MADE[case]
    with pytest.raises(rx.ModelError) as refused:
        make()
    assert words in str(refused.value)


SIMULATED = {
    "a name": (("duffing", RECORD), {}, "rx.find_model('duffing').build_system"),
    "an equation": ((EQUATION, RECORD), {}, "rx.equation_system(equation, values)"),
    "an array": ((SYSTEM, TIME), {}, "rx.Record.from_samples({'u': force}"),
    "a class": ((SYSTEM, RECORD), {"method": rx.FixedStep}, "method=rx.FixedStep(8)"),
}


@pytest.mark.parametrize("case", SIMULATED)
def test_simulate(case):
    arguments, settings, words = SIMULATED[case]
    with pytest.raises(rx.ModelError) as refused:
        rx.simulate(*arguments, **settings)
    assert words in str(refused.value)


REFINED = {
    "a name": (("duffing", RECORD, {"m": 1.0}), {}, "rx.find_model('duffing')"),
    "swapped": ((RECORD, EQUATION, {"m": 1.0}), {}, "then its records"),
    "numbers as start": ((EQUATION, RECORD, [1.0]), {}, "{'m': 2.0}"),
    "a class": ((EQUATION, RECORD, {"k": 1.0}, rx.OutputError), {}, "by=rx.OutputError()"),
    "a name to integrate": (("duffing", RECORD, {"m": 1.0}, rx.IntegralError(ALL)), {}, "find_mo"),
    "a seed": ((EQUATION, RECORD, {"k": 1.0}), {"key": 3}, "key=jax.random.key(3)"),
}


@pytest.mark.parametrize("case", REFINED)
def test_refine(case):
    arguments, settings, words = REFINED[case]
    with pytest.raises(rx.ModelError) as refused:
        rx.refine(*arguments, **settings)
    assert words in str(refused.value)


def test_what_is_right_passes():
    keys = jax.random.split(jax.random.key(0), 2)
    criterion = rx.RIEC(rx.RandomWindows(0.05, 0.5, 50))
    found = jax.vmap(lambda key: rx.identify(EQUATION, [RECORD], criterion, key=key).theta)(keys)
    assert found.shape == (2, 1)
