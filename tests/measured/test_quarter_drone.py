"""A propeller arm in closed loop, whose model leaves out the propeller's lag and its dead zone."""

import jax
import numpy as np
import pytest

from conftest import measured_data
from riecjax.criteria.criterion import RIEC
from riecjax.criteria.test_functions import Hat
from riecjax.criteria.windows import RandomWindows
from riecjax.equations.equation import Equation
from riecjax.equations.term import Term
from riecjax.estimation.identify import identify
from riecjax.records.recording import read_record
from riecjax.validation.sweep import window_sweep

FILES = (
    "sinal2_degraus_malha_fechada.csv",
    "sinal3_swept_sine_malha_fechada.csv",
    "sinal4_multiseno_malha_fechada.csv",
)


def arm() -> Equation:
    return Equation(
        Term(1.0, "theta", derivative=2),
        -Term("c1", lambda s: jax.numpy.sin(s["theta"]), unit="1/s^2"),
        -Term("c2", lambda s: s["u"] ** 2, unit="rad/s^2"),
        -Term("c3", "theta", derivative=1, unit="1/s"),
        name="arm",
    )


@pytest.fixture(scope="module")
def records():
    folder = measured_data("quarter_drone")
    read = [
        read_record(
            folder / name,
            rename={"t": "Tempo_s", "theta": "Saida_y", "u": "Controle_u"},
            scale={"Saida_y": np.pi / 180},
        )
        for name in FILES
    ]
    return [record.part(2000, 8000) for record in read]  # 20 to 80 s, as the data's authors use


@pytest.mark.slow
def test_an_answer_with_warnings_that_the_model_is_wrong(records):
    criterion = RIEC(RandomWindows(0.5, 1.5, 8000), Hat())
    estimate = identify(arm(), records, criterion, key=jax.random.key(0))
    # Between equation error (-5.1, 0.0026, -0.46) and simulation error (-7.9, 0.0040, -1.5).
    assert -7.9 < float(estimate["c1"]) < -5.1
    assert 0.0026 < float(estimate["c2"]) < 0.0040
    assert -1.6 < float(estimate["c3"]) < -0.4
    assert "large_residual" in [finding.code for finding in estimate.findings()]
    sweep = window_sweep(arm(), records, criterion, key=jax.random.key(0))
    found = sweep.findings()
    assert {finding.code for finding in found} == {"window_sensitive"}
    assert "c3" in found[0].parameters
    assert "records_disagree" in [finding.code for finding in estimate.findings()]
