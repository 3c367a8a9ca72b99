"""The typed answer: its schema, documents that it reads, tests of a user's own, hostile names."""

import json
from pathlib import Path

import jsonschema
import msgspec
import numpy as np
import pytest
from rich.console import Console
from test_result_page import documents, whole

import riecjax as rx
from riecjax.charts import Axis, Chart, Line, single
from riecjax.findings import Finding
from riecjax.reporting import Answer, Table, View, answer_of, identification_page
from riecjax.reporting.answer import read
from riecjax.reporting.identification import print_everything
from riecjax.reporting.result_figures import identification_figures

SCHEMA = Path(__file__).parents[2] / "docs" / "results.schema.json"
HOSTILE = "a|b<script>alert(1)</script>&\\input{x}$_%#~^\n\\\\"


def schema() -> str:
    return json.dumps(msgspec.json.schema(Answer), indent=1) + "\n"


def test_the_schema_in_the_docs_is_that_of_the_answer():
    again = "write it anew: python tests/reporting/test_answer.py"
    assert SCHEMA.read_text("utf-8") == schema(), again


@pytest.mark.parametrize("document", documents().values(), ids=documents())
def test_an_answer_holds_every_key_of_a_document_that_the_schema_allows(document):
    document = whole(document)
    jsonschema.validate(document, json.loads(SCHEMA.read_text("utf-8")))
    held = json.loads(json.dumps(msgspec.to_builtins(read(Answer, document))))

    def lacks(kept, given, place=""):
        if isinstance(given, dict):
            assert [key for key in kept if key in given] == [*given], place
            for key, value in given.items():
                lacks(kept[key], value, f"{place}.{key}")
        elif isinstance(given, list):
            assert len(kept) == len(given), place
            for i, value in enumerate(given):
                lacks(kept[i], value, f"{place}[{i}]")
        else:
            assert kept == given, place

    lacks(held, document)


def test_a_document_of_earlier_versions_is_read_and_what_is_none_refused_in_a_line(tmp_path):
    file = tmp_path / "results.json"
    least = {
        "schema": 1,
        "model": "rig",
        "criterion": {"name": "dols"},
        "parameters": {"k": {"value": 2.0, "unit": "N/m", "std_error": 0.5, "interval95": [1, 3]}},
        "known": {"m": {"value": 1, "unit": "kg"}},
        "warnings": [{"code": "hum", "message": "hum", "signals": ["x"], "parameters": []}],
        "provenance": {"command": None},
    }
    file.write_text(json.dumps(least))
    answer = rx.load(file)
    assert dict(answer) == {"k": 2.0, "m": 1.0}
    assert answer.interval("k") == (1.0, 3.0)
    assert answer.findings() == [Finding("hum", "hum", ("x",))]
    assert str(answer).startswith("rig by DOLS")
    file.write_text(json.dumps(least | {"known": {"m": {"value": "heavy", "unit": "kg"}}}))
    with pytest.raises(
        rx.DataError, match=r"Expected `float \| null`, got `str` - at `\$.known"
    ) as e:
        rx.load(file)
    assert "\n" not in str(e.value)


class Rattle:
    """How loud a rig rattles."""

    name = "rattle"

    def findings(self) -> list[Finding]:
        return [Finding("rattle", "the rig rattles at 3 Hz.")]

    def entry(self) -> dict[str, object]:
        return {"loudness": 0.25, "spectrum": [1.0, None]}

    def chart(self) -> Chart:
        return single([Line([0, 1], [0, 1])], Axis("f"), Axis("loudness"), "Rattling.")


def test_a_test_of_a_users_own_is_in_json_on_the_page_in_words_and_in_figures():
    rng = np.random.default_rng(0)
    x = rng.normal(size=2000)
    record = rx.Record({"x": x, "u": 3 * x + 0.1 * rng.normal(size=2000)}, 0.01)
    equation = rx.Equation(rx.Term("k", "x", unit="N/m"), -rx.Term(1.0, "u"), name="rig")
    named = Rattle()
    named.name = "criterion"  # as a key of the document that no test makes
    settings = {"refine": None, "sweep": False, "tests": [lambda *_: Rattle(), lambda *_: named]}
    assessed = rx.assess(equation, record, rx.DOLS(), **settings)
    answer = answer_of(assessed)
    plain = msgspec.to_builtins(answer)
    entry = {"loudness": 0.25, "spectrum": [1.0, None]}
    assert plain["tests"] == {"rattle": entry, "criterion": entry}
    assert [*plain["tests"]] == ["rattle", "criterion"]
    assert plain["criterion"]["name"] == "dols"
    assert "rattle" in [warning["code"] for warning in plain["warnings"]]
    console = Console(width=200)
    with console.capture() as printed:
        print_everything(answer, console)
    assert "rattle: loudness 0.25, spectrum [1, None]" in printed.get()
    page = identification_page(answer, assessed.tests)
    (section,) = (section for section in page.sections if section.heading == "Rattle")
    assert section.text[0] == "the rig rattles at 3 Hz."
    assert section.charts == ("rattle",)
    assert identification_figures(assessed)["rattle"].caption == "Rattling."
    assert "the rig rattles" in str(assessed)


def test_hostile_names_stay_text():
    table = Table((HOSTILE, "value", "unit"), [(HOSTILE, "1.5", HOSTILE)], HOSTILE)
    page = View(HOSTILE, [table], [HOSTILE, Finding("hum", HOSTILE)]).html()
    assert "<script" not in page
    assert page.count("&lt;script&gt;") == 7
    lines = table.markdown().splitlines()
    assert len(lines) == 3
    assert all(line.replace("\\|", "").count("|") == 4 for line in lines)
    latex = table.latex()
    assert "\\input" not in latex
    assert latex.count("\\textbackslash{}input\\{x\\}\\$\\_\\%\\#\\textasciitilde{}\\^{}") == 3
    assert View("", [table]).text().count("<script>") == 4


if __name__ == "__main__":
    SCHEMA.write_text(schema(), encoding="utf-8")
