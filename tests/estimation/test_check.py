import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

from riecjax.criteria.criterion import DOLS, RIEC
from riecjax.criteria.test_functions import Hat
from riecjax.criteria.windows import RandomWindows
from riecjax.equations.equation import Equation
from riecjax.equations.expressions import constant
from riecjax.equations.term import Term
from riecjax.errors import MissingSignalError
from riecjax.estimation.check import check
from riecjax.estimation.excitation import excitation, noise_level
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
    (found,) = excitation(equation("a", "b"), record, DOLS())
    (expected,) = scipy.linalg.subspace_angles(a[:, None], b[:, None])
    np.testing.assert_allclose(found.own_share, np.sin(expected), rtol=1e-6)


@pytest.mark.parametrize("level", [1e-4, 0.1])
def test_noise_is_told_from_smooth_motion(level):
    t = np.arange(5000) / 200
    smooth = np.sin(9 * t) + np.cos(21 * t)
    noise = level * np.random.default_rng(0).normal(size=5000)
    assert float(noise_level(jnp.asarray(smooth + noise))) == pytest.approx(level, rel=0.05)
    assert float(noise_level(jnp.asarray(smooth))) < 1e-6


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
    record = record_of(a=np.sin(3 * t), b=np.cos(7 * t), y=np.sin(3 * t))
    found = check(equation("a", "b"), record, CRITERION, key=KEY)
    assert found.findings == []
    assert found.signals == ("a", "b", "y")


def test_a_silent_regressor_is_named():
    record = record_of(b=np.zeros(4000))
    found = check(equation("a", "b"), record, DOLS())
    assert [f.code for f in found.findings] == ["constant_signal", "not_excited"]
    assert "c_b" in found.findings[1].message


def test_coarse_sampling_is_measured_on_the_integrals_themselves():
    """Ten samples per period: the trapezoid loses pi^2 / (3 n^2) = 3.3 % of the area."""
    t = np.arange(4000) * 0.02
    x = np.sin(2 * np.pi * 5 * t)
    record = Record.from_samples({"x": x, "v": np.cos(2 * np.pi * 5 * t), "y": x}, time_step=0.02)
    model = Equation(Term("k", "x"), Term("m", "v"), -Term(1.0, "y"))
    found = check(model, record, CRITERION, key=KEY)
    (finding,) = [f for f in found.findings if f.code == "coarse_sampling"]
    assert "3.3 % off" in finding.message
    finer = check(model, record, RIEC(CRITERION.windows, Hat(8)), key=KEY)
    assert "coarse_sampling" not in [f.code for f in finer.findings]


def test_windows_of_few_samples_and_short_records_are_told():
    record = record_of(count=200)
    found = check(equation("a", "b"), record, RIEC(RandomWindows(0.02, 0.5, 500)), key=KEY)
    codes = [f.code for f in found.findings]
    assert {"short_windows", "short_record"} <= set(codes)


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
