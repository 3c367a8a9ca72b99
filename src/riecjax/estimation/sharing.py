"""Which parameters several records share, and which take a value of their own in each."""

from collections.abc import Container, Iterable, Mapping
from typing import TypeVar

import jax.numpy as jnp
from jaxtyping import Array, Key

from riecjax.criteria.criterion import AbstractCriterion
from riecjax.equations.procedure import Procedure
from riecjax.errors import ModelError
from riecjax.records.record import Record
from riecjax.summaries.normal_equations import (
    NormalEquations,
    stack_normal_equations,
)
from riecjax.summaries.stage_sums import stage_normal_equations, sum_of_equations

Value = TypeVar("Value")


class Sharing:
    """Names of parameters over several records: `offset` becomes `offset[1]`, `offset[2]`, ...

    **Arguments:** `parameters` of the model; `own`, those with a value of their own in each of
    `record_count` records, such as a sensor's offset; all others are shared.

    **Raises:** `ModelError` for a name in `own` that the model does not have, and for a parameter
    that is already called as a recording's own one would be.
    """

    def __init__(self, parameters: tuple[str, ...], own: Iterable[str], record_count: int):
        self.own = frozenset(own)
        self.record_count = record_count
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
        self.individual = frozenset(self.everywhere(sorted(self.own)))

    # Equal by content, so that a jitted function which takes one is not compiled anew.
    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sharing) and self._content() == other._content()

    def __hash__(self) -> int:
        return hash(self._content())

    def _content(self) -> tuple[object, ...]:
        return (self.parameters, self.own, self.record_count)

    def of_record(self, names: Iterable[str], index: int) -> tuple[str, ...]:
        """The names as the record number `index` (from 0) knows them."""
        return tuple(f"{name}[{index + 1}]" if name in self.own else name for name in names)

    def everywhere(self, names: Iterable[str]) -> tuple[str, ...]:
        """The names over all records."""
        expanded = []
        for name in names:
            if name in self.own:
                expanded += [f"{name}[{i + 1}]" for i in range(self.record_count)]
            else:
                expanded.append(name)
        return tuple(expanded)

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


def all_normal_equations(
    procedure: Procedure,
    sharing: Sharing,
    records: list[Record],
    criterion: AbstractCriterion,
    keys: list[Key[Array, ""] | None],
) -> list[NormalEquations]:
    """Normal equations of each stage over all records, leading axes `(records, short blocks)`."""
    of_stages = []
    for i, (record, key) in enumerate(zip(records, keys)):
        stages = stage_normal_equations(procedure, record, criterion, key, blocks=True)
        of_stages.append([over_records(stage, sharing, i) for stage in stages])
    return [stack_normal_equations(parts) for parts in zip(*of_stages)]


def over_records(equations: NormalEquations, sharing: Sharing, index: int) -> NormalEquations:
    """Normal equations of one record, from 0, among the parameters of all records."""
    if not sharing.own:
        return equations
    names = equations.parameters
    return equations.rename(sharing.of_record(names, index)).embed(sharing.everywhere(names))


def stages_over_records(
    equations: list[list[NormalEquations]], sharing: Sharing
) -> tuple[list[NormalEquations], list[list[NormalEquations]]]:
    """Normal equations of stages, and of each equation, among the parameters of all records.

    **Arguments:** `equations` of each stage, with a leading axis of records.
    """
    apart = [[_over_all_records(e, sharing) for e in stage] for stage in equations]
    names = [tuple(dict.fromkeys(name for e in stage for name in e.parameters)) for stage in apart]
    return [sum_of_equations(stage, own) for stage, own in zip(apart, names)], apart


def _over_all_records(equations: NormalEquations, sharing: Sharing) -> NormalEquations:
    """The same of normal equations with a leading axis of records."""
    if not sharing.own:
        return equations
    every = [
        NormalEquations(equations.moments[i], equations.count[i], equations.parameters)
        for i in range(sharing.record_count)
    ]
    shared = [over_records(e, sharing, i) for i, e in enumerate(every)]
    return NormalEquations(
        jnp.stack([e.moments for e in shared]),
        jnp.stack([e.count for e in shared]),
        shared[0].parameters,
    )
