"""Estimates under vmap: every member is what an estimate of its own is."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.machines import MACHINES, Shape

import riecjax as rx
from nightly import by_day
from riecjax.records.record import stack_records
from riecjax.validation.residuals import residual_tests

MACHINE = MACHINES["linear"]
WINDOWS = rx.RIEC(rx.RandomWindows(0.05, 0.4, 100))
KEYS = jax.random.split(jax.random.key(3), 3)
DAMPING = jnp.array([2.0, 4.0])
RECORDS = [MACHINE.record(0.02, seed, shape=Shape(500, 100)) for seed in range(3)]


def of_key(key, damping):
    known = {"c": damping}
    return rx.identify(
        MACHINE.model, RECORDS[0], WINDOWS, key=key, known=known, intervals=rx.Sandwich()
    )


def of_record(one):
    # Under vmap sensors tell each other's noise of no values.
    rest = {"key": KEYS[0], "intervals": rx.BlockBootstrap(100), "noise": "none"}
    return rx.identify(MACHINE.model, one, WINDOWS, **rest)


def refined(damping):
    start, known = {"m": 1.0, "k": 30.0}, {"c": damping}
    by = rx.IntegralError(WINDOWS)
    return rx.refine(MACHINE.model, RECORDS[0], start, by, key=KEYS[0], known=known)


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


def test_a_member_is_what_an_estimate_of_its_own_is(case):
    batch, singles = case
    assert tuple(batch.values) == tuple(next(iter(singles.values())))
    for place, single in singles.items():
        for name in single.parameters:
            assert batch.values[name].shape == batch[name].shape == batch.batch_shape
            assert_close(batch.values[name][place], single[name])
            assert_close(batch.standard_error(name)[place], single.standard_error(name))
            for found, end in zip(batch.interval(name, 0.9), single.interval(name, 0.9)):
                assert found.shape == batch.batch_shape
                assert_close(found[place], end)
        assert_close(batch.covariance[place], single.covariance)
        np.testing.assert_allclose(batch.correlation[place], single.correlation, atol=1e-6)
        member = batch.member(*place)
        assert member.batch_shape == ()
        assert str(member) == str(single)
        assert member.findings() == single.findings()
    if len(batch.batch_shape) == 2:
        assert batch.member(1).batch_shape == batch.batch_shape[1:]
    with pytest.raises(rx.ModelError, match="no member"):
        batch.member(batch.batch_shape[0])


@pytest.fixture(scope="module")
def batch():
    return CASES["keys, and in them known values"][0]()


def test_a_batch_prints_its_distribution(batch):
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
    shared = eqx.tree_at(lambda e: e.known["c"], batch, jnp.array(0.7))
    np.testing.assert_array_equal(shared["c"], np.full((3, 2), 0.7))
    (line,) = (line for line in str(shared).splitlines() if line.startswith("c "))
    assert line.split() == ["c", "0.7", "0", "known", "0.7", "N", "s/m"]


def gapped(missing: slice, damped: float = 1.0) -> rx.Record:
    held = {name: np.array(RECORDS[0][name]) for name in ("x", "dx", "u")}
    held["dx"] *= damped
    held["x"][missing] = np.nan
    return rx.Record.from_samples(held, time_step=0.01)


def test_members_without_an_answer_say_so_and_are_left_out_of_the_table():
    records = [gapped(slice(200, 220)), gapped(slice(3, 497)), gapped(slice(200, 220), 0.0)]

    def fit(one):
        return rx.identify(MACHINE.model, one, WINDOWS, key=KEYS[0], intervals=rx.Sandwich())

    def refusal(found):
        return " ".join(f.message for f in found.findings() if f.about.refuses)

    found = jax.jit(jax.vmap(fit))(stack_records(records))
    np.testing.assert_array_equal(found.determined, [True, False, False])
    for place, words in ((1, "no rows"), (2, "nothing in the record tells of m;")):
        assert words in refusal(found.member(place))
    assert refusal(found.member(0)) == ""
    assert refusal(found).startswith("in 1 of 3 members, first in member 1")
    assert "in 1 of 3 members, first in member 2" in refusal(found)
    heading, _, line, *_ = str(found).splitlines()
    assert heading.endswith("2 of them undetermined and left out of this table")
    assert float(line.split()[1]) == pytest.approx(float(found.member(0)["m"]), rel=1e-5)


def test_one_estimate_is_asked_for_where_a_batch_makes_no_sense(batch):
    for attempt in (
        lambda: rx.refine(MACHINE.model, RECORDS[0], batch),
        lambda: residual_tests(MACHINE.model, RECORDS[0], batch),
    ):
        with pytest.raises(rx.ModelError, match=r"batch of shape \(3, 2\): take one out by member"):
            attempt()
