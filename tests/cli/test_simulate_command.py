import numpy as np
import pytest
import scipy.integrate
import scipy.io
from command_line import call, write_csv

CAR = "quarter-car-source"


def simulated(capsys, path, model, *options, source: object = "white-noise"):
    result = call(capsys, "simulate", model, "--input", source, *options, "--out", path)
    assert result.status == 0, result.err
    return result


def table(path) -> dict[str, np.ndarray]:
    read = np.genfromtxt(path, delimiter=",", names=True)
    return {name: read[name] for name in read.dtype.names or ()}


def test_seed(capsys, tmp_path):
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        simulated(capsys, tmp_path / f"{name}.csv", CAR, "--duration", 2, "--seed", seed)
    first, again, other = ((tmp_path / f"{name}.csv").read_bytes() for name in "abc")
    assert first == again
    assert first != other


def test_source_model_moves_as_its_equations_say(capsys, tmp_path):
    path = tmp_path / "a.csv"
    simulated(capsys, path, CAR, "--duration", 4, "--rate", 1000)
    car = table(path)
    # x1' = v_r - x3 and x2' = x3 - x4, by trapezoids; their error is of order step^2 x3''.
    rates = {"x1": car["v_r"] - car["x3"], "x2": car["x3"] - car["x4"]}
    for state, rate in (rates | {"x3": car["dx3"], "x4": car["dx4"]}).items():
        integral = scipy.integrate.cumulative_trapezoid(rate, car["t"], initial=0)
        np.testing.assert_allclose(car[state], integral, atol=2e-3 * np.ptp(car[state]))
    # F_t is 180 kN/m x1, but no more than the static load of 330 kg.
    np.testing.assert_allclose(car["F_t"], np.minimum(180e3 * car["x1"], 330 * 9.81), rtol=1e-12)


@pytest.mark.slow
def test_identification_model_gives_its_own_parameters_back(capsys, tmp_path):
    path = tmp_path / "a.csv"
    settings = {"K_t": 150e3, "M_us": 35.0, "M_s": 280.0, "K_s": 18e3}
    options = [word for n, v in settings.items() for word in ("--set", f"{n}={v}")]
    simulated(capsys, path, "quarter-car", "--duration", 20, *options)
    arguments = ("identify", path, "--model", "quarter-car", "--criterion", "dols", "--json")
    found = call(capsys, *arguments, "--refine", "none").document["parameters"]
    # States and derivatives come from the same right-hand side: exact at every sample.
    for name, value in settings.items():
        assert found[name]["value"] == pytest.approx(value, rel=1e-8)
    assert found["F_2"]["value"] == pytest.approx(-750, rel=1e-8)


def test_input_from_a_file(capsys, tmp_path):
    time = np.arange(1000) / 250
    force = 3 * np.sin(4 * time)
    source = write_csv(tmp_path / "force.csv", {"t": time, "other": time, "u": force})
    out = tmp_path / "out.mat"
    settings = {"m": 2.0, "d": 0.7, "k1": 50.0, "k2": 5.0, "k3": 300.0}
    options = [word for n, v in settings.items() for word in ("--set", f"{n}={v}")]
    simulated(capsys, out, "duffing", *options, source=source)
    found = scipy.io.loadmat(out)
    np.testing.assert_array_equal(found["u"].ravel(), force)

    def right_hand_side(t: float, state: np.ndarray) -> list[float]:
        y, dy = state
        spring = 50.0 * y + 5.0 * y**2 + 300.0 * y**3
        return [dy, (np.interp(t, time, force) - 0.7 * dy - spring) / 2.0]

    exact = scipy.integrate.solve_ivp(
        right_hand_side, (0, time[-1]), [0, 0], t_eval=time, rtol=1e-9, atol=1e-11, max_step=0.004
    )
    np.testing.assert_allclose(found["y"].ravel(), exact.y[0], atol=1e-6 * np.ptp(exact.y[0]))
    np.testing.assert_allclose(found["dy"].ravel(), exact.y[1], atol=1e-6 * np.ptp(exact.y[1]))
    simulated(capsys, tmp_path / "out.csv", "duffing", "--duration", 1, source=source)
    assert table(tmp_path / "out.csv")["t"].size == 250
