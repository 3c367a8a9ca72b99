"""The source keeps to its budgets, a reader finds an idea in one module, and no way in a circle."""

import ast
import functools
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TypeGuard

import pytest

import riecjax
from test_import_direction import PUBLIC, imported_names

ROOT = Path(riecjax.__file__).parent
PROJECT = Path(__file__).parents[1]
MODULES = sorted(ROOT.rglob("*.py"))

BUDGETS = {
    "src lines": 50_460,
    "src modules": 215,
    "src statements": 24_310,
    "src literals": 1_353,
    "lines of commands and settings": 2_300,
    "tests lines": 28_485,
    "benchmarks lines": 9_675,
    "README lines": 150,
}
LEAST_PROSE = 17
"""Per cent, rounded."""
MOST_PARAMETERS = 7
MOST_IMPORTS = 12
MANY_PARAMETERS: dict[str, int] = {}
MANY_IMPORTS = {
    "riecjax.assessment.advice": 14,
    "riecjax.assessment.assess": 29,
    "riecjax.assessment.output_error_search": 14,
    "riecjax.discovery.candidate": 13,
    "riecjax.discovery.discover": 24,
    "riecjax.doubts.check": 21,
    "riecjax.doubts.equation_faults": 13,
    "riecjax.elements.backlash": 13,
    "riecjax.assessment.demands": 14,
    "riecjax.doubts.kinematics": 20,
    "riecjax.doubts.reading": 13,
    "riecjax.estimation.identify": 22,
    "riecjax.records.recording": 14,
    "riecjax.refinement.output_error": 14,
    "riecjax.reporting.result_figures": 14,
    "riecjax.reporting.result_files": 13,
    "riecjax.reporting.views": 20,
    "riecjax.summaries.one_pass": 15,
    "riecjax.summaries.summarise": 17,
    "riecjax.validation.sweep": 17,
}
"""What still exceeds the two limits, and by how much: shorten these tables, never lengthen them."""

EVERYDAY_NUMBERS = {0, 1, 2, -1, 0.5}
SOURCE_ENDINGS = {".py", ".pyi", ".js", ".ts", ".css", ".j2", ".html", ".toml", ".txt"}
DOCUMENTED = ast.Module | ast.ClassDef | ast.FunctionDef


