"""An assessment against the stages that it is made of, called one by one, and against the truth."""

import dataclasses
from pathlib import Path

import jax
import numpy as np
import pytest

import riecjax as rx
from riecjax.findings import Finding

STEP = 0.01
TRUTH = {"m": 2.0, "c": 3.0, "k": 80.0}


def motion(samples=1500, seed=0, noise=0.0):
    """x, its derivatives v and a, and the force f = m a + c v + k x, all in closed form."""
    rng = np.random.default_rng(seed)
    t = STEP * np.arange(samples)
    tones = [(w, rng.uniform(0, 6)) for w in (3.1, 5.7, 8.3, 13.0)]
    x = sum(np.sin(w * t + p) / w for w, p in tones)
    v = sum(np.cos(w * t + p) for w, p in tones)
    a = sum(-w * np.sin(w * t + p) for w, p in tones)
    f = TRUTH["m"] * a + TRUTH["c"] * v + TRUTH["k"] * x
    signals = {"t": t, "x": x, "v": v, "a": a, "f": f}
    if noise:
        for name in ("x", "v", "a", "f"):
            signals[name] = signals[name] + noise * np.std(signals[name]) * rng.normal(size=samples)
    return signals


def write(name: str, signals: dict[str, np.ndarray]) -> str:
    rows = "\n".join(",".join(f"{value:.12g}" for value in row) for row in zip(*signals.values()))
    Path(name).write_text(f"{','.join(signals)}\n{rows}\n")
    return name


AXIS = rx.Equation(
    rx.Term("m", "x", derivative=2, measured=("v", "a"), unit="kg"),
    rx.Term("c", "x", derivative=1, measured=("v",), unit="N s/m"),
    rx.Term("k", "x", unit="N/m"),
    -rx.Term(1.0, "f"),
    name="axis",
    unit="N",
)
HATS = rx.RIEC(rx.AllWindows(0.1, 0.5), rx.Hat(quadrature=6))
QUICK = {"sweep": False, "intervals": rx.Sandwich(), "refine": None}


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def codes(found: list[rx.Finding]) -> list[str]:
    return [finding.code for finding in found]


@pytest.mark.slow
def test_an_equation_is_assessed_as_its_stages_are_one_by_one():
    recording = rx.read_recording(write("run.csv", motion(noise=1e-3)))
    seen = []
    found = rx.assess(
        AXIS,
        recording,
        HATS,
        hold_out=0.3,
        intervals=rx.Sandwich(),
        on_estimate=seen.append,
        refine=None,
    )
    first, last = rx.split(recording.record, 0.3)
    alone = rx.identify(AXIS, first, HATS, intervals=rx.Sandwich())
    np.testing.assert_allclose(found.estimate.theta, alone.theta, rtol=1e-10)
    np.testing.assert_allclose(found.estimate.covariance, alone.covariance, rtol=1e-7)
    assert seen == [found.estimate]
    assert found.model.name == "axis"
    assert found.sweep is not None
    system = rx.equation_system(AXIS, alone.values)
    held = rx.validation.validate_held_out(system, last)
    (run,) = found.validations
    assert run.recording.name == "run.csv, last part"
    np.testing.assert_allclose(run.held.signals["x"].fit, held.signals["x"].fit, rtol=1e-6)
    for words in ("validated on run.csv, last part", "m ", "intervals"):
        assert words in str(found)


@pytest.mark.slow
def test_a_refinement_is_compared_on_what_it_was_not_fitted_to():
    first, second = (rx.read_recording(write(f"{i}.csv", motion(600, i, 1e-3))) for i in (0, 1))
    steps = []
    found = rx.assess(
        AXIS,
        first,
        HATS,
        bounds={"c": (0.0, None)},
        validate_on=second,
        progress=steps.append,
        **{**QUICK, "refine": rx.OutputError()},
    )
    refinement = found.refinement
    assert refinement is not None
    assert refinement.refined is not None
    assert steps
    for name, value in TRUTH.items():
        assert float(refinement.refined[name]) == pytest.approx(value, rel=1e-2)
    assert not refinement.on_fitted
    assert [run.recording.name for run in refinement.simulations] == ["1.csv"]
    np.testing.assert_array_equal(
        refinement.simulations[0].after.signals["x"].fit, found.validations[0].held.signals["x"].fit
    )


def with_findings(recording, *signals):
    """The recording with a finding of its file on each of these signals."""
    said = tuple(Finding("unit_mismatch", f"of {name}", (name,), doubt=1.0) for name in signals)
    return dataclasses.replace(recording, findings=said)


