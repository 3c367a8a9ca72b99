"""How a system is stepped along the samples of its inputs.

A sampled input is continuous and piecewise linear (first-order hold), so the right-hand side has a
kink at every sample. Steps that end on samples keep a Runge-Kutta method at its full order, and a
grid that is indexed instead of searched costs nothing. That is why `FixedStep` runs its own
scan over the samples: the same diffrax tableau inside `diffeqsolve`, which looks up its interval
and saves by interpolation at each step, measured about five times slower on the quarter car.
`Adaptive` is that `diffeqsolve`, for reference solutions, unfamiliar systems and stiff ones.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from diffrax import RESULTS as DIFFRAX_RESULTS
from diffrax import (
    AbstractSolver,
    ButcherTableau,
    ClipStepSizeController,
    ForwardMode,
    ODETerm,
    PIDController,
    SaveAt,
    Tsit5,
    diffeqsolve,
)
from jaxtyping import Array, Float, Int

from riecjax.errors import ModelError
from riecjax.simulation.system import AbstractSystem


class SimulationStatus(eqx.Enumeration):
    """Whether a simulation kept its solution to the end."""

    successful = ""
    diverged = (
        "the state left the range of finite numbers. Check the parameters' signs and sizes, or use "
        "more steps per sample."
    )
    max_steps_reached = (
        "the adaptive solver used up its steps. Allow more (max_steps), loosen its tolerances, or "
        "use fixed steps."
    )
    solver_failed = "the solver could not make a step. Loosen its tolerances or use fixed steps."


Trajectory = tuple[Float[Array, "n states"], SimulationStatus, Int[Array, ""]]
"""States at the samples, status, and number of samples that were reached."""

# The classical fourth-order method: four stages, each reading only its predecessor, which makes it
# the cheapest per unit of accuracy at steps of a few milliseconds on systems of a few states.
CLASSICAL_RUNGE_KUTTA = ButcherTableau(
    c=np.array([0.5, 0.5, 1.0]),
    a_lower=(np.array([0.5]), np.array([0.0, 0.5]), np.array([0.0, 0.0, 1.0])),
    b_sol=np.array([1.0, 2.0, 2.0, 1.0]) / 6.0,
    b_error=np.array([1.0, 2.0, 2.0, -5.0]) / 6.0,
)


class AbstractMethod(eqx.Module):
    """Integrates a system from its initial state along sampled inputs."""

    def trajectory(
        self,
        system: AbstractSystem,
        inputs: Float[Array, "n inputs"],
        time_step: Float[Array, ""],
        initial_state: Float[Array, " states"],
    ) -> Trajectory:
        """States at the samples of `inputs`; differentiable and vmappable."""
        raise NotImplementedError


class FixedStep(AbstractMethod):
    """An explicit Runge-Kutta method with a fixed number of steps between samples.

    **Arguments:**

    - `steps_per_sample`: steps between one sample and the next.
    - `tableau`: any explicit diffrax tableau, such as `diffrax.Tsit5.tableau`; the classical
      fourth-order method by default.
    """

    steps_per_sample: int = eqx.field(static=True, default=8)
    tableau: ButcherTableau = eqx.field(static=True, default=CLASSICAL_RUNGE_KUTTA)

    def __check_init__(self):
        if self.steps_per_sample < 1:
            raise ModelError(f"steps_per_sample must be at least 1; got {self.steps_per_sample}.")

    def trajectory(
        self,
        system: AbstractSystem,
        inputs: Float[Array, "n inputs"],
        time_step: Float[Array, ""],
        initial_state: Float[Array, " states"],
    ) -> Trajectory:
        """States at the samples; see the base class."""
        count = self.steps_per_sample
        step = time_step / count

        def between_samples(carry, ends):
            state, running = carry
            first, last = ends
            slope = (last - first) / count

            def one_step(k, x):
                return _runge_kutta_step(self.tableau, system, x, first + slope * k, slope, step)

            # A lost lane restarts from its initial state, unseen, so that no infinity enters later
            # steps or their derivatives; the state it shows stays at its last finite value.
            moved = jax.lax.fori_loop(0, count, one_step, jnp.where(running, state, initial_state))
            running = running & jnp.all(jnp.isfinite(moved))
            state = jnp.where(running, moved, state)
            return (state, running), (state, running)

        _, (states, running) = jax.lax.scan(
            between_samples, (initial_state, jnp.array(True)), (inputs[:-1], inputs[1:])
        )
        status = SimulationStatus.where(
            running[-1], SimulationStatus.successful, SimulationStatus.diverged
        )
        return (
            jnp.concatenate([initial_state[None], states]),
            status,
            1 + jnp.sum(running.astype(jnp.int32)),
        )


class Adaptive(AbstractMethod):
    """`diffrax.diffeqsolve` with an adaptive step, restarted at every kink of the input.

    **Arguments:**

    - `rtol`, `atol`: relative and absolute tolerance of each step, to be chosen by the user.
    - `solver`: any diffrax solver, implicit ones for stiff systems included.
    - `max_steps`: steps in all; none left is the status `max_steps_reached`.
    """

    rtol: float = eqx.field(static=True)
    atol: float = eqx.field(static=True)
    solver: AbstractSolver = eqx.field(default_factory=Tsit5)
    max_steps: int = eqx.field(static=True, default=1_000_000)

    def trajectory(
        self,
        system: AbstractSystem,
        inputs: Float[Array, "n inputs"],
        time_step: Float[Array, ""],
        initial_state: Float[Array, " states"],
    ) -> Trajectory:
        """States at the samples; see the base class."""
        last = inputs.shape[0] - 1

        # Time is counted in samples, so that the sample below a time is found without a search.
        def vector_field(position, state, inputs):
            below = jnp.clip(jnp.floor(position).astype(jnp.int32), 0, last - 1)
            share = position - below
            level = inputs[below] + share * (inputs[below + 1] - inputs[below])
            return time_step * system.derivative(state, level)

        samples = jnp.arange(last + 1, dtype=initial_state.dtype)
        solution = diffeqsolve(
            ODETerm(vector_field),
            self.solver,
            samples[0],
            samples[-1],
            0.1,
            initial_state,
            args=inputs,
            saveat=SaveAt(ts=samples),
            # The right-hand side has a kink at every sample; a step across one loses its order.
            stepsize_controller=ClipStepSizeController(
                PIDController(rtol=self.rtol, atol=self.atol), jump_ts=samples[1:-1]
            ),
            max_steps=self.max_steps,
            adjoint=ForwardMode(),
            throw=False,
        )
        assert solution.ys is not None
        reached = jnp.sum(jnp.all(jnp.isfinite(solution.ys), axis=-1).astype(jnp.int32))
        lost = jnp.arange(last + 1) >= reached
        states = jnp.where(
            lost[:, None], solution.ys[jnp.maximum(reached - 1, 0)][None], solution.ys
        )
        return states, _status_of(solution.result, reached > last), reached


def _status_of(result: DIFFRAX_RESULTS, complete: Array) -> SimulationStatus:
    failed = SimulationStatus.where(
        result == DIFFRAX_RESULTS.max_steps_reached,
        SimulationStatus.max_steps_reached,
        SimulationStatus.solver_failed,
    )
    finished = SimulationStatus.where(
        complete, SimulationStatus.successful, SimulationStatus.diverged
    )
    return SimulationStatus.where(result == DIFFRAX_RESULTS.successful, finished, failed)


def _runge_kutta_step(
    tableau: ButcherTableau,
    system: AbstractSystem,
    state: Float[Array, " states"],
    level: Float[Array, " inputs"],
    rise: Float[Array, " inputs"],
    step: Float[Array, ""],
) -> Float[Array, " states"]:
    """One step over which the inputs go from `level` to `level + rise`."""
    slopes = [system.derivative(state, level)]
    for node, weights in zip(tableau.c, tableau.a_lower):
        at = state + step * _weighted_sum(weights, slopes)
        slopes.append(system.derivative(at, level + float(node) * rise))
    return state + step * _weighted_sum(tableau.b_sol, slopes)


def _weighted_sum(weights: np.ndarray, slopes: list[Array]) -> Array:
    return sum(
        (float(w) * slope for w, slope in zip(weights, slopes) if w != 0),
        start=jnp.zeros_like(slopes[0]),
    )
