"""Tables 3, 4 and 5: published numbers beside their reproduction over many roads."""

from typing import NamedTuple

import numpy as np

from riecjax.paper.published import (
    CONTACT_SHARE,
    CRITERIA,
    TABLE_3,
    TABLE_4,
    TABLE_5,
    VARIANTS,
)
from riecjax.paper.reproduction import RoadResult


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


Table = dict[str, dict[str, Cell]]
"""Row, then criterion."""


def table_3(roads: RoadResult) -> Table:
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


def table_4(roads: RoadResult) -> Table:
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


def table_5(roads: RoadResult) -> Table:
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
