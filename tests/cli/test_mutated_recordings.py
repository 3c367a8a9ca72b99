"""Damaged recordings through the whole command: a right answer, a warning, or one line."""

import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from benchmarks.robustness.fuzzing import Fuzzed, fuzzed, judged, outcome
from benchmarks.robustness.mutations import NAMES, TRUTH, WRITERS, mutated, rigs

from nightly import nightly, nightly_among

RIGS = rigs()
LINEAR = ("--refine", "none")
"""What a refinement adds, which compiles anew for each number of samples, is for the night."""
SLOW = {"shuffled signals", "shuffled column", "many nan", "text entry", "whole numbers", "cut out"}
SLOW |= {"spliced", "dropout", "huge", "swapped blocks", "parquet bomb", "coarse", "offset jump"}
SLOW |= {"repeated block", "truth values", "mixed", "extreme scale", "hostile names", "silent"}
SLOW |= {"frozen all", "burst", "single nan", "late column", "clipped", "saturated"}
SLOW |= {"wrapped", "duplicated column", "empty cells"}
"""What leaves another number of samples, or much to read."""


@pytest.mark.parametrize(
    "rig", [RIGS[0], *nightly(RIGS[1:])], ids=("velocity recorded", "position only")
)
@pytest.mark.parametrize(
    ("file", "options"),
    [
        *((file, LINEAR) for file in WRITERS),
        *nightly((file, ()) for file in WRITERS),
    ],
)
def test_sound_recordings_are_answered_to_half_a_percent_without_a_warning(
    capsys, rig, file, options
):
    # A tenth of what is asked of a damaged one, so that what is found there is the damage's.
    from riecjax.cli.main import run

    Path(file).write_bytes(WRITERS[file](list(rig.columns.items())))
    assert run(["identify", file, *rig.options, *options]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["warnings"] == []
    for name, value in TRUTH.items():
        assert document["parameters"][name]["value"] == pytest.approx(value, rel=0.005)


@pytest.mark.parametrize("name", nightly_among([n for n in NAMES if n != "clean"], SLOW))
@pytest.mark.parametrize("options", [LINEAR, pytest.param((), marks=pytest.mark.slow)])
def test_no_wrong_number_without_a_warning(name, options):
    for number in range(1):
        case = mutated(name, RIGS, np.random.default_rng([20240501, NAMES.index(name), number]))
        found = outcome(case, options)
        assert found.verdict != "WRONG", f"case {number}, {case.file}: {found.why}"


def document(values: dict[str, float], *warnings: str, error: float = 0.01) -> str:
    parameters = {name: {"value": value, "std_error": error} for name, value in values.items()}
    found = [{"code": code, "message": ""} for code in warnings]
    return json.dumps({"parameters": parameters, "warnings": found})


def test_the_verdicts():
    good, bad = document(TRUTH), document({**TRUTH, "k": 22.0})
    assert judged(0, good, "")[0] == "right"
    assert judged(0, bad, "") == ("WRONG", "k = 22 +- 0.01, not 20")
    assert judged(0, document({**TRUTH, "k": 22.0}, "clipped"), "")[0] == "warned"
    assert judged(0, good, "Traceback")[0] == "WRONG"
    refusal = json.dumps({"schema": 4, "error": {"code": "data", "message": "a.csv: no."}})
    assert judged(1, refusal, "riecjax: a.csv: no.\n")[0] == "refused"
    for status, said in ((1, "a.csv: no.\nmore"), (1, "b.csv: no."), (2, "a.csv: no.")):
        assert judged(status, refusal, f"riecjax: {said}\n")[0] == "WRONG"
    with pytest.raises(ValueError, match="NaN"):
        judged(0, document({**TRUTH, "k": float("nan")}), "")


def wrong(cases: Iterable[Fuzzed]) -> list[str]:
    return [
        f"case {one.number}, {one.case.mutation}, {one.case.file}: {one.outcome.why}"
        for one in cases
        if one.outcome.verdict == "WRONG"
    ]


@pytest.mark.parametrize("numbers", [range(50), *nightly([range(50, 5000), range(5000, 10_000)])])
def test_every_format_is_read_or_refused_in_one_line(numbers):
    assert wrong(fuzzed("reading", numbers, 20261125)) == []


@pytest.mark.parametrize("numbers", nightly([range(500), range(500, 1000)]))
def test_every_format_is_identified_from_or_refused(numbers):
    assert wrong(fuzzed("identify", numbers, 20261125)) == []
