"""Columns of doubts, beside what a fault of that size does to rows, and choices among them."""

import numpy as np
import pytest
from test_delays import AXIS, STEP, recorded

import riecjax as rx
from riecjax.doubts.causes import Causes
from riecjax.doubts.columns import Asked, Doubt, folds_of, sensors
from riecjax.equations.model import Model, as_model
from riecjax.folds import Folds

VALUES = {"m": 2.0, "c": 9.0, "k": 400.0, "d": 3.0}
CURVED = rx.Equation(
    *AXIS.equations[0].terms, rx.Term("d", lambda s: s["v"] * abs(s["v"])), name="axis", unit="N"
)


def asked(model: Model) -> Asked:
    return Asked(model, rx.RIEC(rx.AllWindows(0.05, 0.5)), VALUES, {})


FAULTS = {
    "zero of v": (0.02, lambda s, t: np.ones_like(s)),
    "gain of v": (0.02, lambda s, t: s),
    "drift of v": (0.02, lambda s, t: t / np.ptp(t) - 0.5),
    "delay of F": (0.1 * STEP, lambda s, t: -np.gradient(s, STEP)),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_column_is_what_a_small_fault_adds_to_what_is_left(name):
    model, record = as_model(CURVED), recorded(0, noise=0.0)
    drag = VALUES["d"] * np.asarray(record["v"]) * np.abs(np.asarray(record["v"]))
    record = record.with_signals({"F": np.asarray(record["F"]) + drag})
    size, course = FAULTS[name]
    (doubt,) = (d for d in sensors(model, [record], {"x", "v", "F"}) if d.name == name)
    signal = name.rpartition(" ")[2]
    samples, time = np.asarray(record[signal]), np.asarray(record.elapsed)
    faulty = record.with_signals({signal: samples + size * course(samples, time)})
    # Beside the values that are true, the rows of the faulty record leave `size` times the column.
    folds = folds_of(asked(model), [faulty], [doubt])
    at = folds.columns([f"0.{n}" for n in VALUES] + [doubt.name])
    total = folds.motion.sum(0)
    v = np.zeros(len(total))
    v[0], v[at] = 1.0, [*(-value for value in VALUES.values()), -size]
    unexplained = float(v @ total @ v)
    assert unexplained < 1e-3 * size**2 * total[at[-1], at[-1]]
    # And without the column they leave all of it.
    v[at[-1]] = 0.0
    assert float(v @ total @ v) > 0.9 * size**2 * total[at[-1], at[-1]]


def test_noise_is_taken_off_the_products_of_every_column():
    # Of columns that are straight in the signals, noise by itself makes what it adds to products.
    rng, clean = np.random.default_rng(1), recorded(0, noise=0.0)
    deviations = {n: 0.02 * float(np.std(np.asarray(clean[n]))) for n in ("x", "v", "F")}
    alone = {n: size * rng.normal(size=clean.sample_count) for n, size in deviations.items()}
    noisy = {n: np.asarray(clean[n]) + noise for n, noise in alone.items()}
    noisy, alone = (rx.Record.from_samples(one, time_step=STEP) for one in (noisy, alone))
    noisy = noisy.with_noise(rx.Noise.given(deviations))
    model = as_model(AXIS)
    doubts = [d for d in sensors(model, [noisy], {"x", "v", "F"}) if d.kind in ("delay", "gain")]
    found, truth = (folds_of(asked(model), [one], doubts) for one in (noisy, alone))
    taken_off = np.diagonal((found.samples - found.motion).sum(0))
    made = np.diagonal(truth.samples.sum(0))
    # Each is over the size of its own target.
    assert taken_off / taken_off[0] == pytest.approx(made / made[0], rel=0.3)


def test_a_coefficient_beside_others_and_its_error_are_those_of_least_squares():
    rng = np.random.default_rng(3)
    columns = rng.normal(size=(2000, 3)) @ np.array([[1, 0.6, 0], [0, 1, 0.4], [0, 0, 1e4]])
    target = columns @ [1.0, -2.0, 3e-4] + rng.normal(size=2000)
    rows = np.column_stack([target, columns])
    moments = np.array([part.T @ part for part in np.split(rows, 20)])
    folds = Folds(moments, moments, ("a", "b", "c"))
    theta, (left,), *_ = np.linalg.lstsq(columns, target, rcond=None)
    errors = np.sqrt(left / 1997 * np.diag(np.linalg.inv(columns.T @ columns)))
    for place, name in enumerate("abc"):
        told = folds.told(("a", "b", "c"), name)
        assert told.value == pytest.approx(theta[place], rel=1e-9)
        # By the scatter of 20 folds, which is known to a sixth.
        assert told.error == pytest.approx(errors[place], rel=0.5)


def causes(target: np.ndarray, base: np.ndarray, doubts: dict[str, np.ndarray]) -> Causes:
    rows = np.column_stack([target, base, *doubts.values()])
    moments = np.array([part.T @ part for part in np.split(rows, 20)])
    parameters = (*(f"0.p{i}" for i in range(base.shape[1])), *doubts)
    every = [Doubt(name, name.partition(" ")[0]) for name in doubts]
    return Causes(Folds(moments, moments, parameters), every, {})


@pytest.fixture
def columns():
    rng = np.random.default_rng(5)
    base, others = rng.normal(size=(4000, 2)), rng.normal(size=(4000, 6))
    return base, {f"term {i}": column for i, column in enumerate(others.T)}, rng


def test_what_explains_what_is_left_is_demanded_and_nothing_else_is(columns):
    base, doubts, rng = columns
    target = base @ [2.0, -1.0] + 0.5 * doubts["term 3"] + 0.01 * rng.normal(size=4000)
    found = causes(target, base, doubts)
    assert [doubt.name for doubt in found.demanded(found.every)] == ["term 3"]


def test_two_causes_are_found_together(columns):
    base, doubts, rng = columns
    target = base @ [2.0, -1.0] + 0.5 * doubts["term 3"] - 0.3 * doubts["term 1"]
    found = causes(target + 0.01 * rng.normal(size=4000), base, doubts)
    assert {doubt.name for doubt in found.demanded(found.every)} == {"term 1", "term 3"}


def test_what_is_significant_and_explains_a_third_is_no_cause(columns):
    base, doubts, rng = columns
    left_out = 0.5 * doubts["term 3"] + 0.7 * rng.normal(size=4000)
    found = causes(base @ [2.0, -1.0] + left_out, base, doubts)
    (doubt,) = (one for one in found.every if one.name == "term 3")
    assert found.beside([])[doubt].chance < 1e-9
    assert found.demanded(found.every) == []


def test_what_explains_as_much_is_named_and_the_same_column_is_known_as_that(columns):
    base, doubts, rng = columns
    doubts["zero twice"] = 2 * doubts["term 3"]
    doubts["drift alike"] = doubts["term 3"] + 0.2 * rng.normal(size=4000)
    target = base @ [2.0, -1.0] + 0.5 * doubts["term 3"] + 0.01 * rng.normal(size=4000)
    found = causes(target, base, doubts)
    chosen = found.demanded(found.every)
    names = [doubt.name for doubt in found.instead(chosen, chosen[0])]
    assert {chosen[0].name, names[0]} == {"term 3", "zero twice"}
    assert names[1] == "drift alike"
    (same,) = found.same_as(chosen[0], found.every)
    assert {same.name, chosen[0].name} == {"term 3", "zero twice"}


def test_of_four_hundred_sound_choices_at_most_two_find_anything():
    rng, found = np.random.default_rng(7), 0
    for _ in range(400):
        rows = rng.standard_t(4, size=(800, 32))
        doubts = {f"term {i}": column for i, column in enumerate(rows[:, 3:].T)}
        one = causes(rows[:, 0], rows[:, 1:3], doubts)
        found += any(one.is_sure(doubt) for doubt in one.every)
    assert found <= 2
