"""Validation trajectories: the Robson road (9) and the pot-hole (10)."""

import numpy as np

from riecjax.paper.reproduction import VALIDATED_STATES
from riecjax.paper.trajectories import Trajectories
from riecjax.reporting.charts.chart import PALE, Axis, Chart, Line, Panel
from riecjax.reporting.paper_charts.bands import BAND, METHOD_STYLE, banded

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
        trajectories["road"],
        SHOWN["road"],
        "Figure 9. Validation of B_id models on a Robson road.",
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
    kept = (time >= between[0]) & (time <= between[1])
    rows = []
    for i, state in enumerate(VALIDATED_STATES):
        what, unit, factor = QUANTITIES[state]
        source = factor * np.asarray(found.source)[kept, i]
        # Behind the predictions, and wide: where they agree with it they would hide a thin line.
        marks = [Line(time[kept], source, "source", PALE, width=4.0)]
        for method in ("DOLS", "RIEC"):
            predicted = factor * np.asarray(found.predicted[method])[:, kept, i]
            marks.append(banded(time[kept], predicted, method, METHOD_STYLE[method]))
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
