import jax
import numpy as np
import pytest
import scipy.linalg
from tests.machines import MACHINES

from nightly import nightly
from riecjax.criteria.criterion import DOLS, RIEC
from riecjax.criteria.test_functions import Boxcar, Bump, Hat
from riecjax.criteria.windows import AllWindows, RandomWindows
from riecjax.doubts.check import check
from riecjax.equations.bases import roof
from riecjax.equations.equation import Equation
from riecjax.equations.term import Term, Terms
from riecjax.errors import IdentifiabilityError, MissingSignalError
from riecjax.estimation.identify import identify
from riecjax.records.record import Record
from riecjax.uncertainty.intervals import Naive, Sandwich

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


@pytest.mark.raises_finding("nearly_collinear", "unidentifiable")
def test_regressors_are_told_apart_by_more_than_their_noise():
    t = np.arange(4000) / 200
    motion, noise = np.sin(5 * t), 1e-3 * np.random.default_rng(0).normal(size=(2, 4000))
    by_noise = check(
        equation("a", "b"), record_of(**dict(zip("ab", motion + noise))), CRITERION, key=KEY
    )
    (finding,) = [f for f in by_noise.findings if f.code == "unidentifiable"]
    assert "noise" in finding.message
    assert "0.71 c_a - 0.71 c_b" in finding.message
    assert not by_noise.answerable
    truly = record_of(a=motion, b=motion + 1e-2 * np.cos(3 * t), y=motion)
    found = check(equation("a", "b"), truly, CRITERION, key=KEY)
    assert "nearly_collinear" in [finding.code for finding in found.findings]
    assert found.answerable
    record = record_of(a=np.sin(3 * t), b=np.cos(7 * t), y=np.sin(3 * t) + np.cos(7 * t))
    found = check(equation("a", "b"), record, CRITERION, key=KEY)
    assert found.findings == []
    assert found.signals == ("a", "b", "y")


def test_only_what_is_read_is_looked_at_and_findings_say_in_which_record():
    record, dead = record_of(other=np.zeros(4000)), record_of(seed=1, b=np.zeros(4000))
    assert check(equation("a", "b"), record, DOLS()).findings == []
    with pytest.raises(MissingSignalError, match="no signal 'c'"):
        check(equation("a", "c"), record, DOLS())
    found = check(equation("a", "b"), [record, dead], DOLS())
    assert [f.message.partition(":")[0] for f in found.findings] == ["record 2"]


@pytest.mark.raises_finding("break_points_outside")
def test_break_points_that_no_sample_comes_near_are_named():
    v = np.sin(3 * np.arange(4000) / 200)
    record = record_of(a=v, y=np.tanh(v))
    for points, expected in (([-1, -0.3, 0.3, 1], []), ([-1, -0.3, 0.3, 9], [9]), ([-9, 9], [])):
        model = Equation(Terms("f", roof(points), "a"), -Term(1.0, "y"))
        named = [
            f for f in check(model, record, DOLS()).findings if f.code == "break_points_outside"
        ]
        assert len(named) == len(expected)
        assert all(f"at {point}" in f.message for point, f in zip(expected, named))


@pytest.mark.raises_finding("not_excited", "constant_signal")
def test_a_silent_regressor_is_named():
    record = record_of(b=np.zeros(4000))
    found = check(equation("a", "b"), record, DOLS())
    assert [f.code for f in found.findings] == ["constant_signal", "not_excited"]
    assert "c_b" in found.findings[1].message
    with pytest.raises(IdentifiabilityError) as refused:
        identify(equation("a", "b"), record, DOLS(), intervals=Naive())
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
    assert {"short_windows", "short_record"} <= {f.code for f in found.findings}


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


@pytest.mark.parametrize("held", ["clipped", "stuck_sensor"])
def test_a_velocity_that_is_held_is_not_said_to_have_a_wrong_gain(held):
    signals = MACHINES["linear"].signals()
    v = signals["dx"]
    if held == "clipped":
        v = np.clip(v, *(0.6 * np.max(np.abs(v)) * np.array([-1, 1])))
    else:
        v[3000:4000] = v[3000]
    record = Record.from_samples({**signals, "dx": v}, time_step=0.005)
    found = check(MACHINES["linear"].model, record, RIEC(AllWindows(0.05, 0.5)))
    codes = {finding.code for finding in found.findings}
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


def codes_of(truth: float, unit: str, noise: float = 0.01) -> list[str]:
    rng = np.random.default_rng(0)
    a = rng.normal(size=2000)
    signals = {"a": a, "y": truth * a + noise * rng.normal(size=2000)}
    equation = Equation(Term("c", "a", unit=unit), -Term(1.0, "y"))
    record = Record.from_samples(signals, time_step=0.01)
    return [f.code for f in identify(equation, record, DOLS(), intervals=Sandwich()).findings()]


@pytest.mark.raises_finding("negative_value")
@pytest.mark.parametrize("unit", ["kg", "kg m^2", "kg·m²", "N s/m", "N*s/m", "N m s/rad"])
def test_masses_and_dampers_below_zero_are_pointed_out(unit):
    assert codes_of(-2.0, unit) == ["negative_value"]
    assert codes_of(2.0, unit) == []


@pytest.mark.parametrize("unit", ["", "N/m", "N", "1/s", "N m/rad"])
def test_what_may_have_any_sign_is_not(unit):
    assert codes_of(-2.0, unit) == []


@pytest.mark.raises_finding("interval_wider_than_estimate")
def test_what_may_as_well_be_above_zero_is_hardly_determined():
    found = codes_of(-0.001, "kg", noise=1.0)
    assert "interval_wider_than_estimate" in found
    assert "negative_value" not in found
    # A parameter near zero whose term could not matter is left alone.
    record = record_of()
    y = 2 * record["a"] + 0.01 * np.random.default_rng(2).normal(size=4000)
    fit = identify(equation("a", "b"), record.with_signals({"y": y}), DOLS())
    low, high = fit.interval("c_b")
    assert low < 0 < high
    assert fit.findings() == []
