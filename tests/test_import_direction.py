"""Data flows one way through the stages, and so do imports."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import riecjax

STAGES = (
    "records",
    "equations",
    "criteria",
    "summaries",
    "uncertainty",
    "estimation",
    "simulation",
    "refinement",
    "validation",
    "studies",
    "models",
    "assessment",
    "paper",
    "reporting",
    "cli",
)
OUTSIDE = ("models", "assessment", "paper", "reporting", "cli")
"""What the engine never imports."""
SHARED = ("errors", "findings", "leaves", "linear_algebra", "runtime", "tails")
"""Modules beside the stages that all may import, and that import nothing of the package."""
ROOT = Path(riecjax.__file__).parent
MODULES = sorted(path.relative_to(ROOT) for path in ROOT.glob("*/**/*.py"))


def imported_stages(tree: ast.AST, package: tuple[str, ...]) -> Iterator[str]:
    """The part after `riecjax.` of everything imported; `riecjax` itself where nothing follows."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            module = ".".join((*base, *filter(None, [node.module])))
            names = [f"{module}.{alias.name}" for alias in node.names]
        else:
            continue
        for name in names:
            parts = name.split(".")
            if parts[0] == "riecjax":
                yield parts[1] if len(parts) > 1 else "riecjax"


def violations(source: str, module: Path) -> list[str]:
    stage = module.parts[0]
    allowed = {*STAGES[: STAGES.index(stage) + 1], *SHARED}
    package = ("riecjax", *module.parent.parts)
    return [name for name in imported_stages(ast.parse(source), package) if name not in allowed]


def test_every_folder_is_a_stage():
    assert {module.parts[0] for module in MODULES} <= set(STAGES)


@pytest.mark.parametrize("module", MODULES, ids=str)
def test_a_module_imports_only_from_its_own_or_an_earlier_stage(module):
    assert violations((ROOT / module).read_text(), module) == []


def test_modules_beside_the_stages_are_shared_and_import_nothing_of_the_package():
    assert {path.stem for path in ROOT.glob("*.py")} - {"__init__", "__main__"} == set(SHARED)
    for name in SHARED:
        source = (ROOT / f"{name}.py").read_text()
        assert list(imported_stages(ast.parse(source), ("riecjax",))) == []


def test_what_lies_outside_comes_after_the_whole_engine():
    assert STAGES[-len(OUTSIDE) :] == OUTSIDE


@pytest.mark.parametrize(
    "source",
    [
        "from riecjax.models.model import Model",
        "import riecjax.estimation.identify",
        "from riecjax import estimation",
        "import riecjax",
        "from ..estimation import identify",
        "from .. import estimation",
        "def f():\n    from riecjax.cli import main",
    ],
)
def test_a_later_import_is_noticed_in_every_form(source):
    assert violations(source, Path("criteria/windows.py"))


@pytest.mark.parametrize(
    "source",
    ["from riecjax.records.record import Record", "from . import windows", "import jax.numpy"],
)
def test_an_earlier_import_is_not(source):
    assert not violations(source, Path("criteria/windows.py"))
