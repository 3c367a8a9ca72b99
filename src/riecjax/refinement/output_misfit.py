"""Output error over windows: the model simulated from initial states, compared with the recording.

The residual of a window is r = (y(theta, s) - measured) / sigma at every compared sample of every
channel, y simulated from the initial state s. Its derivatives are those of the simulation: along
each unit vector of (theta, s) the variational equation is stepped with the state, by forward
differentiation of the very steps. That is the exact derivative of what is computed, takes p + s
simulations beside the one, and keeps no step in memory for later. Reverse mode would take one pass
for each residual, of which there are thousands.

**Initial states projected out.** Let J = dr/dtheta, S = dr/ds, C = S^T S and B = J^T S of a window.
To first order the best initial state follows theta by ds/dtheta = -C^-1 B^T, and the residual does

    (J - S C^-1 B^T) dtheta.

That is a linear map of columns, [r J S] -> [-r, J - S C^-1 B^T], the same in every piece of the
window. Applied to the moments of pieces it gives scores of theta alone by blocks of time. Their sum
has the Schur complement A - B C^-1 B^T of `arrowhead` for its Gram matrix: a covariance of theta
that includes what is not known of initial states.

Huber's loss, which grows with a residual's square up to a threshold and straight on past it.

With the threshold c, rho(r) = r^2 / 2 up to c and c |r| - c^2 / 2 past it. What searches for least
squares makes it small as the square of f(r) = sign(r) sqrt(2 rho(r)), whose slope is continuous.
f f' is the score psi(r), r cut off at c, so the gradient is the loss's own; f'^2 > 0 past c keeps
steps defined, and is more than the curvature psi' = 0 there. A sandwich takes psi' instead, or its
standard errors were too small: by a fifth of a normal law at c = 1.345.
"""

import dataclasses
import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from riecjax.compilation import kept_jit
from riecjax.estimation.parameters import Sharing
from riecjax.leaves import Leaf, held_still
from riecjax.linear_algebra import solve_scaled
from riecjax.refinement.objective import AbstractMisfit, Expansion
from riecjax.refinement.parametric import AbstractParametric
from riecjax.refinement.shots import Recorded, over_windows
from riecjax.simulation.method import AbstractMethod, FixedStep
from riecjax.simulation.system import AbstractSystem
from riecjax.summaries.normal_equations import NormalEquations, ShortBlocks, stack_normal_equations

THRESHOLD = 1.345
"""Standard deviations of the noise: 95 % as precise as squares where all of it is normal."""
LEAST_NOISE = 1e-3
"""Share of a channel's standard deviation that its noise is taken for at the least."""

Threshold: TypeAlias = Float[Array, "1 channels"] | None
"""Past which a channel's loss is straight, in units of its residuals; `None` where nowhere."""
Columns: TypeAlias = Callable[[Array, Array, Threshold], tuple[Array, Array]]
"""Of residuals and their slopes, two sets of columns whose products are moments from the diagonal
up: energies, scores and curvatures."""


def as_square(
    residual: Float[Array, "*n channels"], threshold: Threshold
) -> Float[Array, "*n channels"]:
    """f(r), half the square of which is the loss."""
    if threshold is None:
        return residual
    past = jnp.maximum(jnp.abs(residual), threshold)
    bent = jnp.sign(residual) * jnp.sqrt(threshold * (2 * past - threshold))
    return jnp.where(jnp.abs(residual) <= threshold, residual, bent)


def for_search(
    level: Float[Array, "*n channels"],
    slopes: Float[Array, "*n channels columns"],
    threshold: Threshold,
) -> tuple[Array, Array]:
    """f and its slopes."""
    square = as_square(level, threshold)
    if threshold is not None:
        bent = jnp.clip(level, -threshold, threshold) / jnp.where(square == 0, 1.0, square)
        slopes = slopes * jnp.where(square == 0, 1.0, bent)[..., None]
    columns = jnp.concatenate([square[..., None], slopes], axis=-1)
    return columns, columns


def for_scatter(
    level: Float[Array, "*n channels"],
    slopes: Float[Array, "*n channels columns"],
    threshold: Threshold,
) -> tuple[Array, Array]:
    """f^2, psi times slopes, and slopes times each other up to the threshold."""
    assert threshold is not None
    score = jnp.clip(level, -threshold, threshold)
    energy = as_square(level, threshold) ** 2 / jnp.where(score == 0, 1.0, score)
    inside = slopes * (jnp.abs(level) <= threshold)[..., None]
    left = jnp.concatenate([score[..., None], inside], axis=-1)
    return left, jnp.concatenate([energy[..., None], slopes], axis=-1)


