"""Data and imports flow one way through the core's stages; the core knows nobody of the rim."""

import ast
import functools
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import riecjax

CORE = ("records", "simulation", "equations", "elements", "criteria", "summaries", "uncertainty",
        "estimation", "refinement", "validation", "models", "doubts", "discovery", "assessment",
        "reporting", "cli")  # fmt: skip
"""Stages in the order of the data; a module imports from its own or an earlier one."""
RIM = ("readers", "fleets", "paper", "studies")
"""A foreign distribution could stand in the place of each: they import public names alone."""
BASE = ("arrays", "charts", "errors", "extensions", "findings", "folds", "leaves", "linear_algebra",
        "public_names", "runtime", "settings", "shows", "standard_output", "tails",
        "whole_files")  # fmt: skip
"""What stands beside the stages: all may import it, and it imports none of them but for types."""
PLACE_OF_RIM = re.compile(rf"(riecjax)?\.({'|'.join(RIM)})\b")
ROOT = Path(riecjax.__file__).parent
MODULES = sorted(
    path.relative_to(ROOT) for kind in ("py", "pyi") for path in ROOT.rglob(f"*.{kind}")
)


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
PACKAGES = {name.rpartition(".")[0] for name in PUBLIC}
"""A type checker refuses what they have beside their public names."""


def test_no_public_name_is_that_of_a_module_beside_it():
    """To import the module would put it in the name's place."""
    beside = {".".join(("riecjax", *path.with_suffix("").parts)) for path in MODULES}
    assert not beside & PUBLIC.keys()


def read(module: Path) -> str:
    return (ROOT / module).read_text(encoding="utf-8")


@functools.lru_cache(maxsize=1)
def nodes_of(source: str) -> list[ast.AST]:
    return list(ast.walk(ast.parse(source)))


def imported_names(source: str, module: Path, *, for_types: bool = True) -> Iterator[str]:
    """Full names of everything that a module imports from this package."""
    package = ("riecjax", *module.parent.parts)
    guards = [node for node in nodes_of(source) if isinstance(node, ast.If)]
    guarded = {
        id(node)
        for guard in guards
        if ast.unparse(guard.test) == "TYPE_CHECKING"
        for node in ast.walk(guard)
    }
    for node in nodes_of(source):
        if id(node) in guarded and not for_types:
            continue
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            path = ".".join((*base, *filter(None, [node.module])))
            names = [f"{path}.{alias.name}" for alias in node.names]
        else:
            continue
        yield from (name for name in names if name.split(".")[0] == "riecjax")


def strings_naming_the_rim(source: str, module: Path) -> Iterator[str]:
    """Text from which a module of the rim could be imported; a docstring is none."""
    nodes = nodes_of(source)
    prose = {node.value for node in nodes if isinstance(node, ast.Expr)}
    for node in nodes:
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and node not in prose:
            # The readers' group of entry points has the name of their package.
            is_group = module == Path("extensions.py") and node.value == "riecjax.readers"
            if PLACE_OF_RIM.match(node.value) and not is_group:
                yield node.value


def violations(source: str, module: Path) -> list[str]:
    """What a module of the core or beside it takes from where it must not; a public name counts as
    where it is defined."""
    stage = module.parts[0]
    allowed = {*(CORE[: CORE.index(stage) + 1] if stage in CORE else ()), *BASE}
    # What settings are of is known to types alone.
    names = imported_names(source, module, for_types=stage != "settings")
    wrong = [name for name in names if place_of(name) not in allowed]
    wrong += [name for name in imported_names(source, module) if place_of(name) in RIM]
    return wrong + list(strings_naming_the_rim(source, module))


def place_of(name: str) -> str:
    return ".".join(PUBLIC.get(name, name).split(".")[1:2])


def private_imports(source: str, module: Path) -> list[str]:
    """What a module of the rim takes from elsewhere that is not public."""
    own, shared = f"riecjax.{module.parts[0]}.", tuple(f"riecjax.{name}." for name in BASE)
    return [
        name
        for name in imported_names(source, module)
        if not (name.startswith(own) or name in ("riecjax", *PUBLIC, *PACKAGES))
        and not (f"{name}.".startswith(shared) and "._" not in name)
    ]


def test_every_folder_is_a_stage_or_of_the_rim_and_every_module_beside_them_is_known():
    assert {m.parts[0] for m in MODULES if m.parent.parts} <= {*CORE, *RIM, "settings"}
    beside = {module.stem for module in MODULES if not module.parent.parts}
    assert beside - {"__init__", "__main__"} <= {*BASE}


@pytest.mark.parametrize("package", [*CORE, "settings", "beside them"])
def test_the_core_imports_from_its_own_or_an_earlier_stage_and_nothing_of_the_rim(package):
    modules = [m for m in MODULES if (m.parts[0] if m.parent.parts else "beside them") == package]
    modules = [m for m in modules if m.parent.parts or m.stem not in ("__init__", "__main__")]
    wrong = {str(module): violations(read(module), module) for module in modules}
    assert {module: names for module, names in wrong.items() if names} == {}


@pytest.mark.parametrize("package", RIM)
def test_the_rim_needs_nothing_private(package):
    modules = [module for module in MODULES if module.parts[0] == package]
    wrong = {str(module): private_imports(read(module), module) for module in modules}
    assert {module: names for module, names in wrong.items() if names} == {}


LATER_OR_RIM = [
    "import riecjax.estimation.identify",
    "import riecjax",
    "from ..estimation import identify",
    "from .. import estimation",
    "def f():\n    from riecjax.cli import main",
    "if TYPE_CHECKING:\n    from riecjax.fleets.fleet import Fleet",
    "from riecjax import fleet",
    "from riecjax import studies",
    "from ..paper import study",
    "importlib.import_module('riecjax.readers.hdf5')",
    "importlib.import_module(f'riecjax.fleets.{name}')",
    "importlib.import_module('.paper', 'riecjax')",
]


@pytest.mark.parametrize("source", LATER_OR_RIM)
def test_a_later_import_is_noticed_in_every_form_and_an_earlier_is_not(source):
    earlier = """from riecjax.records.record import Record
from riecjax import DOLS, Record
from . import windows
import jax.numpy
"""
    assert not violations(earlier, Path("criteria/windows.py"))
    assert violations(earlier + source, Path("criteria/windows.py"))


def test_a_module_beside_the_packages_imports_none_and_only_one_knows_the_group_of_readers():
    group = "from riecjax.errors import DataError\nentry_points(group='riecjax.readers')"
    assert not violations(group, Path("extensions.py"))
    assert violations(group, Path("shows.py"))
    stage = "from riecjax.records.record import Record"
    assert violations(stage, Path("shows.py"))
    for_types = f"if TYPE_CHECKING:\n    {stage}"
    assert violations(for_types, Path("shows.py"))
    assert not violations(for_types, Path("settings/answers.py"))
    assert violations(for_types.replace("records", "fleets"), Path("settings/answers.py"))


@pytest.mark.parametrize(
    "source",
    [
        "from riecjax.criteria.criterion import RIEC",
        "from ..estimation.stages import solve_stages",
        "from ..errors import _listed",
        "from riecjax.studies.monte_carlo import over_keys",
        "def f():\n    from riecjax.records.writing import write_whole",
    ],
)
def test_a_private_import_of_the_rim_is_noticed_and_a_public_is_not(source):
    public = """import riecjax
from riecjax import RIEC, Model, studies, tails
from riecjax.studies import over_keys
from riecjax.errors import DataError
from .claims import claims
"""
    assert not private_imports(public, Path("paper/study.py"))
    assert private_imports(public + source, Path("paper/study.py"))
