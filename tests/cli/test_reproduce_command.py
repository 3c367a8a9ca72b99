"""`riecjax reproduce`: its tables beside the paper's, and the whole study in its small size."""

import json
from pathlib import Path

import pytest

from report_browser import assert_drawn, drawn_page, launched, overlaps
from riecjax.cli.main import run


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("study") / "out"
    assert run(["reproduce", "--quick", "--seed", "3", "--out", str(out)]) == 0
    return out


@pytest.mark.slow
def test_the_quick_study_evaluates_every_claim_and_draws_every_figure(study):
    document = json.loads((study / "results.json").read_text())
    claims = document["claims"]
    assert [claim["id"] for claim in claims] == list(range(1, 18))
    # What does not hold depends on the pot-hole's shape, which is reconstructed.
    assert [claim["id"] for claim in claims if not claim["holds"]] == [16]
    figures = {f"figure_{i}.png" for i in (2, 3, *range(5, 15))}
    others = {"tables.png", "window_lengths.png", "report.html", "results.json"}
    assert {path.name for path in study.iterdir()} == figures | others


@pytest.mark.slow
@pytest.mark.parametrize("width", [390, 1280])
def test_the_report_is_drawn_and_readable(study, width):
    with launched() as browser, drawn_page(browser, study / "report.html", width) as page:
        assert_drawn(page, width)
        assert page.locator("figure").count() == 14
        assert overlaps(page) == []
