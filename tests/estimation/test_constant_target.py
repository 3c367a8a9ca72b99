"""An oscillator m x'' + c x' + k x = F in closed form, under forces that vary, or hardly do."""

import jax.numpy as jnp
import numpy as np
import pytest

import riecjax as rx
from nightly import nightly
from riecjax.equations.model import as_model
from riecjax.estimation.constant_target import target_findings
from riecjax.estimation.parameters import plan_parameters

M, C, K, FORCE = 2.0, 3.0, 80.0, 40.0
RATE = 100
TIME = np.arange(2000) / RATE
HATS = rx.RIEC(rx.AllWindows(0.1, 0.8), rx.Hat())

INERTIA = rx.Term("m", "x", derivative=2, measured=("v", "a"))
DAMPER = rx.Term("c", "x", derivative=1, measured=("v",))
SPRING, OFFSET, INPUT = rx.Term("k", "x"), rx.Term("offset", rx.constant), rx.Term(-1.0, "F")
AXIS = rx.Equation(INERTIA, DAMPER, SPRING, INPUT, name="axis")
WITH_OFFSET = rx.Equation(INERTIA, DAMPER, SPRING, OFFSET, INPUT, name="axis")
CURVE = rx.Equation(
    INERTIA, DAMPER, rx.Terms("f", rx.roof([0.0, 0.3, 0.6, 1]), "x"), INPUT, name="axis"
)


def ringing(t, amplitude):
    """Free motion, zero before t = 0: position, velocity, acceleration."""
    root = np.roots([M, C, K])[0]
    # From rest at -amplitude.
    z = -amplitude / (1 - root / np.conj(root))
    free = [2 * np.real(z * root**n * np.exp(root * np.maximum(t, 0))) for n in range(3)]
    return np.where(t < 0, 0.0, free)


def stepped(start):
    """A step of the force, from rest."""
    position, velocity, acceleration = ringing(TIME - start, FORCE / K)
    on = start <= TIME
    return position + on * FORCE / K, velocity, acceleration, FORCE * on


def swaying(share, frequency=0.8):
    """A force that varies by a share of its mean, with its steady response."""
    w = 2 * np.pi * frequency
    z = share * FORCE / (K - M * w**2 + 1j * C * w)
    x, v, a = (np.imag(z * (1j * w) ** n * np.exp(1j * w * TIME)) for n in range(3))
    return x + FORCE / K, v, a, FORCE * (1 + share * np.sin(w * TIME))


def record(motion, noise=0.0, mean=0.0, seed=0):
    rng = np.random.default_rng(seed)
    x, v, a, force = motion
    signals = {"x": x + mean, "v": v, "a": a, "F": force}
    sizes = {"x": np.ptp(x), "v": np.std(v), "a": np.std(a), "F": FORCE}
    disturbed = {n: s + noise * sizes[n] * rng.normal(size=s.size) for n, s in signals.items()}
    return rx.Record.from_samples(disturbed, time_step=1 / RATE)


def findings(model, records, criterion=HATS, **settings):
    records = records if isinstance(records, list) else [records]
    model = as_model(model)
    sums = rx.summarise(model, records, criterion)
    given = {"known": None, "per_record": (), **settings}
    asked = plan_parameters(model, len(records), given["known"], given["per_record"])
    found = target_findings(model, asked, sums)
    return [finding for finding in found if finding.code == "constant_target"]


HUM = FORCE * (1 + 0.02 * np.sin(2 * np.pi * 49 * TIME))
NOTHING_TOLD = {
    "a step before the record, beside an offset": (WITH_OFFSET, stepped(0), 0.0, "offset"),
    "with hum": (WITH_OFFSET, (*stepped(0)[:3], HUM), 0.0, "offset"),
    "a position with a large mean": (AXIS, stepped(0), 20.0, "k"),
    "a curve, which can be level": (CURVE, stepped(0), 0.0, "f_1, f_2, f_3, f_4"),
}


@pytest.mark.raises_finding("constant_target")
@pytest.mark.parametrize("criterion", [HATS, rx.DOLS()])
@pytest.mark.parametrize("noise", [0.02, *nightly([0.0])])
@pytest.mark.parametrize("case", NOTHING_TOLD)
def test_a_constant_force_that_one_term_reproduces(case, noise, criterion):
    model, motion, mean, alone = NOTHING_TOLD[case]
    (finding,) = findings(model, record(motion, noise, mean), criterion)
    assert finding.code == "constant_target"
    assert f"so {alone} alone explain" in finding.message
    assert f"--set {alone.partition(',')[0]}=VALUE" in finding.message


