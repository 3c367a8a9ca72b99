"""Recorded derivatives, v of x or x3 - x4 of x2, of which one signal is faulty.

Motions are sums of sines, exact at any time, so that what each fault does to them is, too.
"""

import dataclasses
import itertools
from collections.abc import Callable, Mapping

import numpy as np
import pytest
import scipy.integrate
import scipy.signal

import riecjax as rx
from riecjax.doubts import align
from riecjax.doubts.kinematics import Compared, check_kinematics, compare, implied
from riecjax.equations.expressions import relation_of
from riecjax.records.preparation.steps import undone
from riecjax.records.relations import Relation, declared_pairs

STEP, COUNT = 0.005, 6000
TIME = STEP * np.arange(COUNT)
PLAIN = Relation("x", (("v", 1.0),))
SUM = Relation("x2", (("x3", 1.0), ("x4", -1.0)))
NOISE = (0.0, 0.01, 0.05)
mark = pytest.mark


class Motion:
    """Thirty random tones up to `highest` in Hz: of x and v, or of wheel and body and between."""

    def __init__(self, relation: Relation, seed: int = 0, highest: float = 8.0):
        rng = np.random.default_rng(seed)
        self.omega = 2 * np.pi * rng.uniform(0.1, highest, 30)
        waves = rng.normal(size=(2, 30)) * np.exp(2j * np.pi * rng.uniform(size=(2, 30)))
        rates = (waves[0], waves[1] / (1 + (self.omega / 15) ** 2))
        self.waves = dict(zip(relation.terms, rates))
        total = sum((c * self.waves[name] for name, c in relation.of), np.zeros(30))
        self.waves[relation.signal] = total / (1j * self.omega)

    def at(self, name: str, time: np.ndarray, lag: float = 0.0) -> np.ndarray:
        """A signal behind a low-pass with this time constant."""
        waves = self.waves[name] / (1 + 1j * self.omega * lag)
        return np.real(np.exp(1j * np.outer(time, self.omega)) @ waves)


def recorded(
    motion: Motion,
    noise: float = 0.01,
    count: int = COUNT,
    seed: int = 0,
    faulty: Mapping[str, np.ndarray] | None = None,
) -> rx.Record:
    rng, columns = np.random.default_rng(100 + seed), {}
    for name in motion.waves:
        clean = motion.at(name, TIME[:count])
        values = clean if faulty is None or name not in faulty else faulty[name][:count]
        columns[name] = values + noise * np.std(clean) * rng.standard_normal(count)
    return rx.Record.from_samples(columns, time_step=STEP)


@mark.no_finding("late_signal", "low_passed", "wrong_gain", "velocity_offset", "drifting_signal")
@mark.no_finding("lost_rows", "two_clocks", "not_its_derivative")
@pytest.mark.parametrize("noise", NOISE)
@pytest.mark.parametrize("relation", [PLAIN, SUM], ids=["plain", "sum"])
def test_what_fits_raises_no_alarm(relation, noise):
    for seed, highest, count in itertools.product(range(3), (0.7, 4.0, 15.0), (200, COUNT)):
        record = recorded(Motion(relation, seed, highest), noise, count, seed)
        assert check_kinematics(record, [relation]) == []


