"""Charts in print and on a page: what goes in is what both draw, and nothing is cut off."""

import json
from typing import Any

import matplotlib
import numpy as np
import plotly.graph_objects as go
import pytest
from matplotlib.colors import to_hex
from matplotlib.image import imread
from reporting_charts import EVERYTHING, GAP, X, Y, assert_whole_in_print

from riecjax.charts import (
    BLUE,
    RUST,
    Axis,
    Dots,
    HeatMap,
    Level,
    Line,
    Span,
    single,
)
from riecjax.reporting.interactive import interactive
from riecjax.reporting.printed import print_chart, printed


def in_print(*marks: Any, x: Axis | None = None, y: Axis | None = None) -> Any:
    return printed(single(marks, x or Axis("x"), y or Axis("y"))).axes[0]


def on_page(*marks: Any, x: Axis | None = None, y: Axis | None = None) -> dict[str, Any]:
    return interactive(single(marks, x or Axis("x"), y or Axis("y")))


def values(entries: list[Any]) -> np.ndarray:
    """Of a trace, with NaN for gaps."""
    return np.array([np.nan if entry is None else entry for entry in entries])


@pytest.mark.parametrize(
    "mark", [Line(X, GAP, "one", RUST, "dashed", markers=True), Dots(X, Y, "d", RUST, opacity=0.4)]
)
def test_values_gaps_and_looks_are_the_same_in_print_and_on_a_page(mark):
    (line,), (trace,) = in_print(mark).lines, on_page(mark)["data"]
    for drawn in (line.get_xydata(), np.column_stack((values(trace["x"]), values(trace["y"])))):
        np.testing.assert_array_equal(drawn, np.column_stack((mark.x, mark.y)))
    assert line.get_label() == trace["name"] == mark.label
    assert trace["showlegend"]
    assert line.get_marker() == "o"
    if isinstance(mark, Line):
        assert line.get_color() == trace["line"]["color"] == RUST
        assert (line.get_linestyle(), trace["line"]["dash"]) == ("--", "dash")
        assert trace["mode"] == "lines+markers"
    else:
        assert line.get_alpha() == trace["marker"]["opacity"] == 0.4
        assert trace["marker"]["color"] == RUST


def test_a_band_goes_around_each_stretch_and_bars_have_their_ends():
    (band,) = in_print(Line(X, Y, low=Y - 1, high=Y + 2)).collections
    corners = set(map(tuple, band.get_paths()[0].vertices))
    assert {*zip(X, Y + 2), *zip(X, Y - 1)} <= corners
    low, high = GAP - 1, GAP + 2
    band, line = on_page(Line(X, GAP, low=low, high=high))["data"]
    assert band["x"] == [1, 2, 2, 1, None, 4, 5, 5, 4, None]
    around = [high[0], high[1], low[1], low[0], None, high[3], high[4], low[4], low[3], None]
    np.testing.assert_allclose(values(band["y"]), values(around))
    assert (band["fill"], line["customdata"][0], line["customdata"][2]) == (
        "toself",
        [9, 12],
        [None, None],
    )
    (bars,) = in_print(Line(X, Y, error=0.5 * X)).collections
    ends = np.array([path[:, 1] for path in bars.get_segments()])
    np.testing.assert_allclose(ends, np.column_stack((Y - 0.5 * X, Y + 0.5 * X)))
    assert on_page(Line(X, Y, error=0.5 * X))["data"][0]["error_y"]["array"] == list(0.5 * X)


@pytest.mark.parametrize(("axis", "other", "place"), [("x", "y", 0), ("y", "x", 1)])
def test_spans_and_levels(axis, other, place):
    stretch = Span(2, 3, axis, "s", BLUE, 0.5)
    axes = in_print(stretch, Level(4, axis, "l"))
    (span,) = axes.patches
    box = span.get_extents().transformed(axes.transData.inverted())
    assert box.get_points()[:, place] == pytest.approx([2, 3])
    assert to_hex(span.get_facecolor()) == BLUE
    assert set(np.asarray(axes.lines[0].get_xydata())[:, place]) == {4}
    figure = on_page(stretch, Level(4, axis, "l"))
    span, level = figure["layout"]["shapes"]
    assert (span[f"{axis}0"], span[f"{axis}1"], level[f"{axis}0"]) == (2, 3, 4)
    assert (span[f"{axis}ref"], span[f"{other}ref"]) == (axis, f"{other} domain")
    assert (span["fillcolor"], span["opacity"], span["layer"]) == (BLUE, 0.5, "below")
    assert level["layer"] == "above"
    assert [trace["name"] for trace in figure["data"]] == ["s", "l"]