def name_of(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(("riecjax", *parts)).removesuffix(".__init__")


NAMES = {name_of(path): path for path in MODULES}


@functools.cache
def imported(path: Path) -> set[str]:
    """Modules of the package that a file imports anywhere in it, not for types alone."""
    text = path.read_text(encoding="utf-8")
    names = imported_names(text, path.relative_to(ROOT), for_types=False)
    found = {name if name in NAMES else name.rpartition(".")[0] for name in names}
    return found & NAMES.keys() - {name_of(path)}


def circles(arrows: dict[str, set[str]]) -> list[str]:
    """Modules that can be reached from themselves."""
    found = []
    for start in arrows:
        reached, ahead = set(), list(arrows[start])
        while ahead:
            if (name := ahead.pop()) not in reached:
                reached.add(name)
                ahead += arrows.get(name, ())
        if start in reached:
            found.append(start)
    return found


def source_files(folder: str, endings: set[str]) -> list[Path]:
    files = sorted((PROJECT / folder).rglob("*"))
    return [f for f in files if f.suffix in endings and "__pycache__" not in f.parts]


def line_count(files: list[Path]) -> int:
    return sum(file.read_text(encoding="utf-8").count("\n") for file in files)


def is_statement(node: ast.AST) -> bool:
    """A docstring is none."""
    docstring = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    return isinstance(node, ast.stmt) and not docstring


def is_literal(node: ast.AST) -> bool:
    """A number that decides something."""
    return (
        isinstance(node, ast.Constant)
        and type(node.value) in (int, float)
        and node.value not in EVERYDAY_NUMBERS
    )


def is_private_function(node: ast.AST) -> TypeGuard[ast.FunctionDef | ast.AsyncFunctionDef]:
    return (
        isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and node.name.startswith("_")
        and not node.name.startswith("__")
    )


def prose_lines(text: str, nodes: Sequence[ast.AST]) -> int:
    """Lines of docstrings and comments."""
    documented = [node for node in nodes if isinstance(node, DOCUMENTED)]
    docstrings = [ast.get_docstring(node, clean=False) or "" for node in documented]
    comments = [line for line in text.splitlines() if line.lstrip().startswith("#")]
    return sum(len(docstring.splitlines()) for docstring in docstrings) + len(comments)


@pytest.fixture(scope="module")
def parsed() -> dict[str, tuple[str, list[ast.AST]]]:
    texts = {name: path.read_text(encoding="utf-8") for name, path in NAMES.items()}
    return {name: (text, list(ast.walk(ast.parse(text)))) for name, text in texts.items()}


@pytest.fixture(scope="module")
def sizes(parsed) -> dict[str, int]:
    nodes = [node for _, nodes in parsed.values() for node in nodes]
    return {
        "src lines": line_count(source_files("src", SOURCE_ENDINGS)),
        "src modules": len(MODULES),
        "src statements": sum(map(is_statement, nodes)),
        "src literals": sum(map(is_literal, nodes)),
        "lines of commands and settings": sum(
            line_count(source_files(f"src/riecjax/{room}", {".py"})) for room in ("cli", "settings")
        ),
        "tests lines": line_count(source_files("tests", {".py"})),
        "benchmarks lines": line_count(source_files("benchmarks", {".py"})),
        "README lines": line_count([PROJECT / "README.md"]),
    }


@pytest.mark.parametrize("what", BUDGETS)
def test_the_source_keeps_to_its_budget(sizes, what):
    assert sizes[what] <= BUDGETS[what]


def test_nothing_is_private_of_jax_and_nothing_is_pickled(parsed):
    texts = {name: text.replace("allow_pickle=False", "") for name, (text, _) in parsed.items()}
    found = re.compile(r"jax\._src|^\s*(import|from) \w*pickle|\w*pickle\.", re.MULTILINE)
    assert not [name for name, text in texts.items() if found.search(text)]


def test_docstrings_and_comments_have_their_share(parsed):
    code = sum(text.count("\n") for text, _ in parsed.values())
    prose = sum(prose_lines(*module) for module in parsed.values())
    assert round(100 * prose / code) >= LEAST_PROSE


def test_what_is_counted():
    text = '"""Said."""\n# Why.\nx = 3 * 1 + 0.25 if True else 0.5\n'
    nodes = list(ast.walk(ast.parse(text)))
    assert prose_lines(text, nodes) == 2
    assert sum(map(is_statement, nodes)) == 1
    assert sum(map(is_literal, nodes)) == 2


def test_a_private_function_has_few_parameters(parsed):
    counts: dict[str, int] = {}
    for name, (_, nodes) in parsed.items():
        for node in nodes:
            if is_private_function(node):
                where = f"{name}.{node.name}"
                count = len(node.args.args) + len(node.args.kwonlyargs)
                counts[where] = max(count, counts.get(where, 0))
    assert_few(counts, MOST_PARAMETERS, MANY_PARAMETERS)


def test_a_module_imports_few_others():
    counts = {name: len(imported(path)) for name, path in NAMES.items()}
    assert_few(counts, MOST_IMPORTS, MANY_IMPORTS)


def assert_few(counts: dict[str, int], most: int, exceptions: dict[str, int]) -> None:
    """None counts more than that but the exceptions, each of which still needs to be one."""
    many = {name: count for name, count in counts.items() if count > exceptions.get(name, most)}
    assert many == {}, "more than allowed"
    needless = [name for name in exceptions if counts.get(name, 0) <= most]
    assert needless == [], "exceptions that are none any more"


def modules_named(path: Path) -> set[str]:
    """Modules of the package that a file takes anything from, be it for types alone; a public name
    counts as where it is defined."""
    names = imported_names(path.read_text(encoding="utf-8"), path.relative_to(ROOT))
    defined = [PUBLIC.get(name, name) for name in names]
    found = {name if name in NAMES else name.rpartition(".")[0] for name in defined}
    return found & NAMES.keys() - {name_of(path)}


def test_no_module_names_itself_by_way_of_others():
    assert circles({name: modules_named(path) for name, path in NAMES.items()}) == []


IMPORTED_BY_NAME = {
    "riecjax.cli.main": "a command is imported when it is run",
    "riecjax.records.reading.channels": "a reader is imported when a file has its ending",
    "riecjax.records.reading.child_process": "a child process is told which reader it runs",
}
"""Extension points, and why they are some: no other module imports what only a text names."""


def test_nothing_but_an_extension_point_is_imported_by_name(parsed):
    found = {
        name
        for name, (_, nodes) in parsed.items()
        for node in nodes
        if isinstance(node, ast.Call)
        and ast.unparse(node.func).split(".")[-1] in ("import_module", "__import__")
    }
    assert found == IMPORTED_BY_NAME.keys()


def test_a_circle_is_noticed():
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == ["a", "b", "c"]
