"""Whether recordings carry a hidden mode: what it explains of blocks of time it was not found from.

The record is cut into folds. Of each, the mode is found from all others, and what it leaves of the
fold is compared with what the equation leaves without it, both multiplied by the same D and less
noise. A mode that is not there explains nothing of a fold but by chance, wherever the search has
put it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from riecjax import arrays as xp
from riecjax.arrays import Array
from riecjax.equations.equation import Equation
from riecjax.equations.hidden_elements import Expanded, HiddenMode, mode_frequency
from riecjax.equations.model import Model, as_model
from riecjax.errors import ModelError
from riecjax.estimation.estimate import Estimate
from riecjax.estimation.hidden_modes import (
    ModeMap,
    ModeStage,
    Values,
    find_modes,
    mode_map,
    polished,
    search_band,
)
from riecjax.findings import Finding, in_percent
from riecjax.leaves import Leaf, finite, told
from riecjax.shows import Drawn
from riecjax.summaries.normal_equations import NormalEquations

FOLDS = 10
"""Stretches of time that are left out in turn."""
CERTAIN = 3.0
"""Standard errors by which a mode must explain more than nothing: of ten folds, one in 130."""
LEAST = 1e-5
"""Share of the target that is left of any equation by integration between samples."""
UNSURE = 0.2
"""Share of the noise's own energy that may be left because its size was judged wrongly."""
LITTLE = 0.5
"""Share of what is left without a mode that a true one explains at the least."""
NEAR = 2**0.5
"""Ratio of frequencies up to which a mode is near another frequency: half an octave."""


Stray = tuple[tuple[str, ...], float, float]
"""Parameters of a mode, the frequency in hertz near which it was asked for, and that where it was
found."""


