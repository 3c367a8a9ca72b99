"""Bookkeeping of the study: parts, resumption, the tidy table. The experiment is a stand-in."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from riecjax.models.quarter_car.reconstruction import reconstructed
from riecjax.paper import variations as variation_study
from riecjax.paper.reproduction import PARAMETERS
from riecjax.paper.variations import (
    RoadVariations,
    Variations,
    parts_of,
    run_variations,
    varied_study,
)

PLAN = Variations((5.0, 30.0, 12.0), ("pathological", "higher-mode"), 6, 2)
KEY = jax.random.key(3)
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
    monkeypatch.setattr(variation_study, "vary_road", stand_in)


def run(folder: Path | None = None, plan: Variations = PLAN, key=KEY, stop: int | None = None):
    def progress(done: int, total: int) -> None:
        if done == stop:
            raise KeyboardInterrupt

    return run_variations(plan, key, reconstructed(), folder=folder, progress=progress)


def test_rows_hold_what_the_experiment_found():
    table = run().to_pandas()
    mount = jax.tree.map(jnp.asarray, variation_study.TABLE_6["higher-mode"])
    alone = stand_in(jax.random.fold_in(KEY, 4), mount, jnp.array(PLAN.bandwidths), None, 2)
    row = table[
        (table["case"] == "higher-mode")
        & (table["road"] == 4)
        & (table["bandwidth [Hz]"] == 12.0)
        & (table["method"] == "RIEC")
        & (table["draw"] == 1)
    ].iloc[0]
    np.testing.assert_allclose(row["M_us [kg]"], alone.parameters[2, 2, 1], rtol=1e-12)
    np.testing.assert_allclose(row["pothole p_3 [%]"], alone.errors[2, 2, 1, 2], rtol=1e-12)


@pytest.mark.parametrize("stop", [1, 3])
def test_an_interrupted_study_goes_on_to_the_same_table(tmp_path, stop):
    expected = run()
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, stop=stop)
    kept = {path.name for path in tmp_path.iterdir()}
    assert kept == {part.file for part in parts_of(PLAN)[:stop]}
    RUNS.clear()
    assert run(tmp_path).equals(expected)
    jax.effects_barrier()
    assert len(RUNS) == len(parts_of(PLAN)) - stop


def test_parts_of_another_study_are_not_taken(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, key=jax.random.key(4), stop=2)
    assert run(tmp_path).equals(run())


def test_a_broken_part_is_computed_anew(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, stop=2)
    (tmp_path / parts_of(PLAN)[0].file).write_bytes(b"PAR1 cut off")
    assert run(tmp_path).equals(run())


def test_arrays_are_the_table_s_numbers():
    table = run()
    study = varied_study(PLAN, table)
    frame = table.to_pandas()
    found = study.found["pathological"]["RIEC"]
    assert found.parameters["K_s"].shape == (6, 3, 2)
    assert set(found.parameters) == set(PARAMETERS)
    for road, band, draw in ((0, 0, 0), (5, 2, 1), (3, 1, 0)):
        row = frame[
            (frame["case"] == "pathological")
            & (frame["road"] == road)
            & (frame["bandwidth [Hz]"] == PLAN.bandwidths[band])
            & (frame["method"] == "RIEC")
            & (frame["draw"] == draw)
        ].iloc[0]
        assert found.parameters["K_s"][road, band, draw] == row["K_s [N/m]"]
        each = [row[f"road p_{i} [%]"] for i in range(1, 5)]
        assert found.each["road"][road, band, draw].tolist() == each
        assert found.errors["road"][road, band, draw] == pytest.approx(sum(each))
