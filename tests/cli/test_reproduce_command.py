"""`riecjax reproduce`: its tables beside the paper's, and the whole study in its small size."""

import json
import math
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from report_browser import assert_drawn, drawn_page, launched, overlaps
from riecjax.cli.main import run

ROADS = 2
VARIANTS = ("W_id", "W_true", "B_id", "B_true")
ROWS = {
    "3": {"K_t", "M_us", "M_s"},
    "4": set(VARIANTS),
    "5": {f"{variant} {where}" for variant in VARIANTS for where in ("road", "pothole")},
}
# Read off the paper's tables: stiffness in N/m, masses in kg.
TRUE_VALUES = {"K_t": 180e3, "M_us": 30.0, "M_s": 300.0}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("reproduce") / "results"
    assert run(["reproduce", "--roads", str(ROADS), "--seed", "3", "--out", str(out)]) == 0
    return out


@pytest.fixture(scope="module")
def document(folder: Path) -> dict:
    return json.loads((folder / "results.json").read_text())


def numbers(tree: object) -> list[float]:
    if isinstance(tree, dict):
        tree = list(tree.values())
    if isinstance(tree, list):
        return [number for part in tree for number in numbers(part)]
    return [tree] if isinstance(tree, int | float) else []


def test_every_number_is_finite(document):
    assert len(numbers(document)) > 200
    assert all(math.isfinite(number) for number in numbers(document))


def rounding(number: str, row: str) -> float:
    """Half a unit of the last digit in print: 0.1 kN/m, 0.1 kg, 0.1 %."""
    return 50.0 if number == "4" or row == "K_t" else 0.05


@pytest.mark.parametrize("number", ROWS)
def test_tables(document, number):
    table = document["tables"][number]
    assert set(table) == ROWS[number]
    for name, row in table.items():
        assert set(row) == {"RIEC", "DOLS"}
        for cell in row.values():
            low, high = cell["interval95"]
            # Two roads: the mean lies between them, and the range is 95 % of their distance.
            assert low < cell["reproduced"] < high
            assert (low + high) / 2 == pytest.approx(cell["reproduced"])
            reach = rounding(number, name)
            assert cell["inside"] == (low - reach <= cell["published"] <= high + reach)
            if name in TRUE_VALUES:  # in the same unit
                assert cell["published"] == pytest.approx(TRUE_VALUES[name], rel=0.4)
                assert cell["reproduced"] == pytest.approx(cell["published"], rel=0.1)


def test_riec_finds_the_sprung_mass_and_dols_does_not(document):
    masses = document["tables"]["3"]["M_s"]
    assert masses["RIEC"]["reproduced"] == pytest.approx(300, rel=0.03)
    assert masses["DOLS"]["reproduced"] < 270


@pytest.mark.draws
def test_folder(folder):
    names = sorted(path.name for path in folder.iterdir())
    pictures = [f"figure_{i}.png" for i in (3, 5, 6, 7, 8)]
    assert names == [*pictures, "report.html", "results.json", "tables.png"]
    assert [path.name for path in folder.parent.iterdir()] == ["results"]
    page = (folder / "report.html").read_text(encoding="utf-8")
    for word in ("Table 1", "Table 3", "Table 4", "Table 5", "Claim 6", "few_roads"):
        assert word in page


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("study") / "out"
    assert run(["reproduce", "--quick", "--seed", "3", "--out", str(out)]) == 0
    return out


@pytest.mark.slow
def test_the_quick_study_evaluates_every_claim_and_leaves_a_tidy_table(study):
    document = json.loads((study / "results.json").read_text())
    claims = document["claims"]
    assert [claim["id"] for claim in claims] == list(range(1, 18))
    # What does not hold depends on the pot-hole's shape, which is reconstructed.
    assert [claim["id"] for claim in claims if not claim["holds"]] == [16]
    figures = {f"figure_{i}.png" for i in (2, 3, *range(5, 15))}
    others = {"tables.png", "window_lengths.png", "report.html", "results.json"}
    assert {path.name for path in study.iterdir()} == figures | others | {"variations.parquet"}
    # Cases, roads, bandwidths, and DOLS beside one draw of RIEC.
    assert pq.read_table(study / "variations.parquet").num_rows == 3 * 4 * 12 * 2


@pytest.mark.slow
@pytest.mark.parametrize("width", [390, 1280])
def test_the_report_is_drawn_and_readable(study, width):
    with launched() as browser, drawn_page(browser, study / "report.html", width) as page:
        assert_drawn(page, width)
        assert page.locator("figure").count() == 14
        assert overlaps(page) == []
