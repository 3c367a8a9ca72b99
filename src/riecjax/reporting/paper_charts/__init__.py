"""The figures of the paper, from many roads where it shows one."""

from riecjax.models.quarter_car.reconstruction import Reconstruction, quarter_car_source
from riecjax.paper.reproduction import RoadResult
from riecjax.paper.study import PaperStudy
from riecjax.reporting.charts.chart import Chart
from riecjax.reporting.paper_charts.identified import (
    figure_7,
    figure_9,
    figure_10,
    tables_at_a_glance,
)
from riecjax.reporting.paper_charts.models import figure_2, figure_3, figure_5, figure_6, figure_8
from riecjax.reporting.paper_charts.variations import (
    figure_11,
    figure_12,
    figure_13,
    figure_14,
    length_map_chart,
)


def table_charts(roads: RoadResult, shapes: Reconstruction) -> dict[str, Chart]:
    """What the roads behind Tables 3 to 5 show."""
    source = quarter_car_source(shapes)
    return {
        "tables": tables_at_a_glance(roads),
        "figure_3": figure_3(),
        "figure_5": figure_5(source),
        "figure_6": figure_6(roads),
        "figure_7": figure_7(roads, source),
        "figure_8": figure_8(shapes),
    }


def study_charts(study: PaperStudy, shapes: Reconstruction) -> dict[str, Chart]:
    """All figures of the paper, and the map of window lengths."""
    return table_charts(study.roads, shapes) | {
        "figure_2": figure_2(study.demonstrations),
        "figure_9": figure_9(study.trajectories),
        "figure_10": figure_10(study.trajectories),
        "figure_11": figure_11(study.variations),
        "figure_12": figure_12(study.variations),
        "figure_13": figure_13(study.damper, study.variations),
        "figure_14": figure_14(study.variations),
        "window_lengths": length_map_chart(study.lengths),
    }
