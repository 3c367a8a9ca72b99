"""A target that does not vary: one term reproduces it, and nothing of the machine is known.

With a force that never varies, an unknown offset alone explains all of it: the offset takes the
force's value, every other parameter zero, and the residual vanishes, while the regressors are not
collinear at all. A position that hardly moves about a large mean does the same: k takes the ratio
of two constants, wherever its sensor has its zero, and free motion ties all others to k.

Let b be the target, a_j the regressors, and b', a_j' their deviations from the mean (of each record
where a parameter differs between records). An equation says nothing of its parameters if

1. |b'| is a small share of |b|: the target is constant, and
2. a' explains little of b': what varies of it is noise or drift, and
3. one term's columns, or all those that do not move, reproduce b, while other parameters
   appear in no other equation of the stage.

Where motion explains how a target varies (a step that begins late, a force that varies by 5 %),
the second fails. The means weigh far more in the fit than that motion, so it is sound only if they
agree: if least squares on b leave hardly more of b' than least squares on b' alone do.

A target that is zero throughout is fitted by zero for all, unless another equation of the stage has
a target and shares a parameter with it. Equations are averaged by hats as long as the criterion's
windows, which need no recorded derivative; for [`DOLS`][] each sample counts.
"""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float

from riecjax.criteria.criterion import RIEC, AbstractCriterion
from riecjax.equations.equation import Equation
from riecjax.equations.term import AbstractTerm, both_present
from riecjax.estimation.noise import with_noise
from riecjax.estimation.procedure import Procedure
from riecjax.estimation.sharing import Sharing
from riecjax.findings import Finding
from riecjax.records.record import Record

CONSTANT = 0.1
"""Share of a target, rms, that may vary where it counts as constant."""
STILL = 0.05
"""Share of a regressor that may vary where it counts as one that does not move."""
EXPLAINED = 0.5
"""Share of a target's variance past which motion explains how it varies."""
DISAGREEING = 2.0
"""Times what motion alone leaves of b', or noise, rms, past which the means disagree with it."""
SLIGHT = 0.01
"""Share of b', rms, that the means may cost in any case: they move k by about as much."""
ROUNDING = 1e-7
"""Share of a column that double sums over a long record may leave as rounding."""
MOST_ROWS = 4000
"""Rows of a record that are looked at."""

Rows = Float[np.ndarray, " rows"]


# Values too large to be squared are for the fit to refuse.
@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def constant_targets(
    procedure: Procedure,
    sharing: Sharing,
    records: list[Record],
    criterion: AbstractCriterion,
    given: Mapping[str, Array],
) -> list[Finding]:
    """Equations whose target is zero, or constant and reproduced by one term (not under jit).

    **Arguments:** `given`, known values by name over all records.
    """
    settled, findings = set(given), []
    for stage in procedure.stages:
        seen = [_Averaged(e, sharing, records, criterion, given, settled) for e in stage]
        for one in seen:
            others = [other for other in seen if other is not one]
            elsewhere = {name for other in others for name in other.names}
            message = _zero(one, others) or _message(one, elsewhere)
            if message:
                findings.append(Finding("constant_target", f"{one.equation.name}: {message}"))
        settled |= {name for e in stage for name in sharing.everywhere(e.parameters)}
    return findings


def _zero(seen: "_Averaged", others: list["_Averaged"]) -> str:
    """In words, that zero for all fits; empty if it does not."""
    if np.any(seen.target()):
        return ""
    moving = [name for name, column in seen.columns().items() if _norm(column) > 0]
    # What other equations tell reaches this one through those that share parameters.
    linked, rest = set(seen.names), list(others)
    while near := [other for other in rest if linked & other.names]:
        if any(np.any(other.target()) for other in near):
            return ""
        linked |= {name for other in near for name in other.names}
        rest = [other for other in rest if other not in near]
    if not moving:
        return ""
    return (
        f"what is known of the equation is zero throughout, so zero for all of "
        f"{', '.join(moving)} would fit: check the input's channel, or hold {moving[0]} at a known "
        f"value (on the command line: --set {moving[0]}=VALUE)."
    )


