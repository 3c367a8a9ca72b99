"""The whole study: all that the tables, figures and statements of the paper rest on, over roads."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
import pyarrow as pa
from jaxtyping import Array, Float, Key

from riecjax.models.quarter_car.reconstruction import Reconstruction, quarter_car_source
from riecjax.paper.claims import (
    Claim,
    bounded_impulse,
    drop_outs,
    table_claims,
    variation_claims,
    window_errors,
    window_lengths,
)
from riecjax.paper.published import TABLE_6
from riecjax.paper.reproduction import (
    Demonstration,
    LengthMap,
    RoadResult,
    Trajectories,
    WindowErrorMoments,
    demonstrate,
    errors_over_ramps,
    length_map,
    run_road,
    validation_trajectories,
    window_error_moments,
)
from riecjax.paper.variations import (
    Hysteresis,
    Variations,
    VariedStudy,
    hysteresis,
    run_variations,
    varied_study,
)
from riecjax.studies import over_keys


class Scale(NamedTuple):
    """How large a study is.

    **Fields:** `roads` behind the tables; `studied`, roads behind everything else;
    `demonstrations` of Section 2; `bandwidths` in Hz; `draws` of windows on each record.
    """

    roads: int
    studied: int
    demonstrations: int
    bandwidths: tuple[float, ...]
    draws: int


LOW = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5)
"""Hz; here nothing reaches the outer break points of the damper."""
FULL = Scale(
    roads=200,
    studied=24,
    demonstrations=64,
    bandwidths=(*LOW, *(float(f) for f in (*range(4, 17), *range(18, 31, 2)))),
    draws=2,
)
QUICK = Scale(
    roads=8,
    studied=4,
    demonstrations=24,
    bandwidths=(0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0, 12.0, 15.0, 20.0, 30.0),
    draws=1,
)


class PaperStudy(NamedTuple):
    """What was computed.

    **Fields:**

    - `scale`; `roads`, everything of Tables 3 to 5.
    - `demonstrations` of Section 2; `window_errors`, for eq. (18).
    - `lengths`: parameters over alpha and beta. `trajectories`: of Figs 9 and 10.
    - `variations` of Section 6, and the tidy `table` that they were read from.
    - `damper`: its hysteresis. `ramps`: errors on pot-holes of other shapes.
    """

    scale: Scale
    roads: RoadResult
    demonstrations: Demonstration
    window_errors: WindowErrorMoments
    lengths: LengthMap
    trajectories: dict[str, Trajectories]
    variations: VariedStudy
    table: pa.Table
    damper: Hysteresis
    ramps: Float[Array, "ramps roads criteria variants 4"]


Progress = Callable[[str, int, int], None]
"""Called with what is computed, and the numbers of steps done and in all."""


def run_study(
    scale: Scale,
    key: Key[Array, ""],
    shapes: Reconstruction,
    *,
    folder: Path | None = None,
    progress: Progress | None = None,
) -> PaperStudy:
    """Compute it all, with the same roads in every part.

    **Arguments:** `folder`, where finished parts of the variations are kept (see
    [`run_variations`][]).

    **Raises:** `DataError` for a folder that cannot be written to.
    """
    source = quarter_car_source(shapes)
    report = progress or (lambda what, done, of: None)

    def over(what: str, experiment: Callable[..., Any], count: int, *args: Any) -> Any:
        report(what, 0, count)
        return over_keys(
            experiment, key, count, *args, progress=lambda done: report(what, done, count)
        )

    plan = Variations(scale.bandwidths, tuple(TABLE_6), scale.studied, scale.draws)
    what = "bandwidths and engine mounts"
    report(what, 0, 1)
    table = run_variations(
        plan, key, shapes, folder=folder, progress=lambda done, of: report(what, done, of)
    )
    roads = over("roads", run_road, scale.roads, source, shapes)
    few = jax.tree.map(lambda leaf: leaf[: scale.studied], roads)
    demonstrations = over("demonstrations of Section 2", demonstrate, scale.demonstrations)
    report("errors of windows", 0, 1)
    errors = window_error_moments(key, few, source)
    damper = over("hysteresis of the damper", hysteresis, scale.studied, source)
    report("window lengths", 0, 1)
    lengths = length_map(key, source, scale.studied)
    report("trajectories", 0, 1)
    study = PaperStudy(
        scale,
        roads,
        demonstrations,
        errors,
        lengths,
        validation_trajectories(few, key, source, shapes),
        varied_study(plan, table),
        table,
        damper,
        errors_over_ramps(few, source, shapes),
    )
    # NumPy's arrays: JAX would compile a slice for each number that a figure reads.
    return jax.tree.map(lambda leaf: np.asarray(leaf) if eqx.is_array(leaf) else leaf, study)


def evaluate_claims(study: PaperStudy) -> list[Claim]:
    """All 17 statements of the paper, in the order of their numbers."""
    claims = [
        *table_claims(study.roads, study.ramps),
        bounded_impulse(study.demonstrations),
        drop_outs(),
        window_errors(study.window_errors),
        window_lengths(study.lengths),
        *variation_claims(study.variations, study.damper),
    ]
    return sorted(claims, key=lambda claim: claim.id)
