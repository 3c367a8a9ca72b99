"""The oscillator with drag by lmfit over `solve_ivp`, initial state free too."""

from typing import Any

import lmfit
import numpy as np
from jaxtyping import Float

from benchmarks.baselines.scipy_drag import DIFFERENCE, NAMES, SIZE, START, residual


def fit(
    t: Float[np.ndarray, " n"],
    x: Float[np.ndarray, " n"],
    v: Float[np.ndarray, " n"],
    u: Float[np.ndarray, " n"],
) -> dict[str, float]:
    """m, r, r2, k and the initial state."""
    parameters = lmfit.Parameters()
    for name, value in zip(NAMES, START):
        parameters.add(name, value=value)

    def errors(values: lmfit.Parameters) -> np.ndarray:
        return residual(np.array([values[name].value for name in NAMES]), t, x, v, u)

    # Any: its fields are set only when it has run.
    found: Any = lmfit.minimize(
        errors, parameters, method="least_squares", diff_step=DIFFERENCE, x_scale=SIZE
    )
    return dict(found.params.valuesdict())