RIDGE = 1e-10
"""What keeps an initial state that no residual depends on from a division by zero; relative."""
PROFILED = 1e-6
"""Share of the sum of squares that better initial states would still take off: as good as none."""
MOST_TRIALS = 8
"""Initial states that are tried for each window."""


class _Profiling(NamedTuple):
    """Initial states to try, the least energy so far, whether to go on, and trials left."""

    trial: Float[Array, "windows s"]
    energy: Float[Array, " quantities"]
    going: Array
    left: Int[Array, ""]


class OutputMisfit(AbstractMisfit):
    """Simulated minus recorded channels, in units of `sigma`, over all windows of all records.

    `labels` are the channels.
    `threshold` of Huber's loss by channel, in units of sigma; `None` for squares.
    `longest_window` is 0 unless windows overlap: no residual then counts twice. `most_steps`
    between samples may be taken of a method that the user left open, else 0.
    """

    system: AbstractParametric
    recorded: list[Recorded]
    known: dict[str, Leaf]
    sigma: Float[Array, " channels"]
    scale: Float[Array, " s"]
    longest_window: Float[Array, ""]
    method: AbstractMethod
    threshold: Float[Array, "1 channels"] | None
    names: tuple[str, ...] = eqx.field(static=True)
    local: tuple[str, ...] = eqx.field(static=True)
    labels: tuple[str, ...] = eqx.field(static=True)
    units: tuple[str, ...] = eqx.field(static=True)
    estimated: tuple[int, ...] = eqx.field(static=True)
    state_names: tuple[str, ...] = eqx.field(static=True)
    sharing: Sharing = eqx.field(static=True)
    most_steps: int = eqx.field(static=True)

    @property
    def initial_state_names(self) -> tuple[str, ...]:
        """Names of the states whose initial values are estimated."""
        return tuple(self.state_names[i] for i in self.estimated)

    @property
    def work(self) -> int:
        """Steps x states x tangents of an expansion, which a search takes about twelve of.

        Every step of every simulation is taken with a tangent for each parameter and initial state.
        """
        fixed = self.method if isinstance(self.method, FixedStep) else FixedStep()
        samples = sum(math.prod(part.levels.shape[:2]) for part in self.recorded)
        tangents = 1 + len(self.names) + len(self.estimated)
        return samples * fixed.steps_per_sample * len(self.state_names) * tangents

    def first_initial(self) -> Float[Array, "windows s"]:
        """As recorded."""
        return jnp.concatenate(
            [part.initial[:, np.array(self.estimated, int)] for part in self.recorded]
        )

    def initial_scale(self) -> Float[Array, " s"]:
        """Size of each estimated state."""
        return self.scale

    def profiled_energy(
        self, theta: Float[Array, " p"], initial: Float[Array, "windows s"]
    ) -> Float[Array, " quantities"]:
        """Profiled over initial states by Gauss and Newton, while that makes the sum smaller."""
        if not self.estimated:
            return self.energy(theta, initial)
        values = {**self.known, **dict(zip(self.names, theta))}
        held, initial = held_still((dataclasses.replace(self, known=values, names=()), initial))
        none = jnp.zeros(0, initial.dtype)

        def tried(state: _Profiling) -> _Profiling:
            at = held.expansion(none, state.trial)
            moments = at.moments()
            better = jnp.sum(at.energy) < jnp.sum(state.energy)
            energy = jnp.where(better, at.energy, state.energy)
            gradient = moments[:, 1:, :1]
            step = -jax.vmap(lambda g, r: solve_scaled(g, r, RIDGE))(moments[:, 1:, 1:], gradient)
            going = better & (-jnp.sum(gradient * step) > PROFILED * jnp.sum(energy))
            trial = state.trial + step[:, :, 0]
            return _Profiling(trial, energy, going & (state.left > 0), state.left - 1)

        infinite = jnp.full(len(self.labels), jnp.inf, initial.dtype)
        first = _Profiling(initial, infinite, jnp.asarray(True), jnp.asarray(MOST_TRIALS))
        return jax.lax.while_loop(lambda state: state.going, tried, first).energy

    @property
    def steps_label(self) -> str:
        """The method."""
        return self.method.label

    def finer(self, factor: int) -> "OutputMisfit | None":
        """By the method in shorter steps."""
        method = self.method.finer(factor)
        return None if method is None else eqx.tree_at(lambda m: m.method, self, method)

    @property
    def step_factor_limit(self) -> int:
        """As many as `most_steps` leaves."""
        steps = self.method.steps_per_sample if isinstance(self.method, FixedStep) else 1
        return max(self.most_steps // steps, 1)

    def energy(
        self, theta: Float[Array, " p"], initial: Float[Array, "windows s"]
    ) -> Float[Array, " quantities"]:
        """Of each channel, in units of sigma."""
        found = jnp.zeros(len(self.labels), theta.dtype)
        for i, (part, own) in enumerate(zip(self.recorded, self._of_records(initial))):

            def of_window(initial: Array, window: Recorded, i: int = i) -> Array:
                error = self._error(theta, initial, window, i)
                return jnp.sum(as_square(error, self.threshold) ** 2, axis=0)

            found = found + jnp.sum(over_windows(of_window, own, part), axis=0)
        return found

    def expansion(self, theta: Float[Array, " p"], initial: Float[Array, "windows s"]) -> Expansion:
        """Of each window of each record, in pieces of time."""
        return self._expansion(theta, initial, for_search)

    def curved(
        self, theta: Float[Array, " p"], initial: Float[Array, "windows s"], found: Expansion
    ) -> Expansion:
        """With the curvature of Huber's loss itself, none past its threshold."""
        return found if self.threshold is None else self._expansion(theta, initial, for_scatter)

    def _expansion(
        self, theta: Float[Array, " p"], initial: Float[Array, "windows s"], columns: Columns
    ) -> Expansion:
        pieces, energy = [], jnp.zeros(len(self.labels), theta.dtype)
        for i, (part, own) in enumerate(zip(self.recorded, self._of_records(initial))):

            def of_window(initial: Array, window: Recorded, i: int = i) -> tuple[Array, Array]:
                level, slopes = self._columns(theta, initial, window, i)
                left, right = columns(level, slopes, self.threshold)
                cut, other = _in_pieces(left, window.piece), _in_pieces(right, window.piece)
                moments = jnp.einsum("prci,prcj->pij", cut, cut if left is right else other)
                upper = jnp.triu(moments, 1)
                moments = (
                    moments if left is right else jnp.triu(moments) + jnp.swapaxes(upper, 1, 2)
                )
                return moments, jnp.sum(left[..., 0] * right[..., 0], axis=0)

            moments, squares = over_windows(of_window, own, part)
            pieces.append(moments)
            energy = energy + jnp.sum(squares, axis=0)
        return Expansion(pieces, energy)

    @kept_jit
    def residuals(
        self, theta: Float[Array, " p"], initial: Float[Array, "windows s"]
    ) -> list[Float[Array, "windows compared channels"]]:
        """Simulated minus recorded in units of sigma; 0 where nothing is compared."""
        return self._by_window(partial(self._error, theta), initial)

    @kept_jit
    def slopes_by_initial(
        self, theta: Float[Array, " p"], initial: Float[Array, "windows s"]
    ) -> list[Float[Array, "windows compared channels s"]]:
        """Derivatives of `residuals` by the initial states of their window."""
        return self._by_window(jax.jacfwd(partial(self._error, theta)), initial)

    def _by_window(
        self, of: Callable[[Array, Recorded, int], Array], initial: Float[Array, "windows s"]
    ) -> list[Array]:
        """What is made of each window's initial state, the window and its record's number."""
        parts = enumerate(zip(self.recorded, self._of_records(initial)))
        return [
            over_windows(lambda at, window, i=i: of(at, window, i), own, part)
            for i, (part, own) in parts
        ]

    def rms(self, energy: Float[Array, " quantities"]) -> Float[Array, " quantities"]:
        """Of simulated minus recorded."""
        count = sum(jnp.sum(part.present, axis=(0, 1)) for part in self.recorded)
        return self.sigma * jnp.sqrt(energy / jnp.maximum(count, 1))

    def independent_rows(self) -> Float[Array, ""]:
        """All that are compared."""
        return jnp.asarray(sum(jnp.sum(part.present) for part in self.recorded), float)

    def blocks(self, expansion: Expansion) -> tuple[NormalEquations, ShortBlocks]:
        """By blocks of time."""
        p = len(self.names)
        parts, numbers, seconds = [], [], []
        for part, pieces in zip(self.recorded, expansion.pieces):
            samples, most = part.short, part.short_blocks
            number = jnp.clip(-(-part.sample_count // samples), 2, most)
            moments = jax.vmap(lambda m: _without_initial(m, p))(pieces)
            position = part.position[:, :: part.piece]
            index = jnp.minimum(position // samples, number - 1).reshape(-1)
            held = jnp.sum(_in_pieces(part.present, part.piece, axis=1), axis=(2, 3))
            flat, held = moments.reshape(-1, *moments.shape[2:]), held.reshape(-1)
            # Of one window the pieces are the blocks, and there is nothing to add up.
            if part.windows > 1 or part.piece * part.every != samples or len(flat) != most:
                flat = jax.ops.segment_sum(flat, index, num_segments=most)
                held = jax.ops.segment_sum(held, index, num_segments=most)
            parts.append(NormalEquations(flat, held.astype(flat.dtype), self.names))
            numbers.append(number)
            seconds.append(samples * part.time_step)
        return stack_normal_equations(parts), ShortBlocks(jnp.stack(numbers), jnp.stack(seconds))

    def simulated(
        self, theta: Float[Array, " p"], initial: Float[Array, " s"], window: Recorded, index: int
    ) -> Float[Array, "compared channels"]:
        """The channels at the compared samples of one window of record number `index`."""
        values = {**self.known, **dict(zip(self.names, theta))}
        system = self.system.build(self.sharing.values_of(self.local, values, index))
        first = window.initial
        if self.estimated:
            first = first.at[np.array(self.estimated)].set(initial)
        states, kept = window.trajectory(self.method, system, first)
        found = observed(
            system, states[:: window.every], window.levels[:: window.every], self.labels
        )
        # What a lost simulation shows after its loss must not pass for an answer.
        return jnp.where(kept, found, jnp.inf)

    def _error(
        self, theta: Float[Array, " p"], initial: Float[Array, " s"], window: Recorded, index: int
    ) -> Float[Array, "compared channels"]:
        found = self.simulated(theta, initial, window, index)
        return jnp.where(window.present, (found - window.measured) / self.sigma[None, :], 0.0)

    def _columns(
        self, theta: Float[Array, " p"], initial: Float[Array, " s"], window: Recorded, index: int
    ) -> tuple[Float[Array, "compared channels"], Float[Array, "compared channels p+s"]]:
        """Residuals of one window, and their derivatives by parameters and initial states."""
        p = theta.shape[0]
        unknown = jnp.concatenate([theta, initial])
        return jax.vmap(
            lambda along: jax.jvp(
                lambda u: self._error(u[:p], u[p:], window, index), (unknown,), (along,)
            ),
            out_axes=(None, 2),
        )(jnp.eye(unknown.shape[0], dtype=unknown.dtype))

    def _of_records(self, initial: Float[Array, "windows s"]) -> list[Float[Array, "windows s"]]:
        edges = np.cumsum([part.windows for part in self.recorded])[:-1]
        return jnp.split(initial, edges)


def observed(
    system: AbstractSystem,
    states: Float[Array, "n states"],
    levels: Float[Array, "n inputs"],
    channels: tuple[str, ...],
) -> Float[Array, "n channels"]:
    """Channels of a trajectory: states, their derivatives `d<state>`, and outputs."""
    names = system.state_names
    rates = {f"d{name}": i for i, name in enumerate(names)}
    outputs = dict(system.outputs)
    flow = made = None
    columns = []
    for channel in channels:
        if channel in names:
            columns.append(states[:, names.index(channel)])
        elif channel in outputs:
            made = jax.vmap(system.output)(states, levels) if made is None else made
            columns.append(made[channel])
        else:
            flow = jax.vmap(system.derivative)(states, levels) if flow is None else flow
            columns.append(flow[:, rates[channel]])
    return jnp.stack(columns, axis=-1)


def _in_pieces(values: Array, length: int, axis: int = 0) -> Array:
    """One axis cut into pieces of a length, the last one filled up with zeros."""
    n = values.shape[axis]
    count = -(-n // length)
    pad = [(0, 0)] * values.ndim
    pad[axis] = (0, count * length - n)
    shape = (*values.shape[:axis], count, length, *values.shape[axis + 1 :])
    return jnp.pad(values, pad).reshape(shape)


def _without_initial(
    pieces: Float[Array, "pieces columns columns"], p: int
) -> Float[Array, "pieces 1+p 1+p"]:
    """Moments of minus the residual and of its derivatives while initial states follow."""
    head = jnp.eye(1 + p, dtype=pieces.dtype).at[0, 0].set(-1.0)
    if pieces.shape[-1] == 1 + p:
        return jnp.einsum("ia,pij,jb->pab", head, pieces, head)
    whole = jnp.sum(pieces, axis=0)
    following = solve_scaled(whole[1 + p :, 1 + p :], whole[1 + p :, 1 : 1 + p], ridge=RIDGE)
    tail = jnp.concatenate([jnp.zeros_like(whole[1 + p :, :1]), -following], axis=1)
    mix = jnp.concatenate([head, tail])
    return jnp.einsum("ia,pij,jb->pab", mix, pieces, mix)
