"""A model with a hidden mode, through everything that an assessment does."""

import numpy as np
import pytest
from tests.machines import MODE_MODEL as MODEL
from tests.machines import MODE_TRUTH as TRUTH
from tests.machines import STANDARD
from tests.machines import body_with_mode as motion

import riecjax as rx
from riecjax.reporting.charts.chart import Line
from riecjax.reporting.identification import identification_document, modes_in_words
from riecjax.reporting.identification_figures import identification_figures


@pytest.fixture(scope="module")
def noisy() -> rx.Record:
    rng = np.random.default_rng(1)
    clean = motion(True)
    samples = {n: x + 0.01 * np.std(x) * rng.standard_normal(x.shape) for n, x in clean.items()}
    return rx.Record(samples, STANDARD.step)


@pytest.fixture(scope="module")
def assessed(noisy):
    return rx.assess(MODEL, noisy, hold_out=0.2, refine=None)


@pytest.mark.slow
def test_everything_is_asked_of_it(assessed):
    for name in ("m", "M_mode", "K_mode"):
        assert float(assessed.answer[name]) == pytest.approx(TRUTH[name], rel=0.02)
    (mode,) = assessed.modes
    assert mode.carried
    codes = {finding.code for finding in assessed.findings()}
    assert not codes & {"unmodelled_mode", "mode_not_carried", "unidentifiable", "rows_left_out"}
    assert assessed.checked.answerable
    assert assessed.checked.excitations[0].parameters == tuple(TRUTH)
    # What is left is noise of differences, which is not what the mode leaves.
    assert assessed.residuals["body"].peak is None
    (run,) = assessed.validations
    assert run.held.predicts
    assert float(run.held.signals["v"].fit) > 90


@pytest.mark.slow
def test_document_words_and_map(assessed):
    document = identification_document(assessed)
    (mode,) = document["modes"]
    assert mode["frequency_hz"] == pytest.approx(9.416, rel=0.01)
    assert mode["damping_ratio"] == pytest.approx(0.169, rel=0.05)
    assert mode["carried"]
    (line,) = modes_in_words(document["modes"])
    assert line.startswith("hidden mode on v: 9.4")
    figure = identification_figures(assessed)["mode_map"]
    panel = figure.rows[0][0]
    assert panel is not None
    without, there, _ = panel.marks
    assert isinstance(without, Line)
    assert isinstance(there, Line)
    assert np.nanmin(there.y) < 0.1 * np.min(without.y)


@pytest.mark.slow
def test_a_right_model_is_told_to_leave_it_out():
    with pytest.raises(rx.IdentifiabilityError, match="do not carry this mode") as refused:
        rx.assess(MODEL, rx.Record(motion(False), STANDARD.step))
    assert refused.value.code == "mode_not_carried"
