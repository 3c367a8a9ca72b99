"""What figures have in common: colours, panels and labels with units."""

from typing import Any

from riecjax.reporting.output import require_plots

BLUE, RUST, GREY = "#1f4e79", "#9c3d1c", "0.6"
"""What a model says; what it leaves, or a second series; and what was measured."""
PALE = "0.86"
"""Stretches within which nothing is remarkable."""


def panels(rows: int, columns: int, size: tuple[float, float], **settings: Any) -> tuple[Any, Any]:
    """A figure of a size in inches, and its axes as an array of shape `(rows, columns)`.

    **Raises:** `DataError` if matplotlib is not installed.
    """
    return require_plots().subplots(
        rows, columns, figsize=size, squeeze=False, layout="constrained", **settings
    )


def labelled(what: str, unit: str | None) -> str:
    """An axis label with its unit, if there is one."""
    return f"{what} / ({unit})" if unit else what
