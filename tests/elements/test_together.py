"""Elements that go together, each beside its truth; all else is refused in one line.

Two modes and a mode with a spring are in `tests/estimation`, hysteresis in `discover` in
`tests/discovery`.
"""

import numpy as np
import pandas
import pytest
from test_backlash import LOOSE, as_record, turned
from tests.machines import BODY, DRIVE, LAG_MODEL, MODE_MODEL, MODE_TRUTH, STANDARD, body_with_mode

import riecjax as rx

FRICTION = 12.0


def rubbing(count: int = 8000, finer: int = 20) -> dict[str, np.ndarray]:
    """The body of `MODE_TRUTH` with its mode, and dry friction beside, by small Euler-Cromer steps
    in which friction stops the body no further than at rest."""
    m, c, k, m_mode, k_mode, b_mode = MODE_TRUTH.values()
    step, rng = STANDARD.step / finer, np.random.default_rng(5)
    hertz, phase = np.linspace(0.6, 18.0, 40), rng.uniform(0, 2 * np.pi, 40)
    times = np.arange(count * finer) * step
    force = np.zeros(times.size)
    for each, shift in zip(hertz, phase):
        force += 60.0 * np.sin(2 * np.pi * each * times + shift)
    x = v = y = w = 0.0
    kept = np.zeros((3, count))
    for i in range(times.size):
        if i % finer == 0:
            kept[:, i // finer] = x, v, force[i]
        pull = k_mode * (x - y) + b_mode * (v - w)
        free = v + step * (force[i] - c * v - k * x - pull) / m
        slowed = step * FRICTION / m
        v = np.sign(free) * max(abs(free) - slowed, 0.0)
        w += step * pull / m_mode
        x, y = x + step * v, y + step * w
    return dict(zip(("x", "v", "F"), kept))


def test_a_mode_beside_friction():
    rubbed = BODY.of_terms(*BODY.terms, rx.Term("friction", rx.odd("v", 0), unit="N"))
    record = rx.Record.from_samples(rubbing(), time_step=STANDARD.step)
    found = rx.identify(rx.staged(rubbed).with_elements(rx.HiddenMode("v")), record)
    for name, value in {**MODE_TRUTH, "friction": FRICTION}.items():
        assert float(found[name]) == pytest.approx(value, rel=0.06), name


def test_a_zero_of_each_recording():
    model = rx.staged(BODY).with_elements(rx.elements.SensorZero("F"))
    plain = body_with_mode(False)
    records = [
        rx.Record.from_samples({**plain, "F": plain["F"] + zero}, time_step=STANDARD.step)
        for zero in (30.0, -45.0)
    ]
    found = rx.identify(model, records, per_record=("offset_F",))
    assert float(found["offset_F[1]"]) == pytest.approx(30.0, rel=0.02)
    assert float(found["offset_F[2]"]) == pytest.approx(-45.0, rel=0.02)


def test_modes_in_a_fleet(tmp_path):
    for number in range(2):
        folder = tmp_path / f"car={number}"
        folder.mkdir()
        table = pandas.DataFrame({"t": np.arange(6000) * STANDARD.step, **body_with_mode()})
        table.to_csv(folder / "a.csv", index=False)
    found = rx.fleet(MODE_MODEL, tmp_path, by="car", workers=0)
    told = [entry for entry in found.entries if entry.status == "ok"]
    assert len(told) == 2 * len(MODE_TRUTH)
    for entry in told:
        assert entry.value == pytest.approx(MODE_TRUTH[str(entry.parameter)], rel=0.02)


@pytest.mark.slow
def test_a_mode_on_a_body_with_play():
    record = as_record(turned(0.08))
    model = LOOSE.with_elements(rx.HiddenMode("q_m")).for_records([record])
    found = rx.identify(model, record)
    carried = {one.test: one.carried for one in rx.estimation.element_evidence(model, found)}
    assert carried == {"modes": False, "backlash": True}
    assert float(found["play"]) == pytest.approx(0.08, rel=0.02)


@pytest.fixture(scope="module")
def record():
    return rx.Record.from_samples(body_with_mode(count=2000), time_step=STANDARD.step)


@pytest.mark.parametrize(
    ("refused", "words"),
    [
        (lambda record: rx.identify(MODE_MODEL, record, per_record=("c",)), "per_record has no"),
        (lambda record: rx.discover(LAG_MODEL, record), "beside a model without hidden elements"),
        (
            lambda record: rx.refine(MODE_MODEL, record, MODE_TRUTH, rx.IntegralError()),
            "motions of their own",
        ),
        (lambda _: LAG_MODEL.with_elements(rx.SeriesSpring("c")), "has a spring in series already"),
        (
            lambda _: DRIVE.with_elements(rx.SeriesSpring("d_m"), rx.Backlash("d_m")),
            "the term of 'd_m' is none",
        ),
        (lambda _: LOOSE.with_elements(rx.SeriesSpring("k")), "is of a position, a stiffness"),
        (
            lambda record: rx.identify(MODE_MODEL, record, known={"M_mode": 6.0}),
            "all of M_mode, K_mode, B_mode are known or none",
        ),
    ],
)
def test_what_does_not_go_together(refused, words, record):
    with pytest.raises(rx.ModelError, match=words) as error:
        refused(record)
    assert "\n" not in str(error.value)
