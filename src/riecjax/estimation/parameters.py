"""The table of parameters: what each one is, over all recordings, and what is known beforehand.

A parameter named in `per_record` has another value in each recording, such as a sensor's offset; to
least squares these are different parameters, and each is a row of its own, called `offset[1]`,
`offset[2]`, ... So normal equations of a recording are renamed and embedded among the parameters of
all recordings, with zeros for what the recording does not hold, and then add up like any others.

Names are for readers: they are written here, and what a parameter is stands in its row.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple, TypeVar, cast

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from riecjax.arrays import is_concrete
from riecjax.equations.element import Absence, Part
from riecjax.equations.model import Model
from riecjax.equations.quantity import Quantity
from riecjax.errors import ModelError, refuse_unknown, require
from riecjax.findings import Finding
from riecjax.leaves import Leaf, PlainMethods, is_number
from riecjax.summaries.summarise import require_key

Value = TypeVar("Value")
_NO_MASS = "no mass is"
_NO_DAMPING = "damping that feeds energy into the motion"
NEVER_NEGATIVE = {
    **dict.fromkeys(("kg", "kgm2", "kgm2/rad", "Nms2/rad"), _NO_MASS),
    **dict.fromkeys(("Ns/m", "Nms/rad", "Nms"), _NO_DAMPING),
}
"""What it means that a parameter in this unit (without its blanks and signs) is below zero."""


def name_in_recording(name: str, index: int) -> str:
    """What a parameter is called that has a value of its own in recording number `index`."""
    return f"{name}[{index + 1}]"


class Parameter(NamedTuple):
    """One parameter over all recordings.

    **Fields:** `name` that is shown; `local`, what the model calls it; `unit`; `recording`, the
    number (from 0) of the only one that it is of, `None` where all share it; `element`
    that it is hidden in, `None` of the equations' own; `meaning`, as of the
    model's quantities.
    """

    name: str
    local: str
    unit: str = ""
    recording: int | None = None
    element: Part | None = None
    meaning: str = ""

    @property
    def sign(self) -> str:
        """What it means that it is below zero; empty where it may be."""
        plain = "".join(c for c in self.unit if c not in " ·*^()").replace("²", "2")
        return NEVER_NEGATIVE.get(plain, "")


class ParameterTable(PlainMethods, eqx.Module):
    """The parameters of a model over several recordings.

    Bounds and priors of its free parameters are arrays that may be traced, in their order: they
    stand in [`Constraints`][riecjax.estimation.constraints.Constraints], made of this table.

    **Fields:** `rows`, one for each; `known` values of those that are held, by name; `stages`, the
    name of each and the parameters that it finds.
    """

    rows: tuple[Parameter, ...] = eqx.field(static=True)
    known: dict[str, Any] = eqx.field(default_factory=dict)
    stages: tuple[tuple[str, tuple[str, ...]], ...] = eqx.field(static=True, default=())

    @classmethod
    def of(
        cls,
        quantities: Sequence[Quantity],
        per_record: Collection[str],
        record_count: int,
        parts: Mapping[str, Part] = MappingProxyType({}),
    ) -> "ParameterTable":
        """The table of a model's own parameters, nothing of which is known.

        **Arguments:** `parts`, of which element a hidden parameter is one.

        **Raises:** `ModelError` for a name in `per_record` that the model does not have, and for a
        parameter that is already called as a recording's own one would be.
        """
        rows: list[Parameter] = []
        local = {quantity.name for quantity in quantities}
        for name, unit, meaning, _ in quantities:
            row = Parameter(name, name, unit, None, parts.get(name), meaning)
            if name not in per_record:
                rows.append(row)
                continue
            for i in range(record_count):
                if (shown := name_in_recording(name, i)) in local:
                    raise ModelError(
                        f"the model has a parameter called '{shown}', and with per_record="
                        f"['{name}'] that is what {name} is called in recording {i + 1}. Rename "
                        f"one of the two, or leave {name} out of per_record."
                    )
                rows.append(row._replace(name=shown, recording=i))
        table = cls(tuple(rows))
        table.require(sorted(per_record))
        return table

    def __getitem__(self, name: str) -> Parameter:
        return {row.name: row for row in self.rows}[name]

    @property
    def names(self) -> tuple[str, ...]:
        """Of all parameters."""
        return tuple(row.name for row in self.rows)

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the parameters that no value is known of."""
        return tuple(row.name for row in self.rows if row.name not in self.known)

    @property
    def free_somewhere(self) -> tuple[str, ...]:
        """What the model calls those that are free in some recording."""
        return tuple(dict.fromkeys(row.local for row in self.rows if row.name not in self.known))

    @property
    def units(self) -> tuple[tuple[str, str], ...]:
        """Pairs of name and unit."""
        return tuple((row.name, row.unit) for row in self.rows)

    @property
    def per_record(self) -> frozenset[str]:
        """What the model calls the parameters of which each recording has its own."""
        return frozenset(row.local for row in self.rows if row.recording is not None)

    def require(self, names: Iterable[str]) -> None:
        """Raise `ModelError` for a name, over all recordings or the model's own, that is none."""
        every = {*self.names}
        unknown = [name for name in names if not {*self.everywhere([name])} <= every]
        refuse_unknown(unknown, self.names)

    def settled(self, values: Mapping[str, Any]) -> "ParameterTable":
        """The table with these values known as well, which no stage finds."""
        stages = tuple(
            (label, tuple(name for name in names if name not in values))
            for label, names in self.stages
        )
        return ParameterTable(self.rows, {**self.known, **values}, stages)

    def concerned(self, names: Iterable[str]) -> set[str]:
        """Names of the free parameters that are among some, by name or by what the model calls
        them: `offset[1]` is offset's, and named by it."""
        some, free = {*names}, self.free
        return {r.name for r in self.rows if r.name in free and some & {r.name, r.local}}

    def of_recording(self, index: int) -> list[Parameter]:
        """Those of one recording, its own and those that all share."""
        return [row for row in self.rows if row.recording in (None, index)]

    def of_record(self, names: Iterable[str], index: int) -> tuple[str, ...]:
        """Names over all recordings of what recording number `index` calls so."""
        called = {row.local: row.name for row in self.of_recording(index)}
        return tuple(called[name] for name in names)

    def everywhere(self, names: Iterable[str]) -> tuple[str, ...]:
        """Names over all recordings of what the model calls so; others stay as they are."""
        called: dict[str, list[str]] = {}
        for row in self.rows:
            called.setdefault(row.local, []).append(row.name)
        return tuple(shown for name in names for shown in called.get(name, [name]))

    def values(self, given: Mapping[str, Value]) -> dict[str, Value]:
        """Values by name over all recordings.

        One for `offset` holds in every recording but for those that have one by their own name.
        """
        return {
            shown: value
            for name, value in given.items()
            for shown in self.everywhere([name])
            if shown == name or shown not in given
        }

    def values_of(self, values: Mapping[str, Value], index: int) -> dict[str, Value]:
        """Of values by name over all recordings, those of one as it calls them."""
        return {row.local: values[row.name] for row in self.of_recording(index)}

    def values_at(self, theta: Sequence[Any] | Leaf, index: int) -> dict[str, Any]:
        """Every parameter's value with these of the free ones, as one recording calls it."""
        return self.values_of({**self.known, **dict(zip(self.free, theta))}, index)


