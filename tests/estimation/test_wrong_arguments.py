"""Slips in calls of the verbs: each is a `ModelError` that says what to write."""
# pyright: reportArgumentType=false

import jax
import jax.numpy as jnp
import numpy as np
import optimistix
import pytest

import riecjax as rx

TIME = np.arange(400) / 100
RECORD = rx.Record.from_samples({"x": np.sin(9 * TIME), "F": np.cos(5 * TIME)}, time_step=0.01)
TERMS = (rx.Term("k", "x"), -rx.Term(1.0, "F"))
EQUATION = rx.Equation(*TERMS)
TWO = rx.Equation(rx.Term("m", "F"), *TERMS)
ALL = rx.RIEC(rx.AllWindows(0.05, 0.5))
SYSTEM = rx.find_model("duffing").build_system({})

ASKED = {
    "a name": (("quarter-car", RECORD), {}, "rx.find_model('quarter-car')"),
    "a file": (("mine.py", RECORD), {}, "rx.find_model('mine.py')"),
    "swapped": ((RECORD, EQUATION), {}, "the model first, then its records"),
    "a class of model": ((rx.Equation, RECORD), {}, "the class Equation, not an object of it"),
    "a list of equations": (([EQUATION], RECORD), {}, r"rx.staged(*equations)"),
    "no model": ((3.0, RECORD), {}, "rx.find_model('quarter-car')"),
    "a path": ((EQUATION, "run.csv"), {}, "rx.read_recording('run.csv')"),
    "a dictionary": ((EQUATION, {"x": TIME}), {}, "rx.Record.from_samples({'x': samples, ...}"),
    "paths": ((EQUATION, ["a.csv", "b.csv"]), {}, "one of the records is the text 'a.csv'"),
    "an array": ((EQUATION, TIME), {}, "the record is a ndarray"),
    "a criterion's name": ((EQUATION, RECORD, "riec"), {}, "rx.RIEC(rx.AllWindows(0.05, 0.5))"),
    "a criterion's class": ((EQUATION, RECORD, rx.RIEC), {}, "the class RIEC, not an object"),
    "windows alone": ((EQUATION, RECORD, rx.AllWindows(0.1, 1)), {}, "the criterion is an AllW"),
    "a seed": ((EQUATION, RECORD, ALL), {"key": 3}, "key=jax.random.key(3)"),
    "known names": ((EQUATION, RECORD, ALL), {"known": ["k"]}, "known={'m': 2.0}"),
    "two keys": (
        (EQUATION, RECORD, ALL),
        {"key": jax.random.split(jax.random.key(0), 2)},
        "an array of 2 keys. Write key=keys[0]",
    ),
    "a float array": ((EQUATION, RECORD, ALL), {"key": jnp.ones(2)}, "key=jax.random.key(0)"),
    "jax.random.key": ((EQUATION, RECORD, ALL), {"key": jax.random.key}, "the key is a function"),
    "an article": ((EQUATION, RECORD, ALL), {"key": 3}, "the key is an int"),
    "known, a name": ((EQUATION, RECORD, ALL), {"known": ""}, "known={'m': 2.0}"),
    "known as nan": (
        (TWO, RECORD, ALL),
        {"known": {"k": np.nan}},
        "k is held at nan: give a finite number",
    ),
    "known as infinity": (
        (TWO, RECORD, ALL),
        {"known": {"k": jax.numpy.inf * jax.numpy.ones(())}},
        "k is held at inf: give a finite",
    ),
    **{
        f"known as {value}": (
            (TWO, RECORD, ALL),
            {"known": {"k": value}},
            "known values are single numbers, k=2.0",
        )
        for value in (None, [1.0, 2.0], "2", np.ones(2))
    },
    "per record, one name": ((EQUATION, RECORD, ALL), {"per_record": "k"}, "per_record=('k',)"),
    "per record, a number": ((TWO, RECORD, ALL), {"per_record": [1]}, "a name in per_record is an"),
    "per record, a list": (
        (TWO, RECORD, ALL),
        {"per_record": [["k"]]},
        "a name in per_record is a",
    ),
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


@pytest.fixture(scope="module")
def summary() -> rx.Summary:
    return rx.summarise(EQUATION, RECORD, ALL, bins=2)


READ = {
    "a level in per cent": (lambda s: rx.estimate(EQUATION, s).interval("k", 95), "0.95; got 95"),
    "a level of two": (lambda s: rx.estimate(EQUATION, s).intervals(2), "0.95; got 2"),
    "a level of nan": (lambda s: rx.estimate(EQUATION, s).interval_by_name(np.nan), "got nan"),
    "a level as text": (lambda s: rx.estimate(EQUATION, s).interval("k", "95"), "got '95'"),
    "a list of names": (lambda s: rx.estimate(EQUATION, s)[["k"]], "there are: k"),
    "a number's interval": (lambda s: rx.estimate(EQUATION, s).interval(0), "there are: k"),
    "a stretch backwards": (lambda s: s.leave_out(5, 1), "starts before it ends; got 5 to 1"),
    "a stretch from nan": (lambda s: s.leave_out(np.nan, 1), "got nan to 1 s"),
    "a recording's name": (lambda s: s.select("a.csv"), "recording's number is the text 'a.csv'"),
    "a million bins": (lambda s: rx.summarise(EQUATION, RECORD, ALL, bins=10**6), "too much mem"),
    "a million edges": (
        lambda s: rx.summarise(EQUATION, RECORD, ALL, bins=np.linspace(0.1, 0.5, 10**6)),
        "at most 1024",
    ),
}


@pytest.mark.parametrize("case", READ)
def test_what_is_asked_of_sums_and_estimates(summary, case):
    ask, words = READ[case]
    with pytest.raises(rx.ModelError) as refused:
        ask(summary)
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


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
    "no coefficient": (lambda: rx.Term(None, "x"), "coefficient is None. Write a name or"),
    "friction without brackets": (lambda: rx.Terms("F", rx.friction, "v"), "rx.friction()"),
    "a band of one": (lambda: rx.RIEC.of_band(1), "rx.RIEC.of_band((1, 10))"),
    "a band in two": (lambda: rx.RIEC.of_band(1, 10), "rx.RIEC.of_band((1, 10))"),
    "a band as text": (lambda: rx.RIEC.of_band("1 10"), "rx.RIEC.of_band((1, 10))"),
    "a length as text": (lambda: rx.AllWindows("a", 0.5), "alpha is the text 'a'"),
    "two lengths": (lambda: rx.AllWindows(0.1, [0.5, 0.6]), "beta is a list"),
    "a law's name": (lambda: rx.AllWindows(0.1, 0.5, law="uniform"), "law=[1, 2, 1]"),
    "a law's class": (
        lambda: rx.AllWindows(0.1, 0.5, law=rx.criteria.DensityLaw),
        "the class DensityLaw",
    ),
    "a count as text": (lambda: rx.RandomWindows(0.1, 0.5, "a"), "rx.RandomWindows(0.05, 0.5,"),
    "a broken count": (lambda: rx.RandomWindows(0.1, 0.5, 2.5), "windows is a float"),
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


START = {"k": 1.0}
REFINED = {
    "no start": ((EQUATION, RECORD, None), {}, "start is None. Write"),
    "per record, letters": (
        (EQUATION, RECORD, START),
        {"per_record": "mk"},
        "per_record=('mk',): a tuple of names",
    ),
    "per record, a number": (
        (EQUATION, RECORD, START),
        {"per_record": 5},
        "per_record=('offset',)",
    ),
    "known, a name": ((EQUATION, RECORD, START), {"known": "m"}, "known={'m': 2.0}"),
    "known, a number": ((EQUATION, RECORD, START), {"known": 5}, "known={'m': 2.0}"),
    "intervals' name": ((EQUATION, RECORD, START), {"intervals": "a"}, "intervals=rx.Sandwich()"),
    "intervals' class": ((EQUATION, RECORD, START), {"intervals": rx.Sandwich}, "the class Sand"),
    "a solver's name": ((EQUATION, RECORD, START), {"solver": "lm"}, "solver=optimistix.Levenb"),
    "a solver's class": (
        (EQUATION, RECORD, START),
        {"solver": optimistix.LevenbergMarquardt},
        "the class LevenbergMarquardt",
    ),
    "a system's class": ((type(SYSTEM), RECORD, START), {}, f"Write {type(SYSTEM).__name__}(...)"),
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


COMPARED = {
    "windows' name": ({"shooting": "whole"}, "rx.OutputError(rx.refinement.Tiles(0.5))"),
    "windows' class": ({"shooting": rx.refinement.Tiles}, "the class Tiles, not an object of it"),
    "a method's name": ({"method": "rk4"}, "method=rx.FixedStep(8)"),
    "a method's class": ({"method": rx.FixedStep}, "method=rx.FixedStep(8)"),
    "initial states, a number": (
        {"initial_states": 5},
        "initial_states='estimated', 'measured' or values by name",
    ),
    "one channel": ({"channels": "x"}, "channels=('x',)"),
}


@pytest.mark.parametrize("case", COMPARED)
def test_output_error(case):
    settings, words = COMPARED[case]
    with pytest.raises(rx.ModelError) as refused:
        rx.OutputError(**settings)
    assert words in str(refused.value)


STUDIED = {
    "a criterion's name": (
        rx.studies.window_sweep,
        "riec",
        {},
        "rx.RIEC(rx.AllWindows(0.05, 0.5))",
    ),
    "a criterion's class": (rx.studies.window_sweep, rx.RIEC, {}, "the class RIEC"),
    "no windows": (rx.studies.window_sweep, rx.DOLS(), {}, "rx.RIEC(rx.AllWindows(0.05, 0.5))"),
    "sweep's own": (rx.studies.window_sweep, ALL, {"per_record": "k"}, "per_record=('k',)"),
    "scatter's name": (rx.studies.seed_scatter, "riec", {"key": None}, "rx.RIEC(rx.RandomWindows("),
    "scatter's seed": (rx.studies.seed_scatter, ALL, {"key": 3}, "key=jax.random.key(3)"),
}


@pytest.mark.parametrize("case", STUDIED)
def test_studies(case):
    verb, criterion, settings, words = STUDIED[case]
    with pytest.raises(rx.ModelError) as refused:
        verb(EQUATION, RECORD, criterion, **settings)
    assert words in str(refused.value)


RECORDED = {
    "swapped": (lambda: rx.Record(0.005, {"x": TIME}), 'rx.Record.from_samples({"x": x}, time_st'),
    "time as step": (lambda: rx.Record({"x": TIME}, TIME), '({"x": x}, time=t)'),
    "a step as text": (lambda: rx.Record({"x": TIME}, "a"), "time step is the text 'a'"),
    "no step": (lambda: rx.Record({"x": TIME}, 0.0), "positive number of seconds; got 0"),
    "a step backwards": (lambda: rx.Record({"x": TIME}, -0.1), "seconds; got -0.1"),
    "a step of nan": (lambda: rx.Record({"x": TIME}, np.nan), "seconds; got nan"),
    "samples, time as step": (
        lambda: rx.Record.from_samples({"x": TIME}, time_step=TIME),
        '({"x": x}, time=t)',
    ),
    "samples, a step as text": (
        lambda: rx.Record.from_samples({"x": TIME}, time_step="a"),
        "time step is the text 'a'",
    ),
    "a step as time": (lambda: rx.Record.from_samples({"x": TIME}, 0.01), "time_step=0.005"),
    "nothing": (lambda: rx.Record.from_samples(None, time_step=0.1), "is None. Write rx.Record"),
    "a list": (lambda: rx.Record.from_samples([1, 2], time_step=0.1), "is a list. Write rx.Record"),
}


@pytest.mark.parametrize("case", RECORDED)
def test_records(case):
    make, words = RECORDED[case]
    with pytest.raises(rx.DataError) as refused:
        make()
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


def test_samples_with_their_time_need_no_word():
    record = rx.Record.from_samples({"x": TIME}, 2 + TIME)
    np.testing.assert_allclose(record.time, 2 + TIME)


def test_a_term_with_its_names_swapped_says_what_the_record_has():
    swapped = rx.Equation(rx.Term("x", "m", derivative=1), -rx.Term(1.0, "F"))
    with pytest.raises(rx.DataError, match=r"^the record has no signal 'm'; it has: F, x\."):
        rx.identify(swapped, RECORD, rx.DOLS())


def test_a_window_below_one_sample_asks_for_the_unit_of_time():
    slow = rx.Record.from_samples({"x": TIME, "F": TIME}, time_step=5.0)
    with pytest.raises(rx.DataError, match=r"milliseconds .*--scale t=0\.001.* a rate\?$"):
        rx.identify(EQUATION, slow, ALL)


def test_what_is_right_passes():
    keys = jax.random.split(jax.random.key(0), 2)
    criterion = rx.RIEC(rx.RandomWindows(0.05, 0.5, 50))
    found = jax.vmap(lambda key: rx.identify(EQUATION, [RECORD], criterion, key=key).theta)(keys)
    assert found.shape == (2, 1)
