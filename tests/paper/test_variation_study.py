"""Bookkeeping of the study. The experiment is a stand-in."""

import jax
import jax.numpy as jnp
import numpy as np

from riecjax.paper.published import TABLE_6
from riecjax.paper.reproduction import RoadVariations, VariedStudy
from riecjax.studies import over_keys

BANDWIDTHS = (5.0, 30.0, 12.0)
KEY = jax.random.key(3)


def stand_in(key, mount, bandwidths, shapes, draws):
    """Numbers that depend on the road, the mount and the bandwidth, and a loss on each road."""
    theta = jax.random.normal(key, (bandwidths.shape[0], 1 + draws, 8)) + mount.stiffness
    errors = jax.random.uniform(key, (bandwidths.shape[0], 1 + draws, 2, 4)) * bandwidths.mean()
    kept = jnp.ones((bandwidths.shape[0], 1 + draws), bool).at[0, 1].set(False)
    return RoadVariations(theta + bandwidths[:, None, None], errors, kept)


def test_figures_and_statements_read_the_mean_over_draws_and_no_error_of_a_lost_simulation():
    mounts = {case: jax.tree.map(jnp.asarray, mount) for case, mount in TABLE_6.items()}
    settled = jnp.array(BANDWIDTHS), None, 2
    cases = {case: over_keys(stand_in, KEY, 6, mount, *settled) for case, mount in mounts.items()}
    study = VariedStudy(np.array(BANDWIDTHS), jax.tree.map(np.asarray, cases))
    alone = stand_in(jax.random.fold_in(KEY, 4), mounts["higher-mode"], *settled)
    both = alone.parameters[:, 1:, 1].mean(axis=1)
    np.testing.assert_allclose(study.identified("higher-mode", "RIEC", "M_us")[4, :, 0], both)
    errors = alone.errors[:, 1:, 1].sum(axis=-1).mean(axis=1).at[0].set(np.inf)
    np.testing.assert_allclose(study.summed_error("higher-mode", "RIEC", "pothole")[4], errors)
