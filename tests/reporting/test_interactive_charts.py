"""Charts on a page: what goes in is what Plotly is given."""

import json
from typing import Any

import numpy as np
import plotly.graph_objects as go
import pytest
from reporting_charts import EVERYTHING, GAP, X, Y

from riecjax.reporting.charts.chart import (
    BLUE,
    RUST,
    Axis,
    Chart,
    Dots,
    HeatMap,
    Level,
    Line,
    Panel,
    Span,
    Stems,
    single,
)
from riecjax.reporting.charts.interactive import Spaces, interactive


def figure_of(mark: Any, x: Axis | None = None, y: Axis | None = None) -> dict[str, Any]:
    return interactive(single([mark], x or Axis("x"), y or Axis("y")))


def values(entries: list[Any]) -> np.ndarray:
    """Of a trace, with NaN for gaps."""
    return np.array([np.nan if entry is None else entry for entry in entries])


def test_a_line_holds_its_values_look_and_gaps():
    (trace,) = figure_of(Line(X, GAP, "one", RUST, "dashed", markers=True))["data"]
    np.testing.assert_array_equal(values(trace["x"]), X)
    np.testing.assert_array_equal(values(trace["y"]), GAP)
    assert trace["y"][2] is None
    assert trace["line"]["color"] == RUST
    assert trace["line"]["dash"] == "dash"
    assert trace["mode"] == "lines+markers"
    assert (trace["name"], trace["showlegend"]) == ("one", True)


def test_values_are_rounded_to_six_digits():
    (trace,) = figure_of(Dots([np.pi], [1e8 / 3]))["data"]
    assert (trace["x"], trace["y"]) == ([3.14159], [33333300.0])


def test_a_band_is_an_outline_about_each_stretch_and_its_ends_are_told():
    band, line = figure_of(Line(X, GAP, low=GAP - 1, high=GAP + 2))["data"]
    assert band["x"] == [1, 2, 2, 1, None, 4, 5, 5, 4, None]
    high, low = GAP + 2, GAP - 1
    expected = [high[0], high[1], low[1], low[0], None, high[3], high[4], low[4], low[3], None]
    np.testing.assert_allclose(values(band["y"]), values(expected))
    assert band["fill"] == "toself"
    assert line["customdata"][0] == [9, 12]
    assert line["customdata"][2] == [None, None]


def test_bars_dots_and_stems():
    (bars,) = figure_of(Line(X, Y, error=0.5 * X))["data"]
    assert bars["error_y"]["array"] == [0.5, 1, 1.5, 2, 2.5]
    (dots,) = figure_of(Dots(X, Y, "d", RUST, opacity=0.4))["data"]
    assert (dots["mode"], dots["marker"]["opacity"]) == ("markers", 0.4)
    assert (dots["x"], dots["y"]) == (X.tolist(), Y.tolist())
    (stems,) = figure_of(Stems(X, Y))["data"]
    assert stems["y"] == Y.tolist()
    reach = stems["error_y"]
    below = np.array(stems["y"]) - reach["arrayminus"]
    above = np.array(stems["y"]) + reach["array"]
    np.testing.assert_array_equal(np.where(Y > 0, below, above), 0)
    np.testing.assert_array_equal(np.where(Y > 0, above, below), Y)


@pytest.mark.parametrize(("axis", "other"), [("x", "y"), ("y", "x")])
def test_spans_and_levels(axis, other):
    figure = interactive(
        single([Span(2, 3, axis, "s", BLUE, 0.5), Level(4, axis, "l")], Axis(), Axis())
    )
    span, level = figure["layout"]["shapes"]
    assert (span[f"{axis}0"], span[f"{axis}1"], level[f"{axis}0"]) == (2, 3, 4)
    assert (span[f"{axis}ref"], span[f"{other}ref"]) == (axis, f"{other} domain")
    assert (span["fillcolor"], span["opacity"], span["layer"]) == (BLUE, 0.5, "below")
    assert level["layer"] == "above"
    assert [trace["name"] for trace in figure["data"]] == ["s", "l"]
    (hatched,) = figure_of(Span(2, 3, axis, hatched=True))["layout"]["shapes"]
    assert hatched["line"]["width"] > 0


def test_a_sloped_level_reaches_over_the_axis_or_the_data():
    (trace,) = figure_of(Level(axis="diagonal"), Axis(low=-2, high=3))["data"]
    assert trace["x"] == trace["y"] == [-2, 3]
    trace, _ = interactive(single([Level(axis="diagonal"), Dots(X, Y)], Axis(), Axis()))["data"]
    assert trace["x"] == [1, 5]