LOST = np.where(TIME < 13, TIME, TIME + 3 * STEP)
FAULTS: dict[str, tuple[pytest.MarkDecorator, Callable[[Motion, str], np.ndarray]]] = {
    "late": (mark.raises_finding("late_signal"), lambda m, n: m.at(n, TIME - 0.7 * STEP)),
    "filtered": (mark.raises_finding("low_passed"), lambda m, n: m.at(n, TIME, 4 * STEP)),
    "3 % too large": (mark.raises_finding("wrong_gain"), lambda m, n: 1.03 * m.at(n, TIME)),
    "turned": (mark.raises_finding("not_its_derivative"), lambda m, n: -m.at(n, TIME)),
    "in km/h": (mark.raises_finding("not_its_derivative"), lambda m, n: 3.6 * m.at(n, TIME)),
    "offset": (
        mark.raises_finding("velocity_offset"),
        lambda m, n: m.at(n, TIME) + 0.1 * m.at(n, TIME).std(),
    ),
    "drift": (
        mark.raises_finding("drifting_signal"),
        lambda m, n: m.at(n, TIME) + 0.2 * m.at(n, TIME).std() * (TIME / TIME[-1] - 0.5),
    ),
    "rows lost": (mark.raises_finding("lost_rows"), lambda m, n: m.at(n, LOST)),
    "other clock": (mark.raises_finding("two_clocks"), lambda m, n: m.at(n, TIME * (1 - 200e-6))),
    "other clock that began earlier": (
        mark.raises_finding("two_clocks"),
        lambda m, n: m.at(n, TIME * (1 - 200e-6) - 2 * STEP),
    ),
}
CASES = [
    (relation, name, fault)
    for relation in (PLAIN, SUM)
    for name in relation.names
    for fault in FAULTS
    # An offset of what is differentiated is none; of a plain pair no sign or unit says whose it is;
    # of three signals what changes along the record is told of the terms.
    if not (fault in ("offset", "drift") and name == relation.signal)
    and not (fault in ("turned", "in km/h") and relation is PLAIN)
    and not (name == "x2" and fault.startswith(("filtered", "rows", "other")))
]


@pytest.mark.parametrize(
    ("relation", "name", "fault"),
    [pytest.param(*case, marks=FAULTS[case[2]][0], id="-".join(case[1:])) for case in CASES],
)
def test_a_fault_is_named_and_undone_by_what_is_proposed(relation, name, fault):
    (code,), act = FAULTS[fault][0].args, FAULTS[fault][1]
    motion = Motion(relation, 3, 8.0 if relation is PLAIN else 15.0)
    record = recorded(motion, faulty={name: act(motion, name)})
    (finding,) = check_kinematics(record, [relation])
    assert finding.code == code
    assert name in finding.signals
    if code in ("late_signal", "low_passed") or (relation is SUM and "gain" in code):
        assert finding.signals == (name,)
    assert 0 < finding.doubt <= 1
    assert [f.code for f in check_kinematics(undone(record, [finding.remedy]), [relation])] == []
    if code == "late_signal":
        aligned = align(record, [relation])
        assert [found.signals for found in aligned.findings] == [(name,)]
        assert check_kinematics(aligned.record, [relation]) == []


def compared(record: rx.Record, relation: Relation = PLAIN) -> Compared:
    pair = compare(record, relation)
    assert pair is not None
    return pair


def late(delay: float, noise: float, **more) -> rx.Record:
    motion = Motion(PLAIN, 1, 4.0)
    return recorded(motion, noise, faulty={"v": motion.at("v", TIME - delay * STEP)}, **more)


@pytest.mark.parametrize(("noise", "within"), [(0.0, 1e-4), (0.01, 0.05), (0.05, 0.25)])
@pytest.mark.parametrize("delay", [-1.7, 0.3, 1.0, 12.4])
def test_a_delay_is_found_to_a_part_of_a_sample(noise, within, delay):
    pair = compared(late(delay, noise))
    (name,) = pair.late
    assert name == ("v" if delay > 0 else "x")
    assert pair.late[name].samples == pytest.approx(abs(delay), abs=within)
    assert pair.sizes is not None
    assert pair.sizes["v"].value == pytest.approx(1, abs=0.01)
    assert not pair.late[name].low_passed


def test_a_delay_too_long_for_a_short_record_ends_nothing():
    for delay in (3.0, 4.0, 6.0):
        for count in range(50, 130, 3):
            check_kinematics(late(delay, 0.01, count=count), [PLAIN])


