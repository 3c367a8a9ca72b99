"""Tests of an answer: what one is, those of what equations leave, and a user's own."""

import json
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import msgspec

from riecjax.equations.model import Model
from riecjax.errors import RiecjaxError
from riecjax.estimation.estimate import Estimate
from riecjax.findings import KINDS, Finding
from riecjax.leaves import finite
from riecjax.records.record import Record


@runtime_checkable
class Test(Protocol):
    """What was looked at of an answer: findings for its verdict, and numbers for its document.

    Built in are what equations leave, windows of other lengths, evidence of hidden modes,
    refinement and held-out simulation. One of your own is made by a function that
    is among the `tests` of [`assess`][riecjax.assess]; if it has a `view()` or a `chart()`, that is
    shown of it.
    """

    @property
    def name(self) -> str:
        """Its key in the document of a result, unlike that of other tests."""
        ...

    def findings(self) -> list[Finding]:
        """What a user should know of its outcome; empty where all is well."""
        ...

    def entry(self) -> Any:
        """What the document of a result holds of it: numbers, texts, lists and dictionaries."""
        ...


BUILT_IN = ["modes", "window_sweep", "residual_tests", "refinement", "validation"]
"""Names of the tests that come with an assessment."""
FIGURES = ["fit", "curves", "correlation", "mode_map"]
"""Names of figures beside those of tests."""
MakeTest = Callable[[Model, Sequence[Record], Estimate], Test]
"""What makes a test of a model's answer on records."""


class Tested(NamedTuple):
    """Tests that were made, and findings beside them: of those that could not be made, why."""

    tests: list[Test]
    findings: list[Finding]


def residuals_tested(
    model: Model,
    records: list[Record],
    estimate: Estimate,
    faults_of: Callable[..., tuple[list[Finding], bool]],
    by_windows: Estimate,
) -> Tested:
    """Tests of what equations leave.

    **Arguments:** `faults_of` a model, records, errors of each equation on each, and an estimate,
    which finds what explains most of what is left, and whether all causes were weighed; the
    estimate `by_windows` that it is to weigh by.
    """
    # Not earlier: who only checks recordings waits for none of these.
    from riecjax.validation.equation_errors import errors_over_records
    from riecjax.validation.residuals import residual_tests

    # A fit is not lost because what it leaves cannot be tested, nor are its causes.
    faults: list[Finding] = []
    try:
        errors = errors_over_records(model, records, estimate.values)
        faults, weighed = faults_of(model, records, errors, by_windows)
        test = residual_tests(
            model, records, estimate, errors=errors, faults=faults, weighed=weighed
        )
    except RiecjaxError as error:
        return Tested([], [*faults, Finding("residuals_not_tested", str(error))])
    return Tested([test], [])


def own_tests(
    makers: Iterable[MakeTest], model: Model, records: Sequence[Record], answer: Estimate
) -> Tested:
    """Tests of a user's own of an answer; of what raises or is no test, a finding says so."""
    tested, taken = Tested([], []), {*BUILT_IN, *FIGURES}
    for make in makers:
        # An answer is not lost whatever it raises; asked later, it says the same.
        try:
            test = make(model, records, answer)
            if not isinstance(test, Test) or not isinstance(test.name, str):
                raise TypeError("it has no name, findings() and entry(), see rx.validation.Test")
            if test.name in taken:
                raise ValueError(f"its name, {test.name}, is another test's or a figure's")
            for finding in test.findings():
                _require_finding(finding)
            _require_plain(test.entry())
            for shown in ("view", "chart"):
                getattr(test, shown, lambda: None)()
        except Exception as error:
            name = getattr(make, "__name__", type(make).__name__)
            said = " ".join(str(error).split()) or "no message"
            message = f"the test of {name} failed ({type(error).__name__}): {said}."
            tested.findings.append(Finding("test_failed", message))
            continue
        taken.add(test.name)
        tested.tests.append(test)
    return tested


def _require_finding(given: object) -> None:
    """Raise `TypeError` or `ValueError` for what no verdict could take for a finding."""
    if not isinstance(given, Finding):
        raise TypeError(f"{given!r} is among its findings and no rx.Finding")
    try:
        msgspec.convert(msgspec.to_builtins(given, enc_hook=finite), Finding)
    except (msgspec.ValidationError, TypeError) as error:
        raise TypeError(f"its finding '{given.code}' is not as rx.Finding says: {error}") from None
    if not all(0 <= share < math.inf for share in (given.doubt, *given.doubts.values())):
        raise ValueError(f"a doubt of its finding '{given.code}' is no share of zero or more")
    if given.about.kind not in KINDS:
        raise ValueError(f"'{given.about.kind}' is no kind of cause; there are {', '.join(KINDS)}")
    try:
        given.about.said(given.signals, given.parameters)
    except (LookupError, ValueError):
        places = "{signals} and {parameters}"
        raise ValueError(f"the phrase of '{given.code}' may have the places {places}") from None


def _require_plain(entry: Any) -> None:
    """Raise `TypeError` or `ValueError` for what JSON has no words for, or would say otherwise."""
    json.dumps(entry, allow_nan=False)
    keys = entry if isinstance(entry, dict) else ()
    if other := [key for key in keys if not isinstance(key, str)]:
        raise TypeError(f"its entry has the key {other[0]!r}, which is no text")
    parts = entry.values() if isinstance(entry, dict) else entry
    for each in parts if isinstance(entry, dict | list | tuple) else ():
        _require_plain(each)
