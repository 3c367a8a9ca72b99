"""Where results go: the terminal, standard output and a folder that is whole or as it was."""

import json
import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import matplotlib.pyplot as plt
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from rich.console import Console

from riecjax.charts import Axis, Chart, Line, single
from riecjax.errors import DataError
from riecjax.reporting import printed
from riecjax.reporting.document import is_intact, sealed
from riecjax.reporting.output import _folder_beside, emit, write_folder
from riecjax.reporting.page import Page, Section
from riecjax.whole_files import stamp

DOCUMENT = {
    "answer": 42,
    "warnings": [{"code": "odd", "message": "5 < 6 & so on"}],
    "provenance": {"seed": 1},
}


def show(document: dict, console: Console) -> None:
    console.print(f"the answer is {document['answer']}", highlight=False)


CHART = single([Line([1, 2], [3, 4])], Axis("time / s"), Axis("x / m"), "How it moves.")


def page(document: dict) -> Page:
    answer = f"the answer is {document['answer']}"
    return Page("A <title>", "", [Section("Answer", [answer], charts=("one", "two"))])


def emitted(
    out: Path | None = None,
    as_json: bool = False,
    charts: Callable[[], Mapping[str, Chart]] = dict,
) -> None:
    emit(DOCUMENT, as_json=as_json, out=out, show=show, charts=charts, page=page)


@pytest.mark.parametrize("as_json", [False, True])
def test_answers_go_to_standard_output_and_warnings_to_standard_error(capsys, as_json):
    emitted(as_json=as_json, charts=lambda: pytest.fail("was made"))
    captured = capsys.readouterr()
    said = captured.out
    assert (json.loads(said) == sealed(DOCUMENT)) if as_json else (said == "the answer is 42\n")
    assert captured.err == "warning [odd]: 5 < 6 & so on\n"


def test_a_folder_holds_results_report_and_pictures(tmp_path):
    out = tmp_path / "a" / "b"
    emitted(out, charts=lambda: {"one": CHART, "two": CHART})
    names = sorted(path.name for path in out.iterdir())
    assert names == ["one.png", "report.html", "results.json", "two.png"]
    assert [path.name for path in (tmp_path / "a").iterdir()] == ["b"]
    assert json.loads((out / "results.json").read_text()) == sealed(DOCUMENT)
    # Otherwise a program that identifies in a loop keeps every figure and is warned of it.
    assert plt.get_fignums() == []


@pytest.mark.parametrize("existing", [False, True])
def test_a_failure_leaves_the_folder_as_it_was(capsys, tmp_path, monkeypatch, existing):
    def fail(chart: Chart, file: Path) -> None:
        file.write_bytes(b"half")
        if file.name == "two.png":
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(printed, "print_chart", fail)
    out = tmp_path / "out"
    if existing:
        out.mkdir()
        (out / "results.json").write_text("old")
    with pytest.raises(DataError, match="No space left on device"):
        emitted(out, as_json=True, charts=lambda: {"one": CHART, "two": CHART})
    assert capsys.readouterr().out == ""
    assert [path.name for path in tmp_path.iterdir()] == (["out"] if existing else [])
    if existing:
        assert [path.name for path in out.iterdir()] == ["results.json"]
        assert (out / "results.json").read_text() == "old"


def test_figures_of_an_earlier_run_do_not_stay(tmp_path):
    out = tmp_path / "out"

    def stamped(file: Path) -> None:
        table = pa.table({"x": [1.0]}).replace_schema_metadata({"riecjax": stamp(file)})
        pq.write_table(table, file)

    charts, others = {"one": CHART, "two": CHART}, {"variations.parquet": stamped}
    write_folder(out, DOCUMENT, charts, page(DOCUMENT), others)
    (out / "mine.png").write_bytes((out / "one.png").read_bytes())
    (out / "photo.png").write_bytes(b"\x89PNG")
    (out / "table.parquet").write_bytes((out / "variations.parquet").read_bytes())
    write_folder(out, DOCUMENT, {"two": CHART}, page(DOCUMENT))
    names = ["mine.png", "photo.png", "report.html", "results.json", "table.parquet", "two.png"]
    assert sorted(path.name for path in out.iterdir()) == names


@pytest.mark.parametrize("moves", range(4))
def test_results_never_stand_beside_what_is_of_others(tmp_path, monkeypatch, moves):
    """Wherever it ends while files take their places, and whatever stood there."""
    out = tmp_path / "out"
    write_folder(out, DOCUMENT, {"one": CHART, "two": CHART}, page(DOCUMENT))
    done = []

    def killed(file: Path, target: Path) -> Path:
        if len(done) == moves:
            raise KeyboardInterrupt
        done.append(target)
        os.replace(file, target)
        return target

    monkeypatch.setattr(Path, "replace", killed)
    with pytest.raises(KeyboardInterrupt):
        write_folder(out, {**DOCUMENT, "answer": 43}, {"one": CHART, "two": CHART}, page(DOCUMENT))
    assert not (out / "results.json").exists()


def test_a_flipped_bit_of_results_is_seen(tmp_path):
    write_folder(tmp_path / "out", DOCUMENT, {}, page(DOCUMENT))
    file = tmp_path / "out" / "results.json"
    whole = file.read_bytes()
    assert is_intact(json.loads(whole))
    for place in range(8 * len(whole)):
        damaged = bytearray(whole)
        damaged[place // 8] ^= 1 << (place % 8)
        try:
            read = json.loads(damaged.decode())
        except ValueError:
            continue
        told = {key: value for key, value in read.items() if key in DOCUMENT}
        assert not is_intact(read) or told == DOCUMENT


def test_results_are_made_in_a_folder_that_keeps_no_one_out(tmp_path):
    (tmp_path / "ordinary").mkdir()
    with _folder_beside(tmp_path / "out") as made:
        assert made.parent == tmp_path
        assert made.stat().st_mode == (tmp_path / "ordinary").stat().st_mode


@pytest.mark.parametrize("module", ["matplotlib", "jinja2", "plotly"])
def test_missing_packages_are_named_with_the_remedy(tmp_path, monkeypatch, module):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(DataError, match=r'pip install "riecjax\[report\]"'):
        emitted(tmp_path / "out")
    assert list(tmp_path.iterdir()) == []
