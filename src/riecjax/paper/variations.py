"""Section 6 of the paper: input bandwidth, engine mounts and sampling seeds varied, over roads.

On every road the white noise of Table 2 is cut off at each bandwidth, each of Table 6's source
models is driven with it, and the variant B_id is identified by DOLS and by RIEC with several draws
of windows. All of these models are validated on the two inputs of Section 5.
"""

import contextlib
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

from riecjax import DOLS, DataError, FixedStep, Record, simulate
from riecjax.models.quarter_car.reconstruction import Reconstruction, quarter_car_source
from riecjax.models.quarter_car.source import QuarterCarSource
from riecjax.paper.published import TABLE_2, TABLE_6, MountVariant
from riecjax.paper.reproduction import (
    INPUTS,
    PARAMETERS,
    VALIDATED_STATES,
    by_body,
    paper_criteria,
    prediction_errors,
    road_keys,
    training_noise,
    validation_inputs,
)
from riecjax.simulation import low_passed
from riecjax.studies import over_keys


class Variations(NamedTuple):
    """What is varied.

    **Fields:** `bandwidths` of the input in Hz; `cases` of Table 6 by name; `roads`, their number;
    `draws` of random windows on each record.
    """

    bandwidths: tuple[float, ...]
    cases: tuple[str, ...]
    roads: int
    draws: int


class RoadVariations(eqx.Module):
    """One road under one engine mount, at every bandwidth.

    `models` are DOLS, and RIEC with each draw of windows.

    **Fields:** `parameters` in the order of `PARAMETERS`; `errors`, p_i of x1 to x4 in percent for
    each of `INPUTS`; whether all simulations behind a model were `successful`.
    """

    parameters: Float[Array, "bandwidths models parameters"]
    errors: Float[Array, "bandwidths models inputs 4"]
    successful: Bool[Array, "bandwidths models"]


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
    keys = road_keys(key)
    step = 1 / TABLE_2.rate
    noise = training_noise(keys.training)
    driven = jax.vmap(lambda bandwidth: low_passed(noise, step, bandwidth))(bandwidths)

    def identified(velocity: Array) -> tuple[Array, Array]:
        training = simulate(source, Record({"v_r": velocity}, step), method=method)
        return identify_by_body(training.record, keys.windows, draws), training.successful

    parameters, trained = jax.vmap(identified)(driven)
    models = {name: parameters[..., i] for i, name in enumerate(PARAMETERS)}
    errors, successful = [], trained[:, None]
    for velocity in validation_inputs(keys.validation, shapes).values():
        truth = simulate(source, Record({"v_r": velocity}, step), method=method)
        found, predicted = jax.vmap(
            jax.vmap(lambda model, t=truth: prediction_errors(model, t.record, method))
        )(models)
        errors.append(found)
        successful = successful & truth.successful & predicted
    return RoadVariations(parameters, jnp.stack(errors, axis=2), successful)


def identify_by_body(
    record: Record, key: Key[Array, ""], draws: int
) -> Float[Array, "models parameters"]:
    """The variant B_id by DOLS, and by RIEC with so many draws of windows; the first is `key`'s."""
    criteria = paper_criteria()
    rest = jax.random.split(jax.random.fold_in(key, 1), draws - 1)
    drawn = jnp.stack([key, *(rest[i] for i in range(draws - 1))])
    by_riec = jax.vmap(lambda each: by_body(record, criteria["RIEC"], each))(drawn)
    return jnp.concatenate([by_body(record, criteria["DOLS"])[None], by_riec])


ROADS_TO_A_PART = 4
UNITS = {"K_t": "N/m", "M_us": "kg", "M_s": "kg", "K_s": "N/m"} | {
    f"F_{i}": "N" for i in range(1, 5)
}
ERRORS = tuple(f"{where} p_{i + 1} [%]" for where in INPUTS for i in range(len(VALIDATED_STATES)))
"""Columns of validation errors: infinite where a model lost its solution."""
SETTINGS = b"riecjax.variations"