@pytest.mark.parametrize("seed", range(3))
def test_several_faults_of_a_sum_are_told_apart(seed):
    motion = Motion(SUM, seed)
    late = {n: motion.at(n, TIME - by * STEP) for n, by in (("x3", 3), ("x4", 6))}
    pair = compared(recorded(motion, faulty=late, seed=seed), SUM)
    times = {name: pair.late[name].samples if name in pair.late else 0.0 for name in SUM.names}
    # Of what all have in common a relation knows nothing.
    assert times["x3"] - times["x2"] == pytest.approx(3, abs=0.5)
    assert times["x4"] - times["x2"] == pytest.approx(6, abs=0.5)
    x4 = motion.at("x4", TIME)
    both = {"x3": late["x3"], "x4": x4 + 0.3 * np.std(x4)}
    pair = compared(recorded(motion, faulty=both, seed=seed), SUM)
    assert pair.late["x3"].samples == pytest.approx(3, abs=0.1)
    assert {one.code for one in pair.found} == {"late_signal", "velocity_offset"}
    assert all(one.remedy for one in pair.found)


def test_errors_are_what_delays_and_gains_scatter_by():
    pairs = [compared(late(2.4, 0.05, seed=seed, count=2000)) for seed in range(40)]
    delays, sizes = ([getattr(pair, of)["v"] for pair in pairs] for of in ("late", "sizes"))
    for values, truth, errors in (
        ([one.size for one in delays], 2.4 * STEP, [one.error for one in delays]),
        ([one.value for one in sizes], 1.0, [one.error for one in sizes]),
    ):
        scores = (np.array(values) - truth) / errors
        assert 0.7 < np.sqrt(np.mean(scores**2)) < 1.3
        assert abs(np.mean(scores)) < 0.5


def test_gaps_and_spikes_hide_no_delay():
    record = late(0.5, 0.01)
    x, v = (np.array(record[name]) for name in "xv")
    x[::97] = np.nan
    v[1000:1300] = np.nan
    v[[50, 3000, 3001]] = 1e9, -1e300, -1e300
    x[4000] = 1e15
    holed = rx.Record.from_samples({"x": x, "v": v}, time_step=STEP)
    assert compared(holed).late["v"].samples == pytest.approx(0.5, abs=0.05)


FEW = np.arange(33)


@pytest.mark.parametrize(
    ("x", "v"),
    [
        (np.ones(500), np.zeros(500)),
        (np.r_[np.full(400, np.nan), np.ones(100)], np.ones(500)),
        (1e300 * np.sin(0.1 * np.arange(500)), 1e300 * np.cos(0.1 * np.arange(500))),
        (1e-300 * np.sin(0.1 * np.arange(500)), 1e-300 * np.cos(0.1 * np.arange(500))),
        (np.sin(0.1 * np.arange(500)), np.full(500, 1e308)),
        (np.arange(20.0), np.ones(20)),
        (np.arange(500.0), np.ones(500)),
        # Windows too few to give an error.
        (np.sin(FEW / 10), 11 * np.cos(FEW / 10) + 0.1 + 0.05 * np.sin(FEW**2)),
    ],
)
def test_nothing_breaks_it(x, v):
    record = rx.Record.from_samples({"x": x, "v": v}, time_step=STEP)
    for finding in check_kinematics(record, [("x", "v"), ("v", "x")]):
        assert {*finding.signals} <= {"x", "v"}
        assert 0 < finding.doubt <= 1


def test_what_was_computed_from_the_signal_is_not_compared():
    one = rx.Noise({"x": {"x": np.ones(1)}, "v": {"x": np.array([0.5, 0.0, -0.5])}})
    assert check_kinematics(late(1.0, 0.01).with_noise(one), [("x", "v")]) == []


