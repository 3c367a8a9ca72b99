"""The oscillator with drag by PySINDy's weak form: x'' on x, x', u and x'|x'|."""

import numpy as np
import pysindy  # pyright: ignore[reportMissingImports]  (of the bench extra)
from jaxtyping import Float


def fit(
    t: Float[np.ndarray, " n"],
    x: Float[np.ndarray, " n"],
    v: Float[np.ndarray, " n"],
    u: Float[np.ndarray, " n"],
    *,
    subdomains: int = 200,
    half_width: float = 0.3,
) -> dict[str, float]:
    """m, r, r2 and k; where subdomains lie, NumPy's global generator draws."""
    library = pysindy.WeakPDELibrary(
        function_library=pysindy.PolynomialLibrary(degree=1, include_bias=False),
        spatiotemporal_grid=t,
        K=subdomains,
        H_xt=half_width,
    )
    # The structure is known: nothing is to be thresholded, and nothing shrunk.
    optimizer = pysindy.STLSQ(threshold=0.0, alpha=0.0)
    model = pysindy.SINDy(optimizer=optimizer, feature_library=library)
    # With drag as a second control no candidate is offered that the equation lacks.
    model.fit(np.column_stack([x, v]), t=t, u=np.column_stack([u, v * np.abs(v)]))
    of_x, of_v, of_u, of_drag = model.coefficients()[1]
    m = 1 / of_u
    return {"m": m, "r": -m * of_v, "r2": -m * of_drag, "k": -m * of_x}
