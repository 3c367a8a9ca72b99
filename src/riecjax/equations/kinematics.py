"""Which sum of signals the time derivative of another is, read from an expression of them."""

import numpy as np

from riecjax.equations.expressions import Expression
from riecjax.records.faults.relations import Relation

PROBES, EXACT = 32, 1e-5
"""Values that an expression is tried with, and how nearly it must be a sum of them."""


class _Probe(dict[str, np.ndarray]):
    """Random values of whatever signals are asked for."""

    def __missing__(self, name: str) -> np.ndarray:
        rng = np.random.default_rng(len(self))
        return self.setdefault(name, rng.standard_normal(PROBES))


def relation_of(signal: str, rate: Expression) -> Relation | None:
    """The relation that a rate of a signal stands for; `None` unless it is a sum of signals."""
    if isinstance(rate, str):
        return Relation(signal, ((rate, 1.0),))
    probe = _Probe()
    try:
        values = np.asarray(rate(probe), float)  # pyright: ignore[reportArgumentType]
    except Exception:  # of the user's function, which says so where it is used
        return None
    if values.shape != (PROBES,) or not 0 < len(probe) < PROBES // 2 or signal in probe:
        return None
    columns = np.transpose([*probe.values()])
    factors = np.linalg.lstsq(columns, values)[0]
    if not np.abs(columns @ factors - values).max() < EXACT * np.abs(factors).max():
        return None
    # What rounding adds to 1 would be told as a factor.
    told = zip(probe, np.round(factors, 6).tolist())
    return Relation(signal, tuple((name, factor) for name, factor in told if factor))