@mark.no_finding("wrong_gain", "late_signal")
@pytest.mark.parametrize("is_held", [True, False])
def test_what_moves_between_samples_is_not_integrated(is_held):
    """A road that is held between samples, or goes on straight lines on which a wheel follows."""
    rng, memory = np.random.default_rng(0), 0.0 if is_held else 0.85
    road = np.asarray(scipy.signal.lfilter([1.0], [1.0, -memory], rng.standard_normal(COUNT)))
    fine = np.interp(np.arange(8 * COUNT - 7) / 8, np.arange(COUNT), road)
    wheel = np.asarray(scipy.signal.lfilter([0.05], [1.0, -0.95], fine))
    tyre = scipy.integrate.cumulative_simpson(fine - wheel, dx=STEP / 8, initial=0)[::8]
    if is_held:
        tyre = np.concatenate([[0.0], np.cumsum(STEP * (road - wheel[::8]))[:-1]])
    signals = {"x1": tyre, "v_r": road, "x3": wheel[::8]}
    record = rx.Record.from_samples(signals, time_step=STEP)
    assert check_kinematics(record, [Relation("x1", (("v_r", 1.0), ("x3", -1.0)))]) == []


def test_models_declare_relations_by_their_rates():
    pairs = declared_pairs(rx.find_model("quarter-car"))
    assert SUM in pairs
    assert Relation("x1", (("v_r", 1.0), ("x3", -1.0))) in pairs
    equation = rx.Equation(rx.Term("k", "x2"), -rx.Term(1.0, "F"))
    rates = {"x2": rx.difference("x3", "x4"), "x": "v"}
    assert rx.staged(equation).with_rates(rates).derivatives == (SUM, PLAIN)


def names_of(record: rx.Record, model: rx.Model) -> list[str]:
    """Signals that the findings of a check name, late or filtered."""
    findings = rx.check(model, record).findings
    codes = ("low_passed", "late_signal", "velocity_offset")
    return [name for one in findings if one.code in codes for name in one.signals]


@mark.raises_finding("low_passed")
@pytest.mark.parametrize("noise", NOISE)
def test_a_velocity_is_held_against_its_position_whether_a_model_says_so_or_not(noise):
    """v in place of x', once with what says it is and once with nothing."""
    motion = Motion(PLAIN)
    slow = recorded(motion, noise, faulty={"v": motion.at("v", TIME, lag=0.02)})
    force = 2.0 * np.gradient(slow.arrays["v"], STEP) + 300.0 * slow.arrays["x"]
    slow = slow.with_signals({"F": rx.Signal(force)})
    terms = rx.Term("m", "v", derivative=1), rx.Term("k", "x"), -rx.Term(1.0, "F")
    silent = rx.staged(rx.Equation(*terms))
    said = rx.Model(name="rig", summary="", stages=silent.stages, derived={"v": "x"})
    assert names_of(slow, silent) == names_of(slow, said) == ["v"]
    fine = recorded(motion, noise).with_signals({"F": slow.signal("F")})
    # Of two recordings one, for which no option is proposed: how far it moves values is told.
    both = rx.assess(silent, [slow, fine], refine=None, sweep=False, intervals=rx.Sandwich())
    (filtered,) = [one for one in both.findings() if one.code == "low_passed"]
    assert filtered.doubts
    assert not filtered.remedy
    assert names_of(fine, silent) == []
    assert implied(fine, ["F", "v", "x"], []) == [PLAIN]
    assert implied(fine, ["F", "v", "x"], [PLAIN]) == []


@pytest.mark.parametrize(("units", "seen"), [(("m", "m/s"), [PLAIN]), (("m", "N"), [])])
def test_no_force_is_a_derivative(units, seen):
    record = recorded(Motion(PLAIN))
    with_units = dict(zip(("x", "v"), units))
    signals = {n: dataclasses.replace(record.signal(n), unit=u) for n, u in with_units.items()}
    assert implied(record.with_signals(signals), ["v", "x"], []) == seen


@pytest.mark.parametrize(
    "rate",
    [
        lambda s: s["a"] * s["b"],
        lambda s: s["a"] + 1.0,
        lambda s: 1.0,
        lambda s: s["a"].missing,
        rx.equations.faster_than("a", 0.5),
    ],
)
def test_what_is_no_sum_is_no_relation(rate):
    assert relation_of("x", rate) is None
