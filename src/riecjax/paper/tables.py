"""Tables 1, 3, 4 and 5: published numbers beside their reproduction, over many roads."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from riecjax.models.quarter_car import QuarterCarSource, quarter_car_source, reconstructed
from riecjax.paper.published import (
    CONTACT_SHARE,
    CRITERIA,
    DAMPING_RATE,
    INPUTS,
    TABLE_1,
    TABLE_3,
    TABLE_4,
    TABLE_5,
    TABLE_6,
    VARIANTS,
    MountVariant,
    PublishedMode,
)
from riecjax.paper.reproduction import RoadResult
from riecjax.simulation import linearise, modes


class Cell(NamedTuple):
    """One published number and its reproduction.

    **Fields:** `published`; `reproduced`, the mean over the roads; `interval95`, the 2.5 and 97.5 %
    quantiles over the roads: where a single road, such as the paper's, may come to lie; `inside`,
    whether what was rounded to the published number may lie there.
    """

    published: float
    reproduced: float
    interval95: list[float]
    inside: bool

    @property
    def deviation(self) -> float:
        """Relative distance of the mean from the published number."""
        return self.reproduced / self.published - 1


def cell(published: float, over_roads: Float[np.ndarray, " roads"], rounding: float) -> Cell:
    """A published number, rounded by so much at most, beside those of many roads."""
    low, high = np.quantile(over_roads, [0.025, 0.975]).tolist()
    inside = low - rounding <= published <= high + rounding
    return Cell(published, float(over_roads.mean()), [low, high], inside)


def contact(roads: RoadResult) -> Cell:
    """Share of the record during which the tyre touches the road."""
    return cell(CONTACT_SHARE, np.asarray(roads.contact), rounding=0.005)


def number_tables(roads: RoadResult) -> dict[str, dict[str, dict[str, Cell]]]:
    """Tables 3, 4 and 5 by number: rows, then criteria.

    3 has the tyre's stiffness in N/m and masses in kg, 4 the suspension's stiffness in N/m, 5 the
    validation error in percent, summed over x1 to x4, whose rows are variant and input.
    """

    def row(
        published: dict[str, float], values: Float[np.ndarray, "roads criteria"], rounding: float
    ) -> dict[str, Cell]:
        return {c: cell(published[c], v, rounding) for c, v in zip(CRITERIA, values.T)}

    # Printed to a tenth: of kN/m, kg, and percent.
    tenths = {"K_t": 50.0, "M_s": 0.05, "M_us": 0.05}
    return {
        "3": {n: row(TABLE_3[n], roads.identified("B_id", n), tenths[n]) for n in TABLE_3},
        "4": {v: row(TABLE_4[v], roads.identified(v, "K_s"), tenths["K_t"]) for v in VARIANTS},
        "5": {
            f"{v} {where}": row(TABLE_5[v][where], roads.summed_error(v, where), rounding=0.05)
            for v in TABLE_5
            for where in INPUTS
        },
    }


def linear_source(mount: MountVariant = TABLE_6["pathological"]) -> QuarterCarSource:
    """The source model as linearised in Section 3: 1.5 kN s/m, 20 kN/m, and a linear mount."""
    shapes = eqx.tree_at(
        lambda s: (s.damper.low_speed_rate, s.damper.high_speed_rates, s.stop_rates, s.mount_cubic),
        reconstructed(),
        (jnp.asarray(DAMPING_RATE), jnp.full(2, DAMPING_RATE), np.zeros(2), np.zeros(())),
    )
    return quarter_car_source({"K_m": mount.stiffness, "B_m": mount.damping}, shapes)


WHEEL, BODY, ENGINE = 2, 3, 5
"""Places of the velocities x3, x4, x6 in the state."""


def table_1() -> list[tuple[PublishedMode, PublishedMode]]:
    """Every row of Table 1, published and reproduced to the printed digits.

    Shapes are scaled so that the larger of the velocities of wheel and body is 1.
    """
    rows = []
    for published, mode in zip(TABLE_1, modes(linearise(linear_source())[0]), strict=True):
        wheel, body, engine = mode.shape[[WHEEL, BODY, ENGINE]]
        larger = wheel if abs(wheel) >= abs(body) else body
        # Adding zero turns -0.0 into 0.0.
        shape = (np.round(np.array([wheel, body, engine - body]) / larger, 2) + 0.0).tolist()
        eigenvalue = complex(np.round(mode.eigenvalue, published.digits) + 0.0)
        frequency, ratio = (
            None if value is None else round(float(value), 2)
            for value in (mode.frequency, mode.damping_ratio)
        )
        reproduced = PublishedMode(eigenvalue, frequency, ratio, *shape, digits=published.digits)
        rows.append((published, reproduced))
    return rows
