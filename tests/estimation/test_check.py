import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

from nightly import nightly
from riecjax.criteria.criterion import DOLS, RIEC
from riecjax.criteria.test_functions import Boxcar, Bump, Hat
from riecjax.criteria.windows import AllWindows, RandomWindows
from riecjax.equations.equation import Equation
from riecjax.equations.term import Term, Terms, constant, roof
from riecjax.errors import DataError, IdentifiabilityError, MissingSignalError
from riecjax.estimation.check import check
from riecjax.estimation.identify import identify
from riecjax.records.record import Record

KEY = jax.random.key(0)
CRITERION = RIEC(RandomWindows(0.1, 0.5, 3000))


def equation(*names):
    terms = [Term(f"c_{name}", name) for name in names]
    return Equation(*terms, -Term(1.0, "y"), name="law")


def record_of(seed=0, count=4000, **more):
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(2, count))
    return Record.from_samples({"a": a, "b": b, "y": a + 2 * b, **more}, time_step=0.01)


@pytest.mark.parametrize("angle", [0.02, 0.3, 1.2])
def test_own_share_is_the_sine_of_the_angle_to_the_other_regressors(angle):
    rng = np.random.default_rng(1)
    basis, _ = np.linalg.qr(rng.normal(size=(4000, 2)))
    a, b = basis[:, 0], np.cos(angle) * basis[:, 0] + np.sin(angle) * basis[:, 1]
    record = record_of(a=a, b=b)
    (found,) = check(equation("a", "b"), record, DOLS()).excitations
    (expected,) = scipy.linalg.subspace_angles(a[:, None], b[:, None])
    np.testing.assert_allclose(found.own_share, np.sin(expected), rtol=1e-6)


def test_what_differs_only_by_noise_is_unidentifiable():
    t = np.arange(4000) / 200
    motion = np.sin(5 * t)
    rng = np.random.default_rng(0)
    a, b = motion + 1e-3 * rng.normal(size=(2, 4000))
    found = check(equation("a", "b"), record_of(a=a, b=b), CRITERION, key=KEY)
    (finding,) = [f for f in found.findings if f.code == "unidentifiable"]
    assert "noise" in finding.message
    assert "0.71 c_a - 0.71 c_b" in finding.message
    assert not found.answerable


@pytest.mark.raises_finding("nearly_collinear")
def test_what_differs_little_but_truly_is_nearly_collinear():
    t = np.arange(4000) / 200
    motion = np.sin(5 * t)
    record = record_of(a=motion, b=motion + 1e-2 * np.cos(3 * t), y=motion)
    found = check(equation("a", "b"), record, CRITERION, key=KEY)
    codes = [finding.code for finding in found.findings]
    assert "nearly_collinear" in codes
    assert found.answerable


def test_independent_regressors_are_not_complained_of():
    t = np.arange(4000) / 200
    record = record_of(a=np.sin(3 * t), b=np.cos(7 * t), y=np.sin(3 * t) + np.cos(7 * t))
    found = check(equation("a", "b"), record, CRITERION, key=KEY)
    assert found.findings == []
    assert found.signals == ("a", "b", "y")


def test_what_a_fit_refuses_before_it_solves_a_check_refuses_too():
    never_whole = record_of(a=np.where(np.arange(4000) % 9, 1.0, np.nan))
    infinite = record_of(a=np.full(4000, 1e200))
    for record, words in ((never_whole, "every window touches"), (infinite, "not finite")):
        for verb in (check, identify):
            with pytest.raises(DataError, match=words):
                verb(equation("a", "b"), record, CRITERION, key=KEY)


@pytest.mark.parametrize(
    ("points", "expected"),
    [
        ([-1, -0.3, 0.3, 1], []),
        pytest.param(
            [-1, -0.3, 0.3, 9], ["9"], marks=pytest.mark.raises_finding("break_points_outside")
        ),
        ([-9, 9], []),
    ],
)
def test_break_points_that_no_sample_comes_near_are_named(points, expected):
    t = np.arange(4000) / 200
    v = np.sin(3 * t)
    record = record_of(a=v, y=np.tanh(v))
    found = check(Equation(Terms("f", roof(points), "a"), -Term(1.0, "y")), record, DOLS())
    named = [f.message for f in found.findings if f.code == "break_points_outside"]
    assert len(named) == len(expected)
    assert all(f"at {point}" in message for point, message in zip(expected, named))


@pytest.mark.raises_finding("not_excited", "constant_signal")
def test_a_silent_regressor_is_named():
    record = record_of(b=np.zeros(4000))
    found = check(equation("a", "b"), record, DOLS())
    assert [f.code for f in found.findings] == ["constant_signal", "not_excited"]
    assert "c_b" in found.findings[1].message
    with pytest.raises(IdentifiabilityError) as refused:
        identify(equation("a", "b"), record, DOLS())
    assert (refused.value.code, str(refused.value)) == tuple(found.findings[1])[:2]


