"""Figures of Section 6, over the bandwidth of the input: 11, 12 and 14; and windows' lengths."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from riecjax.paper.published import CRITERIA, TABLE_2
from riecjax.paper.reproduction import LENGTHS, PARAMETERS, LengthMap
from riecjax.paper.variations import BANDWIDTHS, Hysteresis, Varied, VariedStudy
from riecjax.reporting.charts.chart import (
    DASHES,
    GREY,
    SERIES,
    Axis,
    Chart,
    Dots,
    HeatMap,
    Level,
    Line,
    Panel,
)
from riecjax.reporting.paper_charts.identified import BAND, METHOD_STYLE, banded, damper_map

BANDWIDTH = Axis("input bandwidth / Hz", low=0, high=30.5)
CASES = {
    "pathological": "pathological, 13 Hz",
    "included-mode": "included mode, 6 Hz",
    "higher-mode": "higher mode, 25 Hz",
}


class _Shown(NamedTuple):
    """A parameter of Fig. 11: its label, what it is divided by, and the source's value."""

    label: str
    scale: float
    true: float


PARAMETERS_SHOWN = {
    "M_us": _Shown("M_us / kg", 1.0, 30.0),
    "M_s": _Shown("M_s / kg", 1.0, 300.0),
    "K_s": _Shown("K_s / (kN/m)", 1e3, 20.0),
}


def _methods(study: VariedStudy, case: str) -> list[tuple[str, Varied]]:
    return [(method, study.found[case][method]) for method in reversed(CRITERIA)]


def _by_both(
    study: VariedStudy, case: str, values: Callable[[Varied], np.ndarray], shown: float = np.inf
) -> list[Line]:
    """A line over bandwidth for each method; values per draw of windows, whose mean is drawn."""
    return [
        banded(
            study.bandwidths,
            values(varied).mean(axis=-1),
            method,
            METHOD_STYLE[method],
            shown=shown,
        )
        for method, varied in _methods(study, case)
    ]


def figure_11(study: VariedStudy) -> Chart:
    """Masses and stiffness in the three cases of Table 6, by both methods."""
    rows = []
    for name, shown in PARAMETERS_SHOWN.items():
        row = []
        for case, title in CASES.items():
            marks = _by_both(study, case, lambda v, n=name, s=shown: v.parameters[n] / s.scale)
            row.append(
                Panel(
                    [Level(shown.true, label="source"), *marks],
                    BANDWIDTH,
                    Axis(shown.label),
                    title=title if name == "M_us" else "",
                )
            )
        rows.append(row)
    return Chart(
        rows,
        f"Figure 11. Identified masses and suspension stiffness over the bandwidth of the input "
        f"(B_id). {BAND}",
        (10.5, 8.0),
        share_y=True,
        legend=True,
    )


def figure_12(study: VariedStudy) -> Chart:
    """Damper forces in the pathological case."""
    row = []
    for method, varied in _methods(study, "pathological"):
        marks = [
            banded(
                study.bandwidths,
                varied.parameters[f"F_{i + 1}"].mean(axis=-1) / 1e3,
                f"F_{i + 1}",
                (SERIES[i], DASHES[i]),
            )
            for i in range(4)
        ]
        row.append(Panel(marks, BANDWIDTH, Axis("F_i / kN", low=-1.6, high=1.6), title=method))
    return Chart(
        [row],
        f"Figure 12. Identified damper forces over the bandwidth of the input, pathological case "
        f"(B_id). {BAND} Below about 3 Hz nothing reaches the outer break points, and F_1 and F_4 "
        f"are undetermined.",
        (9.5, 4.2),
        share_y=True,
        legend=True,
    )


def figure_14(study: VariedStudy) -> Chart:
    """Validation error in the three cases, on both inputs."""
    rows = []
    for where, name, most in (("road", "road", 130.0), ("pothole", "pot-hole", 350.0)):
        row = []
        for case, title in CASES.items():
            marks = _by_both(study, case, lambda v, w=where: v.errors[w], shown=1.3 * most)
            row.append(
                Panel(marks, BANDWIDTH, Axis(f"p on the {name} / %", low=0, high=most), title=title)
            )
        rows.append(row)
    return Chart(
        rows,
        f"Figure 14. Validation error, summed over x1 to x4, over the bandwidth of the input that "
        f"the model was identified on (B_id). {BAND} Models from inputs below about 4 Hz know "
        f"nothing of the damper's outer break points and lose their solution.",
        (10.5, 6.4),
        share_y=True,
        legend=True,
    )


def length_map_chart(lengths: LengthMap) -> Chart:
    """Estimates over alpha and beta (Section 4), as changes from Table 2's choice."""
    grid = len(LENGTHS)
    theta = np.asarray(lengths.theta).mean(axis=0)
    alpha, beta = np.asarray(lengths.alpha), np.asarray(lengths.beta)
    chosen = lengths.of_table_2
    # The next length of the grid below one that is a sample longer than alpha is alpha itself.
    across, up = _places(alpha), _places(beta)
    names = tuple(f"{length:g}" for length in LENGTHS)
    row = []
    for name in PARAMETERS_SHOWN:
        values = theta[:, PARAMETERS.index(name)]
        change = np.full((grid, grid), np.nan)
        change[up, across] = 100 * (values / values[chosen] - 1)
        heat = HeatMap(
            np.arange(grid), np.arange(grid), change, "change / %", -20.0, 20.0, diverging=True
        )
        row.append(
            Panel(
                [heat],
                Axis("alpha / s", categories=names),
                Axis("beta / s", categories=names),
                title=name,
            )
        )
    return Chart(
        [row],
        f"Sensitivity to the window lengths (claim 8): change of the identified values from those "
        f"of Table 2's lengths ({TABLE_2.alpha:g} to {TABLE_2.beta:g} s), mean over the roads, "
        f"with all windows of each pair. On the diagonal beta is one sample longer than alpha.",
        (12.0, 3.9),
    )


def _places(lengths: np.ndarray) -> np.ndarray:
    """Of each length in the grid, rounded down."""
    return np.searchsorted(np.array(LENGTHS), lengths + 1e-9, side="right") - 1


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
        marks += [
            damper_map(
                [models[method].parameters[f"F_{i}"][:, band, 0] for i in range(1, 5)],
                method,
                METHOD_STYLE[method],
                width=1.8,
            )
            for method in ("DOLS", "RIEC")
        ]
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
