"""Which window lengths suit a model: where its error is small relative to what it explains.

A window's error is the equation error through the gain |H| of eq. (13), its signal the target
through the same gain. Over all starts their mean squares are, by Parseval,

    E e_T^2 = integral |H_T(f)|^2 S_error(f) df,    E y_T^2 = integral |H_T(f)|^2 S_target(f) df,

so that two spectra tell the share of error sqrt(E e_T^2 / E y_T^2) at every window length, before
anything is fitted there. For short windows |H| = T at all frequencies and the share is that of the
samples: modes that the model lacks count in full. For long ones |H|^2 = (sin(w T / 2) / (w / 2))^2
falls with the square of frequency, so these modes average out. An offset, at frequency zero, has
|H|^2 = T^2 throughout and grows beside a motion that has long returned: the share rises with T.
"""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from riecjax.criteria.test_functions import AbstractTestFunction, Boxcar
from riecjax.criteria.windows import AbstractWindows
from riecjax.equations.equation import Equation
from riecjax.equations.model import Model
from riecjax.errors import ModelError
from riecjax.estimation.estimate import Estimate
from riecjax.findings import Finding
from riecjax.records.record import Records, as_records
from riecjax.validation.equation_errors import EquationError, errors_over_records, joined
from riecjax.validation.residuals import ErrorSpectrum, error_spectrum
from riecjax.validation.sweep import FEWEST_SAMPLES

PARTS = 8
"""A segment of the spectra is this part of the records: long, for the sake of long windows."""
LENGTHS = 80
WITHIN = 1.5
"""Factor above its least to which the error's share may rise in the recommended range."""
NEGLIGIBLE = 0.01
"""Share of error that is as good as none."""
LEAST_SPREAD = 2.0
"""Longest over shortest window at least: windows of one length are blind at multiples of 1 / T."""


class EquationWindows(eqx.Module):
    """Window lengths as one equation sees them.

    **Fields:**

    - `name`, `unit` of the equation; `spectrum` of its error and of what it explains.
    - `error_share`: root mean square error relative to the target's in windows of each length,
      predicted for these parameters, shape `(lengths,)`.
    - `current_share`: the same for the current law of windows.
    - `mean_gain`: expected |H| of the current law at the spectrum's frequencies, shape
      `(frequencies,)`.
    """

    name: str = eqx.field(static=True)
    unit: str = eqx.field(static=True)
    spectrum: ErrorSpectrum
    error_share: Float[np.ndarray, " lengths"]
    current_share: float
    mean_gain: Float[np.ndarray, " frequencies"]


class WindowChoice(eqx.Module):
    """Which windows suit a model on these records.

    **Fields:**

    - `length`: window lengths in seconds, shape `(lengths,)`.
    - `equations`: as each equation sees them.
    - `alpha`, `beta`: shortest and longest window in use, in seconds.
    - `recommended`: shortest and longest window in seconds of the range around the best length.
      The best is where the equation that is furthest above its own least share of error is least
      so; the range reaches to where it is 1.5 times as far. Shares below 1 % count as 1 %, and
      the range spans an octave at least.
    - `reason`: one sentence that says why.
    """

    name = "window_choice"
    length: Float[np.ndarray, " lengths"]
    equations: tuple[EquationWindows, ...]
    alpha: float
    beta: float
    recommended: tuple[float, float]
    reason: str = eqx.field(static=True)

    def findings(self) -> list[Finding]:
        """None: another choice is an offer."""
        return []

    def entry(self) -> dict[str, Any]:
        """Everything but the spectra, as plain data for JSON."""
        return {
            "alpha_s": self.alpha,
            "beta_s": self.beta,
            # What the current windows see best, by T = 1 / (2 f) of eq. (26).
            "seen_best_hz": [1 / (2 * self.beta), 1 / (2 * self.alpha)],
            "recommended_s": list(self.recommended),
            "reason": self.reason,
            "length_s": self.length.tolist(),
            "equations": {
                each.name: {
                    "error_share": each.error_share.tolist(),
                    "current_error_share": each.current_share,
                    "least_error_share": float(np.min(each.error_share)),
                    "best_length_s": float(self.length[np.argmin(each.error_share)]),
                }
                for each in self.equations
            },
        }


