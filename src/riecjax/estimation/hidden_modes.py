"""Hidden modes by variable projection: frequency and damping are searched, all else is solved for.

For a mode of given shape D = 1 + q s + p s^2 an equation is linear, and its normal equations are a
combination V^T G V of those of its expanded columns. So a search over shapes needs p x p algebra
only, once G is there. Where the shape is best, the equation is linearised about the solution: a
Gauss-Newton step from there stays there, and everything that is said of a linear fit, its scores,
blocks and replicates, is said of this one.

What is made small is the residual's energy less what noise adds. Multiplied by D a residual is
small where D is, whatever the mode's mass: shapes are therefore compared by the share of the
target D y that they leave, and only the last steps, from the best of them, are of the energy.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from riecjax.equations.hidden_modes import Expanded, ModeParameters, Shape
from riecjax.equations.procedure import Procedure
from riecjax.errors import ModelError
from riecjax.leaves import Leaf, held_still
from riecjax.linear_algebra import solve_scaled, symmetric_eigen
from riecjax.summaries.normal_equations import NormalEquations
from riecjax.summaries.stage_sums import sum_of_equations
from riecjax.summaries.summary import Summary
from riecjax.uncertainty.block_statistics import block_influence

Values = Mapping[str, Array]
DAMPINGS = (0.02, 0.06, 0.15, 0.35, 0.8)
"""Damping ratios of the grid."""
FREQUENCIES = 48
"""Frequencies of the grid, in equal ratios."""
STEPS = 12
"""Newton steps from the best point of the grid."""
FARTHEST = 0.3
"""Of one step, in the frequency's logarithm and in the damping ratio."""
SHORTENED = (1.0, 0.5, 0.2, 0.05, 0.01, 0.0)
"""Of each step the best of these shares is gone."""


class ModeStage(NamedTuple):
    """One stage in which modes are to be found, and its sums.

    **Fields:** `equations`; `moments` of each, less noise; `unknown`, coefficients to be found;
    `sought`, of each mode that is to be found its parameters; `given` values.
    """

    equations: tuple[Expanded, ...]
    moments: list[Float[Array, "columns columns"]]
    unknown: tuple[str, ...]
    sought: tuple[ModeParameters, ...]
    given: dict[str, Array]

    @classmethod
    def of(
        cls, equations: tuple[Expanded, ...], sums: list[NormalEquations], known: Values
    ) -> "ModeStage":
        """The stage, from the sums of each of its equations with any leading axes."""
        names = dict.fromkeys(name for e in equations for name in e.parameters)
        modes = dict.fromkeys(of for e in equations for of, _ in e.modes)
        return cls(
            equations,
            [one.flattened().total().clean for one in sums],
            tuple(name for name in names if name not in known),
            tuple(of for of in modes if of.mass not in known),
            dict(known),
        )

    @property
    def linear(self) -> tuple[str, ...]:
        """What is solved for at a shape: coefficients, and masses of the modes sought."""
        return (*self.unknown, *(names.mass for names in self.sought))

    def projected(self, at: Float[Array, "modes 2"]) -> "Projected":
        """The best fit with modes of these shapes, as logarithm of frequency and damping ratio."""
        zero = jnp.zeros(len(self.linear), at.dtype)
        none = self.residuals(at, zero)
        # Residuals are affine in what is solved for: regressors are their slopes, negated.
        slopes = jax.jacfwd(lambda theta: self.residuals(at, theta))(zero)
        gram = jnp.zeros((1 + zero.size,) * 2, at.dtype)
        for rest, slope, moments in zip(none, slopes, self.moments):
            mix = jnp.concatenate([rest[None, :], -slope.T])
            gram = gram + mix @ moments @ mix.T
        return Projected.of(gram)

    def slope_and_bend(
        self, at: Float[Array, "modes 2"]
    ) -> tuple[Float[Array, " 2modes"], Float[Array, "2modes 2modes"]]:
        """First and second derivatives of the least energy by the shapes.

        Of F(x, theta), least in theta: F_x, and F_xx - F_xt F_tt^-1 F_tx.
        """
        count = at.size
        fit = self.projected(at)

        def energy(x: Array) -> Array:
            return self.energy(self.moments, x[:count].reshape(at.shape), x[count:])

        x = jnp.concatenate([at.ravel(), fit.theta])
        slope, bend = jax.grad(energy)(x)[:count], jax.hessian(energy)(x)
        follow = solve_scaled(bend[count:, count:], bend[count:, :count])
        return slope, bend[:count, :count] - bend[:count, count:] @ follow

    def energy(
        self,
        moments: list[Float[Array, "columns columns"]],
        at: Float[Array, "modes 2"],
        theta: Float[Array, " linear"],
    ) -> Float[Array, ""]:
        """What modes of these shapes and coefficients leave of some moments."""
        return sum(
            (r @ m @ r for r, m in zip(self.residuals(at, theta), moments)), start=jnp.zeros(())
        )

    def residuals(
        self, at: Float[Array, "modes 2"], theta: Float[Array, " linear"]
    ) -> list[Float[Array, " columns"]]:
        """Of each equation, as combinations of its columns."""
        shapes = {names: shape_of(row) for names, row in zip(self.sought, at)}
        values = {**self.given, **dict(zip(self.linear, theta))}
        return [
            e.residual(values, [shapes.get(n) or Expanded.shape(self.given, n) for n, _ in e.modes])
            for e in self.equations
        ]

    def values(self, at: Float[Array, "modes 2"]) -> dict[str, Array]:
        """Every parameter of the stage by name, for modes of these shapes."""
        found = dict(zip(self.linear, self.projected(at).theta))
        for names, row in zip(self.sought, at):
            shape, mass = shape_of(row), found[names.mass]
            found[names.stiffness] = mass / shape.p
            found[names.damping] = mass * shape.q / shape.p
        return {**self.given, **found}


