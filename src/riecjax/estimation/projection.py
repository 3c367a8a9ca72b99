"""Elements by variable projection: their shapes are searched, all else is solved for.

For given shapes an equation is linear, and its normal equations are a
combination V^T G V of those of its expanded columns. So a search over shapes needs p x p algebra
only, once G is there. Where the shape is best, the equation is linearised about the solution: a
Gauss-Newton step from there stays there, and everything that is said of a linear fit, its scores,
blocks and replicates, is said of this one.

What is made small is the residual's energy less what noise adds. Multiplied by D a residual is
small where D is, whatever the mode's mass: shapes are therefore compared by the share of the
target D y that they leave, and only the last steps, from the best of them, are of the energy.
"""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from riecjax import arrays as xp
from riecjax.arrays import Array
from riecjax.equations.element import Band, Element, Shape, Values
from riecjax.equations.expanded import Expanded
from riecjax.equations.model import Model
from riecjax.errors import IdentifiabilityError
from riecjax.leaves import Leaf
from riecjax.linear_algebra import solve_scaled, symmetric_eigen
from riecjax.summaries.normal_equations import (
    EquationSums,
    NormalEquations,
    Outline,
    Survey,
    sum_of_equations,
)
from riecjax.summaries.summary import Summary
from riecjax.uncertainty.covariances import block_influence

GRID = 48
"""Points of a grid along the first coordinate of a shape."""
STEPS = 12
"""Newton steps from the best point of the grid."""
FARTHEST = 0.3
"""Of one step, in any coordinate."""
SHORTENED = (1.0, 0.5, 0.2, 0.05, 0.01, 0.0)
"""Of each step the best of these shares is gone."""