ANSWERABLE = {
    "a step in the middle": (WITH_OFFSET, stepped(9.0), {}),
    "a step before the record, from rest, without an offset": (AXIS, stepped(0), {}),
    "a known stiffness": (WITH_OFFSET, stepped(0), {"k": K}),
    "a force that varies by 5 %, beside an offset": (WITH_OFFSET, swaying(0.05), {}),
    "a force that varies by 5 %, beside a curve": (CURVE, swaying(0.05), {}),
    "no force, a known mass": (WITH_OFFSET, (*ringing(TIME, 0.5), 0 * TIME), {"m": M}),
}


@pytest.mark.parametrize("criterion", [HATS, rx.DOLS()])
@pytest.mark.parametrize("noise", [0.01, *nightly([0.0])])
@pytest.mark.parametrize("case", ANSWERABLE)
def test_what_motion_explains_is_an_answer(case, noise, criterion):
    model, motion, known = ANSWERABLE[case]
    assert not findings(model, record(motion, noise), criterion, known=known)


def test_loads_that_differ_between_records_tell_the_stiffness():
    x, v, a, force = stepped(0)
    half = [record((0.5 * x, 0.5 * v, 0.5 * a, 0.5 * force)), record((x, v, a, force))]
    assert not findings(WITH_OFFSET, half)
    # An offset for each record takes that away again.
    (finding,) = findings(WITH_OFFSET, half, per_record=("offset",))
    assert "so offset[1], offset[2] alone explain" in finding.message


def test_what_is_known_joins_the_target():
    x, v, a, _ = swaying(0.05)
    accelerated = record((x, v, a, FORCE + M * a), noise=0.001)
    assert not findings(WITH_OFFSET, accelerated)
    for known in (M, 1.001 * M):
        (finding,) = findings(WITH_OFFSET, accelerated, known={"m": known})
        assert "so offset alone explain" in finding.message


def test_gaps_are_left_out_and_identify_refuses_too():
    motion = stepped(9.0)
    lost = record((*motion[:3], np.where(TIME < 9.5, np.nan, motion[3])))
    assert findings(WITH_OFFSET, lost)
    with pytest.raises(rx.IdentifiabilityError, match="a ratio of two constants") as refused:
        rx.identify(AXIS, record(stepped(0), mean=800.0), HATS, intervals=rx.Naive())
    assert refused.value.code == "constant_target"


@pytest.mark.slow
def test_a_force_that_is_zero_throughout_tells_nothing():
    motion = (*swaying(0.5)[:3], 0 * TIME)
    with pytest.raises(
        rx.IdentifiabilityError, match="zero for all of m, c, k would fit"
    ) as refused:
        rx.identify(
            AXIS, record(motion, noise=0.01).with_signals({"F": jnp.asarray(0 * TIME)}), HATS
        )
    assert refused.value.code == "constant_target"
    # What a second equation knows of k is enough; one that knows nothing either is not.
    spring = rx.Equation(rx.Term("k", "x"), rx.Term(-1.0, "F2"), name="spring")
    both = record(motion).with_signals({"F2": jnp.asarray(K * motion[0])})
    assert not findings(rx.simultaneous(AXIS, spring), both)
    neither = both.with_signals({"F2": jnp.asarray(0 * TIME)})
    assert len(findings(rx.simultaneous(AXIS, spring), neither)) == 2


def two_tones(share):
    """A force that varies at two frequencies, which tell inertia from stiffness."""
    slow, fast = (np.stack(swaying(share / 2, frequency)) for frequency in (0.4, 1.3))
    return slow + fast - np.array([FORCE / K, 0, 0, FORCE])[:, None]


@pytest.mark.parametrize("criterion", [HATS, rx.DOLS()])
@pytest.mark.parametrize(("share", "noise"), [(0.01, 0.001), *nightly([(0.05, 0.0)])])
def test_means_that_disagree_with_the_motion_are_a_sensor_s_zero(share, noise, criterion):
    motion = two_tones(share)
    shifted = record(motion, noise * share, mean=2 * FORCE / K)
    (finding,) = findings(AXIS, shifted, criterion)
    assert "the constant parts disagree with the motion" in finding.message
    assert not findings(AXIS, record(motion, noise * share), criterion)
    assert not findings(WITH_OFFSET, shifted, criterion)
    # A parameter alone hides none.
    assert not findings(rx.Equation(SPRING, INPUT), shifted, criterion)
