"""Hidden modes: what speaks for them in plain data, in words and as a map."""

from collections.abc import Iterator, Sequence

import numpy as np

from riecjax.estimation.mode_evidence import ModeEvidence
from riecjax.reporting.charts.chart import BLUE, GREY, RUST, Axis, Chart, Level, Line, Panel
from riecjax.reporting.document import Document, finite, number

LOWEST = 0.3
"""Where nothing is left, beside the least that is, on a logarithmic axis."""


def mode_entries(modes: Sequence[ModeEvidence]) -> list[Document]:
    """The part of the document about hidden modes, the last one of each stage."""
    return [
        {
            "on": mode.on,
            "equation": mode.stage,
            "parameters": list(mode.parameters),
            "frequency_hz": finite(mode.frequency[0]),
            "frequency_std_error_hz": finite(mode.frequency[1]),
            "damping_ratio": finite(mode.damping_ratio[0]),
            "damping_ratio_std_error": finite(mode.damping_ratio[1]),
            "window_s": list(mode.lengths),
            "strays": [
                {"parameters": list(names), "asked_hz": asked, "found_hz": finite(found)}
                for names, asked, found in mode.strays
            ],
            "carried": mode.carried,
            "oscillates": mode.oscillates,
            "explained": finite(mode.explained),
            "held_out": {
                "with": finite(mode.unexplained),
                "without": finite(mode.without),
                "gain": finite(mode.gain),
                "gain_std_error": finite(mode.gain_error),
            },
            "map": {
                "frequency_hz": finite(mode.map.frequency),
                "unexplained": finite(mode.map.unexplained),
                "without": finite(mode.map.without),
                "damping_ratio": finite(mode.map.damping),
            },
        }
        for mode in modes
    ]


def modes_in_words(modes: Sequence[Document]) -> Iterator[str]:
    """Where each mode is, what it explains, the windows that it was found in, and which modes
    were looked for elsewhere."""
    for mode in modes:
        low, high = mode["window_s"]
        lengths = f"{low:.3g} s" if low == high else f"{low:.3g} to {high:.3g} s"
        held = mode["held_out"]
        left = max(held["with"], 0.0)  # less than nothing, where noise was taken off
        frequency, ratio = (
            f"{number(mode[key], 4)} +- {number(mode[error], 2)}"
            for key, error in (
                ("frequency_hz", "frequency_std_error_hz"),
                ("damping_ratio", "damping_ratio_std_error"),
            )
        )
        yield (
            f"hidden mode on {mode['on']}: {frequency} Hz with the body at rest, damping ratio "
            f"{ratio}, in windows of {lengths}, which tell most of it. On time that it was not "
            f"found from {100 * left:.2g} % of {mode['equation']} is left with it and "
            f"{100 * held['without']:.2g} % without."
        )
        for stray in mode["strays"]:
            yield (
                f"no mode near {stray['asked_hz']:.4g} Hz: the search for "
                f"{stray['parameters'][0]} ended at {number(stray['found_hz'], 3)} Hz."
            )


def mode_map_figure(modes: Sequence[ModeEvidence]) -> Chart:
    """What a mode at each frequency leaves of its equation, and what is left without one."""
    rows = []
    for mode in modes:
        frequency = np.asarray(mode.map.frequency)
        left = np.asarray(mode.map.unexplained)
        # Where no mode fits there is no best damping either, which the other share depends on.
        fits = np.isfinite(left)
        # A logarithmic axis has no room for nothing.
        floor = LOWEST * np.min(left, where=left > 0, initial=1.0)
        shown = np.where(fits, np.maximum(left, floor), np.nan)
        without = np.where(fits, np.asarray(mode.map.without), np.nan)
        marks = [
            Line(frequency, without, "without a mode", GREY),
            Line(frequency, shown, "with a mode there", RUST, markers=True),
            Level(mode.frequency[0], "x", "the mode found", BLUE, "dashed"),
        ]
        share = Axis(f"share of {mode.stage} unexplained", log=True)
        rows.append([Panel(marks, Axis("frequency of the mode / Hz", log=True), share)])
    return Chart(
        rows,
        "The mode map: of each frequency that a hidden mode could have, the share of the target's "
        "energy that the equation then leaves, at the best mass and the best damping ratio from "
        "0.02 to 0.8. Both shares are of the equation multiplied by that mode's own polynomial, "
        "so that the share without a mode, too, depends on its frequency and damping; where the "
        "best damping jumps from one value to another, it has a step. Gaps are frequencies at "
        "which only a negative mass would fit; at the lowest points noise accounts for all.",
        (7, 3.2 * len(rows) + 0.6),
        legend=True,
    )
