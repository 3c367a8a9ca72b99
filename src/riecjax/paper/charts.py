"""The figures of the paper, from many roads where it shows one."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from riecjax import Boxcar
from riecjax.criteria import expected_gain
from riecjax.equations import RoofFunctions
from riecjax.models.quarter_car.identification import BREAK_POINTS
from riecjax.models.quarter_car.reconstruction import Reconstruction, quarter_car_source
from riecjax.models.quarter_car.source import QuarterCarSource
from riecjax.paper.claims import BETWEEN, FIXED, TWO
from riecjax.paper.published import CRITERIA, TABLE_2, VARIANTS
from riecjax.paper.reproduction import (
    DURATION,
    LENGTHS,
    PARAMETERS,
    RATE,
    VALIDATED_STATES,
    Demonstration,
    LengthMap,
    RoadResult,
    Trajectories,
)
from riecjax.paper.study import PaperStudy
from riecjax.paper.tables import table_3, table_4, table_5
from riecjax.paper.variations import BANDWIDTHS, Hysteresis, Varied, VariedStudy
from riecjax.reporting.charts import (
    BLACK,
    BLUE,
    BOLD,
    DASHES,
    GREY,
    LARGE,
    OCHRE,
    PALE,
    RUST,
    SERIES,
    SMALL,
    THIN,
    WIDE,
    Axis,
    Chart,
    Dashes,
    Dots,
    HeatMap,
    Level,
    Line,
    Panel,
    single,
)
from riecjax.simulation import pothole

EXCERPT = 1.0
"""Seconds of the signals themselves that are drawn."""
MOST = 1500
"""Samples of an integral that are drawn."""
MOST_DOTS = 4000
"""Samples of a scatter that are drawn."""


def figure_2(demonstrations: Demonstration) -> Chart:
    """White noise and the mechanical error, and their running integrals."""
    time = np.arange(round(DURATION * RATE)) / RATE
    # The size of the force is arbitrary: everything in units of the error's r.m.s.
    size = np.sqrt(np.mean(np.asarray(demonstrations.error) ** 2, axis=1))[:, None]
    parts = {
        "white noise": (demonstrations.noise, demonstrations.noise_integral, RUST),
        "mechanical error": (demonstrations.error, demonstrations.error_integral, BLUE),
    }
    few = slice(0, round(EXCERPT * RATE))
    thin = np.linspace(0, time.size - 1, MOST).astype(int)
    integrals = {name: np.asarray(integral) / size for name, (_, integral, _) in parts.items()}
    spreads = {n: np.sqrt(np.mean(values**2, axis=0))[thin] for n, values in integrals.items()}
    largest = max(
        max(2.2 * float(spreads[name].max()), 1.1 * float(np.abs(values[0]).max()))
        for name, values in integrals.items()
    )
    rows = []
    for name, (signal, _, color) in parts.items():
        excerpt, one = (np.asarray(signal) / size)[0][few], integrals[name][0][thin]
        ends = {"low": -2 * spreads[name], "high": 2 * spreads[name]}
        zero, label = 0 * time[thin], "± 2 r.m.s. over realisations"
        rows.append(
            [
                Panel(
                    [Line(time[few], excerpt, "", color, width=THIN)],
                    Axis("time / s"),
                    Axis("signal / its r.m.s.", low=-4.5, high=4.5),
                    title=name,
                ),
                Panel(
                    [
                        Line(time[thin], zero, label, GREY, width=1.0, **ends),
                        Line(time[thin], one, "one realisation", color, width=THIN),
                    ],
                    Axis("time / s"),
                    Axis("integral / (r.m.s. s)", low=-largest, high=largest),
                    title=f"integral of the {name}",
                ),
            ]
        )
    return Chart(
        rows,
        f"Figure 2. White noise and the equation error of a one-mass model, of one r.m.s., and "
        f"their running integrals. White noise wanders off, the mechanical error's impulse stays "
        f"bounded. Band: twice the r.m.s. over {size.shape[0]} realisations.",
    )


def figure_3() -> Chart:
    """Gain of one window length, of two, and expected over a range."""
    frequency = np.geomspace(0.2, 50, 900)
    one = Boxcar().gain(frequency, np.array([FIXED]))[:, 0]
    two = Boxcar().gain(frequency, np.array(TWO)).mean(axis=1)
    drawn = expected_gain(frequency, *BETWEEN, Boxcar())
    return single(
        [
            Line(frequency, one, "T = 0.1 s", RUST, width=1.0),
            Line(frequency, two, "mean of T = 0.1 and 0.33 s", OCHRE, "dashed", width=1.0),
            Line(frequency, drawn, "mean of T from 0.1 to 1.0 s", BLUE, width=BOLD),
        ],
        Axis("frequency / Hz", log=True, low=0.2, high=50),
        Axis("gain / s", log=True, low=1e-4, high=1),
        "Figure 3. Gain of the integration over windows (eq. 13). A fixed length is blind at "
        "multiples of its inverse, a range of lengths at no frequency.",
    )


SPEED = 20.0
"""m/s, published."""


@eqx.filter_jit
def _values(curve: Callable[[Array], Array], x: Array) -> Array:
    return curve(x)


def sampled(curve: Callable[[Array], Array], x: np.ndarray) -> np.ndarray:
    """A curve's values, compiled in one piece."""
    return np.asarray(_values(curve, jnp.asarray(x)))