class Part(NamedTuple):
    """Some roads under one mount; `stop` is not included."""

    case: str
    first: int
    stop: int

    @property
    def file(self) -> str:
        """Name of its file."""
        return f"{self.case}-{self.first:05d}.part"


def parts_of(plan: Variations) -> list[Part]:
    """The parts of a study, in the order of the table."""
    return [
        Part(case, first, min(first + ROADS_TO_A_PART, plan.roads))
        for case in plan.cases
        for first in range(0, plan.roads, ROADS_TO_A_PART)
    ]


def run_variations(
    plan: Variations,
    key: Key[Array, ""],
    shapes: Reconstruction,
    *,
    folder: Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> pa.Table:
    """The tidy table: a row for each case, road, bandwidth, method and draw of windows.

    **Arguments:**

    - `folder`: where finished parts are kept until the table is whole. Those of an interrupted
      study with the same plan, key and versions are taken up; others are computed anew.
    - `progress`: called with the numbers of finished and of all parts.

    **Raises:** `DataError` for a folder that cannot be written to.
    """
    # What a part's numbers depend on.
    depends_on = {
        "plan": plan._asdict(),
        "key": np.asarray(jax.random.key_data(key)).tolist(),
        "versions": {name: version(name) for name in ("riecjax", "jax", "jaxlib")},
        "precision": str(jnp.zeros(()).dtype),
    }
    settings = json.dumps(depends_on, sort_keys=True).encode()
    parts = parts_of(plan)
    tables = []
    for done, part in enumerate(parts):
        table = None
        if folder is not None:
            with contextlib.suppress(OSError, pa.ArrowException):  # what is damaged is made anew
                table = pq.read_table(folder / part.file, page_checksum_verification=True)
        if table is None or (table.schema.metadata or {}).get(SETTINGS) != settings:
            # Arrays, so that all mounts share what is compiled.
            found = over_keys(
                vary_road,
                key,
                part.stop - part.first,
                jax.tree.map(jnp.asarray, TABLE_6[part.case]),
                jnp.asarray(plan.bandwidths),
                jax.tree.map(jnp.asarray, shapes),
                plan.draws,
                first=part.first,
                chunk=ROADS_TO_A_PART,
            )
            table = _table(plan, part, found, settings)
            if folder is not None:
                # Renamed when it is whole: an interruption leaves no broken file behind.
                temporary = (folder / part.file).with_suffix(".tmp")
                try:
                    folder.mkdir(parents=True, exist_ok=True)
                    pq.write_table(table, temporary, write_page_checksum=True)
                    temporary.replace(folder / part.file)
                except OSError as error:
                    said = error.strerror or error
                    raise DataError(f"cannot write '{folder / part.file}': {said}.") from None
        tables.append(table)
        if progress is not None:
            progress(done + 1, len(parts))
    return pa.concat_tables(tables)


def write_variations(table: pa.Table, file: Path, stamp: str = "") -> None:
    """The whole table as one Parquet file, whose pages have checksums, and which says `stamp`.

    **Raises:** `OSError` for a file that cannot be written.
    """
    table = table.replace_schema_metadata({**(table.schema.metadata or {}), b"riecjax": stamp})
    pq.write_table(table, file, write_page_checksum=True)


def _table(plan: Variations, part: Part, found: RoadVariations, settings: bytes) -> pa.Table:
    roads = np.arange(part.first, part.stop)
    # DOLS has no draws; RIEC's are numbered.
    models = [("DOLS", 0), *(("RIEC", draw) for draw in range(plan.draws))]
    grid = np.meshgrid(
        roads, np.arange(len(plan.bandwidths)), np.arange(len(models)), indexing="ij"
    )
    road, band, model = (axis.ravel() for axis in grid)
    parameters = np.asarray(found.parameters).reshape(-1, len(PARAMETERS))
    simulated = np.asarray(found.successful).reshape(-1)
    errors = np.asarray(found.errors).reshape(-1, len(ERRORS))
    errors = np.where(simulated[:, None] & np.isfinite(errors), errors, np.inf)
    columns: dict[str, object] = {
        "case": pa.array([part.case] * road.size),
        "road": road.astype(np.int32),
        "bandwidth [Hz]": np.array(plan.bandwidths)[band],
        "method": pa.array([models[m][0] for m in model]),
        "draw": np.array([models[m][1] for m in model], np.int32),
        **{f"{name} [{UNITS[name]}]": parameters[:, i] for i, name in enumerate(PARAMETERS)},
        **{name: errors[:, i] for i, name in enumerate(ERRORS)},
        "simulated": simulated,
    }
    return pa.table(columns).replace_schema_metadata({SETTINGS: settings})


class Varied(NamedTuple):
    """The models of one case and method, in arrays read off the table.

    **Fields:** `parameters` by name, in SI units; `errors`, the sum of p_i over x1 to x4 in
    percent, by input; `each` of the four.
    """

    parameters: dict[str, Float[np.ndarray, "roads bandwidths draws"]]
    errors: dict[str, Float[np.ndarray, "roads bandwidths draws"]]
    each: dict[str, Float[np.ndarray, "roads bandwidths draws 4"]]


class VariedStudy(NamedTuple):
    """The whole study: its plan, and by case and method what was found."""

    plan: Variations
    found: dict[str, dict[str, Varied]]

    @property
    def bandwidths(self) -> Float[np.ndarray, " bandwidths"]:
        """Hz."""
        return np.array(self.plan.bandwidths)

    def by_case(self) -> list[tuple[str, dict[str, Varied]]]:
        """In the order of the plan."""
        return [(case, self.found[case]) for case in self.plan.cases]


def varied_study(plan: Variations, table: pa.Table) -> VariedStudy:
    """The table in arrays."""
    found: dict[str, dict[str, Varied]] = {}
    case, method = (np.array(table[name].to_pylist()) for name in ("case", "method"))
    for name in plan.cases:
        for kind in ("RIEC", "DOLS"):
            chosen = (case == name) & (method == kind)
            shape = (plan.roads, len(plan.bandwidths), plan.draws if kind == "RIEC" else 1)

            def column(label: str, rows: np.ndarray = chosen, shape=shape) -> np.ndarray:
                return table[label].to_numpy()[rows].reshape(shape)

            each = {
                where: np.stack([column(e) for e in ERRORS if e.startswith(where)], axis=-1)
                for where in INPUTS
            }
            found.setdefault(name, {})[kind] = Varied(
                {n: column(f"{n} [{UNITS[n]}]") for n in PARAMETERS},
                {where: errors.sum(axis=-1) for where, errors in each.items()},
                each,
            )
    return VariedStudy(plan, found)


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
    keys, step = road_keys(key), 1 / TABLE_2.rate
    noise = training_noise(keys.training)

    def at(compliance: Array, bandwidth: Array) -> Hysteresis:
        model = eqx.tree_at(lambda s: s.damper_compliance, source, compliance)
        driven = Record({"v_r": low_passed(noise, step, bandwidth)}, step)
        record = simulate(model, driven, method=METHOD).record
        relative = record["x3"] - record["x4"]
        force = source.damper(record["x7"])
        off = force - source.damper(relative)
        width = jnp.sqrt(jnp.mean(off**2) / jnp.mean(force**2))
        return Hysteresis(relative, force, width, by_body(record, DOLS()))

    compliances = jnp.asarray(source.damper_compliance) * jnp.array([1.0, STIFFER])
    over_bandwidths = jax.vmap(at, in_axes=(None, 0))
    found = jax.vmap(over_bandwidths, in_axes=(0, None))(compliances, jnp.array(BANDWIDTHS))
    return Hysteresis(found.velocity[0], found.force[0], found.width, found.by_dols)
