"""What is bypassed: diffrax's steps and loop, optimistix's Levenberg-Marquardt, against ours.

Both sides do the same: the classical Runge-Kutta method with eight steps to a sample; the same
residuals with the same derivatives, from the same start.
"""

from collections.abc import Callable, Iterator
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from diffrax import (
    AbstractERK,
    ButcherTableau,
    ConstantStepSize,
    ForwardMode,
    MultiButcherTableau,
    ODETerm,
    SaveAt,
    ThirdOrderHermitePolynomialInterpolation,
    diffeqsolve,
)
from jaxtyping import Array, Float

from benchmarks.drag_problem import START, oscillator, record
from benchmarks.timing import Comparison, Size, compare
from riecjax.models.quarter_car.reconstruction import quarter_car_source, reconstructed
from riecjax.models.quarter_car.source import QuarterCarSource
from riecjax.refinement.optimum import (
    Constraints,
    LevenbergMarquardt,
    Point,
    Problem,
    Solver,
    default_solver,
    find_optimum,
    residual_variance,
)
from riecjax.refinement.output_error import OutputError, Tiles
from riecjax.simulation.inputs import band_limited_noise
from riecjax.simulation.method import CLASSICAL_RUNGE_KUTTA, AbstractMethod, Adaptive, FixedStep

STEPS, COUNT, TIME_STEP = 8, 8000, 1 / 200
TOLERANCE = 1e-5
"""Of optimistix's solver: the loosest round one at which it is as near to the optimum as ours."""
NO_SLOWER = 0.9
"""Ratio from which ours is taken for no slower: what is left is other programs' noise."""

States = Float[Array, "n states"]
State = tuple[Array, ...]


class ClassicalRungeKutta(AbstractERK):
    """Our default method, as a solver of diffrax."""

    tableau: ClassVar[ButcherTableau | MultiButcherTableau] = CLASSICAL_RUNGE_KUTTA
    interpolation_cls: ClassVar[Callable[..., ThirdOrderHermitePolynomialInterpolation]] = (
        ThirdOrderHermitePolynomialInterpolation.from_k
    )

    def order(self, terms: object) -> int:
        return 4


@eqx.filter_jit
def by_method(source: QuarterCarSource, inputs: Array, method: AbstractMethod) -> States:
    return method.trajectory(
        source, inputs, jnp.asarray(TIME_STEP), jnp.zeros(len(source.state_names))
    )[0]


@eqx.filter_jit
def by_steps_of_diffrax(source: QuarterCarSource, inputs: Array) -> States:
    """`solver.step` in a scan over the samples, in which time counts from each sample.

    The components of the state are carried apart, as ours are: one vector takes 1.5 times as long,
    and twice as long in a batch.
    """
    solver, share, count = ClassicalRungeKutta(), 1 / STEPS, len(source.state_names)

    def slope(place, state, ends):
        level = ends[0] + place * (ends[1] - ends[0])
        found = TIME_STEP * source.derivative(jnp.stack(state), level)
        return tuple(found[i] for i in range(count))

    terms = ODETerm(slope)

    def between_samples(state: State, ends: tuple[Array, Array]) -> tuple[State, Array]:
        def one(k: Array, state: State) -> State:
            return solver.step(terms, share * k, share * (k + 1), state, ends, None, False)[0]

        state = jax.lax.fori_loop(0, STEPS, one, state)
        return state, jnp.stack(state)

    first = tuple(jnp.zeros(()) for _ in range(count))
    states = jax.lax.scan(between_samples, first, (inputs[:-1], inputs[1:]))[1]
    return jnp.concatenate([jnp.stack(first)[None], states])


@eqx.filter_jit
def by_diffeqsolve(source: QuarterCarSource, inputs: Array) -> States:
    """Time counts in samples, so that the sample below a time is found without a search."""
    last = inputs.shape[0] - 1

    def slope(place, state, inputs):
        below = jnp.clip(jnp.floor(place).astype(jnp.int32), 0, last - 1)
        level = inputs[below] + (place - below) * (inputs[below + 1] - inputs[below])
        return TIME_STEP * source.derivative(state, level)

    solution = diffeqsolve(
        ODETerm(slope),
        ClassicalRungeKutta(),
        0.0,
        float(last),
        1 / STEPS,
        jnp.zeros(len(source.state_names)),
        args=inputs,
        saveat=SaveAt(ts=jnp.arange(last + 1.0)),
        stepsize_controller=ConstantStepSize(),
        max_steps=STEPS * last + 1,
        adjoint=ForwardMode(),
    )
    assert solution.ys is not None
    return solution.ys