def window_choice(
    model: Equation | Model,
    records: Records,
    estimate: Estimate | Mapping[str, float | Array],
    *,
    windows: AbstractWindows | None = None,
    errors: list[list[EquationError]] | None = None,
) -> WindowChoice:
    """Predict the share of error at every window length, and recommend a range (not under jit).

    From four samples to half a segment of the spectra, a sixteenth of the records. The prediction
    is for the parameters given: a fit at another length may move them and leave less. A small
    share of error is not the same as a small bias; [`window_sweep`][] shows how estimates move.

    **Arguments:** `estimate`: or parameter name to value, and then `windows`, whose law is the
    current one, under the boxcar. `errors` of each equation on each record, from
    [`errors_over_records`][], if they are known.

    **Raises:** `ModelError` without windows, or for a parameter without a value; `DataError` for an
    absent signal or records of unequal time steps.
    """
    recordings = as_records(records)
    values = estimate.single().values if isinstance(estimate, Estimate) else estimate
    weight: AbstractTestFunction = Boxcar()
    if isinstance(estimate, Estimate) and estimate.criterion is not None:
        windows, weight = windows or estimate.criterion.windows, estimate.criterion.test_function
    if windows is None:
        raise ModelError("a choice of windows needs some to start from: windows=AllWindows(...).")
    alpha, beta = float(windows.alpha), float(windows.beta)
    if errors is None:
        errors = errors_over_records(model, recordings, values)
    whole = [joined(parts, 1) for parts in errors]
    # Means stay in: an offset is what long windows see most of.
    spectra = [error_spectrum(error, parts=PARTS, detrend=False) for error in whole]
    longest = min(0.5 / spectrum.resolution for spectrum in spectra)
    shortest = FEWEST_SAMPLES * float(recordings[0].time_step)
    length = np.geomspace(shortest, max(longest, 2 * shortest), LENGTHS)
    equations = []
    for error, spectrum in zip(whole, spectra):
        squares = weight.gain(spectrum.frequency, length) ** 2
        mean_square = weight.mean_gain(spectrum.frequency, alpha, beta, power=2)
        mean = weight.mean_gain(spectrum.frequency, alpha, beta)
        shares = spectrum.share(squares), float(spectrum.share(mean_square))
        equations.append(EquationWindows(error.name, error.unit, spectrum, *shares, mean))
    # The range around the best length in which no equation is far above its least, and why.
    shares = np.stack([np.maximum(each.error_share, NEGLIGIBLE) for each in equations])
    above = shares / np.min(shares, axis=1, keepdims=True)
    worst = np.max(above, axis=0)
    best = int(np.argmin(worst))
    beyond = np.flatnonzero(worst > WITHIN * worst[best])
    first = int(np.max(beyond[beyond < best], initial=-1)) + 1
    last = int(np.min(beyond[beyond > best], initial=length.size)) - 1
    low, high = float(length[first]), float(length[last])
    if high < LEAST_SPREAD * low:
        middle = np.sqrt(low * high * LEAST_SPREAD)
        low, high = float(middle / LEAST_SPREAD), float(middle)
    limits = []
    for which, edge, end in (("shorter", first - 1, 0), ("longer", last + 1, -1)):
        if 0 <= edge < length.size:
            limiting = equations[int(np.argmax(above[:, edge]))]
            share = 100 * limiting.error_share
            limits.append(
                f"{which} ones are ruled out by {limiting.name} ({share[end]:.3g} % at "
                f"{length[end]:.2g} s, {np.min(share):.2g} % at its least)"
            )
    ruled = f"; {' and '.join(limits)}" if limits else ", and so at all other lengths"
    reason = (
        f"In windows of {low:.2g} to {high:.2g} s the error of no equation is far above its least "
        f"share of the signal{ruled}."
    )
    return WindowChoice(length, tuple(equations), alpha, beta, (low, high), reason)
