"""Estimates under vmap: every member is what an estimate of its own is."""

import json
import warnings
from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from nightly import by_day
from riecjax.criteria.criterion import RIEC
from riecjax.criteria.windows import RandomWindows
from riecjax.equations.equation import Equation
from riecjax.equations.term import Term
from riecjax.errors import ModelError
from riecjax.estimation.estimate import AbstractEstimate
from riecjax.estimation.identify import identify
from riecjax.records.record import Record, stack_records
from riecjax.refinement.integral_error import IntegralError
from riecjax.refinement.refine import refine
from riecjax.reporting.estimate import estimate_entries, parameter_entries
from riecjax.uncertainty.intervals import BlockBootstrap, Sandwich
from riecjax.validation.residuals import residual_tests

EQUATION = Equation(
    Term("m", "v", derivative=1, unit="kg"),
    Term("d", "v", unit="N s/m"),
    Term("k", "x", unit="N/m"),
    -Term(1.0, "u"),
    name="oscillator",
)
WINDOWS = RIEC(RandomWindows(0.05, 0.4, 100))
KEYS = jax.random.split(jax.random.key(3), 3)
DAMPING = jnp.array([0.5, 0.9])


def record(seed: int) -> Record:
    t = np.arange(500) * 0.01
    x, v, a = (
        sum(
            size * rate**order * np.sin(rate * t + phase + order * np.pi / 2)
            for size, rate, phase in ((1.0, 3.0, 0.2), (0.4, 7.1, 1.3), (0.1, 12.7, 2.9))
        )
        for order in range(3)
    )
    noise = np.random.default_rng(seed).normal(size=t.size)
    return Record({"x": x, "v": v, "u": 2 * a + 0.7 * v + 40 * x + 4 * noise}, 0.01)


RECORDS = [record(seed) for seed in range(3)]


def of_key(key, damping):
    known = {"d": damping}
    return identify(EQUATION, RECORDS[0], WINDOWS, key=key, known=known, intervals=Sandwich())


def of_record(one):
    return identify(EQUATION, one, WINDOWS, key=KEYS[0], intervals=BlockBootstrap(100))


def refined(damping):
    start, known = {"m": 1.0, "k": 30.0}, {"d": damping}
    return refine(EQUATION, RECORDS[0], start, IntegralError(WINDOWS), key=KEYS[0], known=known)


CASES = {
    "keys, and in them known values": (
        lambda: jax.vmap(lambda key: jax.vmap(lambda d: of_key(key, d))(DAMPING))(KEYS),
        lambda i, j: of_key(KEYS[i], DAMPING[j]),
        (3, 2),
    ),
    "records": (
        lambda: jax.vmap(of_record)(stack_records(RECORDS)),
        lambda i: of_record(RECORDS[i]),
        (3,),
    ),
    "refinements": (
        lambda: jax.vmap(refined)(DAMPING),
        lambda i: refined(DAMPING[i]),
        (2,),
    ),
}
LAST = {name: tuple(n - 1 for n in shape) for name, (_, _, shape) in CASES.items()}


@pytest.fixture(scope="module", params=by_day(CASES, "keys, and in them known values"))
def case(request):
    batch, single, shape = CASES[request.param]
    return batch(), {place: single(*place) for place in ((0,) * len(shape), LAST[request.param])}


def assert_close(found, expected):
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_names_lead_to_values_of_every_member(case):
    batch, singles = case
    assert tuple(batch.values) == tuple(next(iter(singles.values())))
    for name, values in batch.values.items():
        assert values.shape == batch[name].shape == batch.batch_shape
        for place, single in singles.items():
            assert_close(values[place], single[name])
    assert np.ptp(np.asarray(batch["k"])) > 0


def test_uncertainty_is_read_by_member(case):
    batch, singles = case
    for place, single in singles.items():
        assert isinstance(single.interval("m")[0], float)
        for name in single.parameters:
            assert_close(batch.standard_error(name)[place], single.standard_error(name))
            for found, end in zip(batch.interval(name, 0.9), single.interval(name, 0.9)):
                assert found.shape == batch.batch_shape
                assert_close(found[place], end)
        assert_close(batch.covariance[place], single.covariance)
        np.testing.assert_allclose(batch.correlation[place], single.correlation, atol=1e-6)


def test_a_member_is_an_estimate_of_its_own(case):
    batch, singles = case
    for place, single in singles.items():
        member = batch.member(*place)
        assert member.batch_shape == ()
        assert str(member) == str(single)
        assert member.findings() == single.findings()
        assert str(jax.tree.map(lambda leaf, at=place: leaf[at], batch)) == str(single)
    if len(batch.batch_shape) == 2:
        assert batch.member(1).batch_shape == batch.batch_shape[1:]
    with pytest.raises(ModelError, match="no member"):
        batch.member(batch.batch_shape[0])


@pytest.fixture(scope="module")
def batch():
    return CASES["keys, and in them known values"][0]()


