"""What is identified: the tables at a glance, damper maps (Fig. 7) and validations (9, 10)."""

from collections.abc import Sequence

import numpy as np

from riecjax.models.quarter_car.identification import BREAK_POINTS
from riecjax.models.quarter_car.source import QuarterCarSource
from riecjax.paper.published import CRITERIA, VARIANTS
from riecjax.paper.reproduction import VALIDATED_STATES, RoadResult, Trajectories
from riecjax.paper.tables import table_3, table_4, table_5
from riecjax.reporting.charts.chart import (
    BLUE,
    DASHES,
    GREY,
    PALE,
    RUST,
    SERIES,
    Axis,
    Chart,
    Dashes,
    Dots,
    Level,
    Line,
    Panel,
    single,
)
from riecjax.reporting.paper_charts.models import sampled

METHOD_STYLE: dict[str, tuple[str, Dashes]] = {"RIEC": (BLUE, "solid"), "DOLS": (RUST, "dashed")}
BAND = "Lines are medians over the roads, bands hold 95 % of them."


def banded(
    x: object, over_roads: object, label: str, style: tuple[str, Dashes], *, shown: float = np.inf
) -> Line:
    """Median over the first axis, with the band from its 2.5 to its 97.5 % quantile.

    **Arguments:** `shown`, the largest value that is drawn; larger ones leave a gap.
    """
    values = np.asarray(over_roads)
    with np.errstate(invalid="ignore"):
        low, middle, high = (_quantile(values, q) for q in (0.025, 0.5, 0.975))
    drawn = np.abs(middle) <= shown
    return Line(
        x,  # pyright: ignore[reportArgumentType]
        np.where(drawn, middle, np.nan),
        label,
        style[0],
        style[1],
        low=np.where(drawn, low, np.nan),
        high=np.where(drawn & np.isfinite(high), np.minimum(high, 1e9), np.nan),
    )


def _quantile(values: np.ndarray, share: float) -> np.ndarray:
    # Of an order that is there: between a number and infinity lies nothing.
    return np.quantile(values, share, axis=0, method="nearest")


def tables_at_a_glance(roads: RoadResult) -> Chart:
    """Every number of Tables 3 to 5 relative to its published value."""
    tables = (("", table_3(roads)), ("K_s ", table_4(roads)), ("p ", table_5(roads)))
    cells = {
        f"{prefix}{row}, {criterion}": cell
        for prefix, table in tables
        for row, line in table.items()
        for criterion, cell in line.items()
    }
    marks: list[Line | Dots | Level] = [Level(0.0, "x")]
    for inside, label, color in (
        (True, "published number inside the range over roads", BLUE),
        (False, "outside", RUST),
    ):
        chosen = [(i, cell) for i, cell in enumerate(cells.values()) if cell.inside == inside]
        ends = [
            (100 * (end / cell.published - 1), i)
            for i, cell in chosen
            for end in (cell.low, cell.high, np.nan)
        ]
        if not chosen:
            continue
        x, y = zip(*ends)
        marks.append(Line(x, y, "", color, width=2))
        marks.append(
            Dots([100 * cell.deviation for _, cell in chosen], [i for i, _ in chosen], label, color)
        )
    reach = 105 * max(
        abs(end / cell.published - 1) for cell in cells.values() for end in (cell.low, cell.high)
    )
    return single(
        marks,
        Axis("reproduced against published / %", low=-reach, high=reach),
        Axis(categories=tuple(cells), reverse=True),
        "Tables 3 to 5 at a glance: mean over the roads (dot) and the range that holds 95 % of "
        "them (line), against the published number.",
        size=(8.0, 8.0),
    )


def damper_map(
    forces: Sequence[object], label: str, style: tuple[str, Dashes], width: float = 1.3
) -> Line:
    """Means of F_1 to F_4 over the roads at their velocities, with bars that hold 95 % of them."""
    values = np.stack([np.asarray(force) for force in forces], axis=-1) / 1e3
    bars = 1.96 * values.std(axis=0)
    mean = values.mean(axis=0)
    return Line(BREAK_POINTS, mean, label, *style, width=width, markers=True, error=bars)


def figure_7(roads: RoadResult, source: QuarterCarSource) -> Chart:
    """Identified damper maps, four variants by each method, over the source's curve."""
    velocity = np.linspace(-1.1, 1.1, 221)
    curve = Line(velocity, sampled(source.damper, velocity) / 1e3, "source", GREY, width=4.0)
    row = []
    for criterion in CRITERIA:
        maps = [
            damper_map(
                [roads.parameters[criterion][variant][f"F_{i}"] for i in range(1, 5)],
                variant,
                (color, dashes),
            )
            for variant, dashes, color in zip(VARIANTS, DASHES, SERIES)
        ]
        velocity_axis = Axis("suspension velocity / (m/s)")
        row.append(Panel([curve, *maps], velocity_axis, Axis("damper force / kN"), title=criterion))
    return Chart(
        [row],
        "Figure 7. Identified damper maps, means over the roads with bars that hold 95 % of them. "
        "RIEC finds one map in all four variants, DOLS four.",
        (9.5, 4.2),
        share_y=True,
    )


SHOWN = {"road": (20.0, 23.0), "pothole": (0.0, 1.25)}
"""Seconds that are drawn: the road's start holds the transient."""
QUANTITIES = {
    "x1": ("tyre deflection", "mm", 1e3),
    "x2": ("suspension deflection", "mm", 1e3),
    "x3": ("wheel velocity", "m/s", 1.0),
    "x4": ("body velocity", "m/s", 1.0),
}


def figure_9(trajectories: dict[str, Trajectories]) -> Chart:
    """On a Robson road."""
    return _figure(
        trajectories["road"], SHOWN["road"], "Figure 9. Validation of B_id models on a Robson road."
    )


def figure_10(trajectories: dict[str, Trajectories]) -> Chart:
    """On the pot-hole."""
    return _figure(
        trajectories["pothole"],
        SHOWN["pothole"],
        "Figure 10. Validation of B_id models on the pot-hole.",
    )


def _figure(found: Trajectories, between: tuple[float, float], caption: str) -> Chart:
    time = np.asarray(found.time)
    drawn = (time >= between[0]) & (time <= between[1])
    rows = []
    for i, state in enumerate(VALIDATED_STATES):
        what, unit, factor = QUANTITIES[state]
        source = factor * np.asarray(found.source)[drawn, i]
        # Behind the predictions, and wide: where they agree with it they would hide a thin line.
        marks = [Line(time[drawn], source, "source", PALE, width=4.0)]
        for method in ("DOLS", "RIEC"):
            predicted = factor * np.asarray(found.predicted[method])[:, drawn, i]
            marks.append(banded(time[drawn], predicted, method, METHOD_STYLE[method]))
        rows.append(
            [
                Panel(
                    marks,
                    Axis("time / s" if state == VALIDATED_STATES[-1] else ""),
                    Axis(f"{state} / ({unit})" if "/" in unit else f"{state} / {unit}"),
                    title=what,
                )
            ]
        )
    count = next(iter(found.predicted.values())).shape[0]
    return Chart(
        rows,
        f"{caption} {BAND} Models identified on {count} roads predict one and the same motion.",
        (9.0, 10.0),
        share_x=True,
        legend=True,
    )
