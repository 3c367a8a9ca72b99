"""The source model against eq. (19) written out, and its curves against quadrature and slopes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate

from riecjax.models.catalogue import built_in_model
from riecjax.models.quarter_car.source import (
    DAMPER_KNOTS,
    GRAVITY,
    BumpStopSpring,
    DigressiveDamper,
    HardeningMount,
    LinearDamper,
    QuarterCarSource,
    SplineDamper,
    contact_share,
)
from riecjax.records.record import Record
from riecjax.simulation.inputs import band_limited_noise
from riecjax.simulation.method import FixedStep
from riecjax.simulation.simulate import simulate

STEP = 0.005


def built_in(**settings: float) -> QuarterCarSource:
    source = built_in_model("quarter-car-source").build_system(settings)
    assert isinstance(source, QuarterCarSource)
    return source


def spline_damper() -> SplineDamper:
    return SplineDamper(
        jnp.asarray(5000.0),
        jnp.array([4000.0, 2000.0, 1000.0, 800.0]),
        jnp.array([3500.0, 1500.0, 900.0, 400.0]),
    )


def digressive_damper() -> DigressiveDamper:
    return DigressiveDamper(jnp.asarray(4000.0), jnp.array([900.0, 600.0]), jnp.array([0.1, 0.2]))


DAMPERS = {
    "spline": spline_damper,
    "digressive": digressive_damper,
    "linear": lambda: LinearDamper(jnp.asarray(1500.0)),
    "built in": lambda: built_in().damper,
}
SPEEDS = [1e-9, 1e-4, 0.02, 0.05, 0.1, 0.15, 0.3, 0.4, 0.7, 1.0, 2.5]
VELOCITIES = [*(-v for v in reversed(SPEEDS)), 0.0, *SPEEDS]

CURVES = {
    **DAMPERS,
    "spring": lambda: BumpStopSpring(
        jnp.asarray(20e3), jnp.array([0.02, 0.05]), jnp.array([3e3, 7e3])
    ),
    "mount": lambda: HardeningMount(jnp.asarray(4e5), jnp.asarray(1e9)),
    "built-in spring": lambda: built_in().spring,
    "built-in mount": lambda: built_in().mount,
}


@pytest.mark.parametrize("name", CURVES)
def test_curves_are_zero_at_rest_and_increase(name):
    curve = CURVES[name]()
    assert float(curve(jnp.zeros(()))) == 0.0
    forces = np.asarray(curve(jnp.linspace(-3.0, 3.0, 2001)))
    assert np.all(np.diff(forces) > 0)


@pytest.mark.parametrize("name", CURVES)
def test_curves_are_continuous(name):
    curve = CURVES[name]()
    grid = np.concatenate([np.linspace(-1.2, 1.2, 4801), VELOCITIES, [0.02, -0.02, 0.05]])
    force = np.asarray(curve(jnp.asarray(grid)))
    beside = np.asarray(curve(jnp.asarray(np.nextafter(grid, 9.0))))
    np.testing.assert_allclose(beside, force, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("name", DAMPERS)
def test_slope_is_the_derivative_of_the_damper_force_also_at_rest_and_at_knots(name):
    damper = DAMPERS[name]()
    velocity = jnp.array(VELOCITIES)
    np.testing.assert_allclose(
        jax.vmap(jax.grad(damper))(velocity), damper.slope(velocity), rtol=1e-10
    )


@pytest.mark.parametrize("name", DAMPERS)
def test_damper_force_is_the_integral_of_its_slope(name):
    damper = DAMPERS[name]()
    ends = np.array(VELOCITIES)
    nodes, weights = np.polynomial.legendre.leggauss(30)
    # Gauss's rule from each velocity to the next, so that no knot lies inside an interval.
    half = 0.5 * np.diff(ends)
    points = (ends[:-1] + half)[:, None] + half[:, None] * nodes[None]
    integrals = half * (np.asarray(damper.slope(jnp.asarray(points))) @ weights)
    force = np.asarray(damper(jnp.asarray(ends)))
    np.testing.assert_allclose(np.diff(force), integrals, rtol=1e-9, atol=1e-9)


def test_spline_slope_is_linear_between_its_knots_in_each_direction():
    damper = spline_damper()
    speed = np.linspace(0, 2, 401)
    for sign, slopes in ((1, damper.rebound), (-1, damper.compression)):
        expected = np.interp(speed, DAMPER_KNOTS, [5000.0, *np.asarray(slopes)])
        found = damper.slope(jnp.asarray(sign * speed[1:]))
        np.testing.assert_allclose(found, expected[1:], rtol=1e-12)


def test_digressive_damper_has_its_rates_at_rest_and_far_beyond_the_knee():
    damper = digressive_damper()
    h = 1e-6
    for sign in (1, -1):
        np.testing.assert_allclose(damper(jnp.asarray(sign * h)) / (sign * h), 4000.0, rtol=1e-8)
    for velocity, rate in ((100.0, 600.0), (-100.0, 900.0)):
        slope = damper(jnp.asarray(velocity + 0.5)) - damper(jnp.asarray(velocity - 0.5))
        np.testing.assert_allclose(slope, rate, rtol=1e-4)
    # At the knee, v = 0.2: v (c + (c0 - c) / sqrt 2).
    expected = 0.2 * (600 + 3400 / np.sqrt(2))
    np.testing.assert_allclose(damper(jnp.asarray(0.2)), expected, rtol=1e-13)


def test_bump_stops_stiffen_the_spring_beyond_their_gaps():
    spring = CURVES["spring"]()
    deflection = jnp.array([-0.1, -0.02, 0.01, 0.05, 0.2])
    expected = [-2000 - 3e3 * 0.08, -400, 200, 1000, 4000 + 7e3 * 0.15]
    np.testing.assert_allclose(spring(deflection), expected, rtol=1e-13)


def test_mount_is_odd_cubic_and_scales_as_a_whole():
    mount = CURVES["mount"]()
    x = jnp.array([0.001, 0.01, 0.03])
    np.testing.assert_allclose(mount(x), 4e5 * x + 1e9 * x**3, rtol=1e-14)
    np.testing.assert_array_equal(mount(-x), -mount(x))
    np.testing.assert_allclose(mount.scaled(0.25)(x), 0.25 * mount(x), rtol=1e-14)


def test_symmetric_settings_make_damper_and_spring_odd():
    same = jnp.array([2000.0, 1500.0, 900.0, 800.0])
    x = jnp.asarray(SPEEDS)
    for curve in (
        SplineDamper(jnp.asarray(5000.0), same, same),
        DigressiveDamper(jnp.asarray(4000.0), jnp.full(2, 700.0), jnp.full(2, 0.1)),
        BumpStopSpring(jnp.asarray(2e4), jnp.full(2, 0.03), jnp.full(2, 5e3)),
    ):
        np.testing.assert_allclose(curve(-x), -curve(x), rtol=1e-14)


STATES_TRIED = np.random.default_rng(0).normal(size=(8, 7)) * [
    *(0.03, 0.05, 1.0, 0.5, 0.004, 0.5, 0.6)
]


@pytest.mark.parametrize("state", STATES_TRIED, ids=range(8))
def test_derivative_is_equation_19(state):
    source = built_in(M_w=31, M_b=190, M_e=110, K_t=170e3, K_c=450e3, K_m=390e3, B_m=3800)
    x1, x2, x3, x4, x5, x6, x7 = state
    static_load = (31 + 190 + 110) * 9.81
    tyre = 170e3 * x1 if x1 <= static_load / 170e3 else static_load
    spring, damper = float(source.spring(jnp.asarray(x2))), float(source.damper(jnp.asarray(x7)))
    mount = float(source.mount(jnp.asarray(x5)))
    h = 1e-6
    slope = float(source.damper(jnp.asarray(x7 + h)) - source.damper(jnp.asarray(x7 - h))) / (2 * h)
    expected = [
        0.7 - x3,
        x3 - x4,
        (tyre - spring - damper) / 31,
        (spring + damper - mount - 3800 * (x4 - x6)) / 190,
        x4 - x6,
        (mount + 3800 * (x4 - x6)) / 110,
        450e3 / slope * (x3 - x4 - x7),
    ]
    found = source.derivative(jnp.asarray(state), jnp.array([0.7]))
    # The slope is by differences here.
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(
        source.output(jnp.asarray(state), jnp.array([0.7]))["F_t"], tyre, rtol=1e-13
    )


def test_tyre_force_saturates_at_the_static_load_in_extension_only():
    source = built_in()
    load = 330 * GRAVITY
    np.testing.assert_allclose(source.lift_off_force, load, rtol=1e-14)
    lift_off = load / 180e3
    for extension in (lift_off * 1.0001, 0.1, 5.0):
        np.testing.assert_allclose(source.tyre_force(jnp.asarray(extension)), load, rtol=1e-14)
    for extension in (-0.3, -0.01, 0.0, 0.9 * lift_off):
        np.testing.assert_allclose(source.tyre_force(jnp.asarray(extension)), 180e3 * extension)


def road(rms: float = 0.55, seed: int = 0, count: int = 1600) -> Record:
    key = jax.random.key(seed)
    return Record({"v_r": band_limited_noise(key, count, STEP, bandwidth=30.0, rms=rms)}, STEP)


def test_contact_share_counts_samples_below_lift_off():
    source = built_in()
    record = simulate(source, road(rms=1.5)).checked().record
    share = float(contact_share(record["x1"], source))
    # On the road the force is below the static load; in the air it is the static load.
    expected = np.mean(np.asarray(record["F_t"]) < 330 * 9.81 * (1 - 1e-12))
    np.testing.assert_allclose(share, expected, rtol=1e-12)
    assert 0.5 < share < 1.0
    assert float(jnp.max(record["F_t"])) <= 330 * 9.81 * (1 + 1e-12)


def test_no_input_leaves_the_source_model_at_rest():
    record = simulate(built_in(), Record({"v_r": np.zeros(200)}, STEP)).record
    for name, samples in record.arrays.items():
        np.testing.assert_array_equal(samples, np.zeros(200), err_msg=name)


def test_a_disturbed_source_model_comes_back_to_rest():
    silent = Record({"v_r": np.zeros(2000)}, STEP)
    record = simulate(built_in(), silent, initial_state={"x4": 0.3}).checked().record
    for i in range(1, 8):
        x = np.abs(np.asarray(record[f"x{i}"]))
        assert x[-200:].max() < 1e-3 * x.max()


def test_momentum_of_all_masses_changes_by_the_tyre_force_only():
    source = built_in()
    record = simulate(source, road(), method=FixedStep(16)).checked().record
    rate = 30 * record["dx3"] + 200 * record["dx4"] + 100 * record["dx6"]
    np.testing.assert_allclose(rate, record["F_t"], rtol=1e-9, atol=1e-8)
    # The same over the record: momentum is what the tyre's impulse adds up to.
    momentum = 30 * record["x3"] + 200 * record["x4"] + 100 * record["x6"]
    impulse = scipy.integrate.cumulative_simpson(np.asarray(record["F_t"]), dx=STEP, initial=0)
    # The quadrature's own error: kinks of F_t where the tyre lifts, and 30 Hz at 6.7 samples.
    scatter = np.max(np.abs(momentum - impulse)) / np.max(np.abs(momentum))
    assert scatter < 0.02


def test_states_that_are_differences_stay_consistent_with_the_velocities():
    record = simulate(built_in(), road(), method=FixedStep(16)).checked().record
    np.testing.assert_allclose(record["dx1"], record["v_r"] - record["x3"], atol=1e-12)
    np.testing.assert_allclose(record["dx2"], record["x3"] - record["x4"], atol=1e-12)
    np.testing.assert_allclose(record["dx5"], record["x4"] - record["x6"], atol=1e-12)


@pytest.mark.parametrize(("stiffness", "damping"), [(1e5, 2000.0), (1.5e6, 7750.0)])
def test_mount_settings_scale_the_whole_mount_curve(stiffness, damping):
    source, nominal = built_in(K_m=stiffness, B_m=damping), built_in()
    x = jnp.linspace(-0.02, 0.02, 11)
    np.testing.assert_allclose(source.mount(x), nominal.mount(x) * stiffness / 4e5, rtol=1e-13)
    assert float(source.mount_damping) == damping