def simulations(size: Size) -> Iterator[Comparison]:
    source = quarter_car_source(reconstructed())
    keys = jax.random.split(jax.random.key(0), size.batch)
    roads = jax.vmap(lambda k: band_limited_noise(k, COUNT, TIME_STEP, bandwidth=30.0, rms=0.55))(
        keys
    )[:, :, None]
    truth = np.asarray(by_method(source, roads[0], Adaptive(rtol=1e-10, atol=1e-12)))

    def error(found: Array) -> float:
        return float(np.max(np.abs(np.asarray(found) - truth) / np.abs(truth).max(0)))

    ours = error(by_method(source, roads[0], FixedStep(STEPS)))
    for name, baseline, theirs in (
        ("scan-or-steps", "diffrax's solver.step in a scan", by_steps_of_diffrax),
        ("scan-or-diffeqsolve", "diffrax's diffeqsolve at the same steps", by_diffeqsolve),
    ):
        yield compare(
            name,
            lambda: by_method(source, roads[0], FixedStep(STEPS)),
            baseline,
            lambda theirs=theirs: theirs(source, roads[0]),
            NO_SLOWER,
            {"ours": ours, "baseline": error(theirs(source, roads[0]))},
            repeats=size.repeats,
        )
    together = jax.jit(jax.vmap(lambda road: by_method(source, road, FixedStep(STEPS))))
    stepped = jax.jit(jax.vmap(lambda road: by_steps_of_diffrax(source, road)))
    yield compare(
        "scan-or-steps-batch",
        lambda: together(roads),
        f"diffrax's solver.step in a scan, {size.batch} roads vmapped",
        lambda: stepped(roads),
        1,
        {"ours": error(together(roads)[0]), "baseline": error(stepped(roads)[0])},
        repeats=size.repeats,
    )


def problem_of(objective: OutputError) -> tuple[Problem, Point]:
    """What `refine` searches, and from where."""
    specified = objective.specify(oscillator(), [record(1)], START, {}, (), None)
    misfit = objective.misfit(specified)
    constraints = Constraints.of(specified.names, specified.values, {}, {})
    theta, initial = specified.theta, misfit.first_initial()
    variance = residual_variance(misfit, misfit.energy(theta, initial), theta.shape[0])
    problem = Problem(misfit, constraints.coordinates(jnp.abs(theta)), constraints, variance)
    return problem, problem.point(theta, initial)


@eqx.filter_jit
def searched(problem: Problem, start: Point, solver: Solver) -> tuple[Array, Array]:
    """Parameters in their units, and the search's steps."""
    point, _, steps, _ = find_optimum(problem, start, solver, 100, None)
    return problem.values(point)[0], steps


SEARCHES = {
    "search-one-window": OutputError(initial_states={"x": 0.0, "dx": 0.0}, method=FixedStep(1)),
    "search-one-window-start": OutputError(method=FixedStep(1)),
    "search-many-windows": OutputError(Tiles(seconds=1.0), method=FixedStep(1)),
}
"""Four unknowns, six with the start of the whole record, 44 with those of 20 windows."""


def searches(size: Size) -> Iterator[Comparison]:
    ours = default_solver(jnp.float64)
    theirs = optx.LevenbergMarquardt(TOLERANCE, TOLERANCE)
    for name, objective in SEARCHES.items():
        problem, start = problem_of(objective)
        nearest, _ = searched(problem, start, LevenbergMarquardt(1e-10))
        accuracy = {}
        for side, solver in (("ours", ours), ("baseline", theirs)):
            found, steps = searched(problem, start, solver)
            accuracy[f"{side}_off_the_optimum"] = float(jnp.max(jnp.abs(found / nearest - 1)))
            accuracy[f"{side}_steps"] = float(steps)
        yield compare(
            name,
            lambda problem=problem, start=start: searched(problem, start, ours),
            "optimistix's LevenbergMarquardt on the same residuals",
            lambda problem=problem, start=start: searched(problem, start, theirs),
            NO_SLOWER,
            accuracy,
            repeats=20 * size.repeats,
        )


def run(size: Size) -> Iterator[Comparison]:
    yield from simulations(size)
    yield from searches(size)
