"""The figures of the paper, from many roads where it shows one."""

from collections.abc import Callable, Mapping, Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from riecjax import Boxcar, charts
from riecjax.charts import Axis, Chart, Dashes, Dots, HeatMap, Level, Line, Panel, single
from riecjax.equations import RoofFunctions
from riecjax.models.quarter_car import (
    BREAK_POINTS,
    QuarterCarSource,
    Reconstruction,
    quarter_car_source,
)
from riecjax.paper import reproduction
from riecjax.paper.claims import BETWEEN, FIXED, SHOWN, TWO
from riecjax.paper.published import CRITERIA, TABLE_2, TABLE_6, VARIANTS
from riecjax.paper.tables import number_tables
from riecjax.simulation import pothole

Style = tuple[str, Dashes]
METHOD_STYLE: dict[str, Style] = {"RIEC": (charts.BLUE, "solid"), "DOLS": (charts.RUST, "dashed")}
STYLES: tuple[Style, ...] = tuple(zip(charts.SERIES, charts.DASHES))
BAND = "Lines are medians over the roads, bands hold 95 % of them."
VELOCITY, FORCE = "suspension velocity / (m/s)", "damper force / kN"


def study_charts(study: reproduction.PaperStudy, shapes: Reconstruction) -> dict[str, Chart]:
    """The figures that the study has the numbers for, and the map of window lengths."""
    roads, further, source = study.roads, study.further, quarter_car_source(shapes=shapes)
    figures = {
        "tables": tables_at_a_glance(roads),
        "figure_3": figure_3(),
        "figure_5": figure_5(source),
        "figure_6": figure_6(roads),
        "figure_7": figure_7(roads, source),
        "figure_8": figure_8(shapes),
    }
    if further is None:
        return figures
    motion = further.trajectories
    return figures | {
        "figure_2": figure_2(further.demonstrations),
        # The road's start holds the transient.
        "figure_9": validation_figure(motion["road"], (20.0, 23.0), "Figure 9", "a Robson road"),
        "figure_10": validation_figure(motion["pothole"], (0.0, 1.25), "Figure 10", "the pot-hole"),
        "figure_11": figure_11(further.variations),
        "figure_12": figure_12(further.variations),
        "figure_13": figure_13(further.damper, further.variations),
        "figure_14": figure_14(further.variations),
        "window_lengths": length_map_chart(further.lengths),
    }


EXCERPT = 1.0
"""Seconds of the signals themselves that are drawn."""
MOST = 1500
"""Samples of an integral that are drawn."""
MOST_DOTS = 4000
"""Samples of a scatter that are drawn."""


def figure_2(demonstrations: reproduction.Demonstration) -> Chart:
    """White noise and the mechanical error, and their running integrals."""
    time = np.arange(round(reproduction.DURATION * reproduction.RATE)) / reproduction.RATE
    # The size of the force is arbitrary: everything in units of the error's r.m.s.
    size = np.sqrt(np.mean(np.asarray(demonstrations.error) ** 2, axis=1))[:, None]
    few = slice(0, round(EXCERPT * reproduction.RATE))
    thin = np.linspace(0, time.size - 1, MOST).astype(int)
    above, below = [], []
    for name, signal, integral, color in (
        ("white noise", demonstrations.noise, demonstrations.noise_integral, charts.RUST),
        ("mechanical error", demonstrations.error, demonstrations.error_integral, charts.BLUE),
    ):
        excerpt, over_time = np.asarray(signal)[0] / size[0], np.asarray(integral) / size
        line = Line(time[few], excerpt[few], "", color, width=charts.THIN)
        above.append(Panel([line], Axis("time / s"), Axis("signal / its r.m.s."), title=name))
        spread = 2 * np.sqrt(np.mean(over_time**2, axis=0))[thin]
        label, zero = "± 2 r.m.s. over realisations", np.zeros(MOST)
        marks = [
            Line(time[thin], zero, label, charts.GREY, width=1.0, low=-spread, high=spread),
            Line(time[thin], over_time[0][thin], "one realisation", color, width=charts.THIN),
        ]
        unit = Axis("integral / (r.m.s. s)")
        below.append(Panel(marks, Axis("time / s"), unit, title=f"integral of the {name}"))
    return Chart(
        [above, below],
        f"Figure 2. White noise and the equation error of a one-mass model, of one r.m.s., and "
        f"their running integrals. White noise wanders off, the mechanical error's impulse stays "
        f"bounded. Band: twice the r.m.s. over {size.size} realisations.",
        share_y=True,
    )