def test_findings_of_a_file_are_those_of_signals_that_are_read():
    signals = motion()
    signals["spare"] = signals["v"]
    recording = with_findings(rx.read_recording(write("run.csv", signals)), "x", "spare")
    assert {f.signals for f in recording.findings} == {("x",), ("spare",)}
    checked = rx.check(AXIS, recording, HATS)
    found = rx.assess(AXIS, recording, HATS, **QUICK)
    for said in (checked.findings, found.findings()):
        (finding,) = [f for f in said if f.code == "unit_mismatch"]
        assert finding.signals == ("x",)


def test_a_missing_signal_names_the_file_and_its_column():
    signals = motion(100)
    signals["x"] = np.full(100, np.nan)
    recording = rx.read_recording(write("run.csv", signals))
    with pytest.raises(rx.DataError, match=r"run\.csv: column 'x' was left out: it holds no num"):
        rx.assess(AXIS, recording, HATS)


def test_a_record_shorter_than_a_window_names_the_file():
    recording = rx.read_recording(write("run.csv", motion(20)))
    for verb in (rx.assess, rx.check, rx.identify):
        with pytest.raises(rx.DataError, match=r"^run\.csv: .*window"):
            verb(AXIS, recording, HATS)


@pytest.mark.parametrize(
    ("arguments", "settings", "words"),
    [
        (("quarter-car",), {}, "rx.find_model('quarter-car')"),
        ((AXIS, "dols"), {}, "rx.DOLS()"),
        ((AXIS, HATS), {"refine": "output-error"}, "rx.OutputError()"),
        ((AXIS, HATS), {"bounds": {"m": (0, 1)}, "refine": None}, "refine="),
        ((AXIS, HATS), {"horizon": -1.0}, "a positive number of seconds"),
        ((AXIS, HATS), {"hold_out": "0.2"}, "hold_out=0.2"),
        ((AXIS, HATS), {"hold_out": 1.5}, "between 0 and 1"),
        ((AXIS, HATS), {"known": {"mass": 1.0}}, "unknown parameter 'mass'"),
    ],
)
def test_slips_are_named_with_what_to_write(arguments, settings, words):
    model, *criterion = arguments
    signals = motion(300)
    record = rx.Record.from_samples({n: signals[n] for n in ("x", "f")}, time_step=STEP)
    with pytest.raises(rx.RiecjaxError) as error:
        rx.assess(model, record, *criterion, **settings)
    assert words in str(error.value)


@pytest.mark.slow
def test_own_is_the_old_name_of_per_record():
    signals = motion(600)
    records = [rx.Record.from_samples({"x": signals["x"], "f": signals["f"]}, time_step=STEP)] * 2
    names = ("k",)

    def values(records, **named):
        return rx.identify(AXIS, records, HATS, intervals=rx.Sandwich(), **named).theta

    new = values(records, per_record=names)
    with pytest.warns(DeprecationWarning, match=r"own= of identify\(\) is called per_record="):
        old = values(records, own=names)
    np.testing.assert_array_equal(old, new)
    with pytest.warns(DeprecationWarning, match="per_record="):
        jitted = jax.jit(lambda records: values(records, own=names))(records)
    np.testing.assert_allclose(jitted, new, rtol=1e-6)
    with pytest.raises(TypeError, match="its old name own="):
        values(records, own=names, per_record=names)


@pytest.mark.slow
def test_recordings_of_one_name_are_compared_each_with_itself():
    """Two files called run.csv in two folders, one of them of another machine."""
    fitted = rx.read_recording(write("fit.csv", motion()))
    others = []
    for folder, seed, noise in (("x", 3, 0.3), ("y", 4, 0.0)):
        Path(folder).mkdir()
        others.append(rx.read_recording(write(f"{folder}/run.csv", motion(400, seed, noise))))
    settings = {**QUICK, "refine": rx.IntegralError()}

    def fits(*recordings):
        found = rx.assess(AXIS, fitted, HATS, validate_on=list(recordings), **settings)
        assert found.refinement is not None
        return [
            [held.describe() for held in (pair.before, pair.after)]
            for pair in found.refinement.simulations
        ]

    (first,), (second,) = fits(others[0]), fits(others[1])
    assert first != second
    assert fits(*others) == [first, second]


@pytest.mark.parametrize("refine", [False, "output-error", rx.OutputError, ["auto"]])
def test_what_is_no_refinement_is_refused_before_the_fit(refine):
    recording = rx.read_recording(write("run.csv", motion()))
    with pytest.raises(rx.ModelError, match=r"refine=rx\.OutputError\(\)"):
        rx.assess(AXIS, recording, HATS, refine=refine, on_estimate=lambda _: pytest.fail("fitted"))
