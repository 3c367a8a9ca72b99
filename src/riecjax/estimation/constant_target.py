"""A target that does not vary: one term reproduces it, and nothing of the machine is known."""

# With a force that never varies, an unknown offset alone explains all of it: the offset takes the
# force's value, every other parameter zero, and the residual vanishes, while the regressors are not
# collinear at all. A position that hardly moves about a large mean does the same: k takes the ratio
# of two constants, wherever its sensor has its zero, and free motion ties all others to k.
#
# Let b be the target, a_j the regressors, and b', a_j' their deviations from the mean (of each
# record where a parameter differs between records). An equation says nothing of its parameters if
#
# 1. |b'| is a small share of |b|: the target is constant, and
# 2. a' explains little of b': what varies of it is noise or drift, and
# 3. one term's columns, or all those that do not move, reproduce b, while other parameters appear
#    in no other equation of the stage.
#
# Where motion explains how a target varies (a step that begins late, a force that varies by 5 %),
# the second fails. The means weigh far more in the fit than that motion, so it is sound only if
# they agree: if least squares on b leave hardly more of b' than least squares on b' alone do.
#
# A target that is zero throughout is fitted by zero for all, unless another equation of the stage
# has a target and shares a parameter with it. All this is of the criterion's own rows, and what a
# constant is in each of them stands for the mean.
#
# It asks for lengths of the columns b, a_j and angles between them, of which least squares are
# made. Where [1, b, a] = Q R, the columns of R have the same, since Q keeps both, and R is a factor
# of the rows' moments, R^T R. The constant is the first column of R, (c, 0, ...), so that R's first
# row holds the means times its size c, and the rows below it stand for the deviations b', a'. With
# the factors of several records on top of each other, the constant over all of them holds each
# one's c_i; deviations are what is left when columns are projected off it, or off each record's
# part of it where means are its own.

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from riecjax.equations.equation import Equation
from riecjax.equations.expressions import constant
from riecjax.equations.model import Model
from riecjax.estimation.parameters import ParameterTable
from riecjax.findings import Finding
from riecjax.linear_algebra import factor_of_gram
from riecjax.summaries.normal_equations import EquationSums
from riecjax.summaries.summary import Summary

CONSTANT = 0.05
"""Share of a target, rms, that may vary where it counts as constant: of integrals, in the longest
of which a force varies half as much as under a window of typical length."""
STILL = 0.05
"""Share of a regressor that may vary where it counts as one that does not move."""
EXPLAINED = 0.5
"""Share of a target's variance past which motion explains how it varies."""
DISAGREEING = 2.0
"""Times what motion alone leaves of b', or noise, rms, past which the means disagree with it."""
SLIGHT = 0.01
"""Share of b', rms, that the means may cost in any case: they move k by about as much."""
LEAST = 0.1
"""The same from which a wrong zero is told where the target varies."""
MOST_MOVED = 1e3
"""Share by which a value may be said to move at most."""
ROUNDING = 8.0
"""Times the root of eps: share of a column that its factor, of moments, may hold as rounding."""
FACTORED = 1e-6
"""The same at least: moments over many windows are exact to 300 eps of 64 bits, measured."""
Rows = Float[np.ndarray, " rows"]


# Values too large to be squared are for the fit to refuse.
@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def target_findings(model: Model, table: ParameterTable, summary: Summary) -> list[Finding]:
    """Equations whose target is zero, or constant and reproduced by one term; then those that
    motion explains, and a fit with the means does not (not under jit).

    **Arguments:** `summary`, with a constant beside all equations.
    """
    constants, zeros = [], []
    for stage, (_, unknown), *recordings in zip(
        model.stages, table.stages, *(recording.stages for recording in summary.recordings)
    ):
        seen = [
            _Averaged(equation, table, summary, sums, unknown)
            for equation, *sums in zip(stage, *recordings)
        ]
        for one in seen:
            others = [other for other in seen if other is not one]
            elsewhere = {name for other in others for name in other.names}
            if message := _fitted_by_zero(one, others) or _fitted_by_one(one, elsewhere):
                message = f"{one.equation.name}: {message}"
                constants.append(Finding("constant_target", message, parameters=tuple(one.columns)))
            zeros += _wrong_zero(one, table)
    return [*constants, *zeros]


