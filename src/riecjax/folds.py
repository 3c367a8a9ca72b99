"""Blocks of time of one Gram matrix of all columns, and what structures say of those left out.

With M the sums of products of target and columns over one fold and N what sensor noise adds to
them, C = M - N is that of the signals. A structure is a set of columns. Its coefficients come from
the sum of C over all folds but one, and are held against the one: v^T C v with v = (1, -theta) is
what it leaves unexplained of the motion there, v^T M v of the samples, noise included. No sample
is read, so that a structure costs one solve of p equations a fold.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.special
from jaxtyping import Bool, Float, Int

from riecjax.linear_algebra import eliminate_with_pivots, unit_scale

FOLDS = 20
"""At most: more would make little difference to what is left out of each fit."""
COLLINEAR = 1e-6
"""Least eigenvalue of the columns' correlations, that of one column as many as there are."""


class Left(NamedTuple):
    """What a structure leaves of each fold that it was not fitted to.

    **Fields:** `motion`, of the signals less their noise; `samples`, noise included.
    """

    motion: Float[np.ndarray, "*structures folds"]
    samples: Float[np.ndarray, "*structures folds"]

    def of(self, structure: int) -> "Left":
        """One of several along the first axis."""
        return Left(self.motion[structure], self.samples[structure])


class Folds(NamedTuple):
    """Moments of target and columns by folds of time.

    **Fields:** `samples`, and `motion`, the same less what noise adds, shape
    `(folds, 1 + p, 1 + p)`; `parameters`, names of the p columns.
    """

    samples: Float[np.ndarray, "folds columns columns"]
    motion: Float[np.ndarray, "folds columns columns"]
    parameters: tuple[str, ...]

    @classmethod
    def of(
        cls,
        samples: Float[np.ndarray, "blocks columns columns"],
        motion: Float[np.ndarray, "blocks columns columns"],
        count: Float[np.ndarray, " blocks"],
        parameters: Sequence[str],
    ) -> "Folds":
        """Of moments by block, those of a `count` of zero left out."""
        used = np.flatnonzero(np.asarray(count) > 0)
        number = min(FOLDS, used.size)
        first = -(-np.arange(number) * used.size // max(number, 1))

        def added(blocks: np.ndarray) -> np.ndarray:
            return np.add.reduceat(np.asarray(blocks, float)[used], first)

        return cls(added(samples), added(motion), tuple(parameters))

    @property
    def number(self) -> int:
        """Of folds."""
        return len(self.motion)

    @property
    def energy(self) -> float:
        """Of the target, all folds together."""
        return float(self.samples[:, 0, 0].sum())

    def drawn(self, index: Sequence[int] | np.ndarray) -> "Folds":
        """These folds instead: one that is drawn several times weighs as often, and is left out as
        a whole, since its copies would tell of it."""
        place, times = np.unique(index, return_counts=True)
        weights = times[:, None, None]
        return Folds(self.samples[place] * weights, self.motion[place] * weights, self.parameters)

    def columns(self, names: Sequence[str]) -> np.ndarray:
        """Places of columns, that of the target being 0."""
        return np.array([1 + self.parameters.index(name) for name in names], int)

    def fitted(self, names: Sequence[str]) -> Float[np.ndarray, " p"]:
        """Coefficients from all folds."""
        at, total = self.columns(names), self.motion.sum(0)
        return solved(total[np.ix_(at, at)], total[at, 0])

    def values(self, names: Sequence[str]) -> dict[str, float]:
        """The same by name."""
        return dict(zip(names, self.fitted(names).tolist()))

    def unexplained(self, names: Sequence[str]) -> Float[np.ndarray, " folds"]:
        """Energy of the motion that the coefficients from all folds leave of each."""
        at, row = np.append(0, self.columns(names)), np.append(1.0, -self.fitted(names))
        return np.einsum("i,fij,j->f", row, self.motion[:, at[:, None], at], row)

    def left(self, names: Sequence[str]) -> Left:
        """What is unexplained of each fold by coefficients from all others."""
        at = np.concatenate([[0], self.columns(names)])
        motion, samples = (of[:, at[:, None], at] for of in (self.motion, self.samples))
        others = motion.sum(0) - motion
        theta = solved(others[:, 1:, 1:], others[:, 1:, 0])
        v = np.concatenate([np.ones((self.number, 1)), -theta], axis=1)
        return Left(*(np.einsum("fi,fij,fj->f", v, of, v) for of in (motion, samples)))

    def told(self, names: Sequence[str], column: str) -> "Told":
        """A column's coefficient beside all others of a structure."""
        return self.beside([name for name in names if name != column], [column])[0]

    def beside(self, names: Sequence[str], columns: Sequence[str]) -> list["Told"]:
        """Each of some columns in turn beside the columns of a structure, see `errors`."""
        base, own = self.columns(names), self.columns(columns)
        scale = unit_scale(np.diagonal(self.motion.sum(0)))
        every = self.motion * scale[:, None] * scale
        gram, across = every[:, base[:, None], base], every[:, base[:, None], own]
        inverse = np.linalg.pinv(gram.sum(0), 1e-12, hermitian=True)
        theta, along = inverse @ every[:, base, 0].sum(0), inverse @ across.sum(0)
        left = every[:, base, 0] - gram @ theta
        scores = every[:, own, 0] - np.einsum("fpc,p->fc", across, theta) - left @ along

        def apart(every: np.ndarray) -> np.ndarray:
            """Energy of what no combination of the others explains."""
            return (
                every[..., own, own]
                - 2 * np.einsum("...pc,pc->...c", every[..., base[:, None], own], along)
                + np.einsum("pc,...pq,qc->...c", along, every[..., base[:, None], base], along)
            )

        energy = apart(every)
        total = energy.sum(0)
        value = scores.sum(0) / np.where(total > 0, total, np.inf)
        gained = scores.sum(0) * value / scale[0] ** 2
        error = errors(scores - value * energy, energy)
        size = scale[own] / scale[0]
        noise = apart((self.samples - self.motion).sum(0) * scale[:, None] * scale)
        parts = np.array([size * value, size * error, total, noise, gained])
        return [Told(*part, freedom=self.number - 1) for part in parts.T.tolist()]

    @np.errstate(invalid="ignore", over="ignore")
    def left_with(
        self,
        columns: Int[np.ndarray, " p"],
        there: Bool[np.ndarray, "structures p"],
        more: Int[np.ndarray, "groups q"],
    ) -> Left:
        """What several structures leave, each with each of several groups of columns more.

        A_f, b_f are the Gram matrix and moments of a structure's columns from all folds but f, H_f
        the products of these columns with a group's, D_f and d_f the group's own. By elimination

            Z = A^-1 H,  (D - H^T Z) t = d - H^T theta_0,  theta = theta_0 - Z t,

        so that a structure costs one elimination a fold, whatever the number of groups. A matrix is
        positive definite where all pivots are positive: those of all folds together, less
        `COLLINEAR` on the diagonal of the correlations, say what can be told apart.

        **Arguments:** places of the `columns` of all structures; which of them are `there` in each;
        places of those in groups of `more`, filled up with 0.

        **Returns:** shape `(structures, groups, folds)`, infinite where columns cannot be told
        apart.
        """
        at, is_added = np.concatenate([[0], columns]), more > 0
        both_added = is_added[:, :, None] & is_added[:, None, :]

        def blocks(of: np.ndarray) -> list[np.ndarray]:
            return [
                of[:, at[:, None], at],
                of[:, at[:, None, None], more] * is_added,
                np.where(
                    both_added, of[:, more[:, :, None], more[:, None, :]], np.eye(more.shape[1])
                ),
            ]

        # From all folds but one, and from all.
        motion, total = blocks(self.motion), [part.sum(0) for part in blocks(self.motion)]
        gram, cross, added = (
            np.concatenate([whole - part, whole[None]]) for whole, part in zip(total, motion)
        )
        # Columns scaled to unit length.
        scale = unit_scale(np.diagonal(gram, axis1=1, axis2=2)[:, 1:])
        scale_added = unit_scale(np.diagonal(added, axis1=2, axis2=3))
        a = gram[:, 1:, 1:] * scale[:, :, None] * scale[:, None, :]
        h = cross[:, 1:] * scale[:, :, None, None] * scale_added[:, None]
        d = added * scale_added[..., None] * scale_added[..., None, :]
        a[-1] -= COLLINEAR * np.eye(columns.size)
        d[-1] -= COLLINEAR * np.eye(more.shape[1])
        right = np.concatenate(
            [gram[:, 1:, :1] * scale[:, :, None], h.reshape(*scale.shape, more.size)], axis=2
        )
        # Of columns that are not in a structure coefficients are zero.
        both = (there[:, :, None] & there[:, None, :])[:, None]
        reduced, pivots = eliminate_with_pivots(
            np.where(both, a, np.eye(columns.size)), right * there[:, None, :, None]
        )
        theta, z = reduced[..., 0], reduced[..., 1:].reshape(*reduced.shape[:3], *more.shape)
        moment = cross[:, 0] * scale_added - np.einsum("fpkq,sfp->sfkq", h, theta)
        t, pivots_added = eliminate_with_pivots(
            d - np.einsum("fpkq,sfpkr->sfkqr", h, z), moment[..., None]
        )
        are_apart = np.all(pivots[:, -1] > 0, axis=-1)[:, None]
        are_apart = are_apart & np.all(pivots_added[:, -1] > 0, axis=-1)
        # v = (1, -theta_0 + Z t, -t), in the units of the columns.
        v = np.ones((*t.shape[:1], self.number, at.size, len(more)))
        t, theta, z = t[:, :-1, ..., 0], theta[:, :-1, :, None], z[:, :-1]
        v[:, :, 1:] = (np.einsum("sfpkq,sfkq->sfpk", z, t) - theta) * scale[:-1, :, None]
        t = t * scale_added[:-1]

        def energy(of: Sequence[np.ndarray], otherwise: float) -> np.ndarray:
            g, h, d = of
            found = np.sum(v * (g @ v), axis=2)
            found -= 2 * np.einsum("sfmk,fmkq,sfkq->skf", v, h, t).swapaxes(1, 2)
            found += np.einsum("sfkq,fkqr,sfkr->sfk", t, d, t)
            return np.where(are_apart[:, :, None], found.swapaxes(1, 2), otherwise)

        return Left(energy(motion, np.inf), energy(blocks(self.samples), 0.0))


class Told(NamedTuple):
    """A column beside others.

    **Fields:** `value` and standard `error` of its coefficient, of so many degrees of `freedom`;
    `own`, share of its energy that no combination of the others explains, and the `noise` in that;
    energy of the target that is `gained` by it.
    """

    value: float
    error: float
    own: float
    noise: float
    gained: float
    freedom: int

    def times(self, factor: float) -> "Told":
        """The same in another unit."""
        return self._replace(value=factor * self.value, error=abs(factor) * self.error)

    @property
    def chance(self) -> float:
        """Probability that one which explains nothing is as far from zero, by Student's t."""
        exact = np.inf if abs(self.value) > 0 else 0.0
        away = abs(self.value) / self.error if self.error > 0 else exact
        return float(2 * scipy.special.stdtr(max(self.freedom, 1), -away))


def errors(
    scores: Float[np.ndarray, "folds columns"], energy: Float[np.ndarray, "folds columns"]
) -> Float[np.ndarray, " columns"]:
    """Standard errors of columns' coefficients; infinite where a column has no energy.

    With s_f the score of what is a column's own, all others fitted, and g_f its energy in fold f,
    the coefficient's variance is `sum s^2 / (sum g)^2`, whatever errors are like in each fold.
    Where a few folds have most of the energy that has few degrees of freedom, and `mean(s^2 / g) /
    sum g`, which holds where errors are alike all along, has one a fold. The larger of both is
    taken.
    """
    number, total = len(energy), energy.sum(0)
    total = np.where(total > 0, total, np.inf)
    some = energy > 1e-6 * total
    if number < 2:
        return np.full(total.shape, np.inf)
    apart = np.sum(scores**2, axis=0) / total**2
    alike = np.where(some, scores**2 / np.where(some, energy, 1.0), 0.0).sum(0)
    alike = alike / np.maximum(some.sum(0), 1) / total
    error = np.sqrt(np.maximum(apart, alike) * number / (number - 1))
    return np.where(some.any(0), error, np.inf)


def solved(
    gram: Float[np.ndarray, "*folds p p"], moment: Float[np.ndarray, "*folds p"]
) -> Float[np.ndarray, "*folds p"]:
    """Least squares of columns that are scaled to unit length."""
    scale = unit_scale(np.diagonal(gram, axis1=-2, axis2=-1))
    scaled = gram * scale[..., :, None] * scale[..., None, :]
    try:
        found = np.linalg.solve(scaled, (moment * scale)[..., None])[..., 0]
    except np.linalg.LinAlgError:
        found = (np.linalg.pinv(scaled) @ (moment * scale)[..., None])[..., 0]
    return found * scale
