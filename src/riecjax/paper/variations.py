"""Section 6 of the paper: input bandwidth, engine mounts and sampling seeds varied, over roads.

On every road the white noise of Table 2 is cut off at each bandwidth, each of Table 6's source
models is driven with it, and the variant B_id is identified by DOLS and by RIEC with several draws
of windows. All of these models are validated on the two inputs of Section 5.
"""

import contextlib
import hashlib
import io
import json
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Array, Bool, Float, Key

from riecjax import DOLS, FixedStep, Record, simulate
from riecjax.models.quarter_car import QuarterCarSource, Reconstruction, quarter_car_source
from riecjax.paper import reproduction
from riecjax.paper.published import INPUTS, TABLE_6, MountVariant
from riecjax.simulation import low_passed
from riecjax.studies import over_keys
from riecjax.whole_files import Store, stamp

Values = Array | np.ndarray


class RoadVariations(NamedTuple):
    """Roads under one engine mount, at every bandwidth.

    `models` are DOLS, and RIEC with each draw of windows.

    **Fields:** `parameters`; `errors`, p_i of x1 to x4 in percent on each of `INPUTS`; whether all
    simulations behind a model were `successful`.
    """

    parameters: Float[Values, "roads bandwidths models parameters"]
    errors: Float[Values, "roads bandwidths models inputs 4"]
    successful: Bool[Values, "roads bandwidths models"]


def vary_road(
    key: Key[Array, ""],
    mount: MountVariant,
    bandwidths: Float[Array, " bandwidths"],
    shapes: Reconstruction,
    draws: int,
    *,
    method: FixedStep | None = None,
) -> RoadVariations:
    """Simulate, identify and validate on one random road; vmap over keys for many.

    The road of a key is that of [`run_road`][]: at 30 Hz and with the pathological mount, its first
    draw gives the models of Tables 3 to 5.
    """
    source = quarter_car_source(shapes, mount_rate=mount.stiffness, mount_damping=mount.damping)
    keys, criteria = reproduction.road_keys(key), reproduction.paper_criteria()
    noise = reproduction.training_noise(keys.training)
    # Windows are drawn by the road's own key first.
    rest = jax.random.split(jax.random.fold_in(keys.windows, 1), draws - 1)
    drawn = jnp.stack([keys.windows, *(rest[i] for i in range(draws - 1))])

    def identified(bandwidth: Array) -> tuple[Array, Array]:
        driven = Record({"v_r": low_passed(noise, reproduction.STEP, bandwidth)}, reproduction.STEP)
        training = simulate(source, driven, method=method)
        by_riec = jax.vmap(
            lambda key: reproduction.by_body(training.record, criteria["RIEC"], key)
        )(drawn)
        by_dols = reproduction.by_body(training.record, criteria["DOLS"])
        return jnp.concatenate([by_dols[None], by_riec]), training.successful

    parameters, trained = jax.vmap(identified)(bandwidths)
    inputs = reproduction.validation_inputs(keys.validation, shapes)
    errors, predicted = reproduction.validation_errors(parameters, source, inputs, method)
    return RoadVariations(parameters, errors, trained[:, None] & predicted)


MODELS = {"DOLS": slice(0, 1), "RIEC": slice(1, None)}


class VariedStudy(NamedTuple):
    """What was found in each case of Table 6, in NumPy's arrays, at `bandwidths` in Hz."""

    bandwidths: Float[np.ndarray, " bandwidths"]
    cases: dict[str, RoadVariations]

    def identified(
        self, case: str, method: str, *names: str
    ) -> Float[np.ndarray, "roads bandwidths names"]:
        """Parameters in SI units, mean over the draws of windows."""
        values = np.asarray(self.cases[case].parameters)[:, :, MODELS[method]].mean(axis=2)
        return values[..., [reproduction.PARAMETERS.index(name) for name in names]]

    def summed_error(
        self, case: str, method: str, where: str
    ) -> Float[np.ndarray, "roads bandwidths"]:
        """p_1 + ... + p_4 in percent, mean over draws; infinite where a simulation was lost."""
        models = MODELS[method]
        errors = self.cases[case].errors[:, :, models, INPUTS.index(where)].sum(axis=-1)
        kept = self.cases[case].successful[:, :, models] & np.isfinite(errors)
        return np.where(kept, errors, np.inf).mean(axis=-1)


ROADS_TO_A_PART = 4
MOST_KEPT = 2**40
"""Bytes of finished parts: all of them."""