def figure_5(source: QuarterCarSource) -> Chart:
    """Damper, spring with bump stops, and engine mount."""
    curves = (
        ("damper", source.damper, np.linspace(-1.5, 1.5, 301), 1.0, "velocity / (m/s)"),
        ("bump-stop spring", source.spring, np.linspace(-0.1, 0.1, 301), 1e3, "deflection / mm"),
        ("engine mount", source.mount, np.linspace(-8e-3, 8e-3, 301), 1e3, "deflection / mm"),
    )
    return Chart(
        [
            [
                Panel(
                    [Line(factor * x, sampled(curve, x) / 1e3, width=BOLD)],
                    Axis(label),
                    Axis("force / kN"),
                    title=f"{name} (reconstructed)",
                )
                for name, curve, x, factor, label in curves
            ]
        ],
        "Figure 5, reconstructed. Characteristics of the source model. The paper draws them and "
        "its text does not give them: these are fitted to Tables 3 to 5.",
    )


def figure_6(roads: RoadResult) -> Chart:
    """The piecewise linear damper model, and the functions that it is a sum of."""
    velocity = np.linspace(-1.1, 1.1, 441)
    functions = sampled(RoofFunctions(BREAK_POINTS), velocity)
    forces = [
        float(np.mean(np.asarray(roads.parameters["RIEC"]["B_id"][f"F_{i}"]))) for i in range(1, 5)
    ]
    model = Panel(
        [
            Line(velocity, np.array(forces) @ functions / 1e3, "sum of F_i R_i"),
            Dots(BREAK_POINTS, np.array(forces) / 1e3, "F_i at v_i", RUST, size=LARGE),
        ],
        Axis("suspension velocity / (m/s)"),
        Axis("force / kN"),
        title="damper model",
    )
    roofs = Panel(
        [
            Line(velocity, function, f"R_{i + 1}", SERIES[i], DASHES[i])
            for i, function in enumerate(functions)
        ],
        Axis("suspension velocity / (m/s)"),
        Axis("R_i"),
        title="regression functions",
    )
    return Chart(
        [[model, roofs]],
        "Figure 6. The piecewise linear damper of the identification model (with forces identified "
        f"by RIEC, B_id) and the roof functions that make it linear in its parameters, with break "
        f"points at {', '.join(f'{v:g}' for v in BREAK_POINTS)} m/s.",
    )


def figure_8(shapes: Reconstruction) -> Chart:
    """Profile of the pot-hole, positive upwards as a road is drawn."""
    depth, length, ramp = (
        float(np.asarray(value))
        for value in (shapes.pothole.depth, shapes.pothole.length, shapes.pothole.ramp)
    )
    step, before = 5e-4, 0.05
    count = round((length + ramp + 2.0) / (SPEED * step))
    velocity = np.asarray(
        pothole(count, step, depth=depth, length=length, ramp=ramp, speed=SPEED, start=before)
    )
    distance = SPEED * (step * np.arange(count) - before)
    return single(
        [Line(distance, -1e3 * step * np.cumsum(velocity), "", BLACK, width=BOLD)],
        Axis("distance / m"),
        Axis("road height / mm"),
        f"Figure 8, reconstructed. The pot-hole: {1e3 * depth:.0f} mm deep, {length:.2f} m between "
        f"the middles of its ramps of {ramp:.2f} m, crossed at {SPEED:g} m/s.",
    )


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
        # Of an order that is there: between a number and infinity lies nothing.
        shares = (0.025, 0.5, 0.975)
        low, middle, high = np.quantile(values, shares, axis=0, method="nearest")
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
        marks.append(Line(x, y, "", color, width=BOLD))
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
    curve = Line(velocity, sampled(source.damper, velocity) / 1e3, "source", GREY, width=WIDE)
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


def figures_9_and_10(found: Trajectories, where: str, caption: str) -> Chart:
    """What identified models predict of the source's motion on one of the inputs."""
    time = np.asarray(found.time)
    first, last = SHOWN[where]
    drawn = (time >= first) & (time <= last)
    rows = []
    for i, state in enumerate(VALIDATED_STATES):
        what, unit, factor = QUANTITIES[state]
        source = factor * np.asarray(found.source)[drawn, i]
        # Behind the predictions, and wide: where they agree with it they would hide a thin line.
        marks = [Line(time[drawn], source, "source", PALE, width=WIDE)]
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
        share_x=True,
        legend=True,
    )


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
    )


def _places(lengths: np.ndarray) -> np.ndarray:
    """Of each length in the grid, rounded down."""
    return np.searchsorted(np.array(LENGTHS), lengths + 1e-9, side="right") - 1


def figure_13(damper: Hysteresis, study: VariedStudy) -> Chart:
    """At the lowest and at the highest of the bandwidths."""
    models = study.found["pathological"]
    row = []
    for place in (0, len(BANDWIDTHS) - 1):
        velocity, force = (
            np.asarray(values)[0, place][:MOST_DOTS] for values in (damper.velocity, damper.force)
        )
        marks: list[Dots | Line] = [
            Dots(velocity, force / 1e3, "source, one road", GREY, size=SMALL, opacity=0.5)
        ]
        band = int(np.argmin(np.abs(study.bandwidths - BANDWIDTHS[place])))
        marks += [
            damper_map(
                [models[method].parameters[f"F_{i}"][:, band, 0] for i in range(1, 5)],
                method,
                METHOD_STYLE[method],
                width=BOLD,
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
        share_y=True,
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
        "figure_9": figures_9_and_10(
            study.trajectories["road"],
            "road",
            "Figure 9. Validation of B_id models on a Robson road.",
        ),
        "figure_10": figures_9_and_10(
            study.trajectories["pothole"],
            "pothole",
            "Figure 10. Validation of B_id models on the pot-hole.",
        ),
        "figure_11": figure_11(study.variations),
        "figure_12": figure_12(study.variations),
        "figure_13": figure_13(study.damper, study.variations),
        "figure_14": figure_14(study.variations),
        "window_lengths": length_map_chart(study.lengths),
    }
