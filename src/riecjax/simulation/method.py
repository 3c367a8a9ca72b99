"""How a system is stepped along the samples of its inputs.

**Inputs** are continuous, and between their samples straight lines (first-order hold) or, given
their `bends`, cubics. What a line leaves of a smooth input, H^2 max|u''| / 8 at most, is an error
whatever the method's order: see `intersample`.

**Order.** A method of order p errs by O(h^p) over a fixed time where the right-hand side has p
continuous derivatives. Here its slope in time jumps at every sample, and a step across such a kink
errs by O(h^2) in itself, with as many kinks as samples. Steps that end on samples never see one:
within each, inputs are polynomials, and the full order holds. An adaptive
method is told where the kinks are (`jump_ts`). Where a force jumps with the sign of a velocity no
grid helps; a fixed step is cut there (`reversals`). At other jumps the order falls to one, and
halving the steps says what that does to an answer.

**Error by step.** A fixed step errs by c h^4, so that k times as many leave k^-4 of it. An adaptive
one holds the error of each step, C h^5 of an embedded method of fourth order, at its tolerance:
steps k times as short ask for tolerances k^-5 times as large (`finer`).

A grid that is indexed instead of searched costs nothing. That is why `FixedStep` runs its own scan
over the samples. The same tableau on the quarter car takes 1.3 to 1.9 times as long inside
`diffeqsolve`, which saves by interpolation, and 1.2 to 1.6 times with diffrax's `solver.step` in
the same scan, 3 to 4 times in a batch: benchmarks/NOTES.md.
`Adaptive` is that `diffeqsolve`, for reference solutions, unfamiliar systems and stiff ones.

A step of a small system is a few dozen additions, and what it costs is how they are started. Where
XLA compiles loops whole (see `riecjax.runtime`), the components of the state are carried apart: all
of a step is then one kernel, which a batch of simulations runs in vector instructions. Where XLA
starts kernels one by one, the state is one vector, so that there are few of them.
"""

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from diffrax import RESULTS as DIFFRAX_RESULTS
from diffrax import (
    AbstractAdjoint,
    AbstractSolver,
    ClipStepSizeController,
    ForwardMode,
    ODETerm,
    PIDController,
    SaveAt,
    Tsit5,
    diffeqsolve,
)
from jaxtyping import Float, Int

from riecjax.arrays import Array
from riecjax.errors import ModelError
from riecjax.runtime import compiles_loops_whole
from riecjax.simulation.intersample import curves_of
from riecjax.simulation.reversals import cut_step
from riecjax.simulation.system import AbstractSystem, Inputs, State


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


class AbstractMethod(eqx.Module):
    """Integrates a system from its initial state along sampled inputs."""

    def trajectory(
        self,
        system: AbstractSystem,
        inputs: Float[Array, "n inputs"],
        time_step: Float[Array, ""],
        initial_state: State,
        bends: Float[Array, "n inputs"] | None = None,
    ) -> Trajectory:
        """States at the samples of `inputs`; differentiable and vmappable.

        **Arguments:** `bends`, the inputs' curvature at each sample, in their unit per time step
        squared; without it they are straight lines between samples.
        """
        raise NotImplementedError

    def finer(self, factor: int) -> "AbstractMethod | None":
        """The same with steps `factor` times as short, or None if it has none to shorten."""
        return None

    def counted(self) -> "AbstractMethod":
        """The same with its number of steps as an argument of what is compiled, where that can be:
        one program serves all numbers, but is not differentiated in reverse."""
        return self

    @property
    def label(self) -> str:
        """How it is written, for tables and messages."""
        return type(self).__name__


