import base64
import json
import re
from pathlib import Path

import nbclient
import nbformat
import pytest

NOTEBOOKS = sorted((Path(__file__).parents[2] / "notebooks").glob("*.ipynb"))
LARGEST_NOTEBOOK, LARGEST_PICTURE = 300_000, 60_000
"""Bytes."""
MOST_LINES = 30
LOCAL = re.compile(r"/tmp\b|/home/|/work\b|/root\b|\.venv|site-packages")
SHOWS = re.compile(r"^\s*print\(|\.plot\(|plt\.|^[a-z_]+$", flags=re.MULTILINE)
"""What cells show something with: they print, draw, or end with an object's name."""


def code_cells(path: Path) -> list[nbformat.NotebookNode]:
    notebook = nbformat.read(path, as_version=4)
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def shown(path: Path) -> list[nbformat.NotebookNode]:
    return [output for cell in code_cells(path) for output in cell.outputs]


def said(output: nbformat.NotebookNode) -> str:
    return output.get("text") or output.get("data", {}).get("text/plain", "")


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_notebook_runs_to_its_end(path: Path):
    notebook = nbformat.read(path, as_version=4)
    nbclient.NotebookClient(
        notebook, timeout=300, kernel_name="python3", resources={"metadata": {"path": path.parent}}
    ).execute()
    written = [cell for cell in notebook.cells if cell.cell_type == "code" and cell.source.strip()]
    assert all(cell.execution_count for cell in written)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_what_cells_show_is_stored(path: Path):
    for cell in code_cells(path):
        kinds = {kind for output in cell.outputs for kind in output.get("data", {})}
        if SHOWS.search(cell.source):
            assert cell.outputs, cell.id
        if re.search(r"plt\.subplots\(|\.plot\(\)", cell.source):
            assert "image/png" in kinds, cell.id
        if re.search(r"^print\(", cell.source, flags=re.MULTILINE):
            assert any(output.get("name") == "stdout" for output in cell.outputs), cell.id


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_what_is_stored_is_small_and_says_nothing_of_the_machine_or_the_run(path: Path):
    for cell in code_cells(path):
        assert cell.execution_count is None
        assert cell.metadata == {}
        assert all(output.get("execution_count") is None for output in cell.outputs)
    assert path.stat().st_size <= LARGEST_NOTEBOOK
    for output in shown(path):
        assert output.output_type != "error"
        assert output.get("name") != "stderr"
        assert len(said(output).splitlines()) <= MOST_LINES
        picture = output.get("data", {}).get("image/png", "")
        assert len(base64.b64decode(picture)) <= LARGEST_PICTURE
        words = {kind: data for kind, data in output.get("data", {}).items() if "image" not in kind}
        assert not LOCAL.search(said(output) + json.dumps(words))


# The words around a cell name these numbers, as they read in the output.
TOLD = {
    "1_the_idea": ["11.00 kg"],
    "2_the_quarter_car": [r"M_s +302\.\d+ ± [\d.]+ +24\d\.", r"M_us +23\.\d+ ± \S+ +24\."],
    "3_a_recording_of_your_own": [r"left of axis +3\.", r"left of axis, asymmetric +1\."],
    "4_windows_and_intervals": [
        r"naive +0\.01\d kg +\d\d % +0 %",
        r"bootstrap +0\.1\d+ kg +9[4-9] %",
    ],
    "5_refinement_and_input_design": [r"^r +0\.8 +0\.8[01]", r"^r2 +0\.5 +0\.4[89]"],
    "6_the_mode_that_the_paper_leaves_out": [
        r"M_us +30 +23\.\d +(29\.[89]|30\.[01])",
        r"M_s +200 +30[12]\.\d +20[0-3]",
    ],
}


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_outputs_hold_what_the_words_say(path: Path):
    text = "\n".join(map(said, shown(path)))
    for pattern in TOLD[path.stem]:
        assert re.search(pattern, text, flags=re.MULTILINE), pattern
