"""The same search by PySINDy's weak form, with the same functions on the same samples."""

from typing import Any

import numpy as np
import pysindy  # pyright: ignore[reportMissingImports]  (of the bench extra)
from tests.machines import PROBLEMS, WIDTH, Machine

from riecjax.records.record import Record

FUNCTIONS = {
    "stiffness": lambda x, v: x,
    "quadratic_stiffness": lambda x, v: x * x,
    "cubic_stiffness": lambda x, v: x**3,
    "quintic_stiffness": lambda x, v: x**5,
    "viscous": lambda x, v: v,
    "coulomb": lambda x, v: np.sign(v),
    "asymmetry": lambda x, v: np.abs(v),
    "quadratic_drag": lambda x, v: v * np.abs(v),
    "cubic_drag": lambda x, v: v**3,
    "product": lambda x, v: x * v,
    "offset": lambda x, v: np.ones_like(x),
    # Its width is told.
    "dead_zone": lambda x, v: x - np.clip(x, -WIDTH, WIDTH),
}
SINE = {"gravity": lambda x, v: np.sin(x)}
SETTINGS: dict[str, dict[str, Any]] = {
    f"{kind}, threshold {threshold:g}": {"kind": kind, "threshold": threshold}
    for kind in ("weak", "ensemble")
    for threshold in (0.02, 0.05, 0.1, 0.2)
}


def structure(problem: Machine, record: Record, *, kind: str, threshold: float) -> frozenset[str]:
    """Names of what it finds beside the terms that the problem's model has."""
    t = np.asarray(record.elapsed)
    x, v = (np.asarray(record.arrays[name]) for name in ("x", "dx"))
    swings = problem is PROBLEMS["pendulum"]
    functions = FUNCTIONS | (SINE if swings else {})
    columns = {name: of(x, v) for name, of in functions.items()}
    if "u" in record.arrays:
        columns["u"] = np.asarray(record.arrays["u"])
    # Of unit size, as a threshold on coefficients asks for; the derivative of v likewise.
    size = {name: values.std() or 1.0 for name, values in columns.items()}
    controls = np.column_stack([columns[name] / size[name] for name in columns])
    np.random.seed(0)  # noqa: NPY002  (where subdomains lie, NumPy's global generator draws)
    library = pysindy.WeakPDELibrary(
        function_library=pysindy.PolynomialLibrary(degree=1, include_bias=False),
        spatiotemporal_grid=t,
        K=200,
        H_xt=0.3,
    )
    optimizer: Any = pysindy.STLSQ(threshold=threshold, alpha=0.0)
    if kind == "ensemble":
        optimizer = pysindy.EnsembleOptimizer(optimizer, bagging=True, n_models=20)
    model = pysindy.SINDy(optimizer=optimizer, feature_library=library)
    scale = float(np.std(np.gradient(v, t)))
    model.fit(v[:, None] / scale, t=t, u=controls)
    found = np.asarray(model.coefficients())[0]
    if kind == "ensemble":
        lists = np.asarray(optimizer.coef_list)[:, 0]
        found = np.median(lists, axis=0)
    names = [term for term, c in zip(("own", *columns), found) if abs(c) > 0]
    kept = {"u", "own"} | ({"gravity", "viscous"} if swings else set())
    return frozenset(term for term in names if term not in kept)
