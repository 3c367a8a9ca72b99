from functools import partial

import jax
import numpy as np
import pytest

import riecjax as rx

fit = partial(rx.identify, intervals=rx.Naive())
"""No test here asks for intervals."""

EQUATION = rx.Equation(
    rx.Term("M", "q", derivative=2, measured=("dq", "ddq"), unit="kg"),
    rx.Term("c", "q", derivative=1, measured=("dq",), unit="N s/m"),
    rx.Term("offset", rx.constant, unit="N"),
    -rx.Term(1.0, "force"),
)
OFFSETS = (3.0, -1.5, 0.25)
LENGTHS = (4000, 2500, 3100)


def record(offset, count, phase):
    t = 0.002 * np.arange(count)
    q = np.sin(2 * t + phase) + 0.2 * np.sin(7 * t)
    dq = 2 * np.cos(2 * t + phase) + 1.4 * np.cos(7 * t)
    ddq = -4 * np.sin(2 * t + phase) - 9.8 * np.sin(7 * t)
    force = 12.0 * ddq + 5.0 * dq + offset
    return rx.Record.from_samples({"q": q, "dq": dq, "ddq": ddq, "force": force}, time_step=0.002)


RECORDS = [record(o, n, i) for i, (o, n) in enumerate(zip(OFFSETS, LENGTHS))]
CRITERIA = [rx.DOLS(), rx.RIEC(rx.RandomWindows(0.05, 0.5, 1000), rx.Boxcar(quadrature=4))]
KEY = jax.random.key(0)


@pytest.mark.parametrize("criterion", CRITERIA, ids=["dols", "riec"])
def test_offsets_of_each_record_leave_the_shared_parameters_exact(criterion):
    estimate = fit(EQUATION, RECORDS, criterion, key=KEY, per_record=["offset"])
    assert estimate.parameters == ("M", "c", "offset[1]", "offset[2]", "offset[3]")
    assert float(estimate["M"]) == pytest.approx(12.0, rel=1e-5)
    assert float(estimate["c"]) == pytest.approx(5.0, rel=1e-4)
    for i, offset in enumerate(OFFSETS):
        assert float(estimate[f"offset[{i + 1}]"]) == pytest.approx(offset, abs=1e-3)
    assert dict(estimate.units)["offset[2]"] == "N"


def test_own_offsets_equal_the_dense_solution():
    """One column of ones per record, stacked by hand and solved by NumPy."""
    noisy = [
        r.with_signals({"force": r["force"] + np.random.default_rng(i).normal(size=r.sample_count)})
        for i, r in enumerate(RECORDS)
    ]
    estimate = fit(EQUATION, noisy, rx.DOLS(), per_record=["offset"])
    ones = [np.zeros((r.sample_count, 3)) for r in noisy]
    for i, block in enumerate(ones):
        block[:, i] = 1.0
    columns = [np.column_stack([r["ddq"], r["dq"], block]) for r, block in zip(noisy, ones)]
    expected = np.linalg.lstsq(
        np.vstack(columns), np.concatenate([r["force"] for r in noisy]), rcond=None
    )[0]
    np.testing.assert_allclose(estimate.theta, expected, rtol=1e-9)


def test_own_parameters_may_be_known_all_at_once_or_one_by_one():
    at_once = fit(EQUATION, RECORDS, rx.DOLS(), per_record=["offset"], known={"offset": 1.0})
    assert at_once.parameters == ("M", "c")
    one = fit(EQUATION, RECORDS, rx.DOLS(), per_record=["offset"], known={"offset[2]": OFFSETS[1]})
    assert one.parameters == ("M", "c", "offset[1]", "offset[3]")
    assert float(one["offset[1]"]) == pytest.approx(OFFSETS[0], rel=1e-6)
    # That of one record goes before that of all, in whichever order they are given.
    for known in ({"offset": 1.0, "offset[2]": 5.0}, {"offset[2]": 5.0, "offset": 1.0}):
        both = fit(EQUATION, RECORDS, rx.DOLS(), per_record=["offset"], known=known)
        assert [float(both[f"offset[{i}]"]) for i in (1, 2, 3)] == [1.0, 5.0, 1.0]


def test_names_that_own_parameters_would_collide_with_are_refused():
    equation = rx.Equation(*EQUATION.terms, rx.Term("offset[2]", "q"))
    with pytest.raises(
        rx.ModelError, match=r"called 'offset\[2\]'.*per_record=\['offset'\].*Rename"
    ):
        fit(equation, RECORDS[:2], rx.DOLS(), per_record=["offset"])
    apart = fit(equation, RECORDS[0], rx.DOLS())
    assert float(apart["offset"]) == pytest.approx(OFFSETS[0], rel=1e-6)
    assert float(apart["offset[2]"]) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (dict(per_record=["friction"]), "unknown parameter 'friction'; the model has: M, c, off"),
        (dict(per_record=["offset"], known={"offset[4]": 1.0}), r"unknown parameter 'offset\[4\]'"),
        (dict(known={"offset[1]": 1.0}), r"unknown parameter 'offset\[1\]'"),
    ],
)
def test_unknown_names_are_answered_with_those_that_exist(settings, words):
    with pytest.raises(rx.ModelError, match=words):
        fit(EQUATION, RECORDS, rx.DOLS(), **settings)


@pytest.mark.raises_finding("duplicate_recording")
def test_a_record_that_was_given_twice_is_a_finding():
    found = fit(EQUATION, [RECORDS[0]] * 2, rx.DOLS()).findings()[0]
    assert found.code == "duplicate_recording"
    assert "of record 2, from 0 s on, are those of record 1 from 0 s on" in found.message