def _wrong_zero(seen: "_Averaged", table: ParameterTable) -> list[Finding]:
    """That the means disagree with the motion, of which deviations from the mean know nothing;
    empty if they do not, and of what an earlier stage finds."""
    names, known = {*table.everywhere(seen.equation.parameters)}, {*seen.names, *table.known}
    has_zero = any(term.of is constant for term in seen.equation.terms)
    moves = seen.share(seen.target) > seen.rounding
    if not (names <= known and seen.columns and moves) or has_zero:
        return []
    left = seen.left_by_motion()
    if not (fitted := seen.left_by_means(left)) > LEAST:
        return []
    inputs = seen.inputs
    remedy = ("--unknown-offset", inputs[0]) if len(inputs) == 1 else ()
    # How far each coefficient is from that of motion alone, as a share of it in the fit.
    columns = [*seen.columns.values()]
    whole = _fit(seen.target, columns)
    alone = _fit(seen.moving(seen.target), [seen.moving(column) for column in columns])
    shares = np.minimum(np.abs(alone - whole) / np.maximum(np.abs(whole), 1e-300), MOST_MOVED)
    moved = dict(zip(seen.columns, shares.tolist()))
    most = max(moved, key=lambda name: moved[name])
    message = (
        f"{seen.equation.name}: the constant parts of the signals disagree with their motion, "
        f"as with a wrong zero of a sensor: together they leave {100 * fitted:.2g} % of how "
        f"the target varies, motion alone {100 * left:.2g} %. It moves {most} by "
        f"{100 * moved[most]:.2g} % of its value. Estimate the zero as a constant"
        + (f" (on the command line: {' '.join(remedy)})" if remedy else "")
        + ": rx.Term('offset', rx.constant); or remove the signals' offsets."
    )
    step = "Estimate the zero of a sensor, as a constant force"
    parameters = tuple(seen.columns)
    return [Finding("wrong_zero", message, tuple(inputs), parameters, 0.0, moved, remedy, step)]


def _fitted_by_zero(seen: "_Averaged", others: list["_Averaged"]) -> str:
    """In words, that zero for all fits; empty if it does not."""
    if np.any(seen.target):
        return ""
    moving = [name for name, column in seen.columns.items() if _norm(column) > 0]
    # What other equations tell reaches this one through those that share parameters.
    linked, rest = set(seen.names), list(others)
    while near := [other for other in rest if linked & other.names]:
        if any(np.any(other.target) for other in near):
            return ""
        linked |= {name for other in near for name in other.names}
        rest = [other for other in rest if other not in near]
    if not moving:
        return ""
    named = f" ({', '.join(seen.inputs)})" if seen.inputs else ""
    return (
        f"what is known of the equation is zero throughout{named}, so zero for all of "
        f"{', '.join(moving)} would fit: check the input's channel, or hold {moving[0]} at a known "
        f"value (on the command line: --set {moving[0]}=VALUE)."
    )


