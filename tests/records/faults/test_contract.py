"""Every fault of one signal is named alone, in any unit, and its remedy undoes it."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
from tests.machines import noisy, waves

from riecjax.records.faults.hum import notch
from riecjax.records.faults.signals import check_signals, leave_out
from riecjax.records.faults.spikes import repair_outliers
from riecjax.records.record import Record

STEP, COUNT = 0.005, 4000
TIME = STEP * np.arange(COUNT)


def sound(seed: int = 0) -> dict[str, np.ndarray]:
    """Position, velocity and force: tones up to 4 Hz, with noise of 1 % on each."""
    x, v, a = waves(TIME, seed, 1.0, (0.2, 4.0))
    return noisy({"x": x, "v": v, "u": a + 3 * v + 200 * x}, 0.01, seed)


class Fault(NamedTuple):
    """A fault of the force: its code, what it does, the option against it, and how many samples
    that treats."""

    code: str
    act: Callable[[np.ndarray, dict[str, np.ndarray]], np.ndarray]
    remedy: Callable[[Record], Record] | None = None
    option: str = ""


def at(value: float | None, *stretches: slice) -> Callable:
    """A value, or that of the first sample, in these stretches."""

    def act(u: np.ndarray, others: dict[str, np.ndarray]) -> np.ndarray:
        u = u.copy()
        for stretch in stretches:
            u[stretch] = u[stretch.start] if value is None else value
        return u

    return act


def spiked(u: np.ndarray, others: dict[str, np.ndarray]) -> np.ndarray:
    return u + 2 * u.std() * np.isin(np.arange(COUNT), [500, 1501, 1502, 3003])


HOLES = [slice(k, k + 6) for k in range(150, 3900, 379)]
LEFT_OUT = {"remedy": lambda r: leave_out(r, "u"), "option": "--leave-out"}
FAULTS = {
    "clipped": Fault("clipped", lambda u, _: np.clip(u, -1.5 * u.std(), 1.5 * u.std()), **LEFT_OUT),
    "clipped above": Fault("clipped", lambda u, _: np.minimum(u, 1.7 * u.std()), **LEFT_OUT),
    "stuck": Fault("stuck_sensor", at(None, slice(1000, 1400)), **LEFT_OUT),
    "drops to zero": Fault("stuck_sensor", at(0.0, slice(1000, 1400)), **LEFT_OUT),
    "drops out": Fault("stuck_sensor", at(-9.99, *HOLES), **LEFT_OUT),
    "repeats the last": Fault("stuck_sensor", at(None, *HOLES), **LEFT_OUT),
    "spikes": Fault("outliers", spiked, lambda r: repair_outliers(r, how="missing"), "--outliers"),
    "coarse": Fault("quantised", lambda u, _: 0.1 * u.std() * np.round(10 * u / u.std())),
    "gap": Fault("missing_samples", at(np.nan, slice(1000, 1100))),
    "constant": Fault("constant_signal", lambda u, _: np.full(COUNT, u[0])),
    "copied": Fault("copied_signal", lambda _, others: -2.5 * others["x"]),
    "hum": Fault(
        "hum",
        lambda u, _: u + 0.1 * u.std() * np.sin(2 * np.pi * 50.02 * TIME),
        lambda r: notch(r, 50.0),
        "--notch",
    ),
}
PAIRS = [("x", "v")]


def checked(signals: dict[str, np.ndarray]) -> list:
    return check_signals(Record.from_samples(signals, time_step=STEP), signals, pairs=PAIRS)


CODES = ("clipped", "stuck_sensor", "outliers", "quantised", "missing_samples", "copied_signal")


@pytest.mark.no_finding(*CODES, "constant_signal", "hum")
@pytest.mark.parametrize("seed", range(8))
def test_a_sound_record_shows_none(seed):
    assert checked(sound(seed)) == []


@pytest.mark.parametrize(
    ("name", "seed"),
    [
        pytest.param(name, seed, marks=pytest.mark.raises_finding(fault.code))
        for name, fault in FAULTS.items()
        for seed in range(3)
    ],
)
def test_a_fault_is_named_alone_and_its_remedy_undoes_it(name, seed):
    fault, signals = FAULTS[name], sound(seed)
    faulty = signals | {"u": fault.act(signals["u"], signals)}
    # A limit is told of at either end.
    finding, *others = checked(faulty)
    assert {found.code for found in (finding, *others)} == {fault.code}
    assert "u" in finding.signals
    assert finding.message.split()[0].rstrip(":") in finding.signals
    assert fault.option == next(iter(finding.remedy), "")
    assert bool(finding.remedy) == bool(finding.doubt) or fault.code == "copied_signal"
    if fault.remedy is None:
        return
    record = fault.remedy(Record.from_samples(faulty, time_step=STEP))
    after = [f.code for f in check_signals(record, faulty, pairs=PAIRS)]
    if fault.code == "hum":
        assert after == []
        np.testing.assert_allclose(record["u"], signals["u"], atol=0.03 * signals["u"].std())
        return
    # Samples that say something else than the motion are gone, and no other.
    assert after == ["missing_samples"]
    changed = np.flatnonzero(faulty["u"] != signals["u"])
    gone = np.flatnonzero(np.isnan(record.signal("u").with_nan))
    assert {*changed} <= {*gone}
    assert gone.size <= changed.size + len(HOLES)


@pytest.mark.parametrize(("factor", "offset"), [(-1.0, 0.0), (1e-150, 0.0), (1e140, 0.0), (3, 7)])
@pytest.mark.parametrize("name", FAULTS)
def test_unit_sign_and_offset_do_not_matter(name, factor, offset):
    signals = sound()
    u = FAULTS[name].act(signals["u"], signals)
    changed = {"x": signals["x"], "v": signals["v"], "u": factor * u + offset * u[0]}
    assert {f.code for f in checked(changed)} == {FAULTS[name].code}


@pytest.mark.parametrize("name", FAULTS)
def test_a_gap_elsewhere_hides_no_fault(name):
    signals = sound()
    u = FAULTS[name].act(signals["u"], signals)
    u[2000:2020] = np.nan
    found = {f.code for f in checked(signals | {"u": u})}
    assert found == {FAULTS[name].code, "missing_samples"}
