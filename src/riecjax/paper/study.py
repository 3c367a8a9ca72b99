"""The whole study: all that the tables, figures and statements of the paper rest on, over roads."""

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key

from riecjax.models.quarter_car import Reconstruction, quarter_car_source
from riecjax.paper import reproduction
from riecjax.paper.variations import Hysteresis, VariedStudy, hysteresis, run_variations
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


class Further(NamedTuple):
    """What a whole study has beyond Tables 3 to 5.

    **Fields:** its `scale`; `variations` of Section 6; `demonstrations` of Section 2;
    `window_errors`, for eq. (18); `lengths`, parameters over the `PAIRS` of alpha and beta;
    `trajectories` of Figs 9 and 10; the `damper`'s hysteresis; `ramps`, errors on pot-holes of
    other shapes.
    """

    scale: Scale
    variations: VariedStudy
    demonstrations: reproduction.Demonstration
    window_errors: reproduction.WindowErrorMoments
    lengths: Float[Array, "roads pairs parameters"]
    trajectories: dict[str, reproduction.Trajectories]
    damper: Hysteresis
    ramps: Float[Array, "ramps roads criteria variants 4"]


class PaperStudy(NamedTuple):
    """What was computed: `roads`, all of Tables 3 to 5, and what is `further` in a whole study."""

    roads: reproduction.RoadResult
    further: Further | None = None

    @property
    def road_count(self) -> int:
        """Number of roads behind the tables."""
        return int(np.size(self.roads.contact))


def run_study(
    scale: Scale | int,
    key: Key[Array, ""],
    shapes: Reconstruction,
    *,
    folder: Path | None = None,
    progress: Callable[[str, int, int], None] = lambda what, done, total: None,
) -> PaperStudy:
    """Compute it, with the same roads in every part.

    **Arguments:**

    - `scale` of the whole study, or a number of roads for the tables alone.
    - `folder`, where finished parts of the variations are kept (see [`run_variations`][]).
    - `progress`: called with what is computed, and the numbers of steps done and in all.
    """
    source = quarter_car_source(shapes)

    def over(what: str, experiment: Callable[..., Any], count: int, *args: Any) -> Any:
        progress(what, 0, count)
        return over_keys(
            experiment, key, count, *args, progress=lambda done: progress(what, done, count)
        )

    if isinstance(scale, int):
        return PaperStudy(over("roads", reproduction.run_road, scale, source, shapes))
    what = "bandwidths and engine mounts"
    progress(what, 0, 1)
    report = functools.partial(progress, what)
    plan = (scale.bandwidths, scale.studied, scale.draws)
    variations = run_variations(key, shapes, *plan, folder=folder, progress=report)
    roads = over("roads", reproduction.run_road, scale.roads, source, shapes)
    few = jax.tree.map(lambda leaf: leaf[: scale.studied], roads)
    demonstrations = over(
        "demonstrations of Section 2", reproduction.demonstrate, scale.demonstrations
    )
    progress("errors of windows", 0, 1)
    errors = reproduction.window_error_moments(key, few, source)
    damper = over("hysteresis of the damper", hysteresis, scale.studied, source)
    pairs = jnp.asarray(reproduction.PAIRS)
    lengths = over(
        "window lengths", reproduction.estimates_over_lengths, scale.studied, source, pairs
    )
    progress("trajectories", 0, 1)
    trajectories = reproduction.validation_trajectories(few, key, source, shapes)
    ramps = reproduction.errors_over_ramps(few, source, shapes)
    computed = (roads, demonstrations, errors, lengths, trajectories, damper, ramps)
    # NumPy's arrays: JAX would compile a slice for each number that a figure reads.
    roads, *others = jax.tree.map(np.asarray, computed)
    return PaperStudy(roads, Further(scale, variations, *others))
