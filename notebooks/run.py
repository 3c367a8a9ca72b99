"""Runs the notebooks and keeps their outputs, so that they read without running.

`python notebooks/run.py [NOTEBOOK ...]`, or `make notebooks` for all of them. What differs from run
to run without meaning anything is left out: counts, times, versions, and what goes to stderr.
"""

import base64
import io
import os
import sys
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbformat import NotebookNode
from PIL import Image

HERE = Path(__file__).parent
DPI, COLOURS = 110, 64
KERNEL = [f"--InlineBackend.print_figure_kwargs={{'dpi': {DPI}, 'bbox_inches': 'tight'}}"]


def main(paths: list[Path]) -> None:
    os.environ.setdefault("JAX_PLATFORMS", "cpu")  # results of one kind of machine
    os.environ["MPLBACKEND"] = "module://matplotlib_inline.backend_inline"
    for path in paths:
        path.write_text(executed(path), encoding="utf-8")
        print(f"{path.name}: {path.stat().st_size / 1024:.0f} kB")


def executed(path: Path) -> str:
    """The text of a notebook with the outputs of its cells."""
    notebook = nbformat.read(path, as_version=4)
    metadata = dict(notebook.metadata)
    client = NotebookClient(
        notebook,
        timeout=600,
        record_timing=False,
        coalesce_streams=True,
        extra_arguments=KERNEL,
        resources={"metadata": {"path": str(HERE)}},
    )
    client.execute()
    notebook.metadata = metadata
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)
        if cell.cell_type == "code":
            cell.execution_count = None
            cell.outputs = [cleaned(each) for each in cell.outputs if each.get("name") != "stderr"]
    return nbformat.writes(notebook) + "\n"


def cleaned(output: NotebookNode) -> NotebookNode:
    """An output without counts, and with its picture in few colours."""
    if "execution_count" in output:
        output.execution_count = None
    data = output.get("data", {})
    if "image/png" in data:
        data["image/png"] = smaller(data["image/png"])
        output.metadata = {}
    return output


def smaller(png: str) -> str:
    """A PNG, in base64, of few colours and without words about its making."""
    picture = Image.open(io.BytesIO(base64.b64decode(png))).convert("RGB")
    kept = io.BytesIO()
    picture.quantize(COLOURS, dither=Image.Dither.NONE).save(kept, "PNG", optimize=True)
    return base64.b64encode(kept.getvalue()).decode()


if __name__ == "__main__":
    main([Path(each) for each in sys.argv[1:]] or sorted(HERE.glob("*.ipynb")))
