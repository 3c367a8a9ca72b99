"""Pages and README say what the program says: names, links, code that runs, what commands print."""

import json
import pydoc
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest
from benchmarks.calibration import noise_table
from benchmarks.speed import __main__ as speed
from benchmarks.zoo import __main__ as zoo

import riecjax
from nightly import nightly
from riecjax.cli.main import run

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
SOURCE = ROOT / "src" / "riecjax"
PAGES = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md")),
    *(page for page in DOCS.rglob("*.md") if page.parent.name != "reference"),
]
LINK = re.compile(r"\]\((?!https?:)([^)#\s]*)(?:#([\w-]+))?\)")
MODULE = re.compile(r"`((?:\w+/)+\w+\.py)`")
BLOCK = re.compile(r"```(\w*)\n(.*?)```", flags=re.DOTALL)
PROMISE = re.compile(r"^print\(.*\)  # (.*?);", flags=re.MULTILINE)


def blocks(page: str) -> list[tuple[str, str]]:
    """Kind and text of a page's blocks: `console` and `python`; what is printed has no kind."""
    return BLOCK.findall((ROOT / page).read_text(encoding="utf-8"))


def code(page: str) -> str:
    return "\n".join(text for kind, text in blocks(page) if kind == "python")


def rounded(text: str) -> list[str]:
    """Words of a table without its layout, numbers to three digits."""

    def three_digits(word: str) -> str:
        try:
            return f"{float(word):.3g}"
        except ValueError:
            return word

    return [three_digits(word) for word in text.split()]


def public_names() -> list[str]:
    """Names that users type after `riecjax.`: the top level's, and those of its submodules."""
    names = {name: getattr(riecjax, name) for name in dir(riecjax)}
    modules = {name: each for name, each in names.items() if isinstance(each, ModuleType)}
    below = [f"{name}.{each}" for name, module in modules.items() for each in dir(module)]
    return [*(names.keys() - modules.keys()), *below]


def anchors(page: Path) -> Iterator[str]:
    """Those that the site gives the headings of a page or a notebook."""
    text = page.read_text(encoding="utf-8")
    if page.suffix == ".ipynb":
        text = "\n".join("".join(cell["source"]) for cell in json.loads(text)["cells"])
    for heading in re.findall(r"^#+ (.*)$", text, flags=re.MULTILINE):
        yield re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", heading).strip().lower())


def target(page: Path, link: str) -> Path:
    """The file behind a link, as the site has it: with notebooks and their pictures in place."""
    if not link:
        return page
    if page.is_relative_to(DOCS) and link.startswith("notebooks/"):
        return ROOT / link
    if link.startswith("gallery/"):  # a picture that a notebook keeps
        return ROOT / "notebooks" / f"{Path(link).parent.name}.ipynb"
    return page.parent / link


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_what_a_page_names_is_there(page):
    text = page.read_text(encoding="utf-8")
    for link, anchor in LINK.findall(text):
        file = target(page, link)
        assert file.exists(), link
        assert not anchor or anchor in anchors(file), f"{link}#{anchor}"
    for module in MODULE.findall(text):
        trees = [top for top in (ROOT, SOURCE) if (top / Path(module).parts[0]).is_dir()]
        assert not trees or any((top / module).exists() for top in trees), module
    for name in re.findall(r"\brx\.(\w+(?:\.\w+)?)", text):
        found = riecjax
        for part in name.split("."):
            assert hasattr(found, part), name
            found = getattr(found, part)


def test_reference_shows_every_public_name_once_and_nothing_that_is_gone():
    pages = [path.read_text(encoding="utf-8") for path in (DOCS / "reference").glob("*.md")]
    shown = re.findall(r"^::: riecjax\.(\S+)$", "\n".join(pages), flags=re.MULTILINE)
    assert sorted(name for name in shown if name.count(".") < 2) == sorted(public_names())
    assert [name for name in shown if pydoc.locate(f"riecjax.{name}") is None] == []


def test_every_notebook_is_in_the_navigation():
    navigation = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    for path in (ROOT / "notebooks").glob("*.ipynb"):
        assert f"notebooks/{path.name}" in navigation


@pytest.mark.parametrize(
    "page",
    [
        "index",
        *nightly(["writing_a_model", "hidden_modes", "sensor_noise", "results", "summaries"]),
    ],
)
def test_code_of_a_page_runs_and_prints_what_stands_beside_it(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    text = code(f"docs/{page}.md")
    exec(compile(text, page, "exec"), {})
    printed = iter(capsys.readouterr().out.splitlines())
    for promised in PROMISE.findall(text):
        assert promised in printed, promised  # in this order


@pytest.mark.slow
@pytest.mark.parametrize(
    ("page", "outputs"),
    [("README.md", 2), ("docs/getting_started.md", 2), ("docs/your_recording.md", 3)],
)
def test_commands_print_what_the_page_shows(page, outputs, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    Path("rig.py").write_text(next(text for kind, text in blocks(page) if kind == "python"))
    printed, shown = "", 0
    for kind, text in blocks(page):
        if kind == "console" or text.startswith(".venv/bin/riecjax "):
            for line in text.splitlines():
                command, _, file = line.partition(" > ")
                assert run(shlex.split(command)[1:]) == 0
                printed = capsys.readouterr().out
                if file:
                    Path(file).write_text(printed, encoding="utf-8")
        elif not kind and printed:
            printed = printed.partition("\nwrote ")[0] if "\nwrote " not in text else printed
            assert rounded(printed) == rounded(text)
            shown += 1
    assert shown == outputs


@pytest.mark.slow
@pytest.mark.parametrize(
    ("page", "command", "patterns"),
    [
        ("README.md", "drive.csv", [r"^M_s +302\.[67]\d* "]),
        ("docs/getting_started.md", "drive.csv", [r"^K_s +207\d\d\.?\d* ", r"(x\d.*%.*){4}"]),
        ("docs/your_recording.md", "rig.csv", [r"^m +1\.496", r"well \(fit 89\.2, 90\.2 %\)"]),
    ],
)
def test_python_of_a_page_says_the_same(page, command, patterns, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    lines = "\n".join(text for kind, text in blocks(page) if kind != "python").splitlines()
    simulate = next(line for line in lines if "simulate" in line and line.endswith(command))
    assert run(shlex.split(simulate)[1:]) == 0
    capsys.readouterr()
    python = [text for kind, text in blocks(page) if kind == "python"]
    Path("rig.py").write_text(python[0])
    exec(compile(code(page), page, "exec"), {})
    printed = capsys.readouterr().out
    for pattern in patterns:
        assert re.search(pattern, printed, flags=re.MULTILINE), pattern
    assert sum(map(float, re.findall(r"([\d.]+) %'", printed))) < 50  # errors of a prediction


@pytest.mark.slow
def test_code_of_the_ten_tasks_runs_and_prints_what_it_says(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    names = {}
    for kind, text in blocks("docs/how_to/ten_tasks.md"):
        if kind == "console":
            assert run(shlex.split(text)[1:]) == 0
        elif kind == "python":
            capsys.readouterr()
            exec(compile(text, "ten tasks", "exec"), names)
            printed = capsys.readouterr().out
            for promised in re.findall(r"^print\(.*\)  # (.*)$", text, flags=re.MULTILINE):
                assert promised in printed


@pytest.mark.parametrize("tables", [zoo, noise_table, speed], ids=["zoo", "noise", "speed"])
def test_tables_are_what_was_recorded(tables):
    assert tables.PAGE.read_text(encoding="utf-8") == tables.page()
