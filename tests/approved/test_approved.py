"""Outputs are those that were approved: `python -m tests.approved` shows and approves others."""

import pytest
from tests.approved.approving import OUTPUTS, difference
from tests.approved.cases import CASES


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.slow] if case.slow else [])
        for name, case in CASES.items()
    ],
)
def test_the_output_is_as_approved(name):
    lines = difference(CASES[name])
    assert not lines, "\n".join([f"{name} differs:", *lines, "see python -m tests.approved"])


def test_every_output_belongs_to_a_case():
    assert {path.stem for path in OUTPUTS.iterdir()} <= set(CASES)
