import numpy as np
import pytest

import riecjax as rx
from riecjax.validation.drifting_inputs import drifting_inputs
from riecjax.validation.equation_errors import errors_over_records

RATE, COUNT, SIZE = 100.0, 6000, 3.0
LAW = rx.Equation(rx.Term("c", "v"), rx.Term("k", "x"), -rx.Term(1.0, "u"))


def found(seed: int, drift: float, noise: float) -> tuple[list[rx.findings.Finding], float]:
    """Of c v + k x = u with a drift of u in its standard deviations; and that drift per second."""
    rng = np.random.default_rng(seed)
    t = np.arange(COUNT) / RATE
    omega, phase = 2 * np.pi * rng.uniform(0.1, 3, (20, 1)), rng.uniform(0, 6.3, (20, 1))
    x = np.sum(np.sin(omega * t + phase), axis=0)
    v = np.sum(omega * np.cos(omega * t + phase), axis=0)
    u = 2.0 * v + 30.0 * x
    rate = drift * u.std() / t[-1]
    u += u.std() * (drift * (t / t[-1] - 0.5) + noise * rng.normal(size=COUNT))
    record = rx.Record.from_samples({"x": x, "v": v, "u": u}, time_step=1 / RATE)
    columns = np.stack([v, x], axis=1)
    c, k = np.linalg.lstsq(columns, u, rcond=None)[0]
    errors = errors_over_records(LAW, [record], {"c": c, "k": k})
    return list(drifting_inputs([LAW], [record], errors)), rate


@pytest.mark.raises_finding("drifting_signal")
@pytest.mark.parametrize("noise", [0.0, 0.01, 0.05])
@pytest.mark.parametrize("drift", [0.1, -1.0])
def test_a_force_that_drifts_is_named_with_what_it_drifts_by(noise, drift):
    for seed in range(5):
        (finding,), rate = found(seed, drift, noise)
        assert finding.signals == ("u",)
        assert finding.remedy[1].startswith("u=u-(")
        told = float(finding.remedy[1].split("(")[1].split(")")[0])
        assert told == pytest.approx(rate, rel=0.1)


@pytest.mark.no_finding("drifting_signal")
@pytest.mark.parametrize("noise", [0.0, 0.01, 0.05])
def test_a_force_that_does_not_drift_is_not(noise):
    assert [f for seed in range(30) for f in found(seed, 0.0, noise)[0]] == []
