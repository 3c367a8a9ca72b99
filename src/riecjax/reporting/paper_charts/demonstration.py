"""Figures of Section 2: bounded impulses (2) and the gain of windows (3)."""

import numpy as np

from riecjax.criteria.test_functions import Boxcar
from riecjax.paper.claims.section_2 import BETWEEN, FIXED, TWO
from riecjax.paper.demonstration import DURATION, RATE, Demonstration
from riecjax.reporting.charts.chart import (
    BLUE,
    GREY,
    OCHRE,
    RUST,
    Axis,
    Chart,
    Line,
    Panel,
    single,
)
from riecjax.studies.expected_gain import expected_gain

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
    rows, largest = [], 0.0
    for name, (signal, integral, color) in parts.items():
        values, running = np.asarray(signal) / size, np.asarray(integral) / size
        spread = np.sqrt(np.mean(running**2, axis=0))[thin]
        largest = max(largest, float(2.2 * spread.max()), float(1.1 * np.abs(running[0]).max()))
        rows.append(
            (
                Panel(
                    [Line(time[few], values[0][few], "", color, width=0.6)],
                    Axis("time / s"),
                    Axis("signal / its r.m.s.", low=-4.5, high=4.5),
                    title=name,
                ),
                [
                    Line(
                        time[thin],
                        0 * time[thin],
                        "± 2 r.m.s. over realisations",
                        GREY,
                        width=1.0,
                        low=-2 * spread,
                        high=2 * spread,
                    ),
                    Line(time[thin], running[0][thin], "one realisation", color, width=0.9),
                ],
                name,
            )
        )
    count = size.shape[0]
    return Chart(
        [
            [
                left,
                Panel(
                    marks,
                    Axis("time / s"),
                    Axis("integral / (r.m.s. s)", low=-largest, high=largest),
                    title=f"integral of the {name}",
                ),
            ]
            for left, marks, name in rows
        ],
        f"Figure 2. White noise and the equation error of a one-mass model, of one r.m.s., and "
        f"their running integrals. White noise wanders off, the mechanical error's impulse stays "
        f"bounded. Band: twice the r.m.s. over {count} realisations.",
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