class ShapedStage(NamedTuple):
    """One stage in which elements are to be found, and its sums.

    **Fields:** `equations`; `moments` of each, less noise; `unknown`, coefficients to be found;
    `sought`, elements that are to be found; `given` values. An element that is neither sought nor
    given is not there.

    Shapes of all that is sought are one array, of the coordinates of each in turn.
    """

    equations: tuple[Expanded, ...]
    moments: list[Float[Array, "*batch columns columns"]]
    unknown: tuple[str, ...]
    sought: tuple[Element, ...]
    given: dict[str, Array]
    grid: int = GRID

    @classmethod
    def of(
        cls, equations: tuple[Expanded, ...], sums: list[NormalEquations], known: Values
    ) -> "ShapedStage":
        """The stage, from the sums of each of its equations with any leading axes."""
        names = dict.fromkeys(name for e in equations for name in e.parameters)
        elements = dict.fromkeys(of for e in equations for of, _ in e.elements)
        return cls(
            equations,
            [one.flattened().total().clean for one in sums],
            tuple(name for name in names if name not in known),
            tuple(of for of in elements if of.hidden[0] not in known),
            dict(known),
        )

    @property
    def linear(self) -> tuple[str, ...]:
        """What is solved for at a shape: coefficients, and what elements sought are linear in."""
        hidden = (of.linear for of in self.sought if of.linear not in self.given)
        return tuple(dict.fromkeys((*self.unknown, *hidden)))

    def by_element(self, at: Float[Array, "*batch shapes"]) -> dict[Element, Array]:
        """The part of each element that is sought."""
        counts = [element.coordinates for element in self.sought]
        ends = np.cumsum(counts, dtype=int).tolist()
        return {one: at[..., end - n : end] for one, n, end in zip(self.sought, counts, ends)}

    def projected(self, at: Float[Array, "*batch shapes"]) -> "Projected":
        """The best fit with elements of these shapes."""
        return self.fitted(self.mixes(at))

    def fitted(self, mixes: list[Float[Array, "*batch 1+linear c"]]) -> "Projected":
        """The best fit of the target by the regressors, both combinations of columns."""
        pairs = zip(mixes, self.moments)
        return Projected.of(sum(mix @ sums @ xp.swapaxes(mix, -1, -2) for mix, sums in pairs))

    def mixes(self, at: Float[Array, "*batch shapes"]) -> list[Float[Array, "*batch 1+linear c"]]:
        """Target and regressors of each equation, as combinations of its columns.

        The residual is affine in theta: its value at zero is the target's, and a regressor is by
        how much a coefficient of one makes it less.
        """
        count = len(self.linear)
        places = np.concatenate([np.zeros((1, count)), np.eye(count)]).astype(at.dtype)
        places = places.reshape((1,) * (at.ndim - 1) + places.shape)
        every = (
            xp.broadcast_to(table, (*at.shape[:-1], 1 + count, table.shape[-1]))
            for table in self.residuals(at[..., None, :], places)
        )
        return [
            xp.concatenate([table[..., :1, :], table[..., :1, :] - table[..., 1:, :]], axis=-2)
            for table in every
        ]

    def shares(
        self, at: Float[Array, "*batch shapes"]
    ) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """What elements of these shapes leave of the target D y, infinite where none of positive
        size fits, and what is left without the last one."""
        fit = self.projected(at)
        sizes = fit.theta[..., len(self.unknown) :]
        target = self._target(at, fit)
        good = xp.all(sizes > 0, axis=-1) & (target > 0) & xp.isfinite(fit.energy)
        target = xp.where(target > 0, target, 1.0)
        return xp.where(good, fit.energy / target, xp.inf), fit.without_last().energy / target

    def _target(
        self, at: Float[Array, "*batch shapes"], fit: "Projected"
    ) -> Float[Array, "*batch"]:
        """Energy of the target D y, of which no known force of an element sought is part: it
        changes with the shape, and shares of it would be small where it is large."""
        known = {one.linear for one in self.sought} & {*self.given}
        if not known:
            return fit.target
        bare = self._replace(given={**self.given, **dict.fromkeys(known, np.zeros(()))})
        energy = bare.energy(self.moments, at, xp.zeros_like(fit.theta))
        return xp.where(energy > 0, energy, fit.target)

    def slope_and_bend(
        self, at: Float[Array, " shapes"]
    ) -> tuple[Float[Array, " shapes"], Float[Array, "shapes shapes"]]:
        """First and second derivatives of the least energy F by the shapes x.

        F(x, theta) is least in theta, so that its slope is F_x and its bend
        F_xx - F_xt F_tt^-1 F_tx.
        """

        # Derivatives of the combinations by x are central differences, which no moment enters: the
        # slope's own derivative by the moments, which the implicit function theorem asks for, is
        # exact.
        step, count = float(np.finfo(at.dtype).eps) ** 0.25, at.shape[-1]
        unit = step * np.eye(count, dtype=at.dtype)
        both, apart = unit[:, None] + unit, unit[:, None] - unit
        once, twice = np.stack([unit, -unit]), np.stack([both, apart, -apart, -both])
        offsets = [each.reshape(-1, count) for each in (np.zeros_like(unit[:1]), once, twice)]
        around = self.mixes(at[None] + np.concatenate(offsets))
        theta = self.fitted([table[0] for table in around]).theta
        theta = xp.concatenate([xp.ones_like(theta[:1]), -theta])
        none: Any = 0.0
        slope = own = mixed = inner = none
        for moments, table in zip(self.moments, around):
            mix, rows_once, rows_twice = table[0], table[1 : 1 + 2 * count], table[1 + 2 * count :]
            up, down = rows_once.reshape(2, count, *mix.shape)
            first = (up - down) / (2 * step)
            corners = (theta @ rows_twice).reshape(4, count, count, -1)
            second = (corners[0] - corners[1] - corners[2] + corners[3]) / (4 * step**2)
            moved, rows = theta @ first, -mix[1:]
            left = moments @ (theta @ mix)
            slope = slope + 2 * moved @ left
            own = own + 2 * (moved @ moments @ moved.T + second @ left)
            mixed = mixed + 2 * (moved @ moments @ rows.T - first[:, 1:] @ left)
            inner = inner + 2 * rows @ moments @ rows.T
        return slope, own - mixed @ solve_scaled(inner, mixed.T)

    def energy(
        self,
        moments: list[Float[Array, "*batch columns columns"]],
        at: Float[Array, "*batch shapes"],
        theta: Float[Array, "*batch linear"],
    ) -> Float[Array, "*batch"]:
        """What elements of these shapes and coefficients leave of some moments."""
        every = zip(self.residuals(at, theta), moments)
        return sum(
            (xp.einsum("...i,...ij,...j->...", r, m, r) for r, m in every), start=np.zeros(())
        )

    def residuals(
        self, at: Float[Array, "*batch shapes"], theta: Float[Array, "*batch linear"]
    ) -> list[Float[Array, "*batch columns"]]:
        """Of each equation, as combinations of its columns."""
        sought = self.by_element(at)
        values = {**self.given, **dict(zip(self.linear, xp.moveaxis(theta, -1, 0)))}

        def shape(element: Element) -> Shape:
            known = element not in sought and element.hidden[0] in self.given
            return element.shape(self.given) if known else element.shape_at(sought.get(element))

        return [e.residual(values, [shape(of) for of, _ in e.elements]) for e in self.equations]

    def values(self, at: Float[Array, " shapes"]) -> dict[str, Array]:
        """Every parameter of the stage by name, for elements of these shapes."""
        found = {**self.given, **dict(zip(self.linear, self.projected(at).theta))}
        for element, row in self.by_element(at).items():
            found |= element.values_at(row, found)
        return found

    def with_derivative(self, at: Float[Array, " shapes"]) -> Float[Array, " shapes"]:
        """Shapes of least energy, which change with the sums as these ask for."""
        # One more Newton step. At the minimum it is zero, and by the implicit function theorem its
        # derivative is that of the minimum, the bend being held still: only derivatives come of it.
        at = xp.stop_gradient(at)
        slope, bend = self.slope_and_bend(at)
        step = solve_scaled(xp.stop_gradient(bend), slope[:, None])[:, 0]
        return at - (step - xp.stop_gradient(step))


