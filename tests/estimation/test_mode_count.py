"""How many hidden modes there are, where it is known."""

import pytest
from tests.machines import BODY, STANDARD
from tests.machines import body_with_mode as motion

import riecjax as rx
from riecjax.estimation import carried_modes


@pytest.mark.slow
@pytest.mark.parametrize("mode", [False, True])
def test_as_many_modes_as_there_are(mode):
    found = carried_modes(BODY, rx.Record(motion(mode), STANDARD.step), "v", most=2)
    assert len(found.procedure.modes) == int(mode)
    assert [one.carried for one in found.evidence] == [True, False][not mode :]
    assert ("M_mode" in found.estimate.parameters) == mode