def test_a_map_holds_its_values_and_names_its_cells():
    numbers = np.array([[1.0, -2.0], [np.nan, 0.25]])
    axis = Axis(categories=("front", "a < b"))
    heat = HeatMap([0, 1], [0, 1], numbers, "gain", diverging=True, numbers=1)
    (trace,) = figure_of(heat, axis, axis)["data"]
    assert trace["z"] == [[1, -2], [None, 0.25]]
    assert (trace["zmin"], trace["zmax"]) == (-2, 2)
    assert trace["customdata"][0][1] == ["front", "a &lt; b"]
    assert trace["texttemplate"] == "%{z:.1f}"
    assert trace["colorbar"]["title"]["text"] == "gain"


def test_axes():
    y = Axis("power / (W)", log=True, low=0.01, high=100)
    layout = figure_of(Line(X, Y), Axis("x", low=2, reverse=True), y)["layout"]
    assert layout["yaxis"]["type"] == "log"
    assert layout["yaxis"]["range"] == [-2, 2]
    assert layout["yaxis"]["title"]["text"] == "power / (W)"
    assert layout["xaxis"]["range"] == pytest.approx([5 + 0.04 * 3, 2])
    assert "range" not in figure_of(Line(X, Y))["layout"]["xaxis"]
    reverse = figure_of(Line(X, Y), Axis(reverse=True))["layout"]["xaxis"]
    assert reverse["autorange"] == "reversed"
    named = figure_of(Line([0, 1], [1, 2]), Axis(categories=("a", "b")))["layout"]["xaxis"]
    assert (named["tickvals"], named["ticktext"]) == ([0, 1], ["a", "b"])


@pytest.mark.parametrize(("high", "plain"), [(100, True), (1e7, False)])
def test_numbers_of_a_logarithmic_axis_are_written_out_where_they_are_readable(high, plain):
    layout = figure_of(Line([1, high], [1, 2]), Axis(log=True))["layout"]
    assert ("tickformat" in layout["xaxis"]) is plain


def test_a_right_axis_lies_over_the_panel():
    panel = Panel(
        [Line(X, Y), Line(X, X, right=True)], Axis("x"), Axis("y"), Axis("gain", color=RUST)
    )
    figure = interactive(Chart(((panel,),)))
    left, right = figure["data"]
    assert left["yaxis"] != right["yaxis"]
    axis = figure["layout"]["yaxis" + right["yaxis"][1:]]
    assert (axis["overlaying"], axis["side"], axis["color"]) == (left["yaxis"], "right", RUST)


def test_shared_axes_zoom_together_and_have_numbers_once():
    panels = [Panel([Line(X, k * Y)], Axis("x" if k == 2 else ""), Axis("y")) for k in (1, 2)]
    layout = interactive(Chart([[panel] for panel in panels], share_x=True))["layout"]
    assert layout["xaxis2"]["matches"] == "x"
    assert layout["xaxis"]["showticklabels"] is False
    assert "showticklabels" not in layout["xaxis2"]
    assert "matches" not in layout["yaxis2"]


def test_panels_do_not_overlap_and_fill_the_figure():
    layout = interactive(EVERYTHING)["layout"]
    across = [layout[f"xaxis{n}"]["domain"] for n in ("", 2, 3, 4, 5)]
    down = [layout[f"yaxis{n}"]["domain"] for n in ("", 2, 3, 4, 5)]
    assert across[0] == across[2]
    assert across[1] == across[3] == across[4]
    assert across[0][0] == 0
    assert across[0][1] < across[1][0]
    assert across[1][1] == pytest.approx(1)
    assert down[0] == down[1]
    assert down[0][1] == pytest.approx(1)
    assert down[0][0] > down[2][1] > down[2][0] > down[4][1]
    assert down[4][0] == pytest.approx(0)
    one = Spaces.of(single([Line(X, Y)], Axis(), Axis()))
    assert Spaces.of(EVERYTHING).width > 2 * one.width - 20


def test_a_name_stands_in_a_legend_once_and_in_one_above_all_if_wanted():
    marks = [Line(X, Y, "measured"), Line(X, -Y, "measured"), Line(X, X, "model")]
    own = interactive(Chart(((Panel(marks), Panel(marks)),)))
    shown = [(t["legend"], t["name"]) for t in own["data"] if t["showlegend"]]
    names = [(legend, name) for legend in ("legend", "legend2") for name in ("measured", "model")]
    assert shown == names
    once = interactive(Chart(((Panel(marks), Panel(marks)),), legend=True))
    shown = [(t["legend"], t["name"]) for t in once["data"] if t["showlegend"]]
    assert shown == [("legend", "measured"), ("legend", "model")]


def test_texts_are_shown_and_not_obeyed():
    layout = interactive(EVERYTHING)["layout"]
    titles = [each["text"] for each in layout["annotations"]]
    assert titles[0] == "<b>Forces &amp; &lt;b&gt;levels&lt;/b&gt;</b>"


def test_plotly_knows_every_setting():
    drawn = interactive(EVERYTHING)
    json.dumps(drawn, allow_nan=False)
    # Raises for a setting that does not exist.
    assert len(go.Figure(drawn).to_dict()["data"]) == len(drawn["data"])
