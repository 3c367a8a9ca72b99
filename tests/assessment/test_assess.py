"""An assessment against the stages that it is made of, called one by one, and against the truth."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from tests.machines import MACHINES, Shape

import riecjax as rx
from riecjax.findings import Finding

AXIS, TRUTH = MACHINES["linear"].model, MACHINES["linear"].truth


def motion(samples: int = 1500, seed: int = 0, noise: float = 0.0) -> dict[str, np.ndarray]:
    """Time and signals of a mass on a spring and a damper, in closed form."""
    shape = Shape(samples, 100)
    return {"t": shape.times} | MACHINES["linear"].signals(noise, seed, drive=seed, shape=shape)


def write(name: str, signals: dict[str, np.ndarray]) -> str:
    rows = "\n".join(",".join(f"{value:.12g}" for value in row) for row in zip(*signals.values()))
    Path(name).write_text(f"{','.join(signals)}\n{rows}\n")
    return name


HATS = rx.RIEC(rx.AllWindows(0.1, 0.5), rx.Hat(quadrature=6))
QUICK = {"sweep": False, "intervals": rx.Sandwich(), "refine": None}


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


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
    (run,) = found.test("validation").runs
    np.testing.assert_array_equal(
        refinement.simulations[0].held.signals["x"].fit, run.held.signals["x"].fit
    )


def with_findings(recording, *signals):
    """The recording with a finding of its file on each of these signals."""
    said = tuple(Finding("unit_mismatch", f"of {name}", (name,), doubt=1.0) for name in signals)
    return dataclasses.replace(recording, findings=said)


def test_findings_of_a_file_are_those_of_signals_that_are_read():
    signals = motion()
    signals["spare"] = signals["dx"]
    recording = with_findings(rx.read_recording(write("run.csv", signals)), "x", "spare")
    assert {f.signals for f in recording.findings} == {("x",), ("spare",)}
    checked = rx.check(AXIS, recording, HATS)
    found = rx.assess(AXIS, recording, HATS, **QUICK)
    for said in (checked.findings, found.findings()):
        (finding,) = [f for f in said if f.code == "unit_mismatch"]
        assert finding.signals == ("x",)


@pytest.mark.parametrize(
    ("arguments", "settings", "words"),
    [
        (("quarter-car",), {}, "rx.find_model('quarter-car')"),
        ((AXIS, "least-squares"), {}, "Write 'riec' or 'dols'"),
        ((AXIS, HATS), {"refine": "simulation"}, "'integral' or 'output-error'"),
        ((AXIS, HATS), {"bounds": {"m": (1, 0)}, "refine": None}, "wrong order: 1 to 0"),
        ((AXIS, HATS), {"hold_out": "0.2"}, "hold_out is the text '0.2'. Write a number"),
        ((AXIS, HATS), {"known": {"mass": 1.0}}, "unknown parameter 'mass'"),
    ],
)
def test_slips_are_named_with_what_to_write(arguments, settings, words):
    model, *criterion = arguments
    signals = motion(300)
    record = rx.Record.from_samples({n: signals[n] for n in ("x", "u")}, time_step=0.01)
    with pytest.raises(rx.RiecjaxError) as error:
        rx.assess(model, record, *criterion, **settings)
    assert words in str(error.value)


@pytest.mark.parametrize("refine", [False, "by-hand", rx.OutputError, ["auto"]])
def test_what_is_no_refinement_is_refused_before_the_fit(refine):
    recording = rx.read_recording(write("run.csv", motion()))
    with pytest.raises(rx.ModelError, match=r"^refine is .* Write .*'?auto'?"):
        rx.assess(AXIS, recording, HATS, refine=refine, on_estimate=lambda _: pytest.fail("fitted"))
