"""Runs one case in this process and returns what there is to keep of it."""

import contextlib
import io
import json
import os
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.approved.cases import Case, Moments
from tests.approved.comparison import condensed
from tests.approved.inputs import place

OUT = "out"
MASKED = {
    r"\bversion \d[\w.]*": "version VERSION",
    r"takes? about [\d.]+ (s|min|h)\b": "takes about SECONDS",
    r"in [\d.]+ (s|min|h), [\d.]+( thousand| million)? a second": "in SECONDS",
    r"riecjax: (summing|estimating|reproducing|studying): .*\n": "",
}
"""What texts say of the version, of time that something takes, and of progress."""
STORE = tempfile.TemporaryDirectory(prefix="riecjax-approved-")
"""Where this process makes each input once."""


def output(case: Case | Moments) -> dict[str, Any]:
    """What a case says: exit status, texts, document, files; or its Gram matrices."""
    if isinstance(case, Case) and case.needs:
        pytest.importorskip(case.needs)
    with tempfile.TemporaryDirectory(prefix="riecjax-case-") as folder, working_in(folder):
        place(case.words, case.folder, Path(folder), Path(STORE.name))
        return _moments(case) if isinstance(case, Moments) else _said(case, Path(folder))


@contextlib.contextmanager
def working_in(folder: str) -> Iterator[None]:
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


def _said(case: Case, folder: Path) -> dict[str, Any]:
    words = case.words
    with_files = "--out" in words
    with pytest.MonkeyPatch.context() as patch:
        if not case.draws:
            without_pictures(patch)
        status, out, err = _call(words)
        kept: dict[str, Any] = {"status": status, "out": _masked(out), "err": _masked(err)}
        results = folder / OUT / "results.json"
        if results.exists():
            kept["document"] = condensed(json.loads(results.read_text()))
        elif not with_files and case.document:
            kept["document"] = condensed(_json(_call([*words, "--json"])[1]))
    if case.draws:
        kept["files"] = sorted(str(p.relative_to(folder)) for p in (folder / OUT).rglob("*"))
    return kept


def _json(text: str) -> Any:
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        return None if not text else {"not JSON": text[:200]}


def _call(words: list[str]) -> tuple[int | str, str, str]:
    from riecjax.cli.main import run

    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            status: int | str = run(words)
        except Exception as error:
            status = f"traceback: {type(error).__name__}: {error}"
    return status, out.getvalue(), err.getvalue()


def _masked(text: str) -> str:
    """Without what depends on the machine: folders, versions, seconds that something took."""
    text = text.replace(str(Path.cwd()), "FOLDER").replace(tempfile.gettempdir(), "TMP")
    for pattern, word in MASKED.items():
        text = re.sub(pattern, word, text)
    return "\n".join(line.rstrip() for line in text.splitlines())


def without_pictures(patch: pytest.MonkeyPatch) -> None:
    """Pictures and the page are no part of what is approved, and take longer than all else."""
    from matplotlib.figure import Figure

    patch.setattr("riecjax.reporting.printed.printed", lambda _: Figure(figsize=(0.1, 0.1)))


def _moments(case: Moments) -> dict[str, Any]:
    """Of each equation the Gram matrix of target and regressors, over all blocks of time."""
    import jax

    import riecjax as rx

    criterion, key = case.criterion(), jax.random.key(0)
    summary = rx.summarise(
        rx.find_model(case.model), rx.read_record(case.record), criterion, key=key
    )
    names = [name for stage in summary.outline.stages for name, _ in stage]
    equations = [equation for stage in summary.equations() for equation in stage]
    return {
        "moments": {
            name: {
                "parameters": list(equation.parameters),
                "rows": float(equation.count.sum()),
                "moments": np.asarray(equation.moments).sum((0, 1)).tolist(),
            }
            for name, equation in zip(names, equations, strict=True)
        }
    }