def run_variations(
    key: Key[Array, ""],
    shapes: Reconstruction,
    bandwidths: tuple[float, ...],
    roads: int,
    draws: int,
    *,
    folder: Path | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> VariedStudy:
    """Each case of Table 6 on all roads, at bandwidths in Hz, with so many draws of windows.

    **Arguments:**

    - `folder`: where finished parts are kept if it can be written, some roads under one mount in
      each. Those of an interrupted study with the same numbers, key and versions are taken up.
    - `progress`: called with the numbers of finished and of all parts.
    """
    # What a part's numbers depend on.
    depends_on = {
        "plan": (bandwidths, roads, draws),
        "key": np.asarray(jax.random.key_data(key)).tolist(),
        "versions": [version(name) for name in ("riecjax", "jax", "jaxlib")],
        "precision": str(jnp.zeros(()).dtype),
    }
    settings = hashlib.sha256(json.dumps(depends_on).encode()).hexdigest()
    if folder is not None:
        with contextlib.suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
    store = None if folder is None else Store(folder, ".part", MOST_KEPT)
    places = [(case, first) for case in TABLE_6 for first in range(0, roads, ROADS_TO_A_PART)]
    parts: dict[str, list[RoadVariations]] = {case: [] for case in TABLE_6}
    for done, (case, first) in enumerate(places, 1):
        name, part = f"{case}-{first:05d}-{settings}", None
        if store is not None and (content := store.get(name)) is not None:
            with contextlib.suppress(Exception):  # what is damaged is made anew
                part = RoadVariations(**np.load(io.BytesIO(content)))
        if part is None:
            # Arrays, so that all mounts share what is compiled.
            mount, arrays = jax.tree.map(jnp.asarray, (TABLE_6[case], shapes))
            count, bands = min(ROADS_TO_A_PART, roads - first), jnp.asarray(bandwidths)
            settled = (mount, bands, arrays, draws)
            computed = over_keys(vary_road, key, count, *settled, first=first, chunk=count)
            part = jax.tree.map(np.asarray, computed)
            if store is not None:
                np.savez(content := io.BytesIO(), **part._asdict())
                store.put(name, content.getvalue())
        parts[case].append(part)
        progress(done, len(places))
    cases = {case: RoadVariations(*map(np.concatenate, zip(*some))) for case, some in parts.items()}
    return VariedStudy(np.array(bandwidths), cases)


UNITS = {"K_t": "N/m", "M_us": "kg", "M_s": "kg", "K_s": "N/m"} | dict.fromkeys(
    reproduction.FORCES, "N"
)


def variations_table(study: VariedStudy) -> pa.Table:
    """A row for each case, road, bandwidth, method and draw of windows.

    Errors are infinite where a model lost its solution.
    """
    tables = []
    for case, varied in study.cases.items():
        roads, bandwidths, models = varied.successful.shape
        # DOLS has no draws; RIEC's are numbered.
        methods = [("DOLS", 0), *(("RIEC", draw) for draw in range(models - 1))]
        road, band, model = (axis.ravel() for axis in np.indices((roads, bandwidths, models)))
        parameters = varied.parameters.reshape(-1, len(reproduction.PARAMETERS))
        simulated = varied.successful.ravel()
        errors = varied.errors.reshape(simulated.size, -1)
        errors = np.where(simulated[:, None] & np.isfinite(errors), errors, np.inf)
        states = range(1, 1 + len(reproduction.VALIDATED_STATES))
        names = [f"{where} p_{i} [%]" for where in INPUTS for i in states]
        columns = {
            "case": [case] * road.size,
            "road": road.astype(np.int32),
            "bandwidth [Hz]": study.bandwidths[band],
            "method": [methods[m][0] for m in model],
            "draw": np.array([methods[m][1] for m in model], np.int32),
            **{
                f"{n} [{UNITS[n]}]": parameters[:, i] for i, n in enumerate(reproduction.PARAMETERS)
            },
            **{name: errors[:, i] for i, name in enumerate(names)},
            "simulated": simulated,
        }
        tables.append(pa.table(columns))
    return pa.concat_tables(tables)


def write_variations(study: VariedStudy, file: Path) -> None:
    """The table as one Parquet file, whose pages have checksums and which bears a [`stamp`][].

    **Raises:** `OSError` for a file that cannot be written.
    """
    table = variations_table(study).replace_schema_metadata({b"riecjax": stamp(file)})
    pq.write_table(table, file, write_page_checksum=True)


BANDWIDTHS = (6.0, 15.0, 30.0)
"""Hz of Fig. 13: low, from where DOLS drifts, and high."""
STIFFER = 4.0
"""Factor on K_c that makes the damper follow the suspension more closely."""
METHOD = FixedStep(12)
"""A stiffer damper needs shorter steps: K_c over its least slope is 3500 per second."""


class Hysteresis(eqx.Module):
    """One road at each of `BANDWIDTHS`, with the source's own compliance and a stiffer one.

    **Fields:** `velocity` of the suspension in m/s and `force` of the damper in N, of the source's
    own compliance; `width`, r.m.s. of the force's distance from the damper's curve at this
    velocity, over its r.m.s.; `by_dols`, what DOLS identifies (variant B_id).
    """

    velocity: Float[Array, "bandwidths n"]
    force: Float[Array, "bandwidths n"]
    width: Float[Array, "compliances bandwidths"]
    by_dols: Float[Array, "compliances bandwidths parameters"]


def hysteresis(key: Key[Array, ""], source: QuarterCarSource) -> Hysteresis:
    """What the damper's compliance does to its force, and to identified damper maps (Fig. 13).

    On one random road; vmap over keys for many.
    """
    noise = reproduction.training_noise(reproduction.road_keys(key).training)

    def at(compliance: Array, bandwidth: Array) -> Hysteresis:
        model = eqx.tree_at(lambda s: s.damper_compliance, source, compliance)
        driven = Record({"v_r": low_passed(noise, reproduction.STEP, bandwidth)}, reproduction.STEP)
        record = simulate(model, driven, method=METHOD).record
        relative = record["x3"] - record["x4"]
        force = source.damper(record["x7"])
        off = force - source.damper(relative)
        width = jnp.sqrt(jnp.mean(off**2) / jnp.mean(force**2))
        return Hysteresis(relative, force, width, reproduction.by_body(record, DOLS()))

    compliances = jnp.asarray(source.damper_compliance) * jnp.array([1.0, STIFFER])
    over_bandwidths = jax.vmap(at, in_axes=(None, 0))
    both = jax.vmap(over_bandwidths, in_axes=(0, None))(compliances, jnp.array(BANDWIDTHS))
    return Hysteresis(both.velocity[0], both.force[0], both.width, both.by_dols)
