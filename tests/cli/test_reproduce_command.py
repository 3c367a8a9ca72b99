import json
import math
from pathlib import Path

import numpy as np
import pytest
from command_line import Result, rejected

from riecjax.cli.main import run

ROADS = 2
VARIANTS = ("W_id", "W_true", "B_id", "B_true")
ROWS = {
    "3": {"K_t", "M_us", "M_s"},
    "4": set(VARIANTS),
    "5": {f"{variant} {where}" for variant in VARIANTS for where in ("road", "pothole")},
}
# Read off the paper's tables: stiffness in N/m, masses in kg, errors in percent.
TRUE_VALUES = {"K_t": 180e3, "M_us": 30.0, "M_s": 300.0}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("reproduce") / "results"


@pytest.fixture(scope="module")
def result(folder: Path) -> Result:
    import contextlib
    import io

    out, err = io.StringIO(), io.StringIO()
    arguments = ["reproduce", "--roads", str(ROADS), "--seed", "3", "--out", str(folder), "--json"]
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = run(arguments)
    return Result(status, out.getvalue(), err.getvalue())


@pytest.fixture(scope="module")
def document(result: Result) -> dict:
    assert result.status == 0, result.err
    return result.document


def numbers(tree: object) -> list[float]:
    if isinstance(tree, dict):
        tree = list(tree.values())
    if isinstance(tree, list):
        return [number for part in tree for number in numbers(part)]
    return [tree] if isinstance(tree, int | float) else []


@pytest.mark.slow
def test_standard_output_is_one_json_document(result):
    assert result.status == 0
    assert result.out.startswith("{\n")
    json.loads(result.out)
    assert "Traceback" not in result.err


@pytest.mark.slow
def test_few_roads_are_warned_of(result, document):
    assert [warning["code"] for warning in document["warnings"]] == ["few_roads"]
    assert "warning [few_roads]: only 2 roads" in result.err


def test_top_level_keys(document):
    contract = {"schema", "tables", "claims", "reconstruction", "provenance"}
    assert contract <= set(document)
    assert document["schema"] == 2
    assert set(document["tables"]) == {"1", "3", "4", "5"}


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
            assert {"published", "reproduced", "interval95"} <= set(cell)
            low, high = cell["interval95"]
            # Two roads: the mean lies between them, and the range is 95 % of their distance.
            assert low < cell["reproduced"] < high
            assert (low + high) / 2 == pytest.approx(cell["reproduced"])
            reach = rounding(number, name)
            assert cell["inside"] == (low - reach <= cell["published"] <= high + reach)


@pytest.mark.parametrize("name", TRUE_VALUES)
def test_published_and_reproduced_values_are_in_the_same_unit(document, name):
    for cell in document["tables"]["3"][name].values():
        assert cell["published"] == pytest.approx(TRUE_VALUES[name], rel=0.4)
        assert cell["reproduced"] == pytest.approx(cell["published"], rel=0.1)


def test_table_1(document):
    rows = document["tables"]["1"]
    assert len(rows) >= 4
    for row in rows:
        assert set(row) == {"published", "reproduced", "agrees"}
        assert row["agrees"] is True
        for mode in (row["published"], row["reproduced"]):
            real, imaginary = mode["eigenvalue"]
            assert real <= 0
            if mode["frequency"] is not None:
                size = np.hypot(real, imaginary)
                # Printed to two digits: |lambda| = 2 pi f, zeta = -Re(lambda) / |lambda|.
                assert size == pytest.approx(2 * np.pi * mode["frequency"], rel=0.02)
                assert mode["damping_ratio"] == pytest.approx(-real / size, abs=0.02)


def test_claims(document):
    claims = document["claims"]
    assert [claim["id"] for claim in claims] == [4, 5, 6, 7, 9, 10, 16]
    for claim in claims:
        assert set(claim) == {"id", "statement", "holds", "evidence", "note"}
        assert claim["statement"].endswith(".")
        verdicts = [entry["holds"] for entry in claim["evidence"].values()]
        assert claim["holds"] is all(verdicts)
        for entry in claim["evidence"].values():
            assert set(entry) == {"value", "interval95", "at_least", "at_most", "holds"}
            if entry["interval95"] is not None:
                low, high = entry["interval95"]
                assert low <= entry["value"] <= high


def test_riec_finds_the_sprung_mass_and_dols_does_not(document):
    masses = document["tables"]["3"]["M_s"]
    assert masses["RIEC"]["reproduced"] == pytest.approx(300, rel=0.03)
    assert masses["DOLS"]["reproduced"] < 270


def test_provenance(document):
    provenance = document["provenance"]
    assert provenance["seed"] == 3
    assert provenance["roads"] == ROADS
    assert {"riecjax", "jax", "numpy", "python"} <= set(provenance["versions"])
    assert document["reconstruction"]


def test_folder(document, folder):
    names = sorted(path.name for path in folder.iterdir())
    pictures = [f"figure_{i}.png" for i in (3, 5, 6, 7, 8)]
    assert names == [*pictures, "report.html", "results.json", "tables.png"]
    assert [path.name for path in folder.parent.iterdir()] == ["results"]
    assert json.loads((folder / "results.json").read_text()) == document
    for name in (*pictures, "tables.png"):
        assert (folder / name).read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
    page = (folder / "report.html").read_text(encoding="utf-8")
    for word in ("Table 1", "Table 3", "Table 4", "Table 5", "Claim 6", "few_roads"):
        assert word in page


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--roads", "0"], "--roads"),
        (["--roads", "many"], "--roads"),
        (["--seed", "-1"], "--seed"),
        (["--out", "taken"], "'taken' is a file"),
    ],
    ids=" ".join,
)
def test_wrong_usage(capsys, tmp_path, monkeypatch, options, words):
    monkeypatch.chdir(tmp_path)
    Path("taken").touch()
    assert words in rejected(capsys, 2, "reproduce", *options)


@pytest.mark.parametrize("options", [["--full"], ["--quick"]], ids=" ".join)
def test_a_number_of_roads_contradicts_full_and_quick(capsys, tmp_path, monkeypatch, options):
    # Otherwise one of the two would be dropped without a word.
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("riecjax.cli.reproduce.start_jax", lambda: pytest.fail("was started"))
    assert "--roads" in rejected(capsys, 2, "reproduce", "--roads", "2", *options)
