"""What is said of refined values that leave more than white noise."""

from riecjax.assessment.refining import _coloured
from riecjax.reporting.identification import choice_in_words
from riecjax.validation.whiteness import Whiteness


def test_every_cause_of_coloured_residuals_is_named():
    left = {"white": False, "largest": 8.0, "threshold": 1.9, "vanishing": False}
    entries = {"whiteness": left, "declined": None, "refined": {"m": {}}, "simulations": []}
    said = choice_in_words(entries)
    for cause in ("coloured noise", "noise on a recorded input", "leaves out part of the motion"):
        assert cause in said
    few, more = (Whiteness({"v": 8.0}, 1.9, {"v": 1.0}, {"v": share}) for share in (1e-3, 0.5))
    assert "the input's noise" in _coloured(few)
    assert "a recorded input is noisy" in _coloured(more)
