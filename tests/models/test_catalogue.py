"""One registry, every contract: what each built-in model promises."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import riecjax as rx
from nightly import by_day
from riecjax.equations.model import as_model
from riecjax.models.catalogue import LISTED, built_in_model
from riecjax.simulation.inputs import band_limited_noise

MODELS = {name: built_in_model(name) for name in LISTED}
IDENTIFIED = [name for name, model in MODELS.items() if model.stages]
ROUND_TRIPS = [name for name in IDENTIFIED if not MODELS[name].system.parameters]
EXCITATION = {
    "quarter-car": 0.55,
    "quarter-car-wheel": 0.55,
    "emps": 300.0,
    "emps-asymmetric": 300.0,
    "duffing": 25.0,
    "drag-oscillator": 30.0,
}
"""R.m.s. of each input; a pendulum swings freely, as its equation has no input."""
SETTINGS = {"duffing": {"k2": 150.0}}
"""Instead of defaults that are zero, of which no relative error can be told."""


def truth(model: rx.Model) -> dict[str, float]:
    settings = SETTINGS.get(model.name, {})
    return {p.name: settings.get(p.name, p.default or 0.0) for p in model.parameters}


def recording(model: rx.Model, rate: float = 1000.0, seconds: float = 20.0) -> rx.Record:
    system = model.build_system(SETTINGS.get(model.name, {}))
    count = round(seconds * rate)
    (name,) = system.input_names
    if model.name in EXCITATION:
        u = band_limited_noise(
            jax.random.key(11), count, 1 / rate, bandwidth=6.0, rms=EXCITATION[model.name]
        )
        start = {}
    else:
        u, start = jnp.zeros(count), {"theta": 0.3}
    inputs = rx.Record({name: u}, 1 / rate)
    return rx.simulate(system, inputs, initial_state=start, method=rx.FixedStep(2)).checked().record


def test_an_unknown_name_is_refused_with_those_that_exist():
    with pytest.raises(rx.ModelError, match=".*".join(MODELS)):
        built_in_model("half-car")


@pytest.mark.parametrize("name", IDENTIFIED)
def test_listed_parameters_and_units_are_those_of_the_equations(name):
    model = MODELS[name]
    listed = {p.name: p.unit for p in model.parameters}
    assert set(listed) == set(model.parameter_names)
    assert listed == {parameter: model.units[parameter] for parameter in listed}
    assert [p.name for p in model.parameters] == list(model.parameter_names)


@pytest.mark.parametrize("name", MODELS)
def test_listed_inputs_and_states_have_the_systems_units(name):
    model = MODELS[name]
    system = model.build_system({})
    assert tuple((q.name, q.unit) for q in model.inputs) == system.inputs
    units = dict((*system.states, *system.inputs, *system.outputs))
    for signal in model.signals:
        if signal.name in units:
            assert units[signal.name] == signal.unit


@pytest.mark.parametrize("name", MODELS)
def test_a_simulation_writes_what_it_promises_and_what_identification_reads(name):
    model = MODELS[name]
    system = model.build_system({})
    zero = rx.Record({q.name: np.zeros(20) for q in model.inputs}, 0.005)
    found = set(rx.simulate(system, zero).record.arrays)
    assert set(model.written) <= found
    written = set(model.written) or found
    assert {signal.name for signal in model.signals} <= written


@pytest.mark.parametrize("name", MODELS)
def test_a_setting_changes_the_system_and_an_unknown_one_is_refused(name):
    model = MODELS[name]
    first = model.simulation_parameters[0]
    assert first.default is not None
    changed = jax.tree.leaves(model.build_system({first.name: 2 * first.default + 1}))
    original = jax.tree.leaves(model.build_system({}))
    assert any(not np.array_equal(a, b) for a, b in zip(changed, original, strict=True))
    with pytest.raises(rx.ModelError, match="unknown parameter 'nonsense'"):
        model.build_system({"nonsense": 1.0})


def test_a_jitted_function_takes_one_as_static():
    def doubled(model, x):
        return 2 * x * len(model.parameters)

    assert float(jax.jit(doubled, static_argnums=0)(built_in_model("emps"), 1.5)) == 12.0


def test_what_a_model_cannot_do_is_refused():
    with pytest.raises(rx.ModelError, match="simulated but not identified"):
        as_model(MODELS["quarter-car-source"])
    with pytest.raises(rx.ModelError, match="neither equations nor a system"):
        rx.Model("only-equation", "").build_system({})


@pytest.mark.parametrize("name", by_day(ROUND_TRIPS, "duffing", "pendulum"))
def test_dols_with_exact_derivatives_returns_what_was_simulated(name):
    model = MODELS[name]
    record = recording(model)
    if name.startswith("emps"):
        # At rest dry friction balances whatever it can, of which sign(0) = 0 knows nothing.
        record = record.with_signals({"dq": rx.Signal(record["dq"], record["dq"] != 0)})
    estimate = rx.identify(model, record, rx.DOLS(), intervals=rx.Naive())
    for parameter, value in truth(model).items():
        np.testing.assert_allclose(estimate[parameter], value, rtol=1e-8, err_msg=parameter)


def test_what_is_no_quantity_is_refused_when_a_model_is_made():
    with pytest.raises(rx.ModelError, match=r"what is in signals is the text 'x'\. Write"):
        rx.Model("it", "", signals={"x": ("m", "position")})  # pyright: ignore[reportArgumentType]
