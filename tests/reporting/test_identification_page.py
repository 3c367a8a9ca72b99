"""The page of an identification says what its document holds: of every approved output."""

import json
from pathlib import Path
from typing import Any

import pytest

from riecjax.assessment.refining import _coloured
from riecjax.reporting.identification import choice_in_words, search_in_words
from riecjax.reporting.identification_page import identification_page
from riecjax.reporting.page import Table
from riecjax.validation.whiteness import Whiteness

OUTPUTS = Path(__file__).parents[1] / "approved" / "outputs"


def documents() -> dict[str, dict[str, Any]]:
    held = {file.stem: json.loads(file.read_text("utf-8")) for file in OUTPUTS.glob("*.json")}
    found = {name: output.get("document") or {} for name, output in sorted(held.items())}
    found = {name: document for name, document in found.items() if "verdict" in document}
    for document in found.values():
        for step in document["verdict"]["next"]:  # what outputs do not keep
            step["command"] = " ".join(["riecjax", *step["options"]]) if step["options"] else None
    return found


def column(table: Table, header: str) -> list[str]:
    return [row[list(table.header).index(header)] for row in table.rows]


@pytest.mark.parametrize("document", documents().values(), ids=documents())
def test_a_page_says_what_its_document_holds(document):
    page, verdict = identification_page(document), document["verdict"]
    sections = {section.heading: section for section in page.sections}
    assert page.title.startswith(f"{document['model']} from ")
    assert page.lead == verdict["sentence"]
    assert page.answer is not None
    (judged,) = page.answer.tables
    parameters = document["parameters"]
    assert column(judged, "parameter") == [*parameters]
    assert column(judged, "unit") == [entry["unit"] for entry in parameters.values()]
    levels = [verdict["parameters"][name]["level"] for name in parameters]
    assert column(judged, "verdict") == levels
    for step, said in zip(verdict["next"], page.answer.text):
        assert said.startswith(step["words"])
        assert (step["command"] or "") in said
    values, excited = sections["Parameters"].tables
    assert column(values, "parameter") == [*parameters, *document["known"]]
    for table in (judged, values):
        shown = [float(value) for value in column(table, "value")[: len(parameters)]]
        assert shown == pytest.approx([e["value"] for e in parameters.values()], rel=1e-5)
    assert column(excited, "parameter") == [*document["excitation"]]
    # Warnings stand under what lies behind them; each is of some.
    codes = {code for _, codes in page.groups for code in codes}
    assert codes <= {warning["code"] for warning in document["warnings"]}
    refinement = document["refinement"] or {"refined": None, "chosen": False}
    refined = refinement["refined"] is not None
    assert ("Refinement" in sections) is refined
    assert ("identified" in values.header) is (refined and refinement["chosen"])
    assert ("refined" in values.header) is (refined and not refinement["chosen"])
    assert ("Choice of windows" in sections) is (document["window_choice"] is not None)
    runs = len(document["validation"])
    validation = sections.get("Validation by simulation")
    assert len(validation.charts if validation else ()) == runs
    left = sections["What each equation leaves"]
    assert len(left.text) == len(left.charts) == len(document["residual_tests"] or ())
    fits = column(sections["Fit"].tables[0], "equation")
    assert {stage["equation"] for stage in document["residual"]["stages"]} <= set(fits)
    files = column(sections["Recordings"].tables[0], "file")
    assert len(files) == len(document["provenance"]["records"])
    texts = [text for section in page.sections for text in section.text]
    cells = [
        cell for s in page.sections for table in s.tables for row in table.rows for cell in row
    ]
    assert not any(word in (*texts, *cells) for word in ("None", "nan"))


WHITE = {"white": True, "vanishing": False, "largest": 1.1, "threshold": 1.9, "channels": {}}
COLOURED = {**WHITE, "white": False, "largest": 8.0}
EXACT = {**WHITE, "vanishing": True, "largest": 8e3, "channels": {"v": {"share": 4e-8}}}


@pytest.mark.parametrize(
    ("whiteness", "declined", "refined", "words"),
    [
        (None, "a search would take 4e7 steps", None, ["not refined: a search would take 4e7"]),
        (None, None, {}, ["the answer, as was asked for."]),
        (WHITE, None, {}, ["as precise as the sensors allow"]),
        (WHITE, "it predicts b.csv worse", {}, ["that is not the answer: it predicts b.csv"]),
        (COLOURED, "no white noise", {}, ["The identified values are the physical parameters"]),
        (COLOURED, None, {}, ["coloured noise", "a recorded input", "part of the motion"]),
        (EXACT, None, {}, ["follows the motion to 4e-08 of its size"]),
    ],
)
def test_words_on_what_became_of_a_refinement(whiteness, declined, refined, words):
    entries = {"whiteness": whiteness, "declined": declined, "refined": refined, "simulations": []}
    said = choice_in_words(entries)
    assert all(word in said for word in words)


def test_how_a_search_went_is_told_beside_the_sensors_noise():
    whiteness = {**WHITE, "channels": {"v": {"chi_squared": 2.25}}}
    after = {"signals": {"x": {"fit_percent": 95.0}}}
    run = {"on": "a.csv", "fitted": True, "before": {"signals": {}}, "after": after}
    entries = {
        "by": {"refine": "integral"},
        "reason": "converged",
        "steps": 4,
        "basis": "impulses",
        "left": {"v": {"before": 0.2, "after": None, "unit": "m/s"}},
        "whiteness": whiteness,
        "simulations": [run],
        "intervals": {"method": "bootstrap", "blocks": 9, "block_seconds": 1.0},
    }
    assert list(search_in_words(entries)) == [
        "refined by impulses of the equation error: converged (4 steps)",
        "left before and after, of impulses:",
        "v: 0.2 before, ? m/s r.m.s. after, 1.5 times the sensor's noise",
        "simulated on a.csv (fitted), fit before -> after: x ? -> 95 % (from the state as "
        "recorded)",
        "refined intervals: bootstrap, 9 blocks of 1 s; of what was identified:",
    ]


def test_causes_of_coloured_residuals_depend_on_how_much_is_left():
    few, more = (Whiteness({"v": 8.0}, 1.9, {"v": 1.0}, {"v": share}) for share in (1e-3, 0.5))
    assert "the input's noise" in _coloured(few)
    assert "a recorded input is noisy" in _coloured(more)
