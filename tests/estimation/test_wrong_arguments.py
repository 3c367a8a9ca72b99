"""Slips in calls of the verbs: each is an error of one line that says what to write."""
# pyright: reportArgumentType=false

import contextlib
import functools

import jax
import numpy as np
import optimistix
import pytest

import riecjax as rx
from riecjax.equations import Quantity

TIME = np.arange(400) / 100
RECORD = rx.Record.from_samples({"x": np.sin(9 * TIME), "F": np.cos(5 * TIME)}, time_step=0.01)
TERMS = (rx.Term("k", "x"), -rx.Term(1.0, "F"))
EQUATION = rx.Equation(*TERMS)
TWO = rx.Equation(rx.Term("m", "F"), *TERMS)
ALL = rx.RIEC(rx.AllWindows(0.05, 0.5))

ASKED = {
    "a name": (("quarter-car", RECORD), {}, "rx.find_model('quarter-car')"),
    "swapped": ((RECORD, EQUATION), {}, "the model first, then its records"),
    "a class of model": ((rx.Equation, RECORD), {}, "the class Equation, not an object of it"),
    "a list of equations": (([EQUATION], RECORD), {}, r"rx.staged(*equations)"),
    "a path": ((EQUATION, "run.csv"), {}, "rx.read_recording('run.csv')"),
    "a dictionary": ((EQUATION, {"x": TIME}), {}, "rx.Record.from_samples({'x': samples, ...}"),
    "paths": ((EQUATION, ["a.csv", "b.csv"]), {}, "one of the records is the text 'a.csv'"),
    "a criterion's class": ((EQUATION, RECORD, rx.RIEC), {}, "the class RIEC, not an object"),
    "a seed": ((EQUATION, RECORD, ALL), {"key": 3}, "key=jax.random.key(3)"),
    "two keys": (
        (EQUATION, RECORD, ALL),
        {"key": jax.random.split(jax.random.key(0), 2)},
        "an array of 2 keys. Write key=keys[0]",
    ),
    "known names": ((EQUATION, RECORD, ALL), {"known": ["k"]}, "known={'x': ...}, by name"),
    "known as nan": ((TWO, RECORD, ALL), {"known": {"k": np.nan}}, "'k': nan is not a finite"),
    "known as two": ((TWO, RECORD, ALL), {"known": {"k": [1.0, 2.0]}}, "a list. Write a number."),
    "per record, one name": ((EQUATION, RECORD, ALL), {"per_record": "k"}, "per_record=('k',)"),
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


@pytest.mark.parametrize("verb", [rx.identify, rx.check])
@pytest.mark.parametrize(
    ("model", "units", "says"),
    [
        (EQUATION, ("m", "mm"), "record 2 has x in mm, .* another record has it in m"),
        (EQUATION, ("m", "meter"), ""),
        (EQUATION, ("counts", "raw"), ""),
        (rx.Model(stages=EQUATION, signals=(Quantity("x", "m", ""),)), ("mm",), "has x in mm"),
        (rx.Model(stages=EQUATION, signals=(Quantity("y", "m", ""),)), ("mm",), ""),
    ],
)
def test_units_that_differ_are_refused(model, units, says, verb):
    samples = {"x": RECORD["x"], "F": RECORD["F"]}
    records = [rx.Record.from_samples(samples, time_step=0.01, units={"x": unit}) for unit in units]
    with pytest.raises(rx.DataError, match=says) if says else contextlib.nullcontext():
        verb(model, records, ALL)


def test_a_batch_is_mapped_over():
    batch = rx.records.stack_records([RECORD, RECORD])
    with pytest.raises(rx.DataError, match=r"jax\.vmap"):
        rx.identify(EQUATION, batch, ALL)


@functools.cache
def summary() -> rx.Summary:
    return rx.summarise(EQUATION, RECORD, ALL, bins=2)


@functools.cache
def fit() -> rx.Estimate:
    return rx.estimate(EQUATION, summary(), intervals=rx.Naive())


def refine(*arguments, **settings):
    return rx.refine(EQUATION, RECORD, *arguments, **settings)


def sweep(criterion, **settings):
    return rx.validation.window_sweep(EQUATION, RECORD, criterion, **settings)


CALLS = {
    # Of sums and estimates.
    "a level in per cent": (lambda: fit().interval("k", 95), "0.95; got 95"),
    "a list of names": (lambda: fit()[["k"]], "there are: k"),
    "a stretch backwards": (lambda: summary().leave_out(5, 1), "before it ends; got 5 to 1"),
    "a recording's name": (lambda: summary().select("a.csv"), "number is the text 'a.csv'"),
    "a million bins": (lambda: rx.summarise(EQUATION, RECORD, ALL, bins=10**6), "too much mem"),
    "intervals' class": (
        lambda: rx.identify(EQUATION, RECORD, ALL, intervals=rx.Sandwich),
        "the class Sandwich",
    ),
    "rest, a word": (
        lambda: rx.identify(EQUATION, RECORD, ALL, at_rest="smooth"),
        "'mask' or 'keep'",
    ),
    # Parts of a model.
    "terms in a list": (lambda: rx.Equation(list(TERMS)), "rx.Equation(*terms) of a list"),
    "a term's name": (lambda: rx.Equation("k x"), "a term is the text 'k x'"),
    "no equation": (lambda: rx.staged(), "at least one equation"),
    "measured as text": (lambda: rx.Term("k", "x", measured="dx"), "measured=('dx',)"),
    "no coefficient": (lambda: rx.Term(None, "x"), "coefficient is None. Write a name or"),
    "points as basis": (lambda: rx.Terms("F", [0.0, 1.0], "x"), "rx.roof("),
    # Parts of a criterion.
    "a band in two": (lambda: rx.RIEC.of_band(1, 10), "rx.RIEC.of_band((1, 10))"),
    "a band backwards": (lambda: rx.RIEC.of_band((5.0, 1.0)), "0 < low < high"),
    "a length as text": (lambda: rx.AllWindows("a", 0.5), "alpha is the text 'a'"),
    "an odd quadrature": (lambda: rx.Boxcar(3), "quadrature must be one of"),
    "a blunt bump": (lambda: rx.Bump(2), "p of 3 or more"),
    # Simulation, refinement and studies.
    "simulate a name": (lambda: rx.simulate("duffing", RECORD), "find_model('duffing').build_sys"),
    "simulate an equation": (lambda: rx.simulate(EQUATION, RECORD), "rx.equation_system(equation,"),
    "no start": (lambda: refine(None), "start is None. Write"),
    "refine by a class": (lambda: refine({"k": 1.0}, rx.OutputError), "by=rx.OutputError()"),
    "a solver's class": (
        lambda: refine({"k": 1.0}, solver=optimistix.LevenbergMarquardt),
        "the class LevenbergMarquardt",
    ),
    "integrate a name": (
        lambda: rx.refine("duffing", RECORD, {"m": 1.0}, rx.IntegralError(ALL)),
        "find_mo",
    ),
    "sweep a name": (lambda: sweep("riec"), "rx.RIEC(rx.AllWindows(0.05, 0.5))"),
    # Records.
    "time as step": (lambda: rx.Record({"x": TIME}, TIME), '({"x": x}, time=t)'),
    "a step as time": (lambda: rx.Record.from_samples({"x": TIME}, 0.01), "time_step=0.005"),
    "a list": (lambda: rx.Record.from_samples([1, 2], time_step=0.1), "is a list. Write rx.Record"),
}


@pytest.mark.parametrize("case", CALLS)
def test_other_calls(case):
    call, words = CALLS[case]
    with pytest.raises((rx.ModelError, rx.DataError)) as refused:
        call()
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_term_with_its_names_swapped_says_what_the_record_has():
    swapped = rx.Equation(rx.Term("x", "m", derivative=1), -rx.Term(1.0, "F"))
    with pytest.raises(rx.DataError, match=r"^the record has no signal 'm'; it has: x, F\."):
        rx.identify(swapped, RECORD, rx.DOLS())


def test_a_window_below_one_sample_asks_for_the_unit_of_time():
    slow = rx.Record.from_samples({"x": TIME, "F": TIME}, time_step=5.0)
    with pytest.raises(rx.DataError, match=r"milliseconds .*--scale t=0\.001.* a rate\?$"):
        rx.identify(EQUATION, slow, ALL)
