"""The page of an identification says what its document holds: of every approved output."""

import json
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from riecjax.reporting import Answer
from riecjax.reporting.result_page import identification_page
from riecjax.reporting.tables import Table

OUTPUTS = Path(__file__).parents[1] / "approved" / "outputs"


def documents() -> dict[str, dict[str, Any]]:
    held = {file.stem: json.loads(file.read_text("utf-8")) for file in OUTPUTS.glob("*.json")}
    found = {name: output.get("document") or {} for name, output in sorted(held.items())}
    found = {name: document for name, document in found.items() if "verdict" in document}
    for document in found.values():
        for step in document["verdict"]["next"]:  # what outputs do not keep
            step["command"] = " ".join(["riecjax", *step["options"]]) if step["options"] else None
    return found


def whole(kept: Any) -> Any:
    """A document with a list of numbers wherever its output keeps only sums of one."""
    if isinstance(kept, dict) and "projections" in kept:
        return np.full(kept["numbers"], kept["mean"]).tolist()
    if isinstance(kept, dict):
        return {key: whole(value) for key, value in kept.items()}
    return [*map(whole, kept)] if isinstance(kept, list) else kept


def column(table: Table, header: str) -> list[str]:
    return [row[list(table.header).index(header)] for row in table.rows]


@pytest.mark.parametrize("document", documents().values(), ids=documents())
def test_a_page_says_what_its_document_holds(document):
    verdict = document["verdict"]
    page = identification_page(msgspec.convert(whole(document), Answer))
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