class Projected(NamedTuple):
    """A least-squares fit: `theta`, the `energy` of what it leaves, that of the `target`."""

    theta: Float[Array, "*batch linear"]
    energy: Float[Array, "*batch"]
    target: Float[Array, "*batch"]
    gram: Float[Array, "*batch 1+linear 1+linear"]

    @classmethod
    def of(cls, gram: Float[Array, "*batch 1+linear 1+linear"]) -> "Projected":
        """Of the Gram matrix of target and regressors."""
        target, moment = gram[..., 0, 0], gram[..., 1:, 0]
        theta = solve_scaled(gram[..., 1:, 1:], moment[..., None])[..., 0]
        return cls(theta, target - (moment * theta).sum(axis=-1), target, gram)

    def without_last(self) -> "Projected":
        """The fit without the size of the last element, which is then zero."""
        if self.gram.shape[-1] <= 2:
            return self._replace(theta=xp.zeros_like(self.theta), energy=self.target)
        fit = Projected.of(self.gram[..., :-1, :-1])
        nothing = xp.zeros_like(fit.theta[..., :1])
        theta = xp.concatenate([fit.theta, nothing], axis=-1)
        return self._replace(theta=theta, energy=fit.energy)


def search(stage: ShapedStage, bands: Sequence[Band]) -> Float[Array, " shapes"]:
    """Where elements fit best: one after the other on a grid, then all by Newton's steps.

    Those come first that change an equation most.

    **Arguments:** `bands` in which to look for each.
    """
    at = np.zeros(0, stage.moments[0].dtype)
    for number, (element, band) in enumerate(zip(stage.sought, bands), start=1):
        part = stage._replace(sought=stage.sought[:number])
        axes, count = element.axes(band, stage.grid), element.coordinates
        grid = xp.stack(xp.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, count)
        shapes = xp.concatenate([xp.tile(at, (len(grid), 1)), grid.astype(at.dtype)], axis=1)
        left, _ = part.shares(shapes)
        at = polished(part, xp.take(shapes, xp.argmin(left), axis=0))
    return at


def as_asked(at: Float[Array, " shapes"], stage: ShapedStage) -> Float[Array, " shapes"]:
    """Elements of one class and place exchanged, which changes nothing but their names, so that
    each is as near as may be to where it was asked for, by its first coordinate."""
    parts = stage.by_element(at)
    for one in stage.sought:
        alike = [of for of in stage.sought if (type(of), of.place) == (type(one), one.place)]
        if one is not alike[0] or all(of.near is None for of in alike):
            continue
        rows = xp.stack([parts[of] for of in alike])
        orders = np.array(list(itertools.permutations(range(len(alike)))))
        logs = np.log([np.nan if of.near is None else of.near for of in alike])
        far = xp.nansum(xp.abs(rows[orders, 0] - logs.astype(at.dtype)[None, :]), axis=1)
        nearest = xp.take(orders, xp.argmin(far), axis=0)
        parts |= dict(zip(alike, xp.take(rows, nearest, axis=0)))
    return xp.concatenate([np.zeros(0, at.dtype), *parts.values()])


def polished(stage: ShapedStage, start: Float[Array, " shapes"]) -> Float[Array, " shapes"]:
    """The least energy near a start, by Newton's steps, shortened where they lead up."""
    shares = np.array(SHORTENED, start.dtype)[:, None]

    def step(at: Array) -> Array:
        slope, bend = stage.slope_and_bend(at)
        values, vectors = symmetric_eigen(xp.where(xp.isfinite(bend), bend, 0.0))
        # With the bend's eigenvalues made positive every step leads down.
        rounding = float(xp.finfo(values.dtype).eps) ** 0.5
        size = xp.maximum(xp.abs(values), rounding * xp.max(xp.abs(values)))
        downhill = -vectors @ ((vectors.T @ slope) / xp.where(size > 0, size, 1.0))
        farthest = xp.max(xp.abs(downhill))
        downhill = downhill * xp.minimum(1.0, FARTHEST / xp.where(farthest > 0, farthest, 1.0))
        tried = at[None, :] + shares * downhill[None, :]
        energies = stage.projected(tried).energy
        best = xp.argmin(xp.where(xp.isfinite(energies), energies, np.inf))
        return xp.take(tried, best, axis=0)

    return xp.repeated(step, start, STEPS, beside=(stage.moments, stage.given))