# It prints in words, which no named tuple can take from a base class.
@dataclass(frozen=True, eq=False, repr=False)
class ModeEvidence(Drawn):
    """What speaks for the last hidden mode of a stage.

    **Fields:** `parameters` of the mode, of the `stage` its name, and the signal that it is `on`;
    natural `frequency` in hertz of the mass on a body at rest, and `damping_ratio`, each with its
    standard error; `oscillates`, whether mass,
    stiffness and damping are positive and the damping less than critical; `map`, what a mode of any
    frequency leaves, see [`ModeMap`][riecjax.estimation.ModeMap]; `unexplained` share of the
    target on time left out, with and `without` the mode, means over folds; `gain`, their
    difference, and its standard error; `noise`, share of the target that noise was in the residual,
    and that was taken off; `lengths` of the windows in seconds; `strays`, modes of the stage that
    the search has led farther than half an octave away from where they were asked for.
    """

    parameters: tuple[str, ...]
    stage: str
    on: str
    frequency: tuple[float, float]
    damping_ratio: tuple[float, float]
    oscillates: bool
    map: ModeMap
    unexplained: Float[Leaf, ""]
    without: Float[Leaf, ""]
    noise: Float[Leaf, ""]
    gain: Float[Leaf, ""]
    gain_error: Float[Leaf, ""]
    lengths: tuple[float, float]
    strays: tuple[Stray, ...] = ()

    @property
    def explained(self) -> float:
        """Share that the mode explains of what is left without it, on time left out."""
        without = float(self.without)
        return float(self.gain) / without if without > 0 else 0.0

    @property
    def carried(self) -> bool:
        """Whether the recordings carry the mode: it explains more than chance would, and much."""
        least = max(CERTAIN * float(self.gain_error), LEAST, UNSURE * float(self.noise))
        much = float(self.gain) > least and self.explained > LITTLE
        return much and self.oscillates

    def findings(self) -> list[Finding]:
        """Warnings if nothing speaks for the mode, or little, and of modes found elsewhere."""
        elsewhere = [
            Finding(
                "mode_elsewhere",
                f"{self.stage}: no mode near {asked:.4g} Hz: the search for {names[0]} ended at "
                f"{found:.3g} Hz. If the record carries both, ask for both (on the command line: "
                f"--add-mode {self.on}={asked:.4g} --add-mode {self.on}={found:.3g}).",
                parameters=names,
            )
            for names, asked, found in self.strays
        ]
        if self.carried:
            return elsewhere
        # Less than nothing is left where more noise was taken off than there was.
        shares = "noise accounts for all that is left"
        if float(self.without) > 0:
            shares = (
                f"{in_percent(self.without)} of the signal is left without it and "
                f"{in_percent(max(float(self.unexplained), 0.0))} with it, difference "
                f"{100 * float(self.gain):.2g} +- {in_percent(self.gain_error)}"
            )
        names = self.parameters
        first = names == HiddenMode(self.on).parameters
        close = "" if first else ", or cannot tell it from another that lies close"
        mode = f"the hidden mode on {self.on} ({names[0]})"
        message = (
            f"{self.stage}: the recordings do not carry this mode{close}: on time that it was not "
            f"found from, {mode} explains {in_percent(max(self.explained, 0.0))} of what is left "
            f"without it ({shares}). Leave it out; something else is missing, such as friction or "
            f"a delay, or nothing."
        )
        if not self.oscillates and self.explained > LITTLE:
            message = (
                f"{self.stage}: what fits best in place of {mode} is no oscillator: its mass, "
                f"stiffness or damping is negative, or its damping more than critical. Leave it "
                f"out; something else is missing, such as a delay of one signal."
            )
        return [Finding("mode_not_carried", message, parameters=names), *elsewhere]

    def entry(self) -> dict[str, Any]:
        """All of it, as plain data for JSON."""
        return {
            "on": self.on,
            "equation": self.stage,
            "parameters": list(self.parameters),
            "frequency_hz": finite(self.frequency[0]),
            "frequency_std_error_hz": finite(self.frequency[1]),
            "damping_ratio": finite(self.damping_ratio[0]),
            "damping_ratio_std_error": finite(self.damping_ratio[1]),
            "window_s": list(self.lengths),
            "strays": [
                {"parameters": list(names), "asked_hz": asked, "found_hz": finite(found)}
                for names, asked, found in self.strays
            ],
            **told(self, "carried", "oscillates", "explained"),
            "held_out": {
                "with": finite(self.unexplained),
                **told(self, "without", "gain"),
                "gain_std_error": finite(self.gain_error),
            },
            "map": {
                "frequency_hz": finite(self.map.frequency),
                **told(self.map, "unexplained", "without"),
                "damping_ratio": finite(self.map.damping),
            },
        }


class ModeTests(NamedTuple):
    """What speaks for the last hidden mode of each stage, as a test of an answer."""

    modes: Sequence[ModeEvidence]
    name = "modes"

    def findings(self) -> list[Finding]:
        """Findings of all modes."""
        return [finding for mode in self.modes for finding in mode.findings()]

    def entry(self) -> list[dict[str, Any]]:
        """Of each mode, plain data for JSON."""
        return [mode.entry() for mode in self.modes]


