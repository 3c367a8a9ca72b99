"""Play before a spring: found from both sides, refined from one, refused where there is none."""

import numpy as np
import pytest
from tests.machines import DRIVE

import riecjax as rx
from riecjax.cli.main import run

RATE, FINER = 500.0, 8
TRUTH = {"J_m": 1.2e-3, "d_m": 4e-3, "k": 6.0, "J_l": 2.5e-3, "d_l": 6e-3}
MODEL_FILE = "from tests.machines import DRIVE\n"
LOOSE = DRIVE.with_elements(rx.Backlash("k"))


def turned(play: float, seconds: float = 40.0) -> dict[str, np.ndarray]:
    """A drive by Runge-Kutta steps of an eighth of a sample."""
    rng, step = np.random.default_rng(7), 1 / (RATE * FINER)
    times = np.arange(2 * int(seconds * RATE * FINER) + 1) * step / 2
    hertz, phase = np.linspace(0.5, 8.0, 16), rng.uniform(0, 2 * np.pi, 16)
    torque = 0.1 * np.sin(2 * np.pi * np.outer(times, hertz) + phase).sum(axis=1)
    inertia_m, damping_m, k, inertia_l, damping_l = TRUTH.values()

    def rate(state, drive):
        (a, b), (u, w) = state
        force = k * (a - b - min(max(a - b, -play / 2), play / 2))
        pushed = (drive - force - damping_m * u) / inertia_m, (force - damping_l * w) / inertia_l
        return np.array([(u, w), pushed])

    state, kept = np.zeros((2, 2)), []
    for i in range(int(seconds * RATE) * FINER):
        if i % FINER == 0:
            kept.append(state[0])
        first, middle, last = torque[2 * i : 2 * i + 3]
        one = rate(state, first)
        two = rate(state + step / 2 * one, middle)
        three = rate(state + step / 2 * two, middle)
        state = state + step / 6 * (one + 2 * (two + three) + rate(state + step * three, last))
    angles = np.array(kept)
    spread = 0.01 * np.std(angles[:, 0] - angles[:, 1])
    angles = angles + spread * rng.standard_normal(angles.shape)
    return {
        "q_m": angles[:, 0],
        "q_l": angles[:, 1],
        "tau": torque[: 2 * FINER * len(kept) : 2 * FINER],
    }


@pytest.fixture(scope="module")
def loose():
    return turned(0.08)


def as_record(signals, *names):
    chosen = names or tuple(signals)
    return rx.Record.from_samples({name: signals[name] for name in chosen}, time_step=1 / RATE)


def test_its_width_is_found_from_both_sides(loose):
    record = as_record(loose)
    # The ladder that is searched is by the twist, and may be by what is known of the play.
    for model in (LOOSE, DRIVE.with_elements(rx.Backlash("k", near=0.1))):
        found = rx.identify(model, record)
        low, high = found.interval("play")
        assert low < 0.08 < high
        assert float(found["play"]) == pytest.approx(0.08, rel=0.02)
        assert float(found["k"]) == pytest.approx(TRUTH["k"], rel=0.05)
    # Without it the spring is another one.
    assert abs(float(rx.identify(DRIVE, record)["k"]) / TRUTH["k"] - 1) > 0.2
    assert dict(found.units)["play"] == "rad"


def test_it_is_carried_and_drawn(loose):
    record = as_record(loose)
    model = LOOSE.for_records([record])
    (evidence,) = rx.estimation.element_evidence(model, rx.identify(model, record))
    assert evidence.carried
    assert evidence.explained > 0.9
    (panel,) = evidence.chart().rows[0]
    assert len(panel.marks) == 3
    assert panel.x.label == "width of the play / (rad)"


@pytest.mark.raises_finding("element_not_carried")
def test_a_drive_without_is_given_none():
    record = as_record(turned(0.0, seconds=20.0))
    model = LOOSE.for_records([record])
    (evidence,) = rx.estimation.element_evidence(model, rx.identify(model, record))
    assert [finding.code for finding in evidence.findings()] == ["element_not_carried"]


def test_it_is_refined_from_the_motor_alone():
    record = as_record(turned(0.01, seconds=10.0), "q_m", "tau")
    start = {**{name: 1.05 * value for name, value in TRUTH.items()}, "play": 0.005}
    found = rx.refine(LOOSE, record, start, rx.OutputError())
    low, high = found.interval("play")
    assert low < 0.01 < high
    assert float(found["play"]) == pytest.approx(0.01, rel=0.02)


def test_the_command_line_shows_it(loose, tmp_path, capsys):
    (tmp_path / "drive.py").write_text(MODEL_FILE)
    table = np.column_stack([np.arange(len(loose["tau"])) / RATE, *loose.values()])
    np.savetxt(tmp_path / "a.csv", table, delimiter=",", header="t,q_m,q_l,tau", comments="")
    arguments = ["identify", str(tmp_path / "a.csv"), "--model", f"{tmp_path}/drive.py:DRIVE"]
    more = ["--refine", "none", "--verbose", "--out", str(tmp_path / "out")]
    assert run([*arguments, "--add", "backlash:k", *more]) == 0
    said = capsys.readouterr().out
    assert "play" in said
    assert "carried True" in said
    assert "with play in series with k" in said
    assert run([*arguments, "--add", "backlash:k=-1"]) == 2
    assert run([*arguments, "--add", "backlash:J_m"]) == 1
    assert "play is in series with a spring" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: DRIVE.with_elements(rx.Backlash("c")), "no equation has a coefficient 'c'"),
        (lambda: DRIVE.with_elements(rx.Backlash("d_m")), "the term of 'd_m' is none"),
        (lambda: LOOSE.with_elements(rx.Backlash("k")), "'k' has play in series already"),
        (lambda: rx.Backlash("k", near=-1.0), "a play's width is a positive number"),
        (lambda: LOOSE.linear, "take model.for_records"),
    ],
)
def test_what_cannot_be_asked(make, words):
    with pytest.raises(rx.ModelError, match=words):
        make()


@pytest.mark.slow
def test_it_is_discovered_instead_of_terms(loose):
    found = rx.discover(DRIVE, as_record(loose))
    assert found.names == ("backlash",)
    assert found.element is not None
    assert found.element == rx.Backlash("k", near=found.element.near)
    assert found.element.near == pytest.approx(0.08, rel=0.02)
    assert float(found.estimate["J_m"]) == pytest.approx(TRUTH["J_m"], rel=0.05)


def test_a_known_spring_leaves_the_width_as_it_is(loose):
    record = as_record(loose)
    found = rx.identify(LOOSE, record, known={"k": TRUTH["k"]})
    assert float(found["play"]) == pytest.approx(0.08, rel=0.02)
    assert float(found["J_m"]) == pytest.approx(TRUTH["J_m"], rel=0.05)


def test_a_width_that_is_searched_elsewhere_is_said(loose):
    record = as_record(loose)
    model = DRIVE.with_elements(rx.Backlash("k", near=0.01))
    (evidence,) = rx.estimation.element_evidence(model, rx.identify(model, record))
    (finding,) = evidence.findings()
    assert "ended at the end of the widths that were searched" in finding.message
    assert "J_m" in finding.parameters
    for width in (5.0, -0.01):
        with pytest.raises(rx.ModelError, match="play is held at"):
            rx.identify(LOOSE, record, known={"play": width})
    with pytest.raises(rx.DataError, match="record"):
        LOOSE.for_records([])
    assert LOOSE.for_records(record).elements[0].ends is not None
