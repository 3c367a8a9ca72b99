"""A chart with every kind of mark, and whether one is whole in print."""

from itertools import combinations, product
from typing import Any

import matplotlib
import numpy as np

from riecjax.charts import (
    RUST,
    Axis,
    Chart,
    Dots,
    HeatMap,
    Level,
    Line,
    Panel,
    Span,
)
from riecjax.reporting.printed import STYLE, printed

X = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
Y = np.array([10.0, -20.0, 30.0, 12.3456, 50.0])
GAP = np.where(X == 3, np.nan, Y)

EVERYTHING = Chart(
    (
        (
            Panel(
                [
                    Span(1.5, 2.5, label="stretch", color=RUST, opacity=0.3),
                    Level(0),
                    Level(3, "x", "limit", dashes="dotted"),
                    Line(X, GAP, "measured", low=GAP - 5, high=GAP + 5),
                    Line(X, X, "share", RUST, "dashed"),
                ],
                Axis("time / s"),
                Axis("force / (N)"),
                title="Forces & <b>levels</b>",
            ),
            Panel(
                [Line(X, X, "equal"), Dots(X, X, "dots")],
                Axis("lag / s"),
                Axis("correlation"),
                title="Dots",
            ),
        ),
        (
            Panel(
                [Line(X, np.abs(Y), "with bars", markers=True, error=0.1 * np.abs(Y))],
                Axis("frequency / Hz", log=True),
                Axis("density / (N²/Hz)", log=True, low=5),
            ),
            Panel(
                [HeatMap([0, 1], [0, 1], [[1, -0.5], [-0.5, np.nan]], "r", -1, 1, 2)],
                Axis(categories=("stiffness", "mass")),
                Axis(categories=("stiffness", "mass"), reverse=True),
            ),
        ),
        (None, Panel([Dots(X, Y)], Axis("x"), Axis("y"))),
    ),
    "Every kind of mark < & >.",
)


def assert_whole_in_print(chart: Chart) -> None:
    """Nothing is cut off; titles and legends cover neither a panel nor each other."""
    figure = printed(chart)
    with matplotlib.rc_context(STYLE):
        figure.canvas.draw()
    width, height = figure.canvas.get_width_height()
    above: list[Any] = [legend.get_window_extent() for legend in figure.legends]
    for axes in figure.axes:
        box: Any = axes.get_tightbbox()
        assert box.x0 >= -1
        assert box.y0 >= -1
        assert box.x1 <= width + 1
        assert box.y1 <= height + 1
        titles = [getattr(axes, "_left_title")]  # noqa: B009
        above += [title.get_window_extent() for title in titles if title.get_text()]
        legend = axes.get_legend()
        above += [] if legend is None else [legend.get_window_extent()]
    panels = [axes.get_window_extent() for axes in figure.axes]
    for text, panel in product(above, panels):
        assert not text.padded(-1).overlaps(panel)
    assert not any(one.padded(-1).overlaps(other) for one, other in combinations(above, 2))