def _message(seen: "_Averaged", elsewhere: set[str]) -> str:
    """In words, that one term alone explains the target; empty if it does not."""
    target = seen.target()
    size = _norm(target)
    varying = _norm(seen.moving(target))
    # Negated, so that what is not finite is passed over.
    if not (size > 0 and varying <= CONSTANT * size):
        return ""
    columns = seen.columns()
    left = seen.left_by_motion(target, columns) if varying > ROUNDING * size else 1.0
    if left**2 < 1 - EXPLAINED:
        fitted, noise = seen.left_by_all(target, columns)
        # What other equations tell of a parameter, this one's means do not settle.
        alone = elsewhere.isdisjoint(columns)
        if alone and fitted > DISAGREEING * np.hypot(left, noise) + SLIGHT:
            return (
                f"the constant parts disagree with the motion, as with a wrong zero of a sensor: "
                f"together they leave {100 * fitted:.2g} % of how the input varies, motion alone "
                f"{100 * left:.2g} %. Add a constant term (an offset parameter), or remove the "
                f"signals' offsets."
            )
        return ""
    for names in seen.candidates(columns):
        hidden = [name for name in columns if name not in names and name not in elsewhere]
        left = _norm(_residual(target, [columns[name] for name in names]))
        if hidden and left <= np.hypot(varying, STILL * size):
            # Others at rest to the last digit are collinear with these, and are named as that.
            if any(_norm(columns[n]) > 0 and seen.share(columns[n]) <= ROUNDING for n in hidden):
                return ""
            still = all(ROUNDING < seen.share(columns[name]) <= STILL for name in names)
            return _words(names, hidden, still)
    return ""


def _words(names: list[str], hidden: list[str], still: bool) -> str:
    who, others, one = ", ".join(names), ", ".join(hidden), len(names) == 1
    explains, leaves = ("explains", "leaves") if one else ("explain", "leave")
    if still:
        why = (
            f"neither the input nor what {who} multiplies varies, so {who} alone {explains} the "
            f"input, as a ratio of two constants that every sensor's zero shifts, and "
            f"{others} follow{'s' * (len(hidden) == 1)} from that."
        )
    else:
        why = (
            f"the input never varies, so {who} alone {explains} all of it and {leaves} {others} at "
            f"zero: the record cannot tell {who} from the rest."
        )
    return (
        f"{why} Record from before the step on, excite the system more richly, or hold {names[0]} "
        f"at a known value (on the command line: --set {names[0]}=VALUE)."
    )


class _View(NamedTuple):
    """How one record is averaged: hats of `half` samples to a side (none for 0) about `centres`."""

    record: Record
    half: int
    centres: np.ndarray

    @property
    def independent(self) -> float:
        """Rows that share no data."""
        return self.record.sample_count / max(2 * self.half, 1)

    def rows(self, term: AbstractTerm) -> list[Rows]:
        """The term's columns, each row a mean of d^k/dt^k of it, weighted by a hat."""
        order = 0 if self.half else term.derivative
        samples = np.asarray(term.samples(self.record, order).values)
        if not self.half:
            return [column[self.centres] for column in samples]
        step, h, c = float(self.record.time_step), self.half, self.centres
        found = []
        for column in samples:
            # By parts: the second difference of what is integrated twice, less derivatives.
            for _ in range(2 - term.derivative):
                column = step * np.cumsum(np.append(0.0, 0.5 * (column[1:] + column[:-1])))
            found.append((column[c + h] - 2 * column[c] + column[c - h]) / (h * step) ** 2)
        return found


