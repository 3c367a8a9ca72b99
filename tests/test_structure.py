"""A reader finds an idea in one file, a function on one screen, and no way in a circle."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import riecjax

ROOT = Path(riecjax.__file__).parent
MODULES = sorted(ROOT.rglob("*.py"))
LONGEST_MODULE = 400
LONGEST_FUNCTION = 70


def name_of(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(("riecjax", *parts)).removesuffix(".__init__")


NAMES = {name_of(path): path for path in MODULES}


def imported(path: Path) -> set[str]:
    """Modules of the package that a file imports anywhere in it, not for types alone."""
    found = set()
    for node in run_time(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            below = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= below & NAMES.keys() or {node.module} & NAMES.keys()
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names} & NAMES.keys()
    return found - {name_of(path)}


def run_time(tree: ast.AST) -> Iterator[ast.AST]:
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            continue
        yield node
        yield from run_time(node)


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


@pytest.mark.parametrize("path", MODULES, ids=lambda path: name_of(path))
def test_a_module_is_one_sitting_and_a_function_one_screen(path):
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= LONGEST_MODULE
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            assert node.end_lineno is not None
            assert node.end_lineno - node.lineno < LONGEST_FUNCTION, node.name


def test_no_module_imports_itself_by_way_of_others():
    assert circles({name: imported(path) for name, path in NAMES.items()}) == []


def test_a_circle_is_noticed():
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == ["a", "b", "c"]
