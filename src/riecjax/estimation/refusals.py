"""What a fit refuses once the sums are there: no rows, no numbers, or nothing to tell by."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from riecjax.errors import DataError, IdentifiabilityError
from riecjax.estimation.estimate import combination, weighing
from riecjax.estimation.parameters import ParameterPlan
from riecjax.estimation.remedies import excite_or_hold
from riecjax.estimation.stages import StageSolution
from riecjax.findings import Finding


def raise_if_nothing_to_fit(
    plan: ParameterPlan, counts: Sequence[ArrayLike], sums: Sequence[ArrayLike]
) -> None:
    """Refuse a stage without rows, or with sums that are not finite numbers (not under jit).

    **Arguments:** of each stage of the plan, `counts` of its rows and `sums` of their products.

    **Raises:** `DataError` naming the stage.
    """
    for (label, unknown), count in zip(plan.stages, counts):
        if unknown and not bool(np.sum(np.asarray(count)) > 0):
            raise DataError(
                f"{label}: every window touches a missing or masked sample. Choose a smaller beta, "
                f"or repair the record's gaps."
            )
    for (label, _), values in zip(plan.stages, sums):
        if not bool(np.all(np.isfinite(values))):
            raise DataError(
                f"{label}: its terms are not finite numbers on this record: a division by zero, a "
                f"root of a negative number, or values too large to be squared. Scale the signals "
                f"to SI units and check the equation's expressions."
            )


def not_excited(stage_name: str, name: str) -> Finding:
    """That a parameter's regressor is zero throughout."""
    return Finding(
        "not_excited",
        f"{stage_name}: nothing in the record tells of {name}; its regressor is zero throughout. "
        f"{excite_or_hold([name], name)}",
        parameters=(name,),
    )


def raise_if_unidentifiable(solutions: list[StageSolution], plan: ParameterPlan) -> None:
    """Raise `IdentifiabilityError` for a stage whose regressors are collinear."""
    for stage in solutions:
        if int(stage.solution.rank) == len(stage.parameters):
            continue
        label, _ = plan.stages[stage.stage]
        for name, size in zip(stage.parameters, np.asarray(stage.relative_size)):
            if size == 0:
                silent = not_excited(label, name)
                raise IdentifiabilityError(silent.message, silent.code)
        direction = np.asarray(stage.solution.weakest_direction)
        which = combination(stage.parameters, direction)
        raise IdentifiabilityError(
            f"{label}: the record cannot tell these apart (collinear regressors): {which}, in "
            f"units of each regressor's size. "
            f"{excite_or_hold(weighing(stage.parameters, direction))}"
        )