def figure_3() -> Chart:
    """Gain of one window length, of two, and expected over a range."""
    frequency = np.geomspace(0.2, 50, 900)
    fixed = Boxcar().gain(frequency, np.array([FIXED]))[:, 0]
    two = Boxcar().gain(frequency, np.array(TWO)).mean(axis=1)
    drawn = Boxcar().mean_gain(frequency, *BETWEEN)
    return single(
        [
            Line(frequency, fixed, "T = 0.1 s", charts.RUST, width=1.0),
            Line(frequency, two, "mean of T = 0.1 and 0.33 s", charts.OCHRE, "dashed", width=1.0),
            Line(frequency, drawn, "mean of T from 0.1 to 1.0 s", charts.BLUE, width=charts.BOLD),
        ],
        Axis("frequency / Hz", log=True, low=0.2, high=50),
        Axis("gain / s", log=True, low=1e-4, high=1),
        "Figure 3. Gain of the integration over windows (eq. 13). A fixed length is blind at "
        "multiples of its inverse, a range of lengths at no frequency.",
    )


def sampled(curve: Callable[[Array], Array], x: np.ndarray) -> np.ndarray:
    """A curve's values, compiled in one piece."""
    return np.asarray(eqx.filter_jit(curve)(jnp.asarray(x)))


def figure_5(source: QuarterCarSource) -> Chart:
    """Damper, spring with bump stops, and engine mount."""
    row = []
    for name, curve, most, factor, label in (
        ("damper", source.damper, 1.5, 1.0, "velocity / (m/s)"),
        ("bump-stop spring", source.spring, 0.1, 1e3, "deflection / mm"),
        ("engine mount", source.mount, 8e-3, 1e3, "deflection / mm"),
    ):
        x = np.linspace(-most, most, 301)
        line = Line(factor * x, sampled(curve, x) / 1e3, width=charts.BOLD)
        title = f"{name} (reconstructed)"
        row.append(Panel([line], Axis(label), Axis("force / kN"), title=title))
    return Chart(
        [row],
        "Figure 5, reconstructed. Characteristics of the source model. The paper draws them and "
        "its text does not give them: these are fitted to Tables 3 to 5.",
    )


def figure_6(roads: reproduction.RoadResult) -> Chart:
    """The piecewise linear damper model, and the functions that it is a sum of."""
    velocity = np.linspace(-1.1, 1.1, 441)
    functions = sampled(RoofFunctions(BREAK_POINTS), velocity)
    riec = CRITERIA.index("RIEC")
    forces = [roads.identified("B_id", name)[:, riec].mean() / 1e3 for name in reproduction.FORCES]
    model = [
        Line(velocity, np.array(forces) @ functions, "sum of F_i R_i"),
        Dots(BREAK_POINTS, forces, "F_i at v_i", charts.RUST, size=charts.LARGE),
    ]
    roofs = [
        Line(velocity, function, f"R_{i}", *style)
        for i, (function, style) in enumerate(zip(functions, STYLES), 1)
    ]
    row = [
        Panel(model, Axis(VELOCITY), Axis("force / kN"), title="damper model"),
        Panel(roofs, Axis(VELOCITY), Axis("R_i"), title="regression functions"),
    ]
    return Chart(
        [row],
        "Figure 6. The piecewise linear damper of the identification model (with forces identified "
        f"by RIEC, B_id) and the roof functions that make it linear in its parameters, with break "
        f"points at {', '.join(f'{v:g}' for v in BREAK_POINTS)} m/s.",
    )


def damper_map(forces: np.ndarray, label: str, style: Style, width: float = charts.USUAL) -> Line:
    """Means over the roads of F_1 to F_4 at their velocities, with bars that hold 95 % of them.

    **Arguments:** `forces` in N, shape `(roads, 4)`.
    """
    mean, bars = forces.mean(axis=0) / 1e3, 1.96 * forces.std(axis=0) / 1e3
    return Line(BREAK_POINTS, mean, label, *style, width=width, markers=True, error=bars)


