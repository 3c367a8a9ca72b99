"""Charts in print: what goes in is what is drawn, and nothing is cut off."""

from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.image import imread
from reporting_charts import EVERYTHING, GAP, X, Y, assert_whole_in_print

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
from riecjax.reporting.charts.printed import print_chart, printed


def drawn(mark: Any, x: Axis | None = None, y: Axis | None = None) -> Any:
    figure = printed(single([mark], x or Axis("x"), y or Axis("y")))
    return figure.axes[0]


def test_a_line_holds_its_values_look_and_gaps():
    axes = drawn(Line(X, GAP, "one", RUST, "dashed", width=2, markers=True))
    (line,) = axes.lines
    np.testing.assert_array_equal(line.get_xdata(), X)
    np.testing.assert_array_equal(line.get_ydata(), GAP)
    assert (line.get_color(), line.get_linestyle(), line.get_linewidth()) == (RUST, "--", 2)
    assert line.get_marker() == "o"


def test_a_band_and_bars_have_their_ends():
    (band,) = drawn(Line(X, Y, low=Y - 1, high=Y + 2)).collections
    corners = band.get_paths()[0].vertices
    assert {tuple(pair) for pair in np.column_stack((X, Y + 2))} <= set(map(tuple, corners))
    assert {tuple(pair) for pair in np.column_stack((X, Y - 1))} <= set(map(tuple, corners))
    (bars,) = drawn(Line(X, Y, error=0.5 * X)).collections
    ends = np.array([path[:, 1] for path in bars.get_segments()])
    np.testing.assert_allclose(ends, np.column_stack((Y - 0.5 * X, Y + 0.5 * X)))


def test_dots_and_stems():
    (dots,) = drawn(Dots(X, Y, color=RUST, size=5, opacity=0.4)).lines
    np.testing.assert_array_equal(dots.get_xydata(), np.column_stack((X, Y)))
    assert (dots.get_marker(), dots.get_markersize(), dots.get_alpha()) == ("o", 5, 0.4)
    (stems,) = drawn(Stems(X, Y)).collections
    ends = np.array(stems.get_segments())
    np.testing.assert_array_equal(ends[:, 1], np.column_stack((X, Y)))
    np.testing.assert_array_equal(ends[:, 0], np.column_stack((X, 0 * Y)))


@pytest.mark.parametrize(("axis", "place"), [("x", 0), ("y", 1)])
def test_spans_and_levels(axis, place):
    (span,) = drawn(Span(2, 3, axis, color=BLUE, opacity=0.5)).patches
    box = span.get_extents().transformed(span.axes.transData.inverted())
    assert (box.get_points()[:, place]) == pytest.approx([2, 3])
    assert to_hex(span.get_facecolor()) == BLUE
    (hatched,) = drawn(Span(2, 3, axis, hatched=True)).patches
    assert hatched.get_hatch()
    (level,) = drawn(Level(2.5, axis)).lines
    assert set(np.asarray(level.get_xydata())[:, place]) == {2.5}


def test_a_sloped_level_is_the_line_of_equal_values():
    (line,) = drawn(Level(axis="diagonal")).lines
    assert (line.get_xy1(), line.get_slope()) == ((0, 0), 1)


def test_a_map_holds_its_values_and_writes_them():
    values = np.array([[1.0, -2.0, np.nan], [0.25, 0.0, 4.0]])
    axes = drawn(HeatMap([1, 2, 3], [10, 20], values, "gain", diverging=True, numbers=1))
    (mesh,) = axes.collections
    np.testing.assert_array_equal(mesh.get_array().filled(np.nan), values)
    assert mesh.get_clim() == (-4, 4)
    written = {text.get_position(): text.get_text() for text in axes.texts}
    assert written == {
        (1, 10): "1.0",
        (2, 10): "-2.0",
        (1, 20): "0.2",
        (2, 20): "0.0",
        (3, 20): "4.0",
    }
    assert axes.get_figure().axes[1].get_ylabel() == "gain"


def test_axes():
    y = Axis("force / (N)", log=True, low=0.5, high=200)
    x = Axis(categories=("front", "rear"), reverse=True)
    axes = drawn(Line([0, 1], [1, 100]), x, y)
    axes.get_figure().canvas.draw()
    assert (axes.get_yscale(), axes.get_ylabel()) == ("log", "force / (N)")
    assert axes.get_ylim() == (0.5, 200)
    assert [label.get_text() for label in axes.get_xticklabels()] == ["front", "rear"]
    assert axes.xaxis_inverted()
    numbers = [label.get_text() for label in axes.get_yticklabels()]
    assert {"1", "10", "100"} <= set(numbers)


def test_a_right_axis_has_its_own_values_and_color():
    panel = Panel(
        [Line(X, Y, "left"), Line(X, 100 * Y, "right", right=True)],
        Axis("x"),
        Axis("y"),
        Axis("gain", low=0, color=RUST),
    )
    left, right = printed(Chart(((panel,),))).axes
    assert (len(left.lines), len(right.lines)) == (1, 1)
    assert right.get_ylabel() == "gain"
    assert right.yaxis.label.get_color() == RUST
    legend = left.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["left", "right"]


def test_only_labelled_axes_of_shared_ones_have_numbers():
    panels = [Panel([Line(X, k * Y)], Axis("x" if k == 2 else ""), Axis("y")) for k in (1, 2)]
    figure = printed(Chart([[panel] for panel in panels], share_x=True))
    above, below = figure.axes
    above.set_xlim(-7, 7)
    assert below.get_xlim() == (-7, 7)
    assert not above.xaxis.get_tick_params()["labelbottom"]
    assert below.xaxis.get_tick_params()["labelbottom"]


def test_nothing_is_cut_off_or_covers_a_panel():
    assert_whole_in_print(EVERYTHING)


def test_one_legend_for_all(tmp_path):
    panels = [Panel([Line(X, Y, "measured"), Line(X, -Y, "model")], title=t) for t in "ab"]
    figure = printed(Chart((panels,), legend=True))
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["measured", "model"]
    assert [axes.get_legend() for axes in figure.axes] == [None, None]


def test_a_chart_is_written_in_its_size_and_leaves_the_style_as_it_was(tmp_path):
    import matplotlib

    before = dict(matplotlib.rcParams)
    print_chart(single([Line(X, Y)], Axis("x"), Axis("y"), given_size=(4, 3)), tmp_path / "one.png")
    assert imread(tmp_path / "one.png").shape[:2] == (450, 600)
    assert dict(matplotlib.rcParams) == before


@pytest.mark.parametrize("name", ["$x", "$x$ and $y$", "$\\frac{a}{$", "a_{b}^$2$"])
def test_names_are_no_formulas(tmp_path, name):
    chart = single([Line(X, Y, label=name)], Axis(name), Axis(name))
    print_chart(chart, tmp_path / "a.png")
    axes = printed(chart).axes[0]
    assert not axes.xaxis.label.get_parse_math()
    assert axes.get_xlabel() == name
