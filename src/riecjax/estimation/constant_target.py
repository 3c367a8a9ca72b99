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
# It asks for lengths of the columns b, a_j and angles between them, which their products tell: the
# moments of the rows [1, b, a], G, and those of the deviations. With c^T c the product of the
# constant with itself, and c^T b, c^T a_j those with the others, deviations have the products
#
#     b'^T a_j' = b^T a_j - (b^T c) (c^T a_j) / (c^T c),
#
# from sums over all records, or added up over records where means are each one's own. Of a share
# they tell the square: to eps, and the share to its root.

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from riecjax.equations.equation import Equation
from riecjax.equations.model import Model
from riecjax.estimation.parameters import ParameterTable
from riecjax.findings import Finding, in_percent
from riecjax.linear_algebra import unit_diagonal
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
ROUNDING = 8.0
"""Times the root of eps: share of a column, of moments, that may be rounding."""
SUMMED = 1e-6
"""The same at least: moments over many windows are exact to 300 eps of 64 bits, measured."""
TARGET = ""
"""What stands for it among the names of columns."""
Products = Float[np.ndarray, "columns columns"]


# Values too large to be squared are for the fit to refuse.
@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def target_findings(model: Model, table: ParameterTable, summary: Summary) -> list[Finding]:
    """Equations whose target is zero, or constant and reproduced by one term (not under jit).

    **Arguments:** `summary`, with a constant beside all equations.
    """
    constants = []
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
    return constants