def test_a_map_holds_its_values_writes_them_and_names_its_cells():
    numbers = np.array([[1.0, -2.0], [np.nan, 0.25]])
    heat = HeatMap([0, 1], [0, 1], numbers, "gain", -2, 2, numbers=1)
    axis = Axis(categories=("front", "a < b"))
    axes = in_print(heat, x=axis, y=axis)
    (mesh,) = axes.collections
    np.testing.assert_array_equal(mesh.get_array().filled(np.nan), numbers)
    assert mesh.get_clim() == (-2, 2)
    written = {text.get_position(): text.get_text() for text in axes.texts}
    assert written == {(0, 0): "1.0", (1, 0): "-2.0", (1, 1): "0.2"}
    assert axes.get_figure().axes[1].get_ylabel() == "gain"
    (trace,) = on_page(heat, x=axis, y=axis)["data"]
    assert trace["z"] == [[1, -2], [None, 0.25]]
    assert (trace["zmin"], trace["zmax"]) == (-2, 2)
    assert trace["customdata"][0][1] == ["front", "a &lt; b"]
    assert trace["texttemplate"] == "%{z:.1f}"
    assert trace["colorbar"]["title"]["text"] == "gain"


def test_axes():
    power, names = Axis("power / (W)", log=True, low=0.01, high=100), ("front", "rear")
    axes = in_print(Line([0, 1], [1, 100]), x=Axis(categories=names, reverse=True), y=power)
    axes.get_figure().canvas.draw()
    assert (axes.get_yscale(), axes.get_ylabel()) == ("log", "power / (W)")
    assert axes.get_ylim() == (0.01, 100)
    assert [label.get_text() for label in axes.get_xticklabels()] == [*names]
    assert axes.xaxis_inverted()
    assert {"1", "10", "100"} <= {label.get_text() for label in axes.get_yticklabels()}
    layout = on_page(Line(X, Y), x=Axis("x", low=2, reverse=True), y=power)["layout"]
    assert layout["yaxis"]["type"] == "log"
    assert layout["yaxis"]["range"] == [-2, 2]
    assert layout["yaxis"]["title"]["text"] == "power / (W)"
    assert layout["xaxis"]["range"] == pytest.approx([5 + 0.04 * 3, 2])
    assert "range" not in on_page(Line(X, Y))["layout"]["xaxis"]
    assert on_page(Line(X, Y), x=Axis(reverse=True))["layout"]["xaxis"]["autorange"] == "reversed"
    named = on_page(Line([0, 1], [1, 2]), x=Axis(categories=names))["layout"]["xaxis"]
    assert (named["tickvals"], named["ticktext"]) == ([0, 1], [*names])


def test_panels_do_not_overlap_and_fill_the_figure():
    assert_whole_in_print(EVERYTHING)
    layout = interactive(EVERYTHING)["layout"]
    across, down = ([layout[f"{a}axis{n}"]["domain"] for n in ("", 2, 3, 4, 5)] for a in "xy")
    assert across[0] == across[2]
    assert across[1] == across[3] == across[4]
    assert 0 == across[0][0] < across[0][1] < across[1][0]
    assert (across[1][1], down[0][1], down[4][0]) == pytest.approx((1, 1, 0))
    assert down[0] == down[1]
    assert down[0][0] > down[2][1] > down[2][0] > down[4][1]


def test_a_chart_is_written_in_its_size_and_leaves_the_style_as_it_was(tmp_path):
    before = dict(matplotlib.rcParams)
    chart = single([Line(X, Y)], Axis("x"), Axis("y"))
    print_chart(chart, tmp_path / "one.png")
    wide, high = chart.size
    assert imread(tmp_path / "one.png").shape[:2] == (150 * high, 150 * wide)
    assert dict(matplotlib.rcParams) == before


@pytest.mark.parametrize("name", ["$x$ and $y$", "$\\frac{a}{$"])
def test_texts_are_shown_and_not_obeyed(tmp_path, name):
    chart = single([Line(X, Y, label=name)], Axis(name), Axis(name))
    print_chart(chart, tmp_path / "a.png")
    axes = printed(chart).axes[0]
    assert not axes.xaxis.label.get_parse_math()
    assert axes.get_xlabel() == name
    titles = [each["text"] for each in interactive(EVERYTHING)["layout"]["annotations"]]
    assert titles[0] == "<b>Forces &amp; &lt;b&gt;levels&lt;/b&gt;</b>"


def test_plotly_knows_every_setting():
    drawn = interactive(EVERYTHING)
    json.dumps(drawn, allow_nan=False)
    # Raises for a setting that does not exist.
    assert len(go.Figure(drawn).to_dict()["data"]) == len(drawn["data"])
