"""Bookkeeping of the study: the tidy table. The experiment is a stand-in."""

import jax
import jax.numpy as jnp
import numpy as np

from riecjax.paper.published import TABLE_6
from riecjax.paper.reproduction import RoadVariations, VariedStudy, variations_table
from riecjax.studies import over_keys

BANDWIDTHS = (5.0, 30.0, 12.0)
KEY = jax.random.key(3)


def stand_in(key, mount, bandwidths, shapes, draws):
    """Numbers that depend on the road, the mount and the bandwidth, and a loss on each road."""
    theta = jax.random.normal(key, (bandwidths.shape[0], 1 + draws, 8)) + mount.stiffness
    errors = jax.random.uniform(key, (bandwidths.shape[0], 1 + draws, 2, 4)) * bandwidths.mean()
    kept = jnp.ones((bandwidths.shape[0], 1 + draws), bool).at[0, 1].set(False)
    return RoadVariations(theta + bandwidths[:, None, None], errors, kept)


def test_rows_hold_what_the_experiment_found():
    mounts = {case: jax.tree.map(jnp.asarray, mount) for case, mount in TABLE_6.items()}
    settled = jnp.array(BANDWIDTHS), None, 2
    cases = {case: over_keys(stand_in, KEY, 6, mount, *settled) for case, mount in mounts.items()}
    study = VariedStudy(np.array(BANDWIDTHS), jax.tree.map(np.asarray, cases))
    table = variations_table(study).to_pandas()
    alone = stand_in(jax.random.fold_in(KEY, 4), mounts["higher-mode"], *settled)
    chosen = (table["case"] == "higher-mode") & (table["road"] == 4) & (table["method"] == "RIEC")
    rows = table[chosen & (table["draw"] == 1)].set_index("bandwidth [Hz]")
    np.testing.assert_allclose(rows["M_us [kg]"][12.0], alone.parameters[2, 2, 1], rtol=1e-12)
    np.testing.assert_allclose(rows["pothole p_3 [%]"][12.0], alone.errors[2, 2, 1, 2], rtol=1e-12)
    # Figures and statements read the mean over draws, and no error where a simulation was lost.
    both = alone.parameters[:, 1:, 1].mean(axis=1)
    np.testing.assert_allclose(study.identified("higher-mode", "RIEC", "M_us")[4, :, 0], both)
    errors = alone.errors[:, 1:, 1].sum(axis=-1).mean(axis=1).at[0].set(np.inf)
    np.testing.assert_allclose(study.summed_error("higher-mode", "RIEC", "pothole")[4], errors)
    assert not table["simulated"][table["bandwidth [Hz]"] == 5.0].all()