def mode_evidence(model: Equation | Model, estimate: Estimate) -> list[ModeEvidence]:
    """What speaks for the hidden modes of an estimate, stage by stage (not under jit).

    **Raises:** `ModelError` for an estimate without a Summary or a model without modes.
    """
    model, summary = as_model(model), estimate.summary
    if summary is None or not model.modes:
        raise ModelError("evidence is of an estimate, made outside jax.jit, of hidden modes.")
    values = estimate.values
    given = {name: np.asarray(value) for name, value in estimate.known.items()}
    found = find_modes(model, summary, given)
    evidence, known = [], dict(given)
    for i, equations in enumerate(model.expanded):
        stage = ModeStage.of(equations, summary.equations()[i], known)
        modes = [element for element in stage.sought if isinstance(element, HiddenMode)]
        if modes:
            sums, last = summary.equations(found.bands[i])[i], modes[-1]
            # Modes that lie far from the frequency asked for, and the band that shows the last one.
            places = ((m.parameters, m.hz, float(mode_frequency(values, m)[0])) for m in modes)
            strays = [
                (names, hz, at)
                for names, hz, at in places
                if hz is not None and not hz / NEAR <= at <= hz * NEAR
            ]
            low, high = search_band(summary, last)
            for at in (at for names, _, at in strays if names == last.parameters):
                low, high = np.minimum(low, at / NEAR), np.maximum(high, at * NEAR)
            raw = _evidence(equations, sums, known, found.at[i], (low, high))
            mass, stiffness, damping = size = [float(values[name]) for name in last.parameters]
            # Frequency and damping ratio, with errors by their logarithms' slopes:
            # log f = (log K - log M) / 2 + ..., log zeta = log B - (log K + log M) / 2 + ...
            own = [estimate.parameters.index(name) for name in last.parameters]
            relative = np.asarray(estimate.covariance)[np.ix_(own, own)] / np.outer(size, size)
            slopes = np.array([[-0.5, 0.5, 0.0], [-0.5, -0.5, 1.0]])
            errors = np.sqrt(np.einsum("ki,ij,kj->k", slopes, relative, slopes))
            pairs = zip(mode_frequency(values, last), errors)
            frequency, ratio = ((float(v), abs(float(v)) * float(e)) for v, e in pairs)
            evidence.append(
                ModeEvidence(
                    last.parameters,
                    model.plan(set(known))[i][0],
                    last.on,
                    frequency,
                    ratio,
                    min(size) > 0 and damping**2 < 4 * mass * stiffness,
                    *raw,
                    summary.lengths_of(found.bands[i] or summary.band),
                    tuple(strays),
                )
            )
        known |= {n: np.asarray(values[n]) for e in equations for n in e.all_parameters}
    return evidence


def _evidence(
    equations: tuple[Expanded, ...],
    sums: list[NormalEquations],
    known: Values,
    at: Float[Array, " shapes"],
    band: tuple[Leaf, Leaf],
) -> tuple[ModeMap, Array, Array, Array, Array, Array]:
    stage = ModeStage.of(equations, sums, known)
    # Clean moments of stretches of time, of all recordings one after the other, by windows rather
    # than by blocks, some of which only fill the array up.
    folds = []
    for flat in (one.flattened() for one in sums):
        before = np.cumsum(flat.count) - 0.5 * flat.count
        place = np.clip(FOLDS * before / np.sum(flat.count), 0, FOLDS - 1).astype(int)
        folds.append(xp.sum_by_block(flat.clean, place, FOLDS))

    def of_fold(number: int) -> tuple[Array, Array]:
        others = [whole - fold[number] for whole, fold in zip(stage.moments, folds)]
        train = stage._replace(moments=others)
        there = polished(train, at)
        fit = train.projected(there)
        own = [fold[number] for fold in folds]
        target = stage._replace(moments=own).projected(there).target
        share = np.where(target > 0, target, np.inf)
        left = stage.energy(own, there, fit.theta) / share
        return left, stage.energy(own, there, fit.without_last().theta) / share

    fit = stage.projected(at)
    totals = [one.flattened().total() for one in sums]
    added = [np.zeros_like(t.moments) if t.noise is None else t.noise for t in totals]
    noise = stage.energy(added, at, fit.theta) / np.where(fit.target > 0, fit.target, np.inf)
    left, without = np.array([of_fold(number) for number in range(FOLDS)]).T
    gain = without - left
    error = np.std(gain, ddof=1) / np.sqrt(FOLDS)
    parts = stage.by_element(at)
    mode = [element for element in parts if isinstance(element, HiddenMode)][-1]
    others = {element: part for element, part in parts.items() if element != mode}
    return (
        mode_map(
            stage._replace(sought=(*others, mode)),
            band,
            np.concatenate([np.zeros(0), *others.values()]),
        ),
        np.mean(left),
        np.mean(without),
        noise,
        np.mean(gain),
        error,
    )
