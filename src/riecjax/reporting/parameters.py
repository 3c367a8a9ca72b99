"""Parameters with units and uncertainty in plain data."""

from typing import Any

from riecjax.estimation.estimated_parameters import AbstractEstimate
from riecjax.reporting.output import finite


def parameter_entries(estimate: AbstractEstimate) -> dict[str, Any]:
    """Value, unit, standard error and interval of each estimated parameter; lists of a batch."""
    units = dict(estimate.units)
    entries = {}
    for name in estimate.parameters:
        low, high = estimate.interval(name)
        entries[name] = {
            "value": finite(estimate[name]),
            "unit": units.get(name, ""),
            "std_error": finite(estimate.standard_error(name)),
            "interval95": [finite(low), finite(high)],
        }
    return entries