def _fitted_by_one(seen: "_Averaged", elsewhere: set[str]) -> str:
    """In words, that one term alone explains the target; empty if it does not."""
    target = seen.target
    size = _norm(target)
    varying = _norm(seen.moving(target))
    # Negated, so that what is not finite is passed over.
    if not (size > 0 and varying <= CONSTANT * size):
        return ""
    columns = seen.columns
    left = seen.left_by_motion() if varying > seen.rounding * size else 1.0
    if left**2 < 1 - EXPLAINED:
        # What other equations tell of a parameter, this one's means do not settle.
        if elsewhere.isdisjoint(columns) and (fitted := seen.left_by_means(left)) > 0:
            return (
                f"the constant parts disagree with the motion, as with a wrong zero of a sensor: "
                f"together they leave {100 * fitted:.2g} % of how the input varies, motion alone "
                f"{100 * left:.2g} %. Add a constant term (an offset parameter), or remove the "
                f"signals' offsets."
            )
        return ""
    for names in seen.candidates():
        hidden = [name for name in columns if name not in names and name not in elsewhere]
        left = _left(target, [columns[name] for name in names])
        if hidden and left <= np.hypot(varying, STILL * size):
            # Others at rest to the last digit are collinear with these, and are named as that.
            if any(
                _norm(columns[n]) > 0 and seen.share(columns[n]) <= seen.rounding for n in hidden
            ):
                return ""
            who, others = ", ".join(names), ", ".join(hidden)
            one, other = ("s" if len(group) == 1 else "" for group in (names, hidden))
            if all(seen.rounding < seen.share(columns[name]) <= STILL for name in names):
                why = (
                    f"neither the input nor what {who} multiplies varies, so {who} alone "
                    f"explain{one} the input, as a ratio of two constants that every sensor's zero "
                    f"shifts, and {others} follow{other} from that."
                )
            else:
                why = (
                    f"the input never varies, so {who} alone explain{one} all of it and "
                    f"leave{one} {others} at zero: the record cannot tell {who} from the rest."
                )
            return (
                f"{why} Record from before the step on, excite the system more richly, or hold "
                f"{names[0]} at a known value (on the command line: --set {names[0]}=VALUE)."
            )
    return ""


