"""Section 6 on one road: the same models as those of Tables 3 to 5, where settings are the same."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from riecjax.models.quarter_car.reconstruction import quarter_car_source, reconstructed
from riecjax.paper import reproduction
from riecjax.paper.published import CRITERIA, TABLE_2, TABLE_6, VARIANTS
from riecjax.simulation.inputs import low_passed
from riecjax.simulation.method import FixedStep

# Coarse steps: what is tested is that ways of computing agree, not how accurately.
METHOD = FixedStep(2)
KEY = jax.random.key(7)
SHAPES = jax.tree.map(jnp.asarray, reconstructed())


@pytest.fixture(scope="module")
def varied() -> reproduction.RoadVariations:
    mount = jax.tree.map(jnp.asarray, TABLE_6["pathological"])
    bandwidths = jnp.array([12.0, TABLE_2.bandwidth])
    return eqx.filter_jit(reproduction.vary_road)(KEY, mount, bandwidths, SHAPES, 2, method=METHOD)


@pytest.fixture(scope="module")
def tables() -> reproduction.RoadResult:
    return eqx.filter_jit(reproduction.run_road)(
        KEY, quarter_car_source(shapes=SHAPES), SHAPES, method=METHOD
    )


def test_components_above_the_bandwidth_are_removed_and_the_others_kept():
    time = jnp.arange(400) / 200
    low, high = jnp.sin(2 * jnp.pi * 5 * time + 0.3), jnp.cos(2 * jnp.pi * 12 * time)
    np.testing.assert_allclose(low_passed(2.0 + low + high, 1 / 200, 8.0), 2.0 + low, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(("model", "criterion"), [(0, "DOLS"), (1, "RIEC")])
def test_at_the_bandwidth_of_table_2_models_are_those_of_the_tables(
    varied, tables, model, criterion
):
    place = CRITERIA.index(criterion), VARIANTS.index("B_id")
    np.testing.assert_allclose(varied.parameters[1, model], tables.parameters[place], rtol=1e-7)
    np.testing.assert_allclose(varied.errors[1, model], tables.errors[place], rtol=1e-6)


@pytest.fixture(scope="module")
def damper() -> reproduction.Hysteresis:
    return eqx.filter_jit(reproduction.hysteresis)(KEY, quarter_car_source(shapes=SHAPES))


@pytest.mark.slow
def test_hysteresis_is_the_damper_s_distance_from_its_curve(damper):
    source = quarter_car_source(shapes=SHAPES)
    record = reproduction.identification_record(
        source, reproduction.road_keys(KEY).training, method=FixedStep(12)
    ).record
    force = source.damper(record["x7"])
    off = force - source.damper(record["x3"] - record["x4"])
    expected = np.sqrt(np.mean(np.asarray(off) ** 2) / np.mean(np.asarray(force) ** 2))
    place = reproduction.BANDWIDTHS.index(TABLE_2.bandwidth)
    np.testing.assert_allclose(damper.width[0, place], expected, rtol=1e-6)
    np.testing.assert_allclose(damper.force[place], force, rtol=1e-6, atol=1e-6)