class Projected(NamedTuple):
    """A least-squares fit: `theta`, the `energy` of what it leaves, that of the `target`."""

    theta: Float[Array, " linear"]
    energy: Float[Array, ""]
    target: Float[Array, ""]
    gram: Float[Array, "1+linear 1+linear"]

    @classmethod
    def of(cls, gram: Float[Array, "1+linear 1+linear"]) -> "Projected":
        """Of the Gram matrix of target and regressors."""
        target, moment = gram[0, 0], gram[1:, 0]
        theta = solve_scaled(gram[1:, 1:], moment[:, None])[:, 0]
        return cls(theta, target - moment @ theta, target, gram)

    def without_last(self) -> "Projected":
        """The fit without the mass of the last mode, which is then zero."""
        if self.gram.shape[0] == 2:
            return self._replace(theta=jnp.zeros_like(self.theta), energy=self.target)
        fit = Projected.of(self.gram[:-1, :-1])
        return self._replace(theta=jnp.append(fit.theta, 0.0), energy=fit.energy)


def shape_of(at: Float[Array, "2"]) -> Shape:
    """p and q from the logarithm of the frequency in hertz and the damping ratio."""
    rate = 2 * jnp.pi * jnp.exp(at[0])
    return Shape(1 / rate**2, 2 * at[1] / rate)


class ModeMap(NamedTuple):
    """Shares of the target that modes of each frequency leave, at their best damping.

    **Fields:** `frequency` in hertz; `unexplained` share with a mode there, `without` one, both in
    the same windows; `damping` ratio; infinite where no mode of positive mass fits.
    """

    frequency: Float[Array, " frequencies"]
    unexplained: Float[Array, " frequencies"]
    without: Float[Array, " frequencies"]
    damping: Float[Array, " frequencies"]


def mode_map(stage: ModeStage, band: tuple[Leaf, Leaf], others: Float[Array, "modes 2"]) -> ModeMap:
    """The map of one more mode, the last one sought, `others` being where they are."""
    low, high = (jnp.log(jnp.asarray(f)) for f in band)
    logs = jnp.linspace(low, high, FREQUENCIES)

    def share(log: Array, damping: Array) -> tuple[Array, Array]:
        fit = stage.projected(jnp.concatenate([others, jnp.stack([log, damping])[None]]))
        masses = fit.theta[len(stage.unknown) :]
        good = jnp.all(masses > 0) & (fit.target > 0)
        target = jnp.where(fit.target > 0, fit.target, 1.0)
        return jnp.where(good, fit.energy / target, jnp.inf), fit.without_last().energy / target

    dampings = jnp.asarray(DAMPINGS)
    left, without = jax.vmap(lambda log: jax.vmap(lambda z: share(log, z))(dampings))(logs)
    best = jnp.argmin(left, axis=1)
    at = jnp.arange(FREQUENCIES)
    return ModeMap(jnp.exp(logs), left[at, best], without[at, best], dampings[best])


