"""What is asked of records: everything that can be refused before any arithmetic."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from riecjax.equations.procedure import Procedure
from riecjax.errors import ModelError, require
from riecjax.estimation.sharing import Sharing
from riecjax.leaves import is_concrete, is_number
from riecjax.summaries.task import require_key


class Question(NamedTuple):
    """What is unknown: `sharing` of parameters over records, `given` values by name over all
    records, and the `plan`, (stage name, parameters it finds)."""

    sharing: Sharing
    given: dict[str, Array]
    plan: list[tuple[str, tuple[str, ...]]]


def question(
    procedure: Procedure,
    record_count: int,
    known: Mapping[str, float | Array] | None,
    per_record: Sequence[str],
) -> Question:
    """What can be refused of known values and names; see [`identify`][] for the arguments.

    **Raises:** `ModelError` as [`identify`][].
    """
    require_settings(None, known, per_record)
    sharing = Sharing(procedure.parameters, per_record, record_count)
    given = known_values(procedure, sharing, known or {})
    return Question(sharing, given, plan_stages(procedure, sharing, given))


def require_settings(key: object, known: object, per_record: object) -> None:
    """Raise `ModelError` unless these are a key, values by name and names, or left out."""
    require_key(key)
    write = "known={'m': 2.0}: values by name"
    require("known", {} if known is None else known, Mapping, write)
    name = per_record if isinstance(per_record, str) else "offset"
    kinds = (list, tuple, set, frozenset)
    require("per_record", per_record, kinds, f"per_record=('{name}',): a tuple of names")


def known_values(
    procedure: Procedure, sharing: Sharing, known: Mapping[str, float | Array]
) -> dict[str, Array]:
    """Values held fixed, by name over all records: the equations' own and the user's.

    **Raises:** `ModelError` for a name that the model does not have, and for what is no finite
    number.
    """
    names = {*procedure.parameters, *sharing.parameters}
    if unknown := [name for name in known if name not in names]:
        listed = ", ".join(sharing.parameters)
        raise ModelError(f"unknown parameter '{unknown[0]}'; the model has: {listed}.")
    require_numbers(known)
    merged = {**sharing.values(procedure.known), **sharing.values(known)}
    return {name: jnp.asarray(value, jnp.result_type(float)) for name, value in merged.items()}


def require_numbers(known: Mapping[str, Any]) -> None:
    """Raise `ModelError` for a known value that is no single number, or not finite if it shows."""
    for name, value in known.items():
        if not is_number(value):
            raise ModelError(
                f"{name} is held at {value!r}: known values are single numbers, {name}=2.0."
            )
        if is_concrete(value) and not np.isfinite(float(value)):
            raise ModelError(f"{name} is held at {value}: give a finite number.")


def plan_stages(
    procedure: Procedure, sharing: Sharing, given: Mapping[str, Array]
) -> list[tuple[str, tuple[str, ...]]]:
    """(stage name, parameters it finds, over all records) for each stage."""
    plan = [
        (label, tuple(name for name in sharing.everywhere(names) if name not in given))
        for label, names in procedure.plan(sharing.settled(given))
    ]
    if not any(unknown for _, unknown in plan):
        raise ModelError("every parameter is known; nothing is left to identify.")
    return plan