class FixedStep(AbstractMethod):
    """The classical Runge-Kutta method, of fourth order, with so many steps between samples.

    Of its four stages each reads only its predecessor, which makes it the cheapest per unit of
    accuracy at steps of a few milliseconds on systems of a few states.
    """

    steps_per_sample: int = eqx.field(static=True, default=8)

    def __check_init__(self):
        if self.steps_per_sample < 1:
            raise ModelError(f"steps_per_sample must be at least 1; got {self.steps_per_sample}.")

    def finer(self, factor: int) -> "FixedStep":
        """With so many times more steps."""
        return FixedStep(self.steps_per_sample * factor)

    def counted(self) -> "_Counted":
        """With the number as an array."""
        return _Counted(1, number=np.asarray(self.steps_per_sample, np.int32))

    @property
    def count(self) -> int | Array:
        """Steps between samples, known to what is compiled."""
        return self.steps_per_sample

    @property
    def label(self) -> str:
        """`FixedStep(8)`."""
        return f"FixedStep({self.steps_per_sample})"

    def trajectory(
        self,
        system: AbstractSystem,
        inputs: Float[Array, "n inputs"],
        time_step: Float[Array, ""],
        initial_state: State,
        bends: Float[Array, "n inputs"] | None = None,
    ) -> Trajectory:
        """States at the samples; see the base class."""
        count = self.count
        step = time_step / count
        by_component = compiles_loops_whole()

        def split(state: State) -> _State:
            return tuple(state[i] for i in range(state.shape[0])) if by_component else state

        def whole(state: _State) -> State:
            return jnp.stack(state) if isinstance(state, tuple) else state

        def where(condition: Array, state: _State, otherwise: _State) -> _State:
            return jax.tree.map(partial(jnp.where, condition), state, otherwise)

        def slope(state: _State, level: Array) -> _State:
            return split(system.derivative(whole(state), level))

        def between_samples(carry, interval):
            state, running = carry
            first, last, *curve = interval
            rise = (last - first) / count

            def one_step(k, x):
                begin = first + rise * k

                def level(node: float | Array) -> Array:
                    at_begin = isinstance(node, float) and not node
                    on_line = begin if at_begin else begin + node * rise
                    return on_line + _off_line(curve, (k + node) / count) if curve else on_line

                if system.reversing:
                    return split(cut_step(system, _runge_kutta_step, whole(x), level, step))
                return _runge_kutta_step(slope, x, level, step)

            # A lost lane restarts from its initial state, unseen, so that no infinity enters later
            # steps or their derivatives; the state it shows stays at its last finite value.
            moved = jax.lax.fori_loop(0, count, one_step, where(running, state, start))
            running = running & jnp.all(jnp.isfinite(whole(moved)))
            state = where(running, moved, state)
            return (state, running), (whole(state), running)

        start = split(initial_state)
        intervals = (inputs[:-1], inputs[1:], *curves_of(bends))
        _, (states, running) = jax.lax.scan(between_samples, (start, jnp.array(True)), intervals)
        status = SimulationStatus.where(
            running[-1], SimulationStatus.successful, SimulationStatus.diverged
        )
        reached = 1 + jnp.sum(running.astype(jnp.int32))
        return jnp.concatenate([initial_state[None], states]), status, reached


class _Counted(FixedStep):
    """Fixed steps whose number is an argument of what is compiled."""

    number: Int[Array, ""] = eqx.field(kw_only=True)

    @property
    def count(self) -> int | Array:
        """As many as are asked for at each call."""
        return self.number


