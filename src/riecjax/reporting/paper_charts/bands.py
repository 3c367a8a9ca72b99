"""A line with the band in which nearly all roads lie."""

import numpy as np

from riecjax.reporting.charts.chart import BLUE, RUST, Dashes, Line

METHOD_STYLE: dict[str, tuple[str, Dashes]] = {"RIEC": (BLUE, "solid"), "DOLS": (RUST, "dashed")}
BAND = "Lines are medians over the roads, bands hold 95 % of them."


def banded(
    x: object,
    over_roads: object,
    label: str,
    style: tuple[str, Dashes],
    *,
    shown: float = np.inf,
) -> Line:
    """Median over the first axis, with the band from its 2.5 to its 97.5 % quantile.

    **Arguments:** `shown`, the largest value that is drawn; larger ones leave a gap.
    """
    values = np.asarray(over_roads)
    with np.errstate(invalid="ignore"):
        low, middle, high = (_quantile(values, q) for q in (0.025, 0.5, 0.975))
    drawn = np.abs(middle) <= shown
    return Line(
        x,  # pyright: ignore[reportArgumentType]
        np.where(drawn, middle, np.nan),
        label,
        style[0],
        style[1],
        low=np.where(drawn, low, np.nan),
        high=np.where(drawn & np.isfinite(high), np.minimum(high, 1e9), np.nan),
    )


def _quantile(values: np.ndarray, share: float) -> np.ndarray:
    # Of an order that is there: between a number and infinity lies nothing.
    return np.quantile(values, share, axis=0, method="nearest")