# Elements in the windows that tell most of them, and the sums linearised about them.
#
# Windows of every length have sums of their own. In each elements are searched, and
# promised a standard error; the length that promises the least one is taken. About what is found
# there the stage's equations are linearised, and from then on they are as any others.


Bins = tuple[int, int]
"""Bins of window lengths, first and one beyond the last."""


class FoundShapes(NamedTuple):
    """Where elements are, and what they were found from.

    **Fields:** `summary`, linearised about them; `at`, the shapes of each stage's elements;
    `bands`, of each stage the bins of window lengths that it is solved from, `None` for all or
    under a trace; whether the elements are `shown` in these at all.
    """

    summary: Summary
    at: list[Float[Array, " shapes"]]
    bands: list[Bins | None]
    shown: Bool[Array, ""]


def find_shapes(model: Model, summary: Summary, given: Values, rank: int = 0) -> FoundShapes:
    """The elements of each stage, in the windows that tell most of them.

    Short windows show what is fast, and much noise; which of the lengths tells most is
    seen from the standard errors that each promises. Where lengths were not kept apart all are
    taken.

    **Arguments:** `rank`, 0 for the lengths that tell most, 1 for the next, where there are some.

    **Raises:** `ModelError` where something of an element is known, and not all that it needs, and
    for one beyond what the sampling shows; `IdentifiabilityError` where a signal that tells of an
    element never moves.
    """
    for element in model.hidden:
        element.require_known(given)
    known = {name: xp.asarray(value) for name, value in given.items()}
    found, stages, shown = [], [], np.array(True)
    equations = summary.equations()
    looked_at = xp.is_concrete(equations, known)
    for i, expanded in enumerate(model.expanded):
        stage = ShapedStage.of(expanded, equations[i], known)
        at, band, place = np.zeros(0), None, None
        if stage.sought:
            where = tuple(search_band(summary, element) for element in stage.sought)
            # The sums over the windows that tell most of the stage's elements.
            first, last = summary.band
            options = [(b, b + 1) for b in range(first, last)] if summary.bins else [summary.band]
            every = [summary.equations(option)[i] for option in options]
            stacked: Any = xp.stacked(every)
            best, at, there = _searched(expanded, stacked, known, where, np.asarray(rank))
            used = jax.tree.map(lambda leaf, best=best: xp.take(leaf, best, axis=0), stacked)
            stage = ShapedStage.of(expanded, used, known)
            place = first + best if summary.bins else None
            band = options[int(best)] if summary.bins and xp.is_concrete(best) else None
            shown = shown & there
            # Sums that are not finite themselves are for the fit to refuse.
            finite = looked_at and all(bool(np.isfinite(e.moments).all()) for e in equations[i])
            if finite and not bool(np.isfinite(at).all()):
                raise IdentifiabilityError(
                    f"{', '.join(model.equation_names[i])}: nothing in the record tells of the "
                    f"hidden element, as a signal that it acts on never moves. Check that signal's "
                    f"channel, or excite it.",
                    "not_excited",
                )
            if not looked_at:
                at = stage.with_derivative(at)
        # What no later equation with an element asks for is left to the fit.
        later = [e for stage in model.expanded[i:] for e in stage if e.elements]
        asked = {name for e in later for name in e.all_parameters}
        if asked.intersection(stage.linear):
            known |= stage.values(at)
        stages.append((expanded, [_mix(e, known) for e in expanded], place))
        found.append((at, band))
    recordings = (
        dataclasses.replace(
            one,
            stages=tuple(
                tuple(
                    _in_parameters(*equation, place, summary.band)
                    for equation in zip(expanded, mixes, sums)
                )
                for (expanded, mixes, place), sums in zip(stages, one.stages)
            ),
        )
        for one in summary.recordings
    )
    linear = dataclasses.replace(summary.in_one_bin(recordings), outline=_outline(model))
    shapes, bands = map(list, zip(*found))
    return FoundShapes(linear, shapes, bands, shown)