@pytest.mark.raises_finding("coarse_sampling")
def test_coarse_sampling_is_measured_on_the_integrals_themselves():
    """Ten samples per period: the trapezoid loses pi^2 / (3 n^2) = 3.3 % of the area."""
    t = np.arange(4000) * 0.02
    x = np.sin(2 * np.pi * 5 * t)
    record = Record.from_samples({"x": x, "v": np.cos(2 * np.pi * 5 * t), "y": x}, time_step=0.02)
    model = Equation(Term("k", "x"), Term("m", "v"), -Term(1.0, "y"))
    found = check(model, record, RIEC(CRITERION.windows, Boxcar(2)), key=KEY)
    (finding,) = [f for f in found.findings if f.code == "coarse_sampling"]
    assert "3.3 % off" in finding.message
    finer = check(model, record, RIEC(CRITERION.windows, Hat(8)), key=KEY)
    assert "coarse_sampling" not in [f.code for f in finer.findings]


@pytest.mark.raises_finding("short_windows", "short_record")
def test_windows_of_few_samples_and_short_records_are_told():
    record = record_of(count=200)
    found = check(equation("a", "b"), record, RIEC(RandomWindows(0.02, 0.5, 500)), key=KEY)
    codes = [f.code for f in found.findings]
    assert {"short_windows", "short_record"} <= set(codes)


@pytest.mark.parametrize(("samples", "told"), [(6, True), *nightly([(14, False)])])
def test_a_bump_needs_more_samples_than_a_boxcar(samples, told):
    """Of 6 samples its second derivative is 11 % off for a parabola."""
    windows = AllWindows(samples * 0.01, 1.0)
    time = 0.01 * np.arange(4000)
    record = record_of(x=np.sin(7 * time) + np.sin(3 * time), u=np.cos(10 * time))
    oscillator = Equation(Term("m", "x", derivative=2), Term("k", "x"), -Term(1.0, "u"))
    for criterion, expected in ((RIEC(windows, Bump()), told), (RIEC(windows, Hat()), False)):
        codes = [f.code for f in check(oscillator, record, criterion).findings]
        assert ("short_windows" in codes) == expected


def test_only_what_is_read_is_looked_at():
    record = record_of(other=np.zeros(4000))
    assert check(equation("a", "b"), record, DOLS()).findings == []
    with pytest.raises(MissingSignalError, match="no signal 'c'"):
        check(equation("a", "c"), record, DOLS())


def test_findings_of_several_records_say_which():
    dead = record_of(seed=1, b=np.zeros(4000))
    found = check(equation("a", "b"), [record_of(), dead], DOLS())
    assert [f.message.partition(":")[0] for f in found.findings] == ["record 2"]


def test_a_constant_beside_a_resting_signal_is_the_null_direction():
    still = record_of(a=np.full(4000, 0.3), b=np.random.default_rng(3).normal(size=4000))
    model = Equation(Term("k", "a"), Term("offset", constant), Term("c", "b"), -Term(1.0, "y"))
    found = check(model, still, CRITERION, key=KEY)
    (finding,) = [f for f in found.findings if f.code == "unidentifiable"]
    assert "0.71 k - 0.71 offset" in finding.message


@pytest.mark.parametrize("held", ["clipped", "stuck_sensor"])
def test_a_velocity_that_is_held_is_not_said_to_have_a_wrong_gain(held):
    t = np.arange(8000) / 200
    phases = np.random.default_rng(2).uniform(0, 2 * np.pi, 12)
    omega = 2 * np.pi * np.linspace(0.3, 3, 12)[:, None]
    x = np.sum(np.sin(omega * t + phases[:, None]), axis=0)
    v = np.sum(omega * np.cos(omega * t + phases[:, None]), axis=0)
    if held == "clipped":
        v = np.clip(v, *(0.7 * np.max(np.abs(v)) * np.array([-1, 1])))
    else:
        v[5000:6000] = v[5000]
    law = Equation(
        Term("c", "x", derivative=1, measured=("v",)),
        Term("c2", lambda signals: signals["v"] * jnp.abs(signals["v"])),
        -Term(1.0, "F"),
    )
    record = Record.from_samples({"x": x, "v": v, "F": 20 * x + 3 * v}, time_step=0.005)
    codes = {finding.code for finding in check(law, record, RIEC(AllWindows(0.05, 0.5))).findings}
    assert held in codes
    assert "wrong_gain" not in codes


@pytest.mark.raises_finding("two_clocks")
def test_what_one_of_several_recordings_needs_is_proposed_for_none_of_the_others():
    time, omega = 0.005 * np.arange(6000), np.linspace(2, 15, 25)
    phase = np.random.default_rng(3).uniform(0, 6.3, 25)

    def motion(at, order):
        return np.cos(np.outer(at, omega) + phase + 0.5 * np.pi * order) @ omega**order

    def recorded(ppm):
        late = time * (1 - 1e-6 * ppm)
        signals = {"x": motion(time, 0), "v": motion(late, 1), "F": motion(time, 2)}
        return Record.from_samples(signals, time_step=0.005)

    own = Term("m", "x", derivative=2, measured=("v",)), Term("k", "x")
    mass = Equation(*own, -Term(1.0, "F"))
    for others, proposed in ((0.0, ()), (300.0, ("--clock",))):
        found = check(mass, [recorded(300.0), recorded(others)]).findings
        first = next(f for f in found if f.code == "two_clocks")
        assert first.remedy[:1] == proposed
        assert first.step.endswith("in record 1 alone") == (not proposed)