def values_in_recording(
    names: Iterable[str], values: Mapping[str, Value], index: int
) -> dict[str, Value]:
    """Of values by name over all recordings, those of a model's `names` as one recording knows
    them, as far as there are any."""
    shown = {name: name if name in values else name_in_recording(name, index) for name in names}
    return {name: values[other] for name, other in shown.items() if other in values}


TABLE_KINDS = ParameterTable, Parameter, Part, Absence
"""What a table is made of, beside names and numbers."""


def plan_parameters(
    model: Model,
    record_count: int,
    known: Mapping[str, float | Array] | None,
    per_record: Collection[str],
) -> ParameterTable:
    """The table of what is to be estimated, with known values and names checked; see
    [`identify`][] for the arguments.

    **Raises:** `ModelError` as [`identify`][].
    """
    require_settings(None, known, per_record)
    coefficients = {name for equation in model.equations for name in equation.parameters}
    for element in model.hidden:
        if taken := sorted(coefficients & {*element.hidden}):
            raise ModelError(
                f"the equations have a parameter called '{taken[0]}', and so has "
                f"{element.words}. Rename the equations' own."
            )
    units, meanings = model.units, {q.name: q.meaning for q in model.parameters}
    quantities = [Quantity(name, units[name], meanings[name]) for name in model.parameter_names]
    parts = {name: element.part for element in model.hidden for name in element.hidden}
    table = ParameterTable.of(quantities, per_record, record_count, parts)
    table.require(known or {})
    require_numbers(known or {})
    # Values held fixed: the equations' own and the user's.
    held = {**table.values(model.known), **table.values(known or {})}
    numbers = {
        name: np.asarray(value, float) if is_concrete(value) else value
        for name, value in held.items()
    }
    settled = {row.local for row in table.rows} - {*table.settled(held).free_somewhere}
    # A stage finds what no recording has been given, and no earlier stage has found.
    stages = tuple(
        (label, tuple(name for name in table.everywhere(names) if name not in held))
        for label, names in model.plan(settled)
    )
    if not any(unknown for _, unknown in stages):
        raise ModelError("every parameter is known; nothing is left to identify.")
    return ParameterTable(table.rows, numbers, stages)


