"""Groups that differ, how much of a spread is chance, and steps over time."""

import numpy as np
import pytest
import scipy.stats

from riecjax.fleets.groups import Entry
from riecjax.fleets.spread import RATE, changes, spreads


def entry(group: str, value: float, error: float, name: str = "c", **other: object) -> Entry:
    given = {"start": 0.0, "end": 1.0, "verdict": "good", "status": "ok", **other}
    half = error * float(scipy.stats.norm.isf(0.025))
    return Entry(
        group,
        parameter=name,
        value=value,
        unit="N s/m",
        std_error=error,
        low95=value - half,
        high95=value + half,
        findings="",
        **given,  # pyright: ignore[reportArgumentType]
    )


def fleet(values: np.ndarray, errors: np.ndarray) -> list[Entry]:
    return [entry(f"{i:03}", v, e) for i, (v, e) in enumerate(zip(values, errors))]


def test_mean_and_spread_are_those_of_paule_and_mandel():
    # Seven laboratories of Rukhin and Vangel 1998 would do; here by their defining equations.
    rng = np.random.default_rng(3)
    errors = rng.uniform(0.5, 2.0, 12)
    values = 10 + rng.normal(0, 1.5, 12) + errors * rng.standard_normal(12)
    (found,) = spreads(fleet(values, errors))
    weights = 1 / (errors**2 + found.between**2)
    mean = np.sum(weights * values) / np.sum(weights)
    assert found.mean == pytest.approx(mean)
    assert np.sum(weights * (values - mean) ** 2) == pytest.approx(11, rel=1e-4)
    assert found.std_error == pytest.approx(np.sum(weights) ** -0.5)
    fixed = np.sum(values / errors**2) / np.sum(errors**-2.0)
    q = np.sum((values - fixed) ** 2 / errors**2)
    assert found.p_value == pytest.approx(scipy.stats.chi2.sf(q, 11))
    assert found.share == pytest.approx(max(1 - 11 / q, 0))


def test_worn_groups_are_found_and_do_not_hide_behind_the_spread_that_they_make():
    rng = np.random.default_rng(0)
    for _ in range(20):
        errors = rng.uniform(0.005, 0.02, 20)
        truth = np.where(np.isin(np.arange(20), (4, 11)), 0.85, 1.0)
        (found,) = spreads(fleet(truth + errors * rng.standard_normal(20), errors))
        assert {"004", "011"} <= {one.group for one in found.differing}
        assert found.centre == pytest.approx(1.0, abs=0.02)
        away = {one.group: one.away for one in found.differing}
        assert away["004"] == pytest.approx(-0.15, abs=0.06)


@pytest.mark.parametrize("between", [0.0, 0.03])
def test_false_discoveries_are_as_many_as_the_rate_says(between):
    rng, shares = np.random.default_rng(1), []
    for _ in range(400):
        errors = rng.uniform(0.01, 0.03, 30)
        truth = 1.0 + between * rng.standard_normal(30)
        worn = rng.choice(30, 3, replace=False)
        truth[worn] -= 0.4
        (found,) = spreads(fleet(truth + errors * rng.standard_normal(30), errors))
        called = [int(one.group) for one in found.differing]
        shares.append(np.mean([g not in worn for g in called]) if called else 0.0)
        assert {*worn} <= {*called}
    assert np.mean(shares) < RATE + 2 * np.std(shares) / 20


def test_what_is_ruled_out_failed_or_alone_is_not_compared():
    values, errors = np.full(5, 1.0), np.full(5, 0.1)
    some = fleet(values, errors)
    assert spreads(some[:3]) == []
    out = entry("out", 9.0, 0.1, verdict="do not use")
    lost = entry("lost", 9.0, 0.1, status="broken.csv: it is empty.")
    (found,) = spreads([*some, out, lost])
    assert (found.groups, found.differing, found.between) == (5, (), 0.0)


def course(values: np.ndarray, errors: np.ndarray) -> list[Entry]:
    return [
        entry("drive", v, e, start=60.0 * i, end=60.0 * (i + 1))
        for i, (v, e) in enumerate(zip(values, errors))
    ]


def test_a_step_is_found_where_it_is_also_among_errors_of_all_sizes():
    rng = np.random.default_rng(4)
    for _ in range(30):
        errors = rng.uniform(0.005, 0.05, 40)
        truth = np.where(np.arange(40) < 25, 1.0, 0.8)
        values = truth + errors * rng.standard_normal(40)
        found = changes(reversed(course(values, errors)))
        assert len(found) in (1, 2)
        best = max(found, key=lambda step: abs(step.before - step.after))
        assert abs(best.time / 60 - 25) <= 1
        assert (best.before, best.after) == pytest.approx((1.0, 0.8), abs=0.03)


def test_a_course_without_a_step_has_none_but_in_one_of_a_hundred():
    rng, found = np.random.default_rng(5), 0
    for _ in range(400):
        errors = rng.uniform(0.005, 0.05, 30)
        found += bool(changes(course(20000 + errors * rng.standard_normal(30), errors)))
    assert found <= 12


def test_values_without_a_finite_interval_of_some_width_are_compared_with_none():
    rng = np.random.default_rng(7)
    errors = np.full(12, 0.1)
    usual = fleet(1 + errors * rng.standard_normal(12), errors)
    (found,) = spreads(usual)
    nothing = entry("nan", 1.0, 0.1)._replace(low95=float("nan"))
    exact = entry("exact", 1.0, 1e-30)
    (again,) = spreads([*usual, nothing, exact])
    assert again == found
    assert spreads([exact] * 5) == []
    spans = [entry("a", 1.0, 0.1, start=float(i)) for i in range(8)]
    assert changes([*spans, exact._replace(group="a"), nothing._replace(group="a")]) == []
