"""Which elements there are: by what `--add KIND:SIGNAL` calls them, and which every model has."""

import importlib
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from riecjax.elements.dry_friction import DryFrictionAtRest
from riecjax.equations.element import Element
from riecjax.errors import ModelError
from riecjax.extensions import extension, extension_names

if TYPE_CHECKING:
    from riecjax.elements.hysteresis import Memory
    from riecjax.equations.equation import Equation
    from riecjax.equations.model import Model
    from riecjax.findings import Finding
    from riecjax.records.record import Record

KINDS = {
    "mode": "hidden_mode:HiddenMode",
    "spring": "series_spring:SeriesSpring",
    "backlash": "backlash:Backlash",
    "zero": "sensor_errors:SensorZero",
    "gain": "sensor_errors:SensorGain",
}
"""Module beside this one and class, by kind; those of other distributions are entry points."""
STATES = "hysteresis:Dahl", "hysteresis:BoucWen", "hysteresis:Elapsed"
"""States that recordings lack: a term has to read them, so that no kind adds them."""
STANDING = (DryFrictionAtRest(),)
"""What every model has."""


def element_class(kind: str) -> type[Element]:
    """The class of a kind.

    **Raises:** `ModelError` for an unknown one, and for an entry point that is no element;
    `ExtensionError` for one that cannot be loaded.
    """
    if kind in KINDS:
        return _own(KINDS[kind])
    found = extension("elements", kind)
    if found is None:
        listed = ", ".join((*KINDS, *extension_names("elements")))
        raise ModelError(f"there is no element '{kind}'; there are: {listed}.")
    return as_element_class(kind, found)


def _own(path: str) -> Any:
    module, _, name = path.partition(":")
    return getattr(importlib.import_module(f"riecjax.elements.{module}"), name)


def as_element_class(kind: str, found: object) -> type[Element]:
    """Raise `ModelError` for what is no class of elements."""
    if not (isinstance(found, type) and issubclass(found, Element)):
        raise ModelError(f"'{kind}' is no class derived from rx.Element.")
    return found


def states_of_motion() -> "list[type[Memory]]":
    """Classes of states that recordings lack."""
    return [_own(path) for path in STATES]


def lacked_kinds() -> list[type[Element]]:
    """Classes of elements that a model may lack, as far as sums alone find them."""
    return [one for one in map(_own, KINDS.values()) if one.coordinates]


def findings_of_elements(
    model: "Model",
    records: "Sequence[Record]",
    found: Any,
    otherwise: "Callable[[Model], Any]",
) -> "list[Finding]":
    """What a model's elements say of records; see
    [`Element.findings`][riecjax.Element.findings]."""
    return [
        finding
        for element in elements_of(model)
        for finding in element.findings(model, records, found, otherwise)
    ]


def trusted(model: "Model", record: "Record") -> "Model":
    """The model as it holds where all its elements let this record be trusted."""
    for element in elements_of(model):
        model = element.trusted(model, record)
    return model


def with_states(model: "Model", record: "Record") -> "Record":
    """The record with the signals that it lacks of a model's elements."""
    for element in elements_of(model):
        record = element.with_states(record)
    return record


def lacked(model: "Model", equation: "Equation") -> Element | None:
    """An element that an equation of a model may lack; `None` where no kind suggests one."""
    suggested = (kind.suggested(equation, model) for kind in lacked_kinds())
    return next((one for one in suggested if one is not None), None)


def discovered_kinds() -> list[type[Element]]:
    """Classes of elements that are tried beside terms that a model lacks."""
    return [kind for kind in lacked_kinds() if kind.is_discovered]


def doubted_kinds() -> list[type[Element]]:
    """Classes of elements that what a model leaves is weighed against."""
    return [kind for kind in lacked_kinds() if kind.is_doubted]


def elements_of(model: "Model") -> Sequence[Element]:
    """Those of a model, and those that every one has."""
    return (*model.elements, *STANDING)