def search(stage: ModeStage, bands: Sequence[tuple[Leaf, Leaf]]) -> Float[Array, "modes 2"]:
    """Where modes fit best: one after the other by their maps, then all at once by Newton's steps.

    **Arguments:** `bands` in hertz in which to look for each.
    """
    at = jnp.zeros((0, 2))
    for number, band in enumerate(bands, start=1):
        part = stage._replace(sought=stage.sought[:number], equations=stage.equations)
        found = mode_map(_with_so_many(part, number, stage), band, at)
        best = jnp.argmin(found.unexplained)
        row = jnp.stack([jnp.log(found.frequency[best]), found.damping[best]])
        at = polished(_with_so_many(part, number, stage), jnp.concatenate([at, row[None]]))
    return at


def _with_so_many(part: ModeStage, number: int, stage: ModeStage) -> ModeStage:
    """The stage with the first modes only: the others are so stiff that they are not there."""
    absent = {}
    for names in stage.sought[number:]:
        absent |= {
            names.mass: jnp.zeros(()),
            names.stiffness: jnp.ones(()),
            names.damping: jnp.zeros(()),
        }
    return part._replace(given={**stage.given, **absent})


def polished(stage: ModeStage, start: Float[Array, "modes 2"]) -> Float[Array, "modes 2"]:
    """The least energy near a start, by Newton's steps, shortened where they lead up."""

    def step(_: int, at: Array) -> Array:
        slope, bend = stage.slope_and_bend(at.reshape(start.shape))
        values, vectors = symmetric_eigen(bend)
        # With the bend's eigenvalues made positive every step leads down.
        size = jnp.maximum(jnp.abs(values), 1e-9 * jnp.max(jnp.abs(values)))
        downhill = -vectors @ ((vectors.T @ slope) / jnp.where(size > 0, size, 1.0))
        downhill = downhill * jnp.minimum(1.0, FARTHEST / jnp.max(jnp.abs(downhill)))
        tried = at[None, :] + jnp.asarray(SHORTENED)[:, None] * downhill[None, :]
        energies = jax.vmap(lambda x: stage.projected(x.reshape(start.shape)).energy)(tried)
        return tried[jnp.argmin(jnp.where(jnp.isfinite(energies), energies, jnp.inf))]

    return jax.lax.fori_loop(0, STEPS, step, start.ravel()).reshape(start.shape)


def differentiable(stage: ModeStage, at: Float[Array, "modes 2"]) -> Float[Array, "modes 2"]:
    """The same shapes, with the derivatives of the least energy's place: one more Newton step.

    At the minimum the step is zero, and by the implicit function theorem its derivative is that of
    the minimum, the bend being held still.
    """
    at = jax.lax.stop_gradient(at)
    slope, bend = stage.slope_and_bend(at)
    step = solve_scaled(jax.lax.stop_gradient(bend), slope[:, None])[:, 0]
    # The value is what was found: only derivatives come from the step.
    return at - (step - jax.lax.stop_gradient(step)).reshape(at.shape)


class Contraction(eqx.Module):
    """Normal equations of expanded columns, made those of the model's own parameters.

    **Fields:** `stages` of the procedure; `start`, where the modes of each stage were found.
    """

    stages: tuple[tuple[Expanded, ...], ...]
    start: tuple[Float[Array, "modes 2"], ...]

    def __call__(
        self,
        equations: list[list[NormalEquations]],
        sources: list[list[NormalEquations]],
        known: Values,
    ) -> tuple[list[list[NormalEquations]], list[list[NormalEquations]]]:
        """Both, linearised about the solution of all stages, which are solved in turn."""
        mixes = self.mixes(equations, known)
        return self._mixed(mixes, equations), self._mixed(mixes, sources)

    def mixes(
        self, equations: list[list[NormalEquations]], known: Values
    ) -> list[list[Float[Array, "1+p columns"]]]:
        """Of each equation, target and regressors as combinations of its expanded columns."""
        values, mixes = dict(known), []
        for expanded, sums, start in zip(self.stages, equations, self.start):
            stage = ModeStage.of(expanded, sums, values)
            at = differentiable(stage, start) if stage.sought else start
            values |= stage.values(at)
            mixes.append([e.linearised(values) for e in expanded])
        return mixes

    def _mixed(
        self, mixes: list[list[Array]], sums: list[list[NormalEquations]]
    ) -> list[list[NormalEquations]]:
        return [
            [
                own.each(lambda m, v=v: v @ m @ v.T, parameters=e.all_parameters)
                if e.modes
                else own
                for e, v, own in zip(*stage)
            ]
            for stage in zip(self.stages, mixes, sums)
        ]


