"""A criterion as plain data, for files, and back.

Each part is its class's name and its fields, parts within parts. A file names classes and never
imports them: what is read is looked for among the subclasses that the running program has defined,
so that a new test function needs nothing here, and a file can run no code.
"""

import dataclasses
from collections.abc import Iterator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from riecjax.criteria.criterion import AbstractCriterion
from riecjax.criteria.laws import AbstractLaw
from riecjax.criteria.test_functions import AbstractTestFunction
from riecjax.criteria.windows import AbstractWindows
from riecjax.errors import DataError, ModelError

FAMILIES = (AbstractCriterion, AbstractWindows, AbstractLaw, AbstractTestFunction)
"""What a criterion is made of."""
RESERVED = ("class", "from")
"""Keys beside the fields' names: keywords of Python, and so no names of fields."""


def to_plain_data(part: eqx.Module) -> dict[str, Any]:
    """A part of a criterion as nested dictionaries of what JSON has words for.

    `{"class": name, "from": module, field: value, ...}`, where an array is `{dtype: list}`.

    **Raises:** `ModelError` for what is code rather than numbers.
    """
    kind = type(part)
    fields = {
        field.name: _plain(getattr(part, field.name), f"the {field.name} of {kind.__name__}")
        for field in dataclasses.fields(part)
    }
    return {"class": kind.__name__, "from": kind.__module__} | fields


def _plain(value: Any, name: str) -> Any:
    if isinstance(value, FAMILIES):
        return to_plain_data(value)
    if isinstance(value, tuple | list):
        return [_plain(each, name) for each in value]
    if isinstance(value, np.ndarray | jax.Array) and value.dtype.kind in "fiub":
        return {str(value.dtype): np.asarray(value).tolist()}
    plain = value.item() if isinstance(value, np.generic) else value
    if plain is None or isinstance(plain, bool | int | float | str):
        return plain
    raise ModelError(f"{name} is code, which no file can hold: give numbers in its place.")


def criterion_from_plain_data(document: dict[str, Any]) -> AbstractCriterion:
    """The criterion that [`to_plain_data`][riecjax.criteria.plain_data.to_plain_data] described.

    **Raises:** `DataError` for a class that is not defined here, or one with other fields.
    """
    found = _read(document)
    if not isinstance(found, AbstractCriterion):
        raise DataError("what it calls a criterion is none.")
    return found


def _read(value: Any) -> Any:
    if isinstance(value, list):
        return tuple(_read(each) for each in value)
    if not isinstance(value, dict):
        return value
    if "class" in value:
        name, module = value["class"], value["from"]
        fields = {name: _read(each) for name, each in value.items() if name not in RESERVED}
        # The class of this name, as it was defined last; of several modules', that of `module`.
        found = {kind.__module__: kind for kind in _subclasses(*FAMILIES) if kind.__name__ == name}
        if module not in found and len(found) != 1:
            raise DataError(
                f"it was made with {name} of '{module}', a class that is not defined here: import "
                f"the module that defines it first."
            )
        try:
            return (found.get(module) or next(iter(found.values())))(**fields)
        except (TypeError, ModelError):
            raise DataError(
                f"its {name} has other settings than the one of this name here."
            ) from None
    ((dtype, values),) = value.items()
    array = np.array(values, dtype)
    # Constructors take any NumPy array to 64-bit; JAX's pass unchanged.
    return array if array.dtype == np.float64 else jnp.asarray(array)


def _subclasses(*kinds: type) -> Iterator[type]:
    for kind in kinds:
        below = kind.__subclasses__()
        yield from below
        yield from _subclasses(*below)
