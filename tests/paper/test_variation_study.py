"""Bookkeeping of the study: parts, resumption, the tidy table. The experiment is a stand-in."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from riecjax.models.quarter_car.reconstruction import reconstructed
from riecjax.paper import reproduction
from riecjax.paper.reproduction import RoadVariations, VariedStudy, run_variations, variations_table

BANDWIDTHS = (5.0, 30.0, 12.0)
KEY = jax.random.key(3)
PARTS = 6
"""Two of six roads for each mount."""
RUNS = []


def stand_in(key, mount, bandwidths, shapes, draws):
    """Numbers that depend on the road, the mount and the bandwidth, and a loss on each road."""
    jax.debug.callback(lambda: RUNS.append(1))
    theta = jax.random.normal(key, (bandwidths.shape[0], 1 + draws, 8)) + mount.stiffness
    errors = jax.random.uniform(key, (bandwidths.shape[0], 1 + draws, 2, 4)) * bandwidths.mean()
    kept = jnp.ones((bandwidths.shape[0], 1 + draws), bool).at[0, 1].set(False)
    return RoadVariations(theta + bandwidths[:, None, None], errors, kept)


@pytest.fixture(autouse=True)
def no_simulation(monkeypatch):
    monkeypatch.setattr(reproduction, "vary_road", stand_in)


def run(folder: Path | None = None, key=KEY, stop: int | None = None) -> VariedStudy:
    def progress(done: int, total: int) -> None:
        assert total == PARTS
        if done == stop:
            raise KeyboardInterrupt

    shapes = reconstructed()
    return run_variations(key, shapes, BANDWIDTHS, 6, 2, folder=folder, progress=progress)


def assert_same(study: VariedStudy, expected: VariedStudy) -> None:
    assert variations_table(study).equals(variations_table(expected))


def test_rows_hold_what_the_experiment_found():
    study = run()
    table = variations_table(study).to_pandas()
    mount = jax.tree.map(jnp.asarray, reproduction.TABLE_6["higher-mode"])
    alone = stand_in(jax.random.fold_in(KEY, 4), mount, jnp.array(BANDWIDTHS), None, 2)
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


@pytest.mark.parametrize("stop", [1, 3])
def test_an_interrupted_study_goes_on_to_the_same_table(tmp_path, stop):
    expected = run()
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, stop=stop)
    assert len(list(tmp_path.iterdir())) == stop
    RUNS.clear()
    assert_same(run(tmp_path), expected)
    jax.effects_barrier()
    assert len(RUNS) == PARTS - stop


def test_parts_of_another_study_are_not_taken(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, key=jax.random.key(4), stop=2)
    assert_same(run(tmp_path), run())


@pytest.mark.parametrize("damaged", [b"PAR1 cut off", None])
def test_a_broken_part_is_computed_anew(tmp_path, damaged):
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, stop=2)
    file = min(tmp_path.iterdir())
    whole = file.read_bytes()
    place = len(whole) // 2
    flipped = whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :]
    file.write_bytes(damaged or flipped)
    assert_same(run(tmp_path), run())