class _Averaged:
    """One equation's target and regressors, one record's factor on top of the other.

    **Attributes:** `target`, what the known terms amount to, what an earlier stage finds among
    them; `columns`, the unknown coefficients' regressors; `names` of these; `rounding`, share of a
    column that is none of it.
    """

    def __init__(
        self,
        equation: Equation,
        table: ParameterTable,
        summary: Summary,
        recordings: Sequence[EquationSums],
        unknown: tuple[str, ...],
    ):
        self.equation, self.table = equation, table
        self.names = {*table.everywhere(equation.parameters)}.intersection(unknown)
        # Seconds that a typical window lasts, the geometric mean; 0 without windows.
        windows = summary.criterion.windows
        length = float(np.sqrt(windows.alpha * windows.beta)) if windows is not None else 0.0
        self.independent = sum(
            float(one.samples) * (min(float(one.time_step) / length, 1.0) if length else 1.0)
            for one in summary.recordings
        )
        dtype = np.asarray(recordings[0].moments).dtype
        self.rounding = max(ROUNDING * float(np.finfo(dtype).eps) ** 0.5, FACTORED)
        # Triangular factors of the rows `[1, target, regressors]`, and of what noise adds to them;
        # mixes of their columns are the target less what is known, and regressors of the unknown.
        called = [table.of_record(one.parameters, i) for i, one in enumerate(recordings)]
        columns = [*dict.fromkeys(n for names in called for n in names if n in self.names)]
        rows, noise, mixes = [], [], []
        for sums, names in zip(recordings, called):
            one = sums.of_bins(*summary.band)
            gram, added = np.zeros((2, *(2 + len(names),) * 2))
            gram[0] = gram[:, 0] = np.asarray(one.constant).sum((0, 1))
            gram[1:, 1:] = np.asarray(one.moments).sum((0, 1))
            if one.noise is not None:
                added[1:, 1:] = np.asarray(one.noise).sum((0, 1))
            rows.append(factor_of_gram(gram))
            noise.append(factor_of_gram(added))
            mixes.append(np.zeros((2 + len(names), 1 + len(columns))))
            mixes[-1][1, 0] = 1.0
            for mix, name in zip(mixes[-1][2:], names):
                if name in columns:
                    mix[1 + columns.index(name)] = 1.0
                else:
                    mix[0] = -float(table.known.get(name, 1.0))

        def mixed(factors: list[np.ndarray]) -> tuple[Rows, dict[str, Rows]]:
            target, *found = np.concatenate([f @ mix for f, mix in zip(factors, mixes)]).T
            return target, dict(zip(columns, found))

        (self.target, self.columns), self.noise = mixed(rows), mixed(noise)
        # Unit vectors along what is constant over all records, or over each of them.
        edges = np.cumsum([0, *map(len, rows)])
        constants = np.zeros((edges[-1], len(rows)))
        constants[edges[:-1], np.arange(len(rows))] = [factor[0, 0] for factor in rows]
        if not table.per_record.intersection(equation.parameters):
            constants = constants.sum(axis=1, keepdims=True)
        sizes = np.linalg.norm(constants, axis=0)
        self.constants = constants / np.where(sizes > 0, sizes, 1.0)

    @property
    def inputs(self) -> list[str]:
        """Signals of its known terms."""
        return [t.of for t in self.equation.terms if not t.parameters and isinstance(t.of, str)]

    def moving(self, rows: Rows) -> Rows:
        """Rows less their mean: of each record where a parameter differs between records."""
        return rows - self.constants @ (rows @ self.constants)

    def share(self, column: Rows) -> float:
        """How much of a column moves."""
        size = _norm(column)
        return _norm(self.moving(column)) / size if size > 0 else 0.0

    def left_by_motion(self) -> float:
        """Share, rms, of how the target varies that motion does not explain, chance taken off."""
        moving = [(self.moving(column), _norm(column)) for column in self.columns.values()]
        there = [m for m, size in moving if _norm(m) > self.rounding * size]
        varying = self.moving(self.target)
        # Less than rounding of the whole target is not known of what is left of it.
        least = self.rounding * _norm(self.target)
        left = max(_left(varying, there), least) / _norm(varying)
        free = self.independent - 1
        return left * np.sqrt(free / (free - len(there))) if free > len(there) else 1.0

    def left_by_means(self, left: float) -> float:
        """Share, rms, of how the target varies that a fit with the means leaves, where that is more
        than what is left by motion, and noise, explain; else 0.

        Motion alone attenuates the coefficient of a noisy regressor where others replace it, and
        so leaves less than noise would at the coefficients of this fit.
        """
        theta, size = _fit(self.target, [*self.columns.values()]), _norm(self.moving(self.target))
        fitted, noise = (
            _norm(self.moving(target - np.stack([*columns.values()], axis=1) @ theta)) / size
            for target, columns in ((self.target, self.columns), self.noise)
        )
        return fitted if fitted > DISAGREEING * np.hypot(left, noise) + SLIGHT else 0.0

    def candidates(self) -> list[list[str]]:
        """Columns that may stand for all: of each term, still ones first, and of all that are."""
        groups: list[list[str]] = []
        for term in self.equation.terms:
            names = [n for n in self.table.everywhere(term.parameters) if n in self.columns]
            if names and names not in groups:
                groups.append(names)
        groups.sort(key=lambda names: max(self.share(self.columns[name]) for name in names))
        return [*groups, [name for name, c in self.columns.items() if self.share(c) <= STILL]]


def _fit(target: Rows, columns: list[Rows]) -> Float[np.ndarray, " columns"]:
    """Coefficients of least squares; zero for columns that are not finite."""
    sizes = np.array([_norm(column) or 1.0 for column in columns])
    matrix = np.stack([c / s for c, s in zip(columns, sizes)], axis=1)
    if not np.isfinite(matrix).all():
        return np.zeros(sizes.size)
    return np.linalg.lstsq(matrix, target, rcond=ROUNDING * np.finfo(float).eps ** 0.5)[0] / sizes


def _left(target: Rows, columns: list[Rows]) -> float:
    """Length of what least squares leave of a target."""
    if not columns:
        return _norm(target)
    return _norm(target - np.stack(columns, axis=1) @ _fit(target, columns))


def _norm(rows: Rows) -> float:
    return float(np.linalg.norm(rows))
