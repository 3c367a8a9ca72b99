"""Outside `elements` nothing of the package imports or names an element."""

import ast
from pathlib import Path

import riecjax
from riecjax.elements.catalogue import STANDING, kinds, states_of_motion

ROOT = Path(riecjax.__file__).parent
CLASSES = {one.__name__ for one in (*kinds().values(), *states_of_motion(), *map(type, STANDING))}
ENGINES = {"catalogue", "evidence"}
"""Modules of `elements` that are of no element."""
MODULES = {path.stem for path in (ROOT / "elements").glob("[a-z]*.py")} - ENGINES
EXCEPTIONS = {
    "__init__.pyi": "the list of public names",
    "paper/": "the paper's own system",
}


def named_in(source: str) -> set[str]:
    """Identifiers and modules of elements that a source names."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom):
            words = {*(node.module or "").split("."), *(alias.name for alias in node.names)}
            found |= words & CLASSES
            found |= words & MODULES if "elements" in words else set()
        elif isinstance(node, ast.Name | ast.Attribute):
            found |= {getattr(node, "id", ""), getattr(node, "attr", "")} & CLASSES
    return found


def test_no_other_room_names_an_element():
    named = {}
    for path in (*ROOT.rglob("*.py"), *ROOT.rglob("*.pyi")):
        place = path.relative_to(ROOT).as_posix()
        if not place.startswith(("elements/", *EXCEPTIONS)):
            named[place] = named_in(path.read_text(encoding="utf-8"))
    assert {place: names for place, names in named.items() if names} == {}


def test_a_name_and_an_import_are_noticed():
    assert len(CLASSES) == 9
    assert named_in("if isinstance(element, rx.HiddenMode): ...") == {"HiddenMode"}
    assert named_in("from riecjax.elements.series_spring import TOLD_LAG") == {"series_spring"}
    assert named_in("from riecjax.elements.catalogue import lacked") == set()
