"""Figures of the models: reconstructed curves (5), the damper map (6) and the pot-hole (8)."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from riecjax.equations.bases import RoofFunctions
from riecjax.models.quarter_car.identification import BREAK_POINTS
from riecjax.models.quarter_car.reconstruction import Reconstruction
from riecjax.models.quarter_car.source import QuarterCarSource
from riecjax.paper.reproduction import RoadResult
from riecjax.reporting.charts.chart import (
    BLACK,
    DASHES,
    RUST,
    SERIES,
    Axis,
    Chart,
    Dots,
    Line,
    Panel,
    single,
)
from riecjax.simulation.excitation import pothole

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
        (
            "bump-stop spring",
            source.spring,
            np.linspace(-0.1, 0.1, 301),
            1e3,
            "deflection / mm",
        ),
        ("engine mount", source.mount, np.linspace(-8e-3, 8e-3, 301), 1e3, "deflection / mm"),
    )
    return Chart(
        [
            [
                Panel(
                    [Line(factor * x, sampled(curve, x) / 1e3, width=1.6)],
                    Axis(label),
                    Axis("force / kN"),
                    title=f"{name} (reconstructed)",
                )
                for name, curve, x, factor, label in curves
            ]
        ],
        "Figure 5, reconstructed. Characteristics of the source model. The paper draws them and "
        "its text does not give them: these are fitted to Tables 3 to 5.",
        (10.0, 3.2),
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
            Dots(BREAK_POINTS, np.array(forces) / 1e3, "F_i at v_i", RUST, size=5),
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
        (9.0, 3.6),
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
        [Line(distance, -1e3 * step * np.cumsum(velocity), "", BLACK, width=1.6)],
        Axis("distance / m"),
        Axis("road height / mm"),
        f"Figure 8, reconstructed. The pot-hole: {1e3 * depth:.0f} mm deep, {length:.2f} m between "
        f"the middles of its ramps of {ramp:.2f} m, crossed at {SPEED:g} m/s.",
        size=(7.0, 2.8),
    )
