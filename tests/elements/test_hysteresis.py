"""Hysteresis: states along recordings and in simulations, held against SciPy's solution."""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
from tests.machines import PROBLEMS

import riecjax as rx
from riecjax.elements.hysteresis import BoucWen, Dahl, Elapsed
from riecjax.records.record import Signals

TIMES = np.arange(2001) / 100
HYSTERETIC = PROBLEMS["hysteresis"]


def velocity(t):
    return np.sin(2 * np.pi * 0.4 * t) + 0.6 * np.sin(2 * np.pi * 1.1 * t + 1)


@pytest.mark.parametrize("law", [Dahl, BoucWen])
@pytest.mark.parametrize("width", [0.02, 0.3])
def test_the_course_is_that_of_the_differential_equation(law, width):
    memory = law("z", "v", width)

    def rate(t, z):
        signals = Signals({"v": jnp.asarray([velocity(t)]), "z": jnp.asarray(z)})
        return np.asarray(memory(signals))

    run = scipy.integrate.solve_ivp(
        rate, (0, 5), [0.0], t_eval=TIMES[:501], rtol=1e-7, atol=1e-9, max_step=0.01
    )
    record = rx.Record.from_samples({"v": velocity(TIMES)}, time_step=0.01)
    found = memory.course(record)
    assert np.abs(found).max() <= 1
    # A sample holds one stroke: what turns within it is an error of second order.
    assert np.max(np.abs(found[:501] - run.y[0])) < 0.02


def test_recordings_are_given_states_that_they_lack_and_keep_those_they_have():
    record = rx.Record.from_samples({"v": velocity(TIMES)}, time_step=0.01)
    made = Dahl("z", "v", 0.1).with_states(record)
    assert set(made.arrays) == {"v", "z"}
    assert made.noise.kernels["z"] == {}
    own = rx.Record.from_samples({"v": velocity(TIMES), "z": 0 * TIMES}, time_step=0.01)
    assert np.all(np.asarray(Dahl("z", "v", 0.1).with_states(own)["z"]) == 0)


def test_a_state_stays_where_its_velocity_is_missing():
    v = velocity(TIMES)
    v[500:600] = np.nan
    record = rx.Record.from_samples({"v": v}, time_step=0.01)
    found = Dahl("z", "v", 0.1).course(record)
    assert np.all(np.isfinite(found))
    assert np.ptp(found[502:598]) == 0


def test_a_model_with_hysteresis_is_identified_from_a_record_without_the_state():
    record = HYSTERETIC.record(0.01, 0)
    estimate = rx.identify(HYSTERETIC.model, record, intervals=rx.Naive())
    for name, value in {"m": 1.5, "k": 20.0, "c": 0.8, "loop": 4.0}.items():
        assert float(estimate[name]) == pytest.approx(value, rel=0.03)


def test_elapsed_time_is_a_state_of_recordings_and_of_simulations():
    memory = Elapsed("age")
    record = rx.Record.from_samples({"u": np.ones(301), "x": np.zeros(301)}, time_step=0.01)
    assert memory.course(record) == pytest.approx(np.arange(301) * 0.01)
    falling = rx.staged(
        rx.Equation(rx.Term("m", "x", derivative=2), rx.Term("a", "age"), -rx.Term(1.0, "u"))
    ).with_elements(memory)
    system = rx.equation_system(falling, {"m": 2.0, "a": 0.5})
    run = rx.simulate(system, record).checked()
    t = np.arange(301) * 0.01
    assert np.asarray(run.record["x"]) == pytest.approx(t**2 / 4 - t**3 / 24, abs=1e-8)