def _mix(expanded: Expanded, values: Values) -> Float[Array, "1+p columns"]:
    """The combinations of columns that an equation about these values is."""
    return (
        expanded.linearised(values) if expanded.elements else np.eye(1 + len(expanded.parameters))
    )


@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def _searched(
    expanded: tuple[Expanded, ...],
    options: list[NormalEquations],
    known: Values,
    bands: tuple[Band, ...],
    rank: Int[Leaf, ""],
) -> tuple[Array, Float[Array, " shapes"], Bool[Array, ""]]:
    """Which windows tell most of a stage's hidden elements, where they are by these, and whether
    they show any.

    What a length promises is the sum of squares of errors of what is judged, each as a share of the
    one that counts (`Element.doubted`), infinite for what cannot be.

    **Arguments:** `options`, sums with a leading axis of window lengths.
    """
    # The search is not differentiated: what it finds has the minimum's own derivative.
    options, known, bands = xp.stop_gradient((options, dict(known), bands))

    def tried(sums: list[NormalEquations]) -> tuple[Array, Array]:
        stage = ShapedStage.of(expanded, sums, known)
        at = as_asked(search(stage, bands), stage)
        values = stage.values(at)
        own = [one.mixed(_mix(e, values), e.all_parameters) for e, one in zip(expanded, sums)]
        names = tuple(dict.fromkeys(name for e in expanded for name in e.all_parameters))
        influence = block_influence([sum_of_equations(own, names).flattened()], known, values)
        found = [name for name in names if name not in known]
        sought = [name for of in stage.sought for name in of.judged]
        size = xp.stack([values[name] for name in sought])
        place = np.array([found.index(name) for name in sought])
        share = xp.concatenate([of.doubted(values, band) for of, band in zip(stage.sought, bands)])
        doubt = xp.sum(xp.sum(influence**2, axis=0)[place] / share**2)
        target = stage.projected(at).target
        good = xp.all(size > 0) & xp.isfinite(doubt) & (target > 0)
        for element, part in stage.by_element(at).items():
            good = good & element.is_possible(part)
        return xp.where(good, doubt, xp.inf), at

    doubt, at = xp.each(tried, options, beside=(known, bands))
    chosen = xp.argsort(doubt, stable=True)[np.minimum(rank, doubt.shape[0] - 1)]
    return chosen, xp.take(at, chosen, axis=0), xp.isfinite(xp.take(doubt, chosen))


def search_band(summary: Summary, element: Element) -> Band:
    """Where to look for an element."""
    windows = summary.criterion.windows
    assert windows is not None
    steps = [one.time_step for one in summary.recordings]
    slowest = np.max(steps) if xp.is_concrete(steps) else steps[0]
    return element.band(windows.beta, slowest)


# Sums of a model's own parameters, of which hidden elements make it depend nonlinearly on some.
#
# About its solution such a model is linear, with a regressor for each parameter of its elements.
# Their sums are combinations of the expanded columns' sums, so that whatever asks how regressors
# are excited, drowned in noise or integrated need not know of hidden elements.


def linearised(model: Model, summary: Summary, known: Values) -> Summary:
    """Sums of regressors about the hidden elements that these sums say (not under jit).

    Of a model without any, and of sums that are linearised already, the Summary itself.

    **Returns:** a Summary of all windows together, each stage's of those it is solved from; without
    the constant, which tells of no combination of columns.
    """
    if not model.has_hidden or summary.outline.is_of(_outline(model)):
        return summary
    return find_shapes(model, summary, known).summary


def _outline(model: Model) -> Outline:
    """Of a model's own parameters."""
    stages = tuple(
        tuple((e.equation.name, e.all_parameters) for e in stage) for stage in model.expanded
    )
    return Outline(stages, model.parameter_names, tuple(model.units.items()), "")


def _in_parameters(
    expanded: Expanded,
    mix: Float[Array, "1+p columns"],
    sums: EquationSums,
    place: Int[Leaf, ""] | None,
    band: Bins,
) -> EquationSums:
    """The sums of one of the bins, or of all in a band, of combinations of their columns."""

    def of_bin(leaf: Array) -> Array:
        return xp.take(leaf, place, axis=0)[None]

    survey = sums.survey
    if survey is not None:
        noise, quadrature = (mix @ m @ mix.T for m in (survey.noise, survey.quadrature))
        survey = Survey(noise, quadrature, survey.rows @ mix.T, survey.start, survey.reach)
    sums = sums.of_bins(*band) if place is None else sums.each(of_bin, noise_of_source=of_bin)
    sums = sums.mixed(mix, expanded.all_parameters)
    return dataclasses.replace(sums, survey=survey, factor=None, constant=None)
