"""The page of a report: its text is shown, not obeyed, and nothing of it lies elsewhere."""

import base64
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest
from reporting_charts import X, Y

from riecjax.charts import Axis, Line, single
from riecjax.reporting.interactive import interactive
from riecjax.reporting.page import Page, Section, render
from riecjax.reporting.tables import Table

EVIL = "</script><script>alert(1)</script><img src=x onerror=alert(2)>"
DOCUMENT = {
    "warnings": [{"code": "odd", "message": f"5 < 6 & {EVIL}"}],
    "provenance": {"file": EVIL},
}
VOID = ("meta", "img", "link", "br", "input")


class Reader(HTMLParser):
    """Elements with their attributes, and texts outside of scripts and styles."""

    def __init__(self, page: str):
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.texts: list[str] = []
        self.scripts: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        inside = self.open[-1] if self.open else ""
        if inside == "script":
            self.scripts.append(data)
        elif inside != "style" and data.strip():
            self.texts.append(data.strip())


@pytest.fixture
def picture(tmp_path) -> Path:
    path = tmp_path / "one.png"
    path.write_bytes(b"picture")
    return path


@pytest.fixture
def html(picture) -> str:
    marks = [Line(X, Y, EVIL)]
    chart = single(marks, Axis(EVIL), Axis(EVIL), EVIL)
    tables = [
        Table(("name", "value"), [("K_t", "180"), (EVIL, "1")], EVIL),
        Table(("a", "b"), [("c", "d")], numeric=False),
    ]
    sections = [
        Section(EVIL, [EVIL], tables, ["one", "absent"]),
        Section("Nothing", charts=["absent"]),
        Section("Words", ["all that is said"]),
    ]
    return render(Page(EVIL, EVIL, sections), DOCUMENT, {"one": chart}, {"one": picture})


def test_every_text_is_shown_as_it_is(html):
    page = Reader(html)
    assert page.open == []
    for word in (EVIL, "K_t", "all that is said", f"5 < 6 & {EVIL}", "odd"):
        assert word in page.texts
    assert not [tag for tag, given in page.elements if any(name.startswith("on") for name in given)]
    tags = [tag for tag, _ in page.elements]
    # The chart's data, Plotly and the page's own; the chart's picture.
    assert (tags.count("script"), tags.count("img")) == (3, 1)


def test_nothing_is_loaded_from_elsewhere(html):
    page = Reader(html)
    for tag, given in page.elements:
        assert tag not in ("link", "iframe", "object", "embed", "base", "form")
        for name in ("src", "href", "srcset", "data", "action"):
            assert (given.get(name) or "#").startswith(("#", "data:"))
    (policy,) = (
        given["content"] or ""
        for tag, given in page.elements
        if given.get("http-equiv") == "Content-Security-Policy"
    )
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert rules["default-src"] == "'none'"
    assert set(rules) == {
        "default-src", "script-src", "style-src", "img-src", "base-uri", "form-action",
    }  # fmt: skip
    assert not re.search(r"https?:|\*", policy)


def test_figures_come_with_their_data_and_a_picture(html, picture):
    page = Reader(html)
    (image,) = (given for tag, given in page.elements if tag == "img")
    assert image["src"] == "data:image/png;base64," + base64.b64encode(b"picture").decode()
    assert image["alt"] == EVIL
    kinds = [given.get("type") for tag, given in page.elements if tag == "script"]
    assert kinds == ["application/json", None, None]
    chart = single([Line(X, Y, EVIL)], Axis(EVIL), Axis(EVIL), EVIL)
    assert json.loads(page.scripts[0]) == interactive(chart)
