"""Hidden modes by variable projection: frequency and damping are searched, all else is solved for.

For a mode of given shape D = 1 + q s + p s^2 an equation is linear, and its normal equations are a
combination V^T G V of those of its expanded columns. So a search over shapes needs p x p algebra
only, once G is there. Where the shape is best, the equation is linearised about the solution: a
Gauss-Newton step from there stays there, and everything that is said of a linear fit, its scores,
blocks and replicates, is said of this one.

What is made small is the residual's energy less what noise adds. Multiplied by D a residual is small
where D is, whatever the mode's mass: shapes are therefore compared by the share of the target D y
that they leave, and only the last steps, from the best of them, are of the energy itself.
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
from riecjax.leaves import Leaf
from riecjax.linear_algebra import solve_scaled
from riecjax.summaries.normal_equations import NormalEquations

Values = Mapping[str, Array]
DAMPINGS = (0.02, 0.06, 0.15, 0.35, 0.8)
"""Damping ratios of the grid."""
FREQUENCIES = 48
"""Frequencies of the grid, in equal ratios."""
STEPS = 12
"""Newton steps from the best point of the grid."""
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
        shapes = {names: shape_of(row) for names, row in zip(self.sought, at)}
        gram = jnp.zeros((1 + len(self.linear),) * 2, at.dtype)
        for equation, moments in zip(self.equations, self.moments):
            mix = self._affine(equation, shapes)
            gram = gram + mix @ moments @ mix.T
        return Projected.of(gram, len(self.sought))

    def _affine(
        self, equation: Expanded, shapes: Mapping[ModeParameters, Shape]
    ) -> Float[Array, "1+linear columns"]:
        """Target and regressors for modes of these shapes, as combinations of columns."""
        zero = {name: jnp.zeros(()) for name in self.linear}
        known = [
            shapes[n] if n in shapes else Expanded.shape(self.given, n) for n, _ in equation.modes
        ]

        def residual(linear: Values) -> Array:
            return equation.residual({**self.given, **linear}, known)

        slopes = jax.jacfwd(residual)(zero)
        return jnp.stack([residual(zero), *(-slopes[name] for name in self.linear)])

    def values(self, at: Float[Array, "modes 2"]) -> dict[str, Array]:
        """Every parameter of the stage by name, for modes of these shapes."""
        found = dict(zip(self.linear, self.projected(at).theta))
        for names, row in zip(self.sought, at):
            shape, mass = shape_of(row), found[names.mass]
            found[names.stiffness] = mass / shape.p
            found[names.damping] = mass * shape.q / shape.p
        return {**self.given, **found}


class Projected(NamedTuple):
    """A least-squares fit: `theta`, the residual's `energy`, the `target`'s, and the energy
    `without` the last unknowns, the modes' masses."""

    theta: Float[Array, " linear"]
    energy: Float[Array, ""]
    target: Float[Array, ""]
    without: Float[Array, ""]

    @classmethod
    def of(cls, gram: Float[Array, "1+linear 1+linear"], masses: int) -> "Projected":
        """Of the Gram matrix of target and regressors."""
        target, moment, normal = gram[0, 0], gram[1:, 0], gram[1:, 1:]
        theta = solve_scaled(normal, moment[:, None])[:, 0]
        rest = moment.size - masses
        fewer = solve_scaled(normal[:rest, :rest], moment[:rest, None])[:, 0]
        return cls(theta, target - moment @ theta, target, target - moment[:rest] @ fewer)


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
        return jnp.where(good, fit.energy / target, jnp.inf), fit.without / target

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

    def energy(flat: Array) -> Array:
        return stage.projected(flat.reshape(-1, 2)).energy

    slope, bend = jax.grad(energy), jax.hessian(energy)

    def step(_: int, at: Array) -> Array:
        downhill = -_definite_solve(bend(at), slope(at))
        # No further than a tenth of the frequency at once, nor of the damping.
        downhill = downhill * jnp.minimum(1.0, 0.3 / jnp.maximum(jnp.max(jnp.abs(downhill)), 1e-12))
        tried = at + jnp.asarray(SHORTENED)[:, None] * downhill
        energies = jax.vmap(energy)(tried)
        return tried[jnp.argmin(jnp.where(jnp.isfinite(energies), energies, jnp.inf))]

    return jax.lax.fori_loop(0, STEPS, step, start.ravel()).reshape(start.shape)


def _definite_solve(bend: Array, slope: Array) -> Array:
    """bend^-1 slope, with the bend's eigenvalues made positive: a direction that leads down."""
    values, vectors = jnp.linalg.eigh(bend)
    size = jnp.maximum(jnp.abs(values), 1e-9 * jnp.max(jnp.abs(values)))
    return vectors @ ((vectors.T @ slope) / jnp.where(size > 0, size, 1.0))


def differentiable(stage: ModeStage, at: Float[Array, "modes 2"]) -> Float[Array, "modes 2"]:
    """The same shapes, with the derivatives of the least energy's place: one more Newton step.

    At the minimum the step is zero, and by the implicit function theorem its derivative is that of
    the minimum, the bend being held still.
    """
    at = jax.lax.stop_gradient(at)

    def energy(flat: Array) -> Array:
        return stage.projected(flat.reshape(-1, 2)).energy

    bend = jax.lax.stop_gradient(jax.hessian(energy)(at.ravel()))
    scale = 1 / jnp.sqrt(jnp.maximum(jnp.abs(jnp.diagonal(bend)), 1e-300))
    moved = scale * jnp.linalg.solve(
        bend * scale[:, None] * scale, scale * jax.grad(energy)(at.ravel())
    )
    # The value is what was found: only derivatives come from the step.
    return at - (moved - jax.lax.stop_gradient(moved)).reshape(at.shape)


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
        values = dict(known)
        contracted, of_sources = [], []
        for expanded, sums, noise, start in zip(self.stages, equations, sources, self.start):
            stage = ModeStage.of(expanded, sums, values)
            at = differentiable(stage, start) if stage.sought else start
            values |= stage.values(at)
            mixes = [e.linearised(values) for e in expanded]
            contracted.append([_mixed(*each) for each in zip(expanded, mixes, sums)])
            of_sources.append([_mixed(*each) for each in zip(expanded, mixes, noise)])
        return contracted, of_sources


def _mixed(expanded: Expanded, mix: Array, sums: NormalEquations) -> NormalEquations:
    return sums.each(lambda m: mix @ m @ mix.T, parameters=expanded.all_parameters)


def require_whole_modes(procedure: Procedure, known: Mapping[str, object]) -> None:
    """Raise `ModelError` where of a mode something is known, and not all."""
    for number, _ in enumerate(procedure.modes):
        names = ModeParameters.of(number)
        held = [name for name in names if name in known]
        if held and len(held) < 3:
            raise ModelError(
                f"of a hidden mode all of {', '.join(names)} are known or none; got "
                f"{', '.join(held)}."
            )
