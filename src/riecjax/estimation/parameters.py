"""Which parameters are unknown, in which record and in which stage: `known` and `per_record`.

A parameter named in `per_record` has another value in each record, such as a sensor's offset; to
least squares these are different parameters, `offset[1]`, `offset[2]`, ... So normal equations of a
record are renamed and embedded among the parameters of all records, with zeros for what the record
does not hold, and then add up like any others.
"""

from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from riecjax.equations.model import Model
from riecjax.errors import ModelError, require
from riecjax.leaves import is_concrete, is_number
from riecjax.summaries.task import require_key

Value = TypeVar("Value")


# Equal by content, so that a jitted function which takes one is not compiled anew.
@dataclass(init=False, unsafe_hash=True)
class Sharing:
    """Names of parameters over several records: `offset` becomes `offset[1]`, `offset[2]`, ...

    **Arguments:** `parameters` of the model; `own`, those with a value of their own in each of
    `record_count` records, such as a sensor's offset; all others are shared.

    **Raises:** `ModelError` for a name in `own` that the model does not have, and for a parameter
    that is already called as a recording's own one would be.
    """

    parameters: tuple[str, ...]
    own: frozenset[str]
    record_count: int

    def __init__(self, parameters: tuple[str, ...], own: Iterable[str], record_count: int):
        self.own, self.record_count = frozenset(own), record_count
        if unknown := sorted(self.own - set(parameters)):
            raise ModelError(
                f"unknown parameter '{unknown[0]}'; the model has: {', '.join(parameters)}."
            )
        for name in parameters:
            base, number = _numbered(name)
            if number and base in self.own:
                raise ModelError(
                    f"the model has a parameter called '{name}', and with per_record=['{base}'] "
                    f"that is what {base} is called in recording {number}. Rename one of the two, "
                    f"or leave {base} out of per_record."
                )
        self.parameters = self.everywhere(parameters)

    @property
    def individual(self) -> frozenset[str]:
        """Names over all records of what each has a value of its own of."""
        return frozenset(self.everywhere(sorted(self.own)))

    def of_record(self, names: Iterable[str], index: int) -> tuple[str, ...]:
        """The names as the record number `index` (from 0) knows them."""
        return tuple(f"{name}[{index + 1}]" if name in self.own else name for name in names)

    def everywhere(self, names: Iterable[str]) -> tuple[str, ...]:
        """The names over all records."""
        numbers = [f"[{i + 1}]" for i in range(self.record_count)]
        return tuple(
            name + ending for name in names for ending in (numbers if name in self.own else [""])
        )

    def values(self, given: Mapping[str, Value]) -> dict[str, Value]:
        """Values by name over all records.

        One for `offset` holds in every record but for those that have one by their own name.
        """
        return {
            expanded: value
            for name, value in given.items()
            for expanded in self.everywhere([name])
            if expanded == name or expanded not in given
        }

    def values_of(
        self, names: Iterable[str], values: Mapping[str, Value], index: int
    ) -> dict[str, Value]:
        """Of values by name over all records, those of `names` as one record knows them."""
        return {name: values[self.of_record((name,), index)[0]] for name in names}

    def free_somewhere(self, names: Iterable[str], free: Iterable[str]) -> tuple[str, ...]:
        """Of the model's own `names`, those whose value in some record is among `free`."""
        among = set(free)
        return tuple(name for name in names if among.intersection(self.everywhere((name,))))

    def settled(self, names: Iterable[str]) -> set[str]:
        """Of the model's own names, those whose every record's value is among `names`."""
        known = set(names)
        among = known | {local_name(name, self.own) for name in known}
        return {name for name in among if set(self.everywhere([name])) <= known}


class ParameterPlan(NamedTuple):
    """What is to be estimated.

    **Fields:** `sharing` of parameters over records; `given` values by name over all records;
    `stages`, the name of each and the parameters that it finds, over all records.
    """

    sharing: Sharing
    given: dict[str, Array]
    stages: list[tuple[str, tuple[str, ...]]]


def plan_parameters(
    model: Model,
    record_count: int,
    known: Mapping[str, float | Array] | None,
    per_record: Sequence[str],
) -> ParameterPlan:
    """The plan, with known values and names checked; see [`identify`][] for the arguments.

    **Raises:** `ModelError` as [`identify`][].
    """
    require_settings(None, known, per_record)
    sharing = Sharing(model.parameter_names, per_record, record_count)
    # Values held fixed, by name over all records: the equations' own and the user's.
    names = {*model.parameter_names, *sharing.parameters}
    if unknown := [name for name in known or {} if name not in names]:
        listed = ", ".join(sharing.parameters)
        raise ModelError(f"unknown parameter '{unknown[0]}'; the model has: {listed}.")
    require_numbers(known or {})
    held = {**sharing.values(model.known), **sharing.values(known or {})}
    given = {name: jnp.asarray(value, jnp.result_type(float)) for name, value in held.items()}
    # A stage finds what no record has been given, and no earlier stage has found.
    stages = [
        (label, tuple(name for name in sharing.everywhere(names) if name not in given))
        for label, names in model.plan(sharing.settled(given))
    ]
    if not any(unknown for _, unknown in stages):
        raise ModelError("every parameter is known; nothing is left to identify.")
    return ParameterPlan(sharing, given, stages)


def require_settings(key: object, known: object, per_record: object) -> None:
    """Raise `ModelError` unless these are a key, values by name and names, or left out."""
    require_key(key)
    write = "known={'m': 2.0}: values by name"
    require("known", {} if known is None else known, Mapping, write)
    name = per_record if isinstance(per_record, str) else "offset"
    kinds = (list, tuple, set, frozenset)
    write = f"per_record=('{name}',): a tuple of names"
    require("per_record", per_record, kinds, write)
    for name in per_record if isinstance(per_record, kinds) else ():
        require("a name in per_record", name, str, write)


def require_numbers(known: Mapping[str, Any]) -> None:
    """Raise `ModelError` for a known value that is no single number, or not finite if it shows."""
    for name, value in known.items():
        if not is_number(value):
            raise ModelError(
                f"{name} is held at {value!r}: known values are single numbers, {name}=2.0."
            )
        if is_concrete(value) and not np.isfinite(float(value)):
            raise ModelError(f"{name} is held at {value}: give a finite number.")


def values_of_record(values: Mapping[str, Value], index: int) -> dict[str, Value]:
    """Values as the record number `index` (from 0) knows them: its own `offset[2]` as `offset`.

    Those of other records keep their names, and so does `offset[2]` of a model that has an `offset`
    beside it.
    """
    ending = f"[{index + 1}]"
    own = {name.removesuffix(ending): v for name, v in values.items() if name.endswith(ending)}
    return {**own, **values}


def local_name(name: str, own: Container[str]) -> str:
    """A name over all records as the model knows it: `offset` of `offset[2]`, if that is `own`."""
    base, _ = _numbered(name)
    return base if base in own else name


def _numbered(name: str) -> tuple[str, str]:
    """The parts of `offset[2]`, `offset` and `2`; of any other name, itself and nothing."""
    base, bracket, number = name.removesuffix("]").rpartition("[")
    return (base, number) if bracket and name.endswith("]") and number.isdigit() else (name, "")