def figure_7(roads: reproduction.RoadResult, source: QuarterCarSource) -> Chart:
    """Identified damper maps, four variants by each method, over the source's curve."""
    velocity = np.linspace(-1.1, 1.1, 221)
    curve = Line(
        velocity, sampled(source.damper, velocity) / 1e3, "source", charts.GREY, width=charts.WIDE
    )
    forces = {
        v: np.stack([roads.identified(v, n) for n in reproduction.FORCES], axis=-1)
        for v in VARIANTS
    }
    row = []
    for i, criterion in enumerate(CRITERIA):
        maps = [damper_map(forces[v][:, i], v, style) for v, style in zip(VARIANTS, STYLES)]
        row.append(Panel([curve, *maps], Axis(VELOCITY), Axis(FORCE), title=criterion))
    return Chart(
        [row],
        "Figure 7. Identified damper maps, means over the roads with bars that hold 95 % of them. "
        "RIEC finds one map in all four variants, DOLS four.",
        share_y=True,
    )


SPEED = 20.0
"""m/s, published."""


def figure_8(shapes: Reconstruction) -> Chart:
    """Profile of the pot-hole, positive upwards as a road is drawn."""
    shape = {name: float(np.asarray(leaf)) for name, leaf in vars(shapes.pothole).items()}
    depth, length, ramp = shape.values()
    step, before = 5e-4, 0.05
    count = round((length + ramp + 2.0) / (SPEED * step))
    velocity = np.asarray(pothole(count, step, **shape, speed=SPEED, start=before))
    distance = SPEED * (step * np.arange(count) - before)
    return single(
        [Line(distance, -1e3 * step * np.cumsum(velocity), "", charts.BLACK, width=charts.BOLD)],
        Axis("distance / m"),
        Axis("road height / mm"),
        f"Figure 8, reconstructed. The pot-hole: {1e3 * depth:.0f} mm deep, {length:.2f} m between "
        f"the middles of its ramps of {ramp:.2f} m, crossed at {SPEED:g} m/s.",
    )


def tables_at_a_glance(roads: reproduction.RoadResult) -> Chart:
    """Every number of Tables 3 to 5 relative to its published value."""
    prefixes = {"3": "", "4": "K_s ", "5": "p "}
    cells = {
        f"{prefixes[name]}{row}, {criterion}": cell
        for name, table in number_tables(roads).items()
        for row, line in table.items()
        for criterion, cell in line.items()
    }
    published = np.array([[cell.published] for cell in cells.values()])
    numbers = np.array([(*cell.interval95, cell.reproduced) for cell in cells.values()])
    percent, places = 100 * (numbers / published - 1), np.arange(len(cells))
    inside = np.array([cell.inside for cell in cells.values()])
    marks: list[Level | Line | Dots] = [Level(0.0, "x")]
    for chosen, label, color in (
        (inside, "published number inside the range over roads", charts.BLUE),
        (~inside, "outside", charts.RUST),
    ):
        if chosen.any():
            # A gap after each range.
            ends = np.insert(percent[chosen, :2], 2, np.nan, axis=1).ravel()
            marks.append(Line(ends, np.repeat(places[chosen], 3), "", color, width=charts.BOLD))
            marks.append(Dots(percent[chosen, 2], places[chosen], label, color))
    reach = 1.05 * np.abs(percent[:, :2]).max()
    return single(
        marks,
        Axis("reproduced against published / %", low=-reach, high=reach),
        Axis(categories=tuple(cells), reverse=True),
        "Tables 3 to 5 at a glance: mean over the roads (dot) and the range that holds 95 % of "
        "them (line), against the published number.",
    )