def require_settings(key: object, known: object, per_record: object) -> None:
    """Raise `ModelError` unless these are a key, values by name and names, or left out."""
    require_key(key)
    write = "known={'m': 2.0}: values by name"
    require("known", {} if known is None else known, Mapping, write)
    name = per_record if isinstance(per_record, str) else "offset"
    kinds = (list, tuple, set, frozenset)
    write = f"per_record=('{name}',): a tuple of names"
    require("per_record", per_record, kinds, write)
    for name in cast("Collection[str]", per_record):
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


# What to do where recordings do not tell of some parameters, or not of one by itself.


def excite_or_hold(rows: Sequence[Parameter], hold: str = "") -> str:
    """A sentence on parameters that cannot be told apart.

    Parts of a hidden element are known together or not at all, and where nothing tells of them the
    likeliest reason is that there is none: it is left out rather than held.

    **Arguments:** `hold`, the one that is named to hold; by default none is.
    """
    elements = (row.element for row in rows)
    hidden = dict.fromkeys((e.words, e.option) for e in elements if e is not None)
    if hidden:
        what, options = (" and ".join(words) for words in zip(*hidden))
        return (
            f"Leave {what} out (on the command line: without {options}): the recordings may carry "
            f"none; if there is one, excite the system more richly."
        )
    if len(rows) == 1:
        name = rows[0].name
        return f"Excite it, or hold it at a known value (on the command line: --set {name}=VALUE)."
    return (
        f"Excite the system more richly, or hold one of them at a known value (on the command "
        f"line: --set {hold or 'NAME'}=VALUE)."
    )


def not_excited(stage_name: str, row: Parameter) -> Finding:
    """That a parameter's regressor is zero throughout."""
    return Finding(
        "not_excited",
        f"{stage_name}: nothing in the record tells of {row.name}; its regressor is zero "
        f"throughout. {excite_or_hold([row], row.name)}",
        parameters=(row.name,),
    )


def weighing(names: Sequence[str], direction: Float[np.ndarray, " p"]) -> tuple[str, ...]:
    """Parameters that weigh more than a tenth of the largest part of a direction."""
    largest = np.max(np.abs(direction))
    return tuple(n for c, n in zip(direction, names) if abs(c) > 0.1 * largest)


def combination(names: tuple[str, ...], direction: Float[np.ndarray, " p"]) -> str:
    """A direction over parameters as `0.71 F_1 - 0.71 F_2`, small parts left out."""
    large = weighing(names, direction)
    parts = [(c, n) for c, n in zip(direction, names) if n in large]
    if parts and parts[0][0] < 0:
        parts = [(-c, n) for c, n in parts]
    words = [f"{'-' if c < 0 else '+'} {abs(c):.2f} {n}" for c, n in parts]
    return " ".join(words).removeprefix("+ ")
