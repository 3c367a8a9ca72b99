"""Damper maps over the scatter of force and velocity, at low and high bandwidth (13)."""

import numpy as np

from riecjax.models.quarter_car.identification import BREAK_POINTS
from riecjax.paper.hysteresis import BANDWIDTHS, Hysteresis
from riecjax.paper.variation_study import VariedStudy
from riecjax.reporting.charts.chart import GREY, Axis, Chart, Dots, Line, Panel
from riecjax.reporting.paper_charts.bands import METHOD_STYLE

MOST = 4000
"""Samples of the scatter that are drawn."""


def figure_13(damper: Hysteresis, study: VariedStudy) -> Chart:
    """At the lowest and at the highest of the bandwidths."""
    models = study.found["pathological"]
    row = []
    for place in (0, len(BANDWIDTHS) - 1):
        velocity, force = (
            np.asarray(values)[0, place][:MOST] for values in (damper.velocity, damper.force)
        )
        marks: list[Dots | Line] = [
            Dots(velocity, force / 1e3, "source, one road", GREY, size=1.5, opacity=0.5)
        ]
        band = int(np.argmin(np.abs(study.bandwidths - BANDWIDTHS[place])))
        for method in ("DOLS", "RIEC"):
            forces = [models[method].parameters[f"F_{i}"][:, band, 0] for i in range(1, 5)]
            found = np.stack(forces, axis=-1) / 1e3
            color, dashes = METHOD_STYLE[method]
            marks.append(
                Line(
                    BREAK_POINTS,
                    found.mean(axis=0),
                    method,
                    color,
                    dashes,
                    width=1.8,
                    markers=True,
                    error=1.96 * found.std(axis=0),
                )
            )
        row.append(
            Panel(
                marks,
                Axis("suspension velocity / (m/s)", low=-1.2, high=1.2),
                Axis("damper force / kN", low=-1.6, high=1.6),
                title=f"input to {BANDWIDTHS[place]:g} Hz",
            )
        )
    return Chart(
        [row],
        "Figure 13. Identified damper maps (B_id, pathological case; bars hold 95 % of the roads) "
        "over force and velocity in the source. The compliant damper's hysteresis widens with "
        "bandwidth: DOLS follows the line of least instantaneous error, RIEC does not.",
        (9.5, 4.4),
        share_y=True,
    )