def _fitted_by_zero(seen: "_Averaged", others: list["_Averaged"]) -> str:
    """In words, that zero for all fits; empty if it does not."""
    if seen.size(TARGET) != 0:
        return ""
    moving = [name for name in seen.columns if seen.size(name) > 0]
    # What other equations tell reaches this one through those that share parameters.
    linked, rest = set(seen.names), list(others)
    while near := [other for other in rest if linked & other.names]:
        if any(other.size(TARGET) != 0 for other in near):
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
    size = seen.size(TARGET)
    varying = seen.share(TARGET) * size
    # Negated, so that what is not finite is passed over.
    if not (size > 0 and varying <= CONSTANT * size):
        return ""
    columns = seen.columns
    left = seen.left_by_motion() if varying > seen.rounding * size else 1.0
    if left**2 < 1 - EXPLAINED:
        # What other equations tell of a parameter, this one's means do not settle.
        if elsewhere.isdisjoint(columns) and (fitted := seen.left_by_means(left)) > 0:
            options = [f"on the command line: --unknown-offset {name}" for name in seen.inputs[:1]]
            ways = "; ".join([*options, "rx.Term('offset', rx.constant)"])
            return (
                f"the constant parts disagree with the motion, as with a wrong zero of a sensor: "
                f"together they leave {in_percent(fitted)} of how the input varies, motion alone "
                f"{in_percent(left)}. Add a constant term ({ways}), or remove the signals' "
                f"offsets."
            )
        return ""
    for names in seen.candidates():
        hidden = [name for name in columns if name not in names and name not in elsewhere]
        left = seen.left(seen.products, names)
        if hidden and left <= np.hypot(varying, STILL * size):
            # Others at rest to the last digit are collinear with these, and are named as that.
            if any(seen.size(n) > 0 and seen.share(n) <= seen.rounding for n in hidden):
                return ""
            who, others = ", ".join(names), ", ".join(hidden)
            one, other = ("s" if len(group) == 1 else "" for group in (names, hidden))
            if all(seen.rounding < seen.share(name) <= STILL for name in names):
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
    """Products of one equation's target and regressors over all records, and how these move.

    **Attributes:** `columns`, the unknown coefficients, in order, behind the target, which is what
    the known terms amount to, what an earlier stage finds among them; `products` of all, those of
    their deviations (`moving`), and what of these `noise` adds; `names` of the coefficients;
    `rounding`, share of a column that is none of it.
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
        self.rounding = max(ROUNDING * float(np.finfo(dtype).eps) ** 0.5, SUMMED)
        called = [table.of_record(one.parameters, i) for i, one in enumerate(recordings)]
        self.columns = [*dict.fromkeys(n for names in called for n in names if n in self.names)]
        # Of the rows `[1, target, regressors]`, mixes of whose columns are the target less what is
        # known, and regressors of the unknown.
        grams = np.zeros((len(recordings), *(2 + len(self.columns),) * 2))
        self.noise = np.zeros(grams.shape[1:])
        for gram, sums, names in zip(grams, recordings, called):
            one = sums.of_bins(*summary.band)
            rows, added = np.zeros((2, *(2 + len(names),) * 2))
            rows[0] = rows[:, 0] = np.asarray(one.constant).sum((0, 1))
            rows[1:, 1:] = np.asarray(one.moments).sum((0, 1))
            if one.noise is not None:
                added[1:, 1:] = np.asarray(one.noise).sum((0, 1))
            mix = np.zeros((len(gram), len(rows)))
            mix[0, 0] = mix[1, 1] = 1.0
            for place, name in enumerate(names, start=2):
                if name in self.columns:
                    mix[2 + self.columns.index(name), place] = 1.0
                else:
                    mix[1, place] = -float(table.known.get(name, 1.0))
            gram += mix @ rows @ mix.T
            self.noise += mix @ added @ mix.T
        self.products, self.noise = grams.sum(0)[1:, 1:], self.noise[1:, 1:]
        if not table.per_record.intersection(equation.parameters):
            grams = grams.sum(0, keepdims=True)
        means = grams[:, 0, 1:]
        constant = np.where(grams[:, 0, 0] > 0, grams[:, 0, 0], 1.0)
        self.moving = self.products - np.einsum("ki,kj,k->ij", means, means, 1 / constant)

    @property
    def inputs(self) -> list[str]:
        """Signals of its known terms."""
        return [t.of for t in self.equation.terms if not t.parameters and isinstance(t.of, str)]

    def size(self, name: str, products: Products | None = None) -> float:
        """Length of a column, or of the target; of its deviations by theirs."""
        place = 0 if name == TARGET else 1 + self.columns.index(name)
        of = self.products if products is None else products
        return float(np.sqrt(np.maximum(of[place, place], 0.0)))

    def share(self, name: str) -> float:
        """How much of a column, or of the target, moves."""
        size = self.size(name)
        return self.size(name, self.moving) / size if size > 0 else 0.0

    def left(self, products: Products, names: Sequence[str]) -> float:
        """Length of what least squares on some columns leave of the target."""
        place = [0, *(1 + self.columns.index(name) for name in names)]
        some = products[np.ix_(place, place)]
        return _length(some, _fit(some))

    def left_by_motion(self) -> float:
        """Share, rms, of how the target varies that motion does not explain, chance taken off."""
        there = [name for name in self.columns if self.share(name) > self.rounding]
        # Less than rounding of the whole target is not known of what is left of it.
        left = max(self.left(self.moving, there), self.rounding * self.size(TARGET))
        left, free = left / self.size(TARGET, self.moving), self.independent - 1
        return left * np.sqrt(free / (free - len(there))) if free > len(there) else 1.0

    def left_by_means(self, left: float) -> float:
        """Share, rms, of how the target varies that a fit with the means leaves, where that is more
        than what is left by motion, and noise, explain; else 0.

        Motion alone attenuates the coefficient of a noisy regressor where others replace it, and
        so leaves less than noise would at the coefficients of this fit.
        """
        theta, size = _fit(self.products), self.size(TARGET, self.moving)
        fitted, noise = (_length(of, theta) / size for of in (self.moving, self.noise))
        return fitted if fitted > DISAGREEING * np.hypot(left, noise) + SLIGHT else 0.0

    def candidates(self) -> list[list[str]]:
        """Columns that may stand for all: of each term, still ones first, and of all that are."""
        groups: list[list[str]] = []
        for term in self.equation.terms:
            names = [n for n in self.table.everywhere(term.parameters) if n in self.columns]
            if names and names not in groups:
                groups.append(names)
        groups.sort(key=lambda names: max(map(self.share, names)))
        return [*groups, [name for name in self.columns if self.share(name) <= STILL]]


def _fit(products: Products) -> Float[np.ndarray, " columns"]:
    """Coefficients of least squares on all columns but the first, the target; zero for what is not
    finite."""
    gram, scale = unit_diagonal(products[1:, 1:])
    if not np.isfinite(products).all():
        return np.zeros(scale.size)
    least = ROUNDING**2 * np.finfo(float).eps
    return scale * (np.linalg.pinv(gram, least, hermitian=True) @ (scale * products[1:, 0]))


def _length(products: Products, theta: Float[np.ndarray, " columns"]) -> float:
    """Of the target less columns times coefficients."""
    row = np.concatenate([[1.0], -theta])
    return float(np.sqrt(np.maximum(row @ products @ row, 0.0)))
