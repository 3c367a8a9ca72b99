"""Answers from many recordings, and figures of them beside what is asked."""

import sys
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

import riecjax as rx

CLEARLY = 3.0
"""Standard errors beyond what is asked from which a figure clearly misses it."""
FINAL_SHARE, FEWEST = 0.15, 20
"""Share of the seeds whose final answers, which take longer, are looked at."""

Range = tuple[float | None, float | None]
ANY: Range = (None, None)


class Run(NamedTuple):
    """How large a run is, and the keyword of `noise=`."""

    seeds: int
    noise: str

    @property
    def options(self) -> dict[str, Any]:
        return {"noise": self.noise} if self.noise != "auto" else {}

    @property
    def final_seeds(self) -> int:
        return min(self.seeds, max(FEWEST, round(FINAL_SHARE * self.seeds)))


class Fits(NamedTuple):
    """Of every recording that has an answer: estimates, standard errors, ends of intervals.

    Shapes `(n, p)`; numbers of the recordings that were `kept`, how many were `refused`, and how
    many answers are refinements.
    """

    theta: np.ndarray
    errors: np.ndarray
    low: np.ndarray
    high: np.ndarray
    names: tuple[str, ...]
    kept: list[int]
    refused: int
    refined: int

    def covers(self, truth: np.ndarray) -> np.ndarray:
        return (self.low <= truth) & (truth <= self.high)


def fit_all(recordings: Iterable[Any], fit: Callable[[Any], Any]) -> Fits:
    """Answers one by one; what is refused is counted."""
    found, kept, refusals = [], [], []
    for number, recording in enumerate(recordings):
        try:
            found.append(fit(recording))
            kept.append(number)
        except rx.RiecjaxError as error:
            refusals.append(str(error))
    if refusals:
        print(f"{len(refusals)} refused, such as: {refusals[0]}", file=sys.stderr)
    parts = [(one.theta, one.standard_errors, *one.intervals()) for one in found]
    return Fits(
        *(np.array(part) for part in (zip(*parts) if parts else [()] * 4)),
        names=found[0].parameters if found else (),
        kept=kept,
        refused=len(refusals),
        refined=sum(one.search is not None for one in found),
    )


def identified(model: Any, run: Run, **settings: Any) -> Callable[[Any], Any]:
    return lambda recording: rx.identify(model, recording, **settings, **run.options)


def answered(model: Any, run: Run) -> Callable[[Any], Any]:
    """The final answer of `assess`: refined, where that is warranted and the library does so."""

    def fit(recording: Any) -> Any:
        assessed = rx.assess(model, recording, **run.options)
        return getattr(assessed, "answer", assessed.estimate)

    return fit


def judged(
    value: Any,
    most: float | None = None,
    least: float | None = None,
    error: Any = 0.0,
    allowed: float = 0.0,
) -> dict[str, Any]:
    """A figure beside what is asked; `allowed` standard errors beyond that are still met."""
    value, error = float(value), float(error)
    low = -np.inf if least is None else least
    high = np.inf if most is None else most

    def within(errors: float) -> bool:
        return low - errors * error <= value <= high + errors * error

    return {
        "value": value,
        "standard_error": error,
        "asked": [least, most],
        "met": within(allowed),
        "clearly_missed": not within(CLEARLY),
    }


def coverage(
    hits: np.ndarray, names: tuple[str, ...], pooled: Range, each: Range
) -> dict[str, Any]:
    """Share of the recordings, shape `(n, p)`, whose intervals hold the value."""
    count, shares = len(hits), hits.mean(axis=0)
    # The binomial error of the share that is asked for: that of none or all would be zero.
    errors = np.sqrt(np.maximum(shares * (1 - shares), 0.95 * 0.05) / count)
    by_record = hits.mean(axis=1)
    scatter = max(by_record.std(), np.sqrt(0.95 * 0.05 / hits.shape[1])) / np.sqrt(count)
    return {
        "pooled": judged(by_record.mean(), pooled[1], pooled[0], scatter),
        **{n: judged(s, each[1], each[0], e) for n, s, e in zip(names, shares, errors)},
    }


def accuracy(
    fits: Fits,
    truth: Mapping[str, float],
    *,
    bias: float | None = None,
    bound: np.ndarray | None = None,
    ratio: tuple[float, float] = (np.inf, 0.0),
    pooled: Range = ANY,
    each: Range = ANY,
) -> dict[str, Any]:
    """Bias, root mean square error over the bound, and coverage of the truth, by parameter.

    `ratio`: the most that the error may be of the bound, and the standard errors allowed beyond.
    """
    count, refused = len(fits.theta), {"refused": judged(fits.refused, 0)}
    if count < 2:
        return refused
    true = np.array([truth[name] for name in fits.names])
    off = fits.theta - true
    own = off.std(axis=0, ddof=1)
    # Spread of a mean in units of a scatter that is estimated from the same draws.
    shift = off.mean(axis=0) / own
    shift_error = np.sqrt((1 + shift**2 / 2) / count)
    report: dict[str, Any] = {
        "answers": count,
        **refused,
        "refined": fits.refined,
        "percent_off": dict(zip(fits.names, (100 * off.mean(axis=0) / true).tolist())),
        "bias": {
            n: judged(b, bias, None if bias is None else -bias, e)
            for n, b, e in zip(fits.names, shift, shift_error)
        },
    }
    if bound is not None:
        square = off**2
        rms = np.sqrt(square.mean(axis=0))
        error = square.std(axis=0) / (2 * rms * np.sqrt(count))
        report["error_over_bound"] = {
            n: judged(r, ratio[0], None, e, ratio[1])
            for n, r, e in zip(fits.names, rms / bound, error / bound)
        }
    return report | {"coverage": coverage(fits.covers(true), fits.names, pooled, each)}
