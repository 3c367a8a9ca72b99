"""Pages of the site say what the code says: names, warnings, and code that runs."""

import re
import shlex
from pathlib import Path
from types import ModuleType

import pytest

import riecjax
from nightly import nightly
from riecjax.cli.main import run

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
CODE = re.compile(r"```python\n(.*?)```", flags=re.DOTALL)


def public_names() -> list[str]:
    """Names that users type after `riecjax.`: the top level's, and those of its submodules."""
    names = {name: getattr(riecjax, name) for name in dir(riecjax)}
    modules = {name: each for name, each in names.items() if isinstance(each, ModuleType)}
    below = [f"{name}.{each}" for name, module in modules.items() for each in dir(module)]
    return [*(names.keys() - modules.keys()), *below]


def test_reference_shows_every_public_name_once():
    pages = [path.read_text(encoding="utf-8") for path in (DOCS / "reference").glob("*.md")]
    shown = re.findall(r"^::: riecjax\.(\w+(?:\.\w+)?)$", "\n".join(pages), flags=re.MULTILINE)
    assert sorted(shown) == sorted(public_names())


def test_every_notebook_is_in_the_navigation():
    navigation = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    for path in (ROOT / "notebooks").glob("*.ipynb"):
        assert f"notebooks/{path.name}" in navigation


@pytest.mark.parametrize(
    "page",
    [
        "index.md",
        *nightly(["writing_a_model.md", "hidden_modes.md", "sensor_noise.md", "results.md"]),
    ],
)
def test_code_of_a_page_runs(page, capsys):
    text = (DOCS / page).read_text(encoding="utf-8")
    exec(compile("\n".join(CODE.findall(text)), page, "exec"), {})
    for promised in re.findall(r"^print\(.*\)  # ([\d. ]*\d);", text, flags=re.MULTILINE):
        assert promised in capsys.readouterr().out


@pytest.mark.slow
def test_getting_started_runs_and_prints_what_it_shows(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    text = (DOCS / "getting_started.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```(\w*)\n(.*?)```", text, flags=re.DOTALL)
    simulate, check, identify = (block for kind, block in blocks if kind == "console")
    of_check, of_identify = [block for kind, block in blocks if not kind][1:]
    for command in (simulate, check):
        assert run(shlex.split(command)[1:]) == 0
    assert capsys.readouterr().out.split("\n", 1)[1].split() == of_check.split()
    # What identification prints is told in the README too; it takes a minute, so it is not run.
    assert identify.strip() in (ROOT / "README.md").read_text(encoding="utf-8")
    assert of_identify in (ROOT / "README.md").read_text(encoding="utf-8")
    exec(compile("\n".join(CODE.findall(text)), "getting_started.md", "exec"), {})
    printed = capsys.readouterr().out
    assert re.search(r"^K_s +207\d\d\.?\d* ", printed, flags=re.MULTILINE)
    shares = [float(share) for share in re.findall(r"([\d.]+) %'", printed)]
    assert len(shares) == 4
    assert sum(shares) < 50
