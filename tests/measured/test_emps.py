"""EMPS, a measured axis: against published values, and least squares written out."""

import contextlib
import functools
import io
import json
from pathlib import Path

import numpy as np
import pytest
import scipy.io
import scipy.signal
from benchmarks.measured.emps_closed_loop import ASYMMETRIC, STEP, SYMMETRIC

from conftest import measured_data
from nightly import nightly
from riecjax.cli.main import run

GAIN = 35.1507
FILTERED = ("--low-pass", "q=100")
AS_COMPARED = ("--refine", "none", "--noise", "none")
"""The velocity by central differences, and nothing taken off, as in what tests compare with."""
TRAPEZOIDS = ("--test-function", "boxcar", "--quadrature", "2")
PUBLISHED_PREPARATION = (*FILTERED, "--every", "10", "--criterion", "dols")


@pytest.fixture(scope="module")
def file() -> Path:
    return measured_data("emps") / "DATA_EMPS.mat"


@pytest.fixture(scope="module")
def document(file):
    """What a command line answers; each is run once."""

    @functools.cache
    def identify(model: str, *options: object) -> dict:
        given = ("--map", "q=qm", "--map", "force=vir", "--scale", f"vir={GAIN}", "--json")
        windows = () if "dols" in options else TRAPEZOIDS
        arguments = ["identify", file, "--model", model, *AS_COMPARED, *windows, *given, *options]
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            assert run([str(argument) for argument in arguments]) == 0
        return json.loads(printed.getvalue())

    return identify


@pytest.fixture(scope="module")
def identified(document):
    return lambda *arguments: document(*arguments)["parameters"]


@pytest.fixture(scope="module")
def raw(file) -> tuple[np.ndarray, np.ndarray]:
    variables = scipy.io.loadmat(file)
    return variables["qm"].ravel(), GAIN * variables["vir"].ravel()


def butterworth(cutoff: float) -> tuple[np.ndarray, np.ndarray]:
    coefficients = scipy.signal.butter(4, cutoff, fs=1 / STEP)
    assert coefficients is not None
    return np.asarray(coefficients[0]), np.asarray(coefficients[1])


def motion(raw: tuple[np.ndarray, np.ndarray], cutoff: float | None) -> list[np.ndarray]:
    """Position, velocity, acceleration and force; five periods are cut where it is filtered."""
    q, force = raw
    if cutoff is not None:
        cut = round(5 / cutoff / STEP)
        q = scipy.signal.filtfilt(*butterworth(cutoff), q)[cut:-cut]
        force = force[cut:-cut]
    velocity = np.gradient(q, STEP, edge_order=2)
    return [q, velocity, np.gradient(velocity, STEP, edge_order=2), force]


def symmetric(velocity: np.ndarray) -> list[np.ndarray]:
    return [velocity, np.sign(velocity), np.ones_like(velocity)]


def asymmetric(velocity: np.ndarray) -> list[np.ndarray]:
    forward, backward = velocity > 0, velocity < 0
    return [velocity * forward, 1.0 * forward, velocity * backward, -1.0 * backward]


MODELS = {
    "emps": (SYMMETRIC, symmetric, 0.005),
    "emps-asymmetric": (ASYMMETRIC, asymmetric, 0.01),
}


@pytest.mark.parametrize("model", ["emps", *nightly(["emps-asymmetric"])])
def test_dols_is_least_squares_on_filtered_differences_and_near_the_published_values(
    identified, raw, model
):
    published, friction, tolerance = MODELS[model]
    _, velocity, acceleration, force = (part[::10] for part in motion(raw, 100.0))
    regressors = np.column_stack([acceleration, *friction(velocity)])
    expected = np.linalg.lstsq(regressors, force)[0]
    found = identified(model, *PUBLISHED_PREPARATION)
    assert list(found) == list(published)
    assert [entry["value"] for entry in found.values()] == pytest.approx(expected, rel=1e-6)
    for name, value in published.items():
        assert found[name]["value"] == pytest.approx(value, rel=tolerance), name


def integral_fit(position, velocity, force, windows: int, seed: int) -> np.ndarray:
    """Windows of 0.05 to 0.5 s by rejection, integrals by trapezoids, least squares."""
    rng = np.random.default_rng(seed)
    lag = rng.integers(50, 501, 2 * windows)
    start = rng.integers(0, force.size, 2 * windows)
    inside = start + lag < force.size
    start, stop = start[inside][:windows], (start + lag)[inside][:windows]

    def over(values: np.ndarray) -> np.ndarray:
        running = np.concatenate([[0], np.cumsum((values[1:] + values[:-1]) / 2)]) * STEP
        return running[stop] - running[start]

    columns = [velocity[stop] - velocity[start], position[stop] - position[start]]
    columns += [over(np.sign(velocity)), over(np.ones_like(force))]
    return np.linalg.lstsq(np.column_stack(columns), over(force))[0]


@pytest.mark.parametrize("cutoff", [None, *nightly([100.0])])
def test_riec_agrees_with_an_independent_draw_of_windows(identified, raw, cutoff):
    q, velocity, _, force = motion(raw, cutoff)
    draws = np.array([integral_fit(q, velocity, force, 8000, seed) for seed in range(12)])
    found = identified("emps", *(FILTERED if cutoff else ()))
    values = np.array([found[name]["value"] for name in SYMMETRIC])
    # Scatter over draws of 8000 windows, from 12 of them: within four of its standard deviations.
    assert np.all(np.abs(values - draws.mean(0)) < 4 * draws.std(0, ddof=1))


@pytest.mark.parametrize("options", [(), *nightly([(FILTERED,)])], ids=["raw", "filtered"])
def test_riec_sees_a_lighter_axis_than_dols_does(identified, options):
    mass = identified("emps", *options)["M"]
    assert 92.5 < mass["value"] < 93.5
    dols = identified("emps", *PUBLISHED_PREPARATION)["M"]["value"]
    low, high = mass["interval95"]
    assert not low <= dols <= high


def test_the_verdict_doubts_what_drifts_and_what_noise_does_not_explain(document):
    found = document("emps")
    sweep = found["window_sweep"]
    masses = sweep["parameters"]["M"]["value"]
    assert (sweep["alpha"][0], sweep["beta"][-1]) == pytest.approx((0.05, 1.0))
    assert masses[-1] == pytest.approx(91.5, abs=0.4)
    (warning,) = [w for w in found["warnings"] if w["code"] == "window_sensitive"]
    assert "Fv" in warning["parameters"]
    mass = found["verdict"]["parameters"]["M"]
    # The published value, by another method.
    assert mass["doubt"][0] < 95.11 < mass["doubt"][1]