def banded(
    x: ArrayLike, over_roads: ArrayLike, label: str, style: Style, shown: float = np.inf
) -> Line:
    """Median over the first axis, with the band from its 2.5 to its 97.5 % quantile.

    **Arguments:** `shown`, the largest value that is drawn; larger ones leave a gap.
    """
    with np.errstate(invalid="ignore"):
        # Of an order that is there: between a number and infinity lies nothing.
        shares = (0.025, 0.5, 0.975)
        low, middle, high = np.quantile(np.asarray(over_roads), shares, axis=0, method="nearest")
    drawn = np.abs(middle) <= shown
    low, middle = np.where(drawn, low, np.nan), np.where(drawn, middle, np.nan)
    high = np.where(drawn & np.isfinite(high), np.minimum(high, 1e9), np.nan)
    return Line(x, middle, label, *style, low=low, high=high)


QUANTITIES = (
    ("tyre deflection", "x1 / mm", 1e3),
    ("suspension deflection", "x2 / mm", 1e3),
    ("wheel velocity", "x3 / (m/s)", 1.0),
    ("body velocity", "x4 / (m/s)", 1.0),
)


def validation_figure(
    motion: reproduction.Trajectories, stretch: tuple[float, float], figure: str, where: str
) -> Chart:
    """What identified models predict of the source's motion on one of the inputs.

    **Arguments:** `stretch` that is drawn, in seconds.
    """
    predicted = np.asarray(motion.predicted)
    time = reproduction.STEP * np.arange(predicted.shape[-1])
    drawn = (time >= stretch[0]) & (time <= stretch[1])
    rows = []
    for i, (title, label, factor) in enumerate(QUANTITIES):
        # Behind the predictions, and wide: where they agree with it they would hide a thin line.
        source = factor * np.asarray(motion.source)[i, drawn]
        marks = [Line(time[drawn], source, "source", charts.PALE, width=charts.WIDE)]
        for method in reversed(CRITERIA):
            values = factor * predicted[:, CRITERIA.index(method), i, drawn]
            marks.append(banded(time[drawn], values, method, METHOD_STYLE[method]))
        x = Axis("time / s" if title == QUANTITIES[-1][0] else "")
        rows.append([Panel(marks, x, Axis(label), title=title)])
    return Chart(
        rows,
        f"{figure}. Validation of B_id models on {where}. {BAND} Models identified on "
        f"{predicted.shape[0]} roads predict one and the same motion.",
        share_x=True,
        legend=True,
    )


BANDWIDTH = Axis("input bandwidth / Hz", low=0, high=30.5)
CASES = {
    case: f"{case.replace('-', ' ')}, {mount.frequency:g} Hz" for case, mount in TABLE_6.items()
}
BY_CASE = [(case, method) for case in CASES for method in CRITERIA]


def by_case(
    study: reproduction.VariedStudy,
    values: Mapping[tuple[str, str], np.ndarray],
    y: Axis,
    *,
    behind: Sequence[Level] = (),
    shown: float = np.inf,
) -> list[Panel]:
    """A panel for each case of Table 6, with a line for each method over the bandwidth.

    **Arguments:** `values` of [`BY_CASE`][], shape `(roads, bandwidths)`; `shown`, the largest
    value that is drawn.
    """
    panels = []
    for case, title in CASES.items():
        lines = [
            banded(study.bandwidths, values[case, method], method, METHOD_STYLE[method], shown)
            for method in reversed(CRITERIA)
        ]
        panels.append(Panel([*behind, *lines], BANDWIDTH, y, title=title))
    return panels


def figure_11(study: reproduction.VariedStudy) -> Chart:
    """Masses and stiffness in the three cases of Table 6, by both methods."""
    rows = []
    for name, unit, scale in (("M_us", "kg", 1.0), ("M_s", "kg", 1.0), ("K_s", "(kN/m)", 1e3)):
        values = {key: study.identified(*key, name)[..., 0] / scale for key in BY_CASE}
        true = Level(reproduction.TRUE[name] / scale, label="source")
        rows.append(by_case(study, values, Axis(f"{name} / {unit}"), behind=[true]))
    return Chart(
        rows,
        f"Figure 11. Identified masses and suspension stiffness over the bandwidth of the input "
        f"(B_id). {BAND}",
        share_y=True,
        legend=True,
    )


