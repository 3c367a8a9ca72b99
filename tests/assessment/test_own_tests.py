"""A test of a user's own: its part in findings and verdict, and what becomes of one that fails."""

from typing import Any, NamedTuple

import numpy as np
import pytest
from tests.machines import BODY, STANDARD
from tests.machines import body_with_mode as motion

import riecjax as rx
from riecjax.findings import Step

QUICK = {"refine": None, "sweep": False, "intervals": rx.Sandwich()}


class Rattle(NamedTuple):
    """How much of a signal lies above a tenth of the sampling rate; too much is its finding."""

    signal: str
    share: float
    code: str = "rattle"
    doubt: float = 0.0
    name = "rattle"

    def findings(self) -> list[rx.Finding]:
        message = f"{self.signal} rattles"
        return [rx.Finding(self.code, message, (self.signal,), ("c",), doubt=self.doubt)]

    def entry(self) -> dict[str, Any]:
        return {"signal": self.signal, "share": self.share}


def assessed(*tests) -> rx.Assessment:
    return rx.assess(BODY, rx.Record(motion(False), STANDARD.step), tests=tests, **QUICK)


def rattle_of(signal: str, **fields):
    def rattle(model, records, estimate):
        assert estimate.parameters == model.parameter_names
        power = np.abs(np.fft.rfft(np.asarray(records[0][signal]))) ** 2
        return Rattle(signal, float(power[power.size // 5 :].sum() / power.sum()), **fields)

    return rattle


@pytest.fixture
def registered(monkeypatch):
    def register(**fields) -> None:
        said = rx.FindingClass(phrase="{signals} rattles", **{"kind": "sensors", **fields})
        monkeypatch.setitem(rx.CODES, "rattle", said)

    return register


def test_a_test_of_your_own_takes_part_by_what_its_finding_means(registered):
    registered(step="Fasten the sensor of {signals}")
    found = assessed(rattle_of("v", doubt=0.3))
    assert isinstance(found.test("rattle"), rx.validation.Test)
    assert found.tests[-1] is found.test("rattle")
    entry = found.test("rattle").entry()
    assert entry["share"] < 0.01
    assert rx.reporting.answer_of(found).tests == {"rattle": entry}
    assert [f.message for f in found.findings()] == ["v rattles"]
    verdict = found.verdict
    assert {name: one.level for name, one in verdict.parameters.items()} == {
        "m": "good", "c": "caution", "k": "good"
    }  # fmt: skip
    (cause,) = verdict.causes
    assert (cause.kind, cause.parameters) == ("sensors", ("c",))
    assert cause.share == pytest.approx(0.3)
    assert cause.step == Step("Fasten the sensor of v")
    assert verdict.sentence.endswith("take c to 31 % with caution: v rattles.")
    # Its class may rule the parameter out instead, or blame the model.
    registered(kind="undetermined", rules_out=True)
    assert assessed(rattle_of("v", doubt=0.3)).verdict.parameters["c"].level == "do not use"
    registered(kind="model")
    assert assessed(rattle_of("v", doubt=0.3)).verdict.parameters["c"].reason == "v rattles"


def test_a_code_that_is_not_registered_is_said_in_its_words_and_counts_by_its_doubt():
    verdict = assessed(rattle_of("v", code="loose_sensor", doubt=0.3)).verdict
    assert verdict.parameters["c"].level == "caution"
    assert verdict.sentence.endswith(": loose sensor.")


def failing(*_):
    raise ZeroDivisionError("no motion\nat all")


class Unsaid(Rattle):
    def entry(self) -> Any:
        return {"share": float("nan")}


class Drawn(Rattle):
    chart = failing


@pytest.mark.raises_finding("test_failed")
@pytest.mark.parametrize(
    ("make", "words"),
    [
        (failing, "the test of failing failed (ZeroDivisionError): no motion at all."),
        (lambda *_: 1.0, "has no name, findings() and entry()"),
        (lambda *_: Unsaid("v", 0.0), "(ValueError): Out of range float values"),
        (lambda *_: Rattle("v", 0.0)._replace(share=np.zeros(2)), "(TypeError): "),
        (
            lambda *_: Rattle("v", 0.0)._replace(share={1: 2.0, None: 3.0}),
            "has the key 1, which is no text",
        ),
        (lambda *_: Rattle("v", 0.0)._replace(doubt="big"), "Expected `float`, got `str`"),
        (lambda *_: Rattle("v", 0.0, doubt=-0.1), "is no share of zero or more"),
        (lambda *_: Rattle("v", 0.0, code="rattle_of_wheel"), "'wheel' is no kind of cause"),
        (lambda *_: Rattle("v", 0.0, code="rattle_of_door"), "{signals} and {parameters}"),
        (lambda *_: Drawn("v", 0.0), "(ZeroDivisionError): no motion at all"),
    ],
)
def test_what_a_test_of_your_own_raises_is_a_finding(make, words, monkeypatch):
    wheel: Any = "wheel"
    wrong = {"wheel": rx.FindingClass(wheel, ""), "door": rx.FindingClass("model", "{door}")}
    for name, said in wrong.items():
        monkeypatch.setitem(rx.CODES, f"rattle_of_{name}", said)
    found = assessed(make, rattle_of("v"), rattle_of("F"))
    failed, twice = (f.message for f in found.findings() if f.code == "test_failed")
    assert words in failed
    assert "its name, rattle, is another test's" in twice
    assert {one.level for one in found.verdict.parameters.values()} == {"good"}


@pytest.mark.parametrize("tests", [failing, "rattle", 5])
def test_what_is_no_list_of_tests_is_refused_before_the_fit(tests):
    with pytest.raises(rx.ModelError, match=r"^tests is .* Write tests=\[make\]"):
        rx.assess(
            BODY,
            rx.Record(motion(False), STANDARD.step),
            tests=tests,
            on_estimate=lambda _: pytest.fail("fitted"),
            **QUICK,
        )


def test_a_test_that_tells_nothing_has_an_empty_part(tmp_path):
    class Silent(Rattle):
        def entry(self) -> Any:
            return {}

    class Named(Silent):
        name = "fit"

    found = assessed(lambda *_: Silent("v", 0.0), lambda *_: Named("v", 0.0))
    assert "its name, fit, is another test's or a figure's" in found.findings()[0].message
    rx.reporting.write_report(found, tmp_path / "out")
    again = rx.load(tmp_path / "out")
    assert again.tests == {"rattle": {}}
    assert again.plot() is not None
