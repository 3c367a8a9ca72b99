"""Tables 3, 4 and 5: published numbers beside their reproduction over many roads."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from riecjax.models.quarter_car.reconstruction import (
    MOUNT_DAMPING,
    MOUNT_RATE,
    SPRING_RATE,
    source_with_curves,
)
from riecjax.models.quarter_car.source import (
    BumpStopSpring,
    HardeningMount,
    LinearDamper,
    QuarterCarSource,
)
from riecjax.paper.published import (
    CONTACT_SHARE,
    CRITERIA,
    DAMPING_RATE,
    TABLE_1,
    TABLE_3,
    TABLE_4,
    TABLE_5,
    VARIANTS,
    PublishedMode,
)
from riecjax.paper.reproduction import RoadResult
from riecjax.simulation import Mode, linearise, modes


class Cell(NamedTuple):
    """One published number and its reproduction.

    **Fields:** `published`; `reproduced`, the mean over the roads; `low` and `high`, the 2.5 and
    97.5 % quantiles over the roads: where a single road, such as the paper's, may come to lie;
    `rounding`, half a unit of the last digit in print.
    """

    published: float
    reproduced: float
    low: float
    high: float
    rounding: float

    @property
    def deviation(self) -> float:
        """Relative distance of the mean from the published number."""
        return self.reproduced / self.published - 1

    @property
    def inside(self) -> bool:
        """Whether what was rounded to the published number may lie in the range over the roads."""
        return self.low - self.rounding <= self.published <= self.high + self.rounding


CellTable = dict[str, dict[str, Cell]]
"""Row, then criterion."""


def table_3(roads: RoadResult) -> CellTable:
    """Tyre stiffness in N/m and masses in kg."""
    return {
        name: {
            criterion: _cell(
                TABLE_3[name][criterion],
                roads.parameters[criterion]["B_id"][name],
                rounding=50.0 if name == "K_t" else 0.05,
            )
            for criterion in CRITERIA
        }
        for name in TABLE_3
    }


def table_4(roads: RoadResult) -> CellTable:
    """Suspension stiffness in N/m."""
    return {
        variant: {
            criterion: _cell(
                TABLE_4[variant][criterion],
                roads.parameters[criterion][variant]["K_s"],
                rounding=50.0,
            )
            for criterion in CRITERIA
        }
        for variant in VARIANTS
    }


def table_5(roads: RoadResult) -> CellTable:
    """Validation error in percent, summed over x1 to x4; rows are variant and input."""
    return {
        f"{variant} {where}": {
            criterion: _cell(
                TABLE_5[variant][where][criterion],
                np.sum(roads.errors[where][criterion][variant], axis=-1),
                rounding=0.05,
            )
            for criterion in CRITERIA
        }
        for variant in TABLE_5
        for where in ("road", "pothole")
    }


def contact(roads: RoadResult) -> Cell:
    """Share of the record during which the tyre touches the road."""
    return _cell(CONTACT_SHARE, roads.contact, rounding=0.005)


def _cell(published: float, over_roads: object, *, rounding: float) -> Cell:
    values = np.asarray(over_roads)
    low, high = np.quantile(values, [0.025, 0.975])
    return Cell(published, float(values.mean()), float(low), float(high), rounding)


WHEEL, BODY, ENGINE = 2, 3, 5
"""Places of the velocities x3, x4, x6 in the state."""


class ModeComparison(NamedTuple):
    """A published mode beside the reproduced one, and whether every printed digit agrees."""

    published: PublishedMode
    reproduced: PublishedMode
    agrees: bool


def linear_source(
    mount_rate: float = MOUNT_RATE, mount_damping: float = MOUNT_DAMPING
) -> QuarterCarSource:
    """The source model as linearised in Section 3: 1.5 kN s/m, 20 kN/m, and a linear mount."""
    return source_with_curves(
        LinearDamper(jnp.asarray(DAMPING_RATE)),
        BumpStopSpring(jnp.asarray(SPRING_RATE), jnp.full(2, 1.0), jnp.zeros(2)),
        HardeningMount(jnp.asarray(mount_rate), jnp.zeros(())),
        mount_damping,
    )


def table_1() -> list[ModeComparison]:
    """Every row of Table 1, published and reproduced to the printed digits."""
    found = modes(linearise(linear_source())[0])
    reproduced = [_printed(mode, like) for like, mode in zip(TABLE_1, found, strict=True)]
    return [ModeComparison(*both, agrees=both[0] == both[1]) for both in zip(TABLE_1, reproduced)]


def _printed(mode: Mode, like: PublishedMode) -> PublishedMode:
    """The mode rounded as the paper prints it, scaled so that the larger velocity is 1."""
    wheel, body, engine = mode.shape[[WHEEL, BODY, ENGINE]]
    reference = wheel if abs(wheel) >= abs(body) else body
    parts = np.array([wheel, body, engine - body]) / reference
    return PublishedMode(
        _round(mode.eigenvalue, like.digits),
        None if mode.frequency is None else round(float(mode.frequency), 2),
        None if mode.damping_ratio is None else round(float(mode.damping_ratio), 2),
        *(_round(complex(part), 2) for part in parts),
        digits=like.digits,
    )


def _round(value: complex, digits: int) -> complex:
    # Adding zero turns -0.0 into 0.0.
    return complex(round(value.real, digits) + 0.0, round(value.imag, digits) + 0.0)