def figure_12(study: reproduction.VariedStudy) -> Chart:
    """Damper forces in the pathological case."""
    row = []
    for method in reversed(CRITERIA):
        forces = study.identified("pathological", method, *reproduction.FORCES) / 1e3
        marks = [
            banded(study.bandwidths, forces[..., i], name, style)
            for i, (name, style) in enumerate(zip(reproduction.FORCES, STYLES))
        ]
        row.append(Panel(marks, BANDWIDTH, Axis("F_i / kN", low=-1.6, high=1.6), title=method))
    return Chart(
        [row],
        f"Figure 12. Identified damper forces over the bandwidth of the input, pathological case "
        f"(B_id). {BAND} Below about 3 Hz nothing reaches the outer break points, and F_1 and F_4 "
        f"are undetermined.",
        share_y=True,
        legend=True,
    )


def figure_13(damper: reproduction.Hysteresis, study: reproduction.VariedStudy) -> Chart:
    """At the lowest and at the highest of the bandwidths."""
    row = []
    for place in (0, -1):
        velocity, force = (
            np.asarray(a)[0, place, :MOST_DOTS] for a in (damper.velocity, damper.force)
        )
        source = Dots(
            velocity, force / 1e3, "source, one road", charts.GREY, size=charts.SMALL, opacity=0.5
        )
        band = int(np.argmin(np.abs(study.bandwidths - reproduction.BANDWIDTHS[place])))
        forces = {
            m: study.identified("pathological", m, *reproduction.FORCES)[:, band] for m in CRITERIA
        }
        maps = [
            damper_map(forces[method], method, METHOD_STYLE[method], charts.BOLD)
            for method in reversed(CRITERIA)
        ]
        x, y = Axis(VELOCITY, low=-1.2, high=1.2), Axis(FORCE, low=-1.6, high=1.6)
        row.append(
            Panel([source, *maps], x, y, title=f"input to {reproduction.BANDWIDTHS[place]:g} Hz")
        )
    return Chart(
        [row],
        "Figure 13. Identified damper maps (B_id, pathological case; bars hold 95 % of the roads) "
        "over force and velocity in the source. The compliant damper's hysteresis widens with "
        "bandwidth: DOLS follows the line of least instantaneous error, RIEC does not.",
        share_y=True,
    )


def figure_14(study: reproduction.VariedStudy) -> Chart:
    """Validation error in the three cases, on both inputs."""
    rows = []
    for where, name, most in (("road", "road", 130.0), ("pothole", "pot-hole", 350.0)):
        errors = {key: study.summed_error(*key, where) for key in BY_CASE}
        y = Axis(f"p on the {name} / %", low=0, high=most)
        rows.append(by_case(study, errors, y, shown=1.3 * most))
    return Chart(
        rows,
        f"Figure 14. Validation error, summed over x1 to x4, over the bandwidth of the input that "
        f"the model was identified on (B_id). {BAND} Models from inputs below about 4 Hz know "
        f"nothing of the damper's outer break points and lose their solution.",
        share_y=True,
        legend=True,
    )


def length_map_chart(lengths: Float[Array, "roads pairs parameters"]) -> Chart:
    """Estimates over alpha and beta (Section 4), as changes from Table 2's choice."""
    theta = np.asarray(lengths).mean(axis=0)
    grid, names = (
        np.arange(len(reproduction.LENGTHS)),
        tuple(f"{length:g}" for length in reproduction.LENGTHS),
    )
    # The next length of the grid below one that is a sample longer than alpha is alpha itself.
    across, up = (
        np.searchsorted(reproduction.LENGTHS, reproduction.PAIRS.T + 1e-9, side="right") - 1
    )
    row = []
    for name in SHOWN:
        values = theta[:, reproduction.PARAMETERS.index(name)]
        change = np.full((grid.size, grid.size), np.nan)
        change[up, across] = 100 * (values / values[reproduction.OF_TABLE_2] - 1)
        heat = HeatMap(grid, grid, change, "change / %", -20.0, 20.0)
        x, y = Axis("alpha / s", categories=names), Axis("beta / s", categories=names)
        row.append(Panel([heat], x, y, title=name))
    return Chart(
        [row],
        f"Sensitivity to the window lengths (claim 8): change of the identified values from those "
        f"of Table 2's lengths ({TABLE_2.alpha:g} to {TABLE_2.beta:g} s), mean over the roads, "
        f"with all windows of each pair. On the diagonal beta is one sample longer than alpha.",
    )
