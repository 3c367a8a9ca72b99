"""Figures of Section 2 (2, 3) and of the models (5, 6, 8)."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from riecjax import Boxcar
from riecjax.criteria import expected_gain
from riecjax.equations import RoofFunctions
from riecjax.models.quarter_car.identification import BREAK_POINTS
from riecjax.models.quarter_car.reconstruction import Reconstruction
from riecjax.models.quarter_car.source import QuarterCarSource
from riecjax.paper.claims.sections_2_to_5 import BETWEEN, FIXED, TWO
from riecjax.paper.reproduction import RoadResult
from riecjax.paper.section_2 import DURATION, RATE, Demonstration
from riecjax.reporting.charts.chart import (
    BLACK,
    BLUE,
    DASHES,
    GREY,
    OCHRE,
    RUST,
    SERIES,
    Axis,
    Chart,
    Dots,
    Line,
    Panel,
    single,
)
from riecjax.simulation import pothole

EXCERPT = 1.0
"""Seconds of the signals themselves that are drawn."""
MOST = 1500
"""Samples of an integral that are drawn."""


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
                    [Line(time[few], excerpt, "", color, width=0.6)],
                    Axis("time / s"),
                    Axis("signal / its r.m.s.", low=-4.5, high=4.5),
                    title=name,
                ),
                Panel(
                    [
                        Line(time[thin], zero, label, GREY, width=1.0, **ends),
                        Line(time[thin], one, "one realisation", color, width=0.9),
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
        (8.5, 5.2),
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
            Line(frequency, drawn, "mean of T from 0.1 to 1.0 s", BLUE, width=1.8),
        ],
        Axis("frequency / Hz", log=True, low=0.2, high=50),
        Axis("gain / s", log=True, low=1e-4, high=1),
        "Figure 3. Gain of the integration over windows (eq. 13). A fixed length is blind at "
        "multiples of its inverse, a range of lengths at no frequency.",
        size=(7.0, 4.2),
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
