"""Which elements there are: by what `--add KIND:SIGNAL` calls them, and which every model has."""

import functools
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

STANDING = (DryFrictionAtRest(),)
"""What every model has."""


@functools.cache
def kinds() -> dict[str, type[Element]]:
    """Classes of this package that `--add` knows, by kind; imported once one is asked for."""
    from riecjax.elements.backlash import Backlash
    from riecjax.elements.hidden_mode import HiddenMode
    from riecjax.elements.sensor_errors import SensorGain, SensorZero
    from riecjax.elements.series_spring import SeriesSpring

    return {one.kind: one for one in (HiddenMode, SeriesSpring, Backlash, SensorZero, SensorGain)}


def states_of_motion() -> "list[type[Memory]]":
    """Classes of states that recordings lack; a term has to read them, so that `--add` has none."""
    from riecjax.elements.hysteresis import BoucWen, Dahl, Elapsed

    return [Dahl, BoucWen, Elapsed]


def element_class(kind: str) -> type[Element]:
    """The class of a kind, of this package or of an entry point in `riecjax.elements`.

    **Raises:** `ModelError` for an unknown one, and for an entry point that is no element;
    `ExtensionError` for one that cannot be loaded.
    """
    if kind in kinds():
        return kinds()[kind]
    found = extension("elements", kind)
    if found is None:
        listed = ", ".join((*kinds(), *extension_names("elements")))
        raise ModelError(f"there is no element '{kind}'; there are: {listed}.")
    return as_element_class(kind, found)


def as_element_class(kind: str, found: object) -> type[Element]:
    """Raise `ModelError` for what is no class of elements."""
    if not (isinstance(found, type) and issubclass(found, Element)):
        raise ModelError(f"'{kind}' is no class derived from rx.Element.")
    return found


def doubted_kinds() -> list[type[Element]]:
    """Classes of elements that what a model leaves is weighed against."""
    return [kind for kind in kinds().values() if kind.is_doubted]


def discovered_kinds() -> list[type[Element]]:
    """Classes of elements that are tried beside terms that a model lacks."""
    return [kind for kind in kinds().values() if kind.is_discovered]


def lacked(model: "Model", equation: "Equation") -> Element | None:
    """An element that an equation of a model may lack; `None` where no kind suggests one."""
    every = model.equations, model.elements
    suggested = (kind.suggested(equation, *every) for kind in kinds().values())
    return next((one for one in suggested if one is not None), None)


# What the elements of a model make of records, one after the other.


def elements_of(model: "Model") -> Sequence[Element]:
    """Those of a model, and those that every one has."""
    return (*model.elements, *STANDING)


def with_states(model: "Model", record: "Record") -> "Record":
    """The record with the signals that it lacks of a model's elements."""
    for element in elements_of(model):
        record = element.with_states(record)
    return record


def trusted(model: "Model", record: "Record", linear: "Model | None" = None) -> "Model":
    """The model, or the linear one of it, as it holds where its elements let a record be
    trusted."""
    made = model if linear is None else linear
    for element in elements_of(model):
        made = element.trusted(made, record)
    return made


def findings_of_elements(
    model: "Model",
    records: "Sequence[Record]",
    found: Any,
    otherwise: "Callable[[Model], Any]",
) -> "list[Finding]":
    """What a model's elements say of records; see `Element.findings`."""
    return [
        finding
        for element in elements_of(model)
        for finding in element.findings(model, records, found, otherwise)
    ]