def test_a_batch_prints_its_distribution(case):
    batch, _ = case
    heading, columns, *lines = str(batch).splitlines()
    assert heading == f"batch of {' x '.join(map(str, batch.batch_shape))} estimates"
    assert columns.split("  ")[0] == "parameter"
    mass = np.asarray(batch["m"])
    name, mean, scatter, error, low, dots, high, unit = lines[0].split()
    assert (name, dots, unit) == ("m", "..", "kg")
    assert float(mean) == pytest.approx(mass.mean(), rel=1e-5)
    assert float(scatter) == pytest.approx(mass.std(ddof=1), rel=1e-2)
    assert float(error) == pytest.approx(np.mean(batch.standard_error("m")), rel=1e-2)
    assert (float(low), float(high)) == pytest.approx((mass.min(), mass.max()), rel=1e-5)


def test_what_is_known_to_all_members_has_one_value(batch):
    shared = eqx.tree_at(lambda e: e.known["d"], batch, jnp.array(0.7))
    np.testing.assert_array_equal(shared["d"], np.full((3, 2), 0.7))
    assert shared.member(2, 1)["d"] == 0.7
    (line,) = (line for line in str(shared).splitlines() if line.startswith("d "))
    assert line.split() == ["d", "0.7", "0", "known", "0.7", "N", "s/m"]


def test_findings_of_a_batch_say_how_many_members_they_concern(batch):
    mass = batch.theta.at[1, :, 0].set(-100.0)
    wrong = eqx.tree_at(lambda e: e.theta, batch, mass)
    found = [f.message for f in wrong.findings() if f.code == "negative_value"]
    assert len(found) == 1
    assert found[0].startswith("in 2 of 6 members, first in member 1, 0: m is below zero")
    assert f"warning [negative_value] {found[0]}" in str(wrong)


def gapped(missing: slice, damped: float = 1.0) -> Record:
    held = {name: np.array(RECORDS[0][name]) for name in ("x", "v", "u")}
    held["v"] *= damped
    held["x"][missing] = np.nan
    return Record.from_samples(held, time_step=0.01)


def messages(found) -> dict[str, str]:
    return {finding.code: finding.message for finding in found.findings()}


def test_members_without_an_answer_say_so_and_are_left_out_of_the_table():
    records = [gapped(slice(200, 220)), gapped(slice(3, 497)), gapped(slice(200, 220), 0.0)]

    def fit(one):
        return identify(EQUATION, one, WINDOWS, key=KEYS[0], intervals=Sandwich())

    found = jax.jit(jax.vmap(fit))(stack_records(records))
    np.testing.assert_array_equal(found.determined, [True, False, False])
    for place, words in ((1, "no rows"), (2, "cannot tell these apart: ")):
        assert words in messages(found.member(place))["unidentifiable"]
    assert "unidentifiable" not in messages(found.member(0))
    assert messages(found)["unidentifiable"].startswith("in 2 of 3 members, first in member 1")
    heading, _, line, *_ = str(found).splitlines()
    assert heading.endswith("2 of them undetermined and left out of this table")
    assert float(line.split()[1]) == pytest.approx(float(found.member(0)["m"]), rel=1e-5)


def test_exports_hold_lists_of_the_batchs_shape(batch):
    document = estimate_entries("cart", batch)
    json.dumps(document, allow_nan=False)
    member = estimate_entries("cart", batch.member(2, 1))
    for name, entry in parameter_entries(batch).items():
        assert np.shape(entry["value"]) == (3, 2)
        assert entry["value"][2][1] == member["parameters"][name]["value"]
        assert entry["interval95"][0][2][1] == member["parameters"][name]["interval95"][0]
    assert document["known"]["d"]["value"][2][1] == member["known"]["d"]["value"]
    assert document["residual"]["stages"][0]["rows"] == [[100] * 2] * 3
    assert document["criterion"]["beta"][2][1] == member["criterion"]["beta"] == 0.4


def test_one_estimate_is_asked_for_where_a_batch_makes_no_sense(batch):
    for attempt in (
        lambda: refine(EQUATION, RECORDS[0], batch),
        lambda: residual_tests(EQUATION, RECORDS[0], batch),
    ):
        with pytest.raises(ModelError, match=r"batch of shape \(3, 2\): take one out by member"):
            attempt()


def test_correlations_of_tiny_errors_do_not_overflow():
    covariance = np.array([[1e-320, 0.0, 0.0], [0.0, 4.0, -1.0], [0.0, -1.0, 1.0]])
    one = SimpleNamespace(covariance=covariance, standard_errors=np.sqrt(np.diagonal(covariance)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = AbstractEstimate.correlation.fget(one)  # pyright: ignore[reportOptionalCall, reportArgumentType]
        one.standard_errors = np.array([1e-310, 2.0, np.inf])
        worse = AbstractEstimate.correlation.fget(one)  # pyright: ignore[reportOptionalCall, reportArgumentType]
    np.testing.assert_allclose(found[1:, 1:], [[1.0, -0.5], [-0.5, 1.0]])
    assert np.isnan(worse[2]).all()
    assert worse[1, 1] == 1.0