class Tried(NamedTuple):
    """What was found in windows of one length, leading axes of a batch left out.

    **Fields:** `at`, the modes' shapes; `doubt`, the sum of squared relative standard errors of
    masses and stiffnesses, infinite for what is no oscillator; share of the target that modes leave
    `unexplained`, and that is `without` them.
    """

    at: Float[Array, "modes 2"]
    doubt: Float[Array, ""]
    unexplained: Float[Array, ""]
    without: Float[Array, ""]


@eqx.filter_jit
def _tried(
    equations: tuple[Expanded, ...],
    sums: list[NormalEquations],
    known: Values,
    bands: tuple[tuple[Leaf, Leaf], ...],
) -> Tried:
    """The modes that one stage's equations ask for, from its sums over some windows."""
    # The search is not differentiated: what it finds has the minimum's own derivative.
    sums, known, bands = held_still((sums, dict(known), bands))
    stage = ModeStage.of(equations, sums, known)
    at = search(stage, bands)
    fit, values = stage.projected(at), stage.values(at)
    contracted, _ = Contraction((equations,), (at,))([sums], [sums], known)
    names = tuple(dict.fromkeys(name for e in equations for name in e.all_parameters))
    together = sum_of_equations(contracted[0], names).flattened()
    influence = block_influence([together], known, values)
    found = [name for name in names if name not in known]
    sought = [name for of in stage.sought for name in (of.mass, of.stiffness)]
    size = jnp.stack([values[name] for name in sought])
    variance = jnp.sum(influence**2, axis=0)[jnp.array([found.index(name) for name in sought])]
    doubt = jnp.sum(variance / size**2)
    good = jnp.all(size > 0) & jnp.all(at[:, 1] > 0) & jnp.isfinite(doubt) & (fit.target > 0)
    target = jnp.where(fit.target > 0, fit.target, 1.0)
    return Tried(
        at, jnp.where(good, doubt, jnp.inf), fit.energy / target, fit.without_last().energy / target
    )


class FoundModes(NamedTuple):
    """Where modes are, and what they were found from.

    **Fields:** `contraction`; of each stage the bins of window lengths that it is solved from,
    `None` for all; `lengths` of these in seconds.
    """

    contraction: Contraction
    bands: list[tuple[int, int] | None]
    lengths: list[tuple[float, float] | None]


def find_modes(procedure: Procedure, summary: Summary, given: Values) -> FoundModes:
    """The modes of each stage, in the windows that tell most of them.

    Short windows show a fast mode and much noise; which of the lengths tells most is seen from the
    standard errors that each promises. Where lengths were not kept apart all are taken.

    **Raises:** `ModelError` where of a mode something is known, and not all.
    """
    _require_whole_modes(procedure, given)
    known, starts, bands, lengths = dict(given), [], [], []
    for i, equations in enumerate(procedure.expanded):
        sought = ModeStage.of(equations, summary.equations()[i], known).sought
        tried, band = None, None
        if sought:
            where = tuple(search_band(procedure, summary, names) for names in sought)
            first, last = summary.band
            options = [(b, b + 1) for b in range(first, last)] if summary.bins else [summary.band]
            every = [_tried(equations, summary.equations(o)[i], known, where) for o in options]
            best = 0
            if len(options) > 1:
                best = int(np.argmin([float(one.doubt) for one in every]))
            tried, band = every[best], options[best] if summary.bins else None
        starts.append(jnp.zeros((0, 2)) if tried is None else jax.lax.stop_gradient(tried.at))
        bands.append(band)
        lengths.append(summary.lengths_of(band) if band is not None else None)
        # What later stages take as known has a name here, and any value.
        known |= dict.fromkeys((n for e in equations for n in e.all_parameters), jnp.ones(()))
    return FoundModes(Contraction(procedure.expanded, tuple(starts)), bands, lengths)


def search_band(procedure: Procedure, summary: Summary, names: ModeParameters) -> tuple[Leaf, Leaf]:
    """Hertz between which to look for a mode."""
    hz = procedure.mode_named(names).hz
    if hz is not None:
        return np.asarray(hz / 1.5), np.asarray(hz * 1.5)
    windows = summary.criterion.windows
    assert windows is not None
    step = summary.recordings[0].time_step
    # From half a period of the longest window to where a period has a dozen samples.
    return 0.5 / windows.beta, 1 / (8 * step)


def _require_whole_modes(procedure: Procedure, known: Mapping[str, object]) -> None:
    for number, _ in enumerate(procedure.modes):
        names = ModeParameters.of(number)
        held = [name for name in names if name in known]
        if held and len(held) < 3:
            raise ModelError(
                f"of a hidden mode all of {', '.join(names)} are known or none; got "
                f"{', '.join(held)}."
            )