class Adaptive(AbstractMethod):
    """`diffrax.diffeqsolve` with an adaptive step, restarted at every kink of the input.

    **Arguments:**

    - `rtol`, `atol`: relative and absolute tolerance of each step, to be chosen by the user.
    - `solver`: any diffrax solver, implicit ones for stiff systems included.
    - `max_steps`: steps in all; none left is the status `max_steps_reached`.
    - `adjoint`: how it is differentiated, as for `diffeqsolve`. Forward by default (`jax.jvp`,
      `jacfwd`, and `refine`, which forms its Jacobians forward); in reverse (`jax.grad`) by
      `diffrax.RecursiveCheckpointAdjoint()`; both ways by `diffrax.DirectAdjoint()`, whose memory
      grows with `max_steps`.
    """

    rtol: float = eqx.field(static=True)
    atol: float = eqx.field(static=True)
    solver: AbstractSolver = eqx.field(default_factory=Tsit5)
    max_steps: int = eqx.field(static=True, default=1_000_000)
    adjoint: AbstractAdjoint = eqx.field(default_factory=ForwardMode)

    def finer(self, factor: int) -> "Adaptive":
        """At tolerances for steps about that much shorter, of a method of fourth order."""
        share = float(factor) ** -5
        return dataclasses.replace(
            self, rtol=self.rtol * share, atol=self.atol * share, max_steps=self.max_steps * factor
        )

    @property
    def label(self) -> str:
        """`Adaptive(1e-06, 1e-09)`."""
        return f"Adaptive({self.rtol:g}, {self.atol:g})"

    def trajectory(
        self,
        system: AbstractSystem,
        inputs: Float[Array, "n inputs"],
        time_step: Float[Array, ""],
        initial_state: State,
        bends: Float[Array, "n inputs"] | None = None,
    ) -> Trajectory:
        """States at the samples; see the base class."""
        last = inputs.shape[0] - 1

        # Time is counted in samples, so that the sample below a time is found without a search.
        # All that may be differentiated by is an argument: some adjoints see no closure.
        def vector_field(position, state, args):
            system, inputs, time_step, curves = args
            below = jnp.clip(jnp.floor(position).astype(jnp.int32), 0, last - 1)
            share = position - below
            level = inputs[below] + share * (inputs[below + 1] - inputs[below])
            if curves:
                level = level + _off_line([part[below] for part in curves], share)
            return time_step * system.derivative(state, level)

        samples = jnp.arange(last + 1, dtype=initial_state.dtype)
        solution = diffeqsolve(
            ODETerm(vector_field),
            self.solver,
            samples[0],
            samples[-1],
            0.1,
            initial_state,
            args=(system, inputs, time_step, curves_of(bends)),
            saveat=SaveAt(ts=samples),
            # The right-hand side has a kink at every sample; a step across one loses its order.
            stepsize_controller=ClipStepSizeController(
                PIDController(rtol=self.rtol, atol=self.atol), jump_ts=samples[1:-1]
            ),
            max_steps=self.max_steps,
            adjoint=self.adjoint,
            throw=False,
        )
        assert solution.ys is not None
        reached = jnp.sum(jnp.all(jnp.isfinite(solution.ys), axis=-1).astype(jnp.int32))
        lost = jnp.arange(last + 1) >= reached
        states = jnp.where(
            lost[:, None], solution.ys[jnp.maximum(reached - 1, 0)][None], solution.ys
        )
        result, choose = solution.result, SimulationStatus.where
        failed = choose(
            result == DIFFRAX_RESULTS.max_steps_reached,
            SimulationStatus.max_steps_reached,
            SimulationStatus.solver_failed,
        )
        finished = choose(reached > last, SimulationStatus.successful, SimulationStatus.diverged)
        return states, choose(result == DIFFRAX_RESULTS.successful, finished, failed), reached


_State = State | tuple[Array, ...]
"""The state as one vector, or as its components."""


def _off_line(curve: Sequence[Array], share: float | Array) -> Inputs:
    """What inputs differ from a straight line by, at a share of the interval."""
    return share * (1 - share) * (curve[0] + share * curve[1])


def _runge_kutta_step(
    slope: Callable[[Any, Array], Any],
    state: Any,
    level: Callable[[float], Inputs],
    step: Float[Array, ""],
) -> Any:
    """One step, over which `level` gives the inputs from 0 to 1."""

    def moved(share: float, rate: Any) -> Any:
        return jax.tree.map(lambda x, slope: x + step * (share * slope), state, rate)

    first = slope(state, level(0.0))
    second = slope(moved(0.5, first), level(0.5))
    third = slope(moved(0.5, second), level(0.5))
    last = slope(moved(1.0, third), level(1.0))
    sixths = jax.tree.map(lambda *k: k[0] + 2 * k[1] + 2 * k[2] + k[3], first, second, third, last)
    return moved(1 / 6, sixths)
