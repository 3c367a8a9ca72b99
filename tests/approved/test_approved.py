"""Outputs are those that were approved: `python -m tests.approved` shows and approves others."""

import pytest
from tests.approved.approving import OUTPUTS, difference
from tests.approved.cases import CASES
from tests.approved.comparison import differences, merged


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


def test_what_moves_in_its_standard_errors_alone_is_kept_when_it_is_approved():
    kept = {"k": {"interval95": [1.0, 2.0], "std_error": 1e-3}}
    moved = {"k": {"interval95": [1.0 + 1e-7, 2.0], "std_error": 1e-3}}
    assert [*differences(kept, moved)]
    assert merged(kept, moved) == moved
