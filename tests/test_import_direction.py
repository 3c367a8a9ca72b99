"""Data flows one way through the stages, and so do imports; the paper's study uses public names."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import riecjax

STAGES = (
    "records",
    "readers",
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
    "discovery",
    "assessment",
    "fleets",
    "paper",
    "reporting",
    "cli",
)
SHARED = (
    "compilation",
    "errors",
    "extensions",
    "finding_codes",
    "findings",
    "leaves",
    "linear_algebra",
    "runtime",
    "shows",
    "standard_output",
    "tails",
    "whole_files",
    "memory",
    "public_names",
)
"""Modules beside the stages that all may import, and that import none of the stages."""
STUDY = ("paper", "models/quarter_car", "reporting/paper_charts")
"""A user's own study could stand in the place of these: they import what is public, as public."""
ROOT = Path(riecjax.__file__).parent
MODULES = sorted(path.relative_to(ROOT) for path in ROOT.glob("*/**/*.py"))


def exported(stub: Path) -> dict[str, str]:
    """Public names of a package, and the module that each comes from."""
    package = ".".join(("riecjax", *stub.parent.relative_to(ROOT).parts))
    found = {}
    for node in ast.parse(stub.read_text()).body:
        assert isinstance(node, ast.ImportFrom)
        assert node.level == 1
        source = ".".join(filter(None, [package, node.module]))
        found |= {f"{package}.{alias.name}": f"{source}.{alias.name}" for alias in node.names}
    return found


PUBLIC = {
    name: source
    for stub in sorted(ROOT.glob("**/__init__.pyi"))
    for name, source in exported(stub).items()
}


def read(module: Path) -> str:
    return (ROOT / module).read_text(encoding="utf-8")


def belongs_to_the_study(module: Path) -> bool:
    return module.as_posix().startswith(STUDY)


def imported_names(tree: ast.AST, package: tuple[str, ...]) -> Iterator[str]:
    """Full names of everything that is imported from this package."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            module = ".".join((*base, *filter(None, [node.module])))
            names = [f"{module}.{alias.name}" for alias in node.names]
        else:
            continue
        yield from (name for name in names if name.split(".")[0] == "riecjax")


def violations(source: str, module: Path) -> list[str]:
    stage = module.parts[0]
    allowed = {*STAGES[: STAGES.index(stage) + 1], *SHARED}
    wrong = []
    for name in imported_names(ast.parse(source), ("riecjax", *module.parent.parts)):
        # The study imports a public name from where users do; it counts as where it is defined.
        defined = PUBLIC.get(name, name) if belongs_to_the_study(module) else name
        if not {*defined.split(".")[1:2]} & allowed:
            wrong.append(name)
    return wrong


def private_imports(source: str, module: Path) -> list[str]:
    """What a module of the study takes from the engine that is not public."""
    own = tuple(f"riecjax.{folder.replace('/', '.')}." for folder in (*STUDY, module.parts[0]))
    if module.parts[0] == "models":
        own = ("riecjax.models.quarter_car.",)
    # Modules beside the stages are public, and so are the options that commands share.
    open_to_all = tuple(f"riecjax.{name}." for name in (*SHARED, "cli.options"))
    names = imported_names(ast.parse(source), ("riecjax", *module.parent.parts))
    return [name for name in names if name not in PUBLIC and not name.startswith(own + open_to_all)]


def test_every_folder_is_a_stage():
    assert {module.parts[0] for module in MODULES} <= set(STAGES)


def test_a_module_imports_only_from_its_own_or_an_earlier_stage():
    wrong = {str(module): violations(read(module), module) for module in MODULES}
    assert {module: names for module, names in wrong.items() if names} == {}


def test_modules_beside_the_stages_are_shared_and_import_none_of_these():
    assert {path.stem for path in ROOT.glob("*.py")} - {"__init__", "__main__"} == set(SHARED)
    for name in SHARED:
        source = (ROOT / f"{name}.py").read_text()
        names = imported_names(ast.parse(source), ("riecjax",))
        assert {name.split(".")[1] for name in names} <= set(SHARED)


@pytest.mark.parametrize(
    "source",
    [
        "import riecjax.estimation.identify",
        "import riecjax",
        "from ..estimation import identify",
        "from .. import estimation",
        "def f():\n    from riecjax.cli import main",
    ],
)
def test_a_later_import_is_noticed_in_every_form_and_an_earlier_is_not(source):
    earlier = "from riecjax.records.record import Record\nfrom . import windows\nimport jax.numpy\n"
    assert not violations(earlier, Path("criteria/windows.py"))
    assert violations(earlier + source, Path("criteria/windows.py"))


def test_readers_need_nothing_private_and_nobody_needs_them():
    for module in MODULES:
        if module.parts[0] == "readers":
            assert private_imports(read(module), module) == []
        else:
            tree = ast.parse(read(module))
            names = imported_names(tree, ("riecjax", *module.parent.parts))
            assert not [name for name in names if name.startswith("riecjax.readers")]


def test_the_papers_study_needs_nothing_private():
    study = filter(belongs_to_the_study, MODULES)
    wrong = {str(module): private_imports(read(module), module) for module in study}
    assert {module: names for module, names in wrong.items() if names} == {}


@pytest.mark.parametrize(
    "source",
    [
        "from riecjax.criteria.criterion import RIEC",
        "from ..estimation.stages import solve_stages",
        "def f():\n    from riecjax.records.writing import write_whole",
    ],
)
def test_a_private_import_of_the_study_is_noticed(source):
    assert private_imports(source, Path("paper/study.py"))


def test_public_names_count_as_where_they_are_defined():
    public = "from riecjax import RIEC, Model\nfrom riecjax.studies import over_keys"
    assert not private_imports(public, Path("paper/study.py"))
    assert not violations(public, Path("paper/study.py"))
    assert violations("from riecjax import RIEC", Path("studies/sweep.py")) == ["riecjax.RIEC"]