def _view(equation: Equation, record: Record, criterion: AbstractCriterion) -> _View:
    half = 0
    if isinstance(criterion, RIEC):
        length = np.sqrt(float(criterion.windows.alpha) * float(criterion.windows.beta))
        most = (record.sample_count - 2) // 2
        half = int(np.clip(round(length / (2 * float(record.time_step))), 1, max(most, 1)))
    centres = np.arange(half, record.sample_count - half)
    if record.missing or equation.where is not None:
        read = equation.signals_read(record, 2 if half else 0)
        present = both_present(equation.trusted(record), record.present(read))
        if present is not None:
            absent = np.append(0, np.cumsum(~np.asarray(present)))
            centres = centres[absent[centres + half + 1] == absent[centres - half]]
    return _View(record, half, centres[:: max(centres.size // MOST_ROWS, 1)])


class _Averaged:
    """One equation's target and regressors on all records, one record's rows after the other."""

    def __init__(
        self,
        equation: Equation,
        sharing: Sharing,
        records: list[Record],
        criterion: AbstractCriterion,
        given: Mapping[str, Array],
        settled: set[str],
    ):
        self.equation, self.sharing = equation, sharing
        self.names = set(sharing.everywhere(equation.parameters)) - settled
        self.given, self.settled, self.criterion = given, settled, criterion
        self.views = [_view(equation, record, criterion) for record in records]
        individual = bool(sharing.own.intersection(equation.parameters))
        sizes = [view.centres.size for view in self.views]
        self.record_of_row = np.repeat(np.arange(len(sizes)) * individual, sizes)

    def _terms(self, free: bool) -> Iterator[tuple[int, AbstractTerm, tuple[str, ...]]]:
        """Terms with an unknown coefficient, or those without, with their names, by record."""
        for i in range(len(self.views)):
            for term in self.equation.terms:
                names = self.sharing.of_record(term.parameters, i)
                if bool(set(names) - self.settled) == free:
                    yield i, term, names

    def target(self) -> Rows:
        """What the known terms amount to. What an earlier stage finds counts as one."""
        parts = [np.zeros(view.centres.size) for view in self.views]
        for i, term, names in self._terms(free=False):
            rows = self.views[i].rows(term)
            values = [float(self.given.get(name, 1.0)) for name in names] or [1.0]
            parts[i] -= sum(value * row for value, row in zip(values, rows))
        return np.concatenate(parts)

    def columns(self) -> dict[str, Rows]:
        """The unknown coefficients' regressors."""
        edges = np.cumsum([0, *(view.centres.size for view in self.views)])
        found: dict[str, Rows] = {}
        for i, term, names in self._terms(free=True):
            for name, row in zip(names, self.views[i].rows(term)):
                column = found.setdefault(name, np.zeros(edges[-1]))
                column[edges[i] : edges[i + 1]] += row
        return {name: column for name, column in found.items() if name not in self.settled}

    def moving(self, rows: Rows) -> Rows:
        """Rows less their mean: of each record where a parameter differs between records."""
        count = np.maximum(np.bincount(self.record_of_row), 1)
        return rows - (np.bincount(self.record_of_row, rows) / count)[self.record_of_row]

    def share(self, column: Rows) -> float:
        """How much of a column moves."""
        size = _norm(column)
        return _norm(self.moving(column)) / size if size > 0 else 0.0

    def left_by_motion(self, target: Rows, columns: Mapping[str, Rows]) -> float:
        """Share, rms, of how the target varies that motion does not explain, chance taken off."""
        moving = [self.moving(column) for column in columns.values()]
        there = [m for m, c in zip(moving, columns.values()) if _norm(m) > ROUNDING * _norm(c)]
        varying = self.moving(target)
        left = _norm(_residual(varying, there)) / _norm(varying)
        free = sum(view.independent for view in self.views) - 1
        return left * np.sqrt(free / (free - len(there))) if free > len(there) else 1.0

    def left_by_all(self, target: Rows, columns: Mapping[str, Rows]) -> tuple[float, float]:
        """Share, rms, of how the target varies that a fit with the means leaves, and its noise.

        Motion alone attenuates the coefficient of a noisy regressor where others replace it, and
        so leaves less than noise would at the coefficients of this fit.
        """
        theta = _fit(target, list(columns.values()))
        noisy = _Averaged(
            self.equation,
            self.sharing,
            [with_noise(view.record, seed) for seed, view in enumerate(self.views)],
            self.criterion,
            self.given,
            self.settled,
        )
        left = self.moving(target - np.stack([*columns.values()], axis=1) @ theta)
        disturbed = noisy.target() - np.stack([*noisy.columns().values()], axis=1) @ theta
        size = _norm(self.moving(target))
        return _norm(left) / size, _norm(self.moving(disturbed) - left) / size

    def candidates(self, columns: Mapping[str, Rows]) -> list[list[str]]:
        """Columns that may stand for all: of each term, still ones first, and of all that are."""
        groups: list[list[str]] = []
        for _, term, _ in self._terms(free=True):
            names = [name for name in self.sharing.everywhere(term.parameters) if name in columns]
            if names not in groups:
                groups.append(names)
        groups.sort(key=lambda names: max(self.share(columns[name]) for name in names))
        return [*groups, [name for name, c in columns.items() if self.share(c) <= STILL]]


def _fit(target: Rows, columns: list[Rows]) -> Float[np.ndarray, " columns"]:
    """Coefficients of least squares; zero for columns that are not finite."""
    sizes = np.array([_norm(column) or 1.0 for column in columns])
    matrix = np.stack([c / s for c, s in zip(columns, sizes)], axis=1)
    if not np.isfinite(matrix).all():
        return np.zeros(sizes.size)
    return np.linalg.lstsq(matrix, target, rcond=ROUNDING)[0] / sizes


def _residual(target: Rows, columns: list[Rows]) -> Rows:
    """What least squares leave of a target."""
    if not columns:
        return target
    return target - np.stack(columns, axis=1) @ _fit(target, columns)


def _norm(rows: Rows) -> float:
    return float(np.linalg.norm(rows))
