"""A budget of functions that each command compiles: what a first run waits for."""

from functools import cache

import pytest
from benchmarks.speed.compilation import COMMANDS, compiled_by

from nightly import by_day

BUDGET = {"models": 0, "simulate": 48, "check": 16, "identify": 56, "identify, refined": 68}
"""`identify` refines by itself."""


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    folder = tmp_path_factory.mktemp("compiled")

    @cache
    def found(name):
        if name in ("check", "identify", "identify, refined"):
            found("simulate")  # makes what they read
        return compiled_by(COMMANDS[name], folder)

    return found


@pytest.mark.parametrize("name", by_day(COMMANDS, "models", "simulate"))
def test_commands_compile_no_more_than_their_budget(compiled, name):
    assert compiled(name)["functions"] <= BUDGET[name]
