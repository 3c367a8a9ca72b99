"""Fisher information of a recording on a model's parameters, before it is made.

With white Gaussian noise of standard deviation sigma_c on each channel, y_c(k) = h_c(k; u) + noise
for unknown parameters and initial state u, and the log-likelihood is, up to a constant,
-1/2 sum ((y_c - h_c) / sigma_c)^2. Its slope by u is J'r, with r the residuals and J the
sensitivities dh/du, both in units of sigma, and the covariance of that slope is the information

    I = E J'r r'J = J'J.

No unbiased estimate has a covariance below I^-1 (Cramer and Rao); output error attains it on all
but short records. With all of u unknown the parameters' part of I^-1 is (I_pp - I_ps I_ss^-1
I_sp)^-1: what could as well be another initial state tells nothing.

Everything is in units of the values: with u_i = v_i theta_i the information on v is theta_i I_ij
theta_j, and [I_v^-1]_jj is the square of a relative standard error, whatever the units.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float, Key

from riecjax.errors import ModelError
from riecjax.leaves import is_concrete
from riecjax.linear_algebra import solve_scaled
from riecjax.records.record import Record
from riecjax.refinement.objective import AbstractParametric, as_parametric_system
from riecjax.refinement.output_error import observed
from riecjax.simulation.inputs import multisine
from riecjax.simulation.linearisation import suitable_steps
from riecjax.simulation.method import AbstractMethod, FixedStep
from riecjax.simulation.system import AbstractSystem


class Experiment(eqx.Module):
    """A model that is to be excited, and what is measured of it.

    **Fields:**

    - `system` for every value of its parameters; `values` of the `parameters` that will be
      estimated; `known`, values held.
    - `initial_state`, which will be estimated too.
    - `sigma`: standard deviation of the white noise on each of `channels`.
    - `time_step` in seconds; `method` of simulation.
    """

    system: AbstractParametric
    values: Float[Array, " p"]
    known: dict[str, Array]
    initial_state: Float[Array, " states"]
    sigma: Float[Array, " channels"]
    time_step: Float[Array, ""]
    method: AbstractMethod
    channels: tuple[str, ...] = eqx.field(static=True)
    parameters: tuple[str, ...] = eqx.field(static=True)

    def built(self, values: Float[Array, " p"] | None = None) -> AbstractSystem:
        """The system at its values, or at others."""
        chosen = self.values if values is None else values
        return self.system.build({**self.known, **dict(zip(self.parameters, chosen))})

    def trajectory(self, levels: Float[Array, "n inputs"]) -> Float[Array, "n states"]:
        """States from the initial one, along the inputs."""
        return self._states(self.built(), self.initial_state, levels)

    def information(
        self, levels: Float[Array, "n inputs"]
    ) -> tuple[Float[Array, "p+s p+s"], Float[Array, "n states"]]:
        """Information matrix of the parameters and, after them, the initial state; and the states.

        Of parameters in units of their values, where these are not zero, and of states in theirs.
        """
        p, size = self.values.shape[0], self._size()
        # A share of a value; from a value of zero, one unit.
        unknown = jnp.concatenate([self.values / size, self.initial_state])

        def simulated(unknown: Array) -> tuple[Array, Array]:
            system = self.built(unknown[:p] * size)
            states = self._states(system, unknown[p:], levels)
            return observed(system, states, levels, self.channels) / self.sigma[None, :], states

        slopes, states = jax.jacfwd(simulated, has_aux=True)(unknown)
        return jnp.einsum("nci,ncj->ij", slopes, slopes), states

    def standard_errors(self, information: Float[Array, "p+s p+s"]) -> Float[Array, " p"]:
        """Least standard deviation of each parameter in its unit, all others being unknown."""
        p = self.values.shape[0]
        return jnp.sqrt(jnp.diagonal(inverse(information))[:p]) * self._size()

    def _size(self) -> Float[Array, " p"]:
        return jnp.where(self.values != 0, jnp.abs(self.values), 1.0)

    def _states(
        self, system: AbstractSystem, start: Float[Array, " states"], levels: Array
    ) -> Float[Array, "n states"]:
        return self.method.trajectory(system, levels, self.time_step, start)[0]


def inverse(information: Float[Array, "k k"]) -> Float[Array, "k k"]:
    """Inverse of an information matrix; huge, not infinite, where there is no information."""
    k = information.shape[0]
    rounding = 8 * k * float(jnp.finfo(information.dtype).eps)
    return solve_scaled(information, jnp.eye(k, dtype=information.dtype), ridge=rounding)


def plan_experiment(
    model: Any,
    values: Mapping[str, float | Array],
    record: Record,
    *,
    channels: Sequence[str],
    sigma: Mapping[str, float | Array],
    known: Mapping[str, float | Array] | None = None,
    initial_state: Mapping[str, float | Array] | None = None,
    method: AbstractMethod | None = None,
) -> Experiment:
    """An experiment, checked.

    **Arguments:** as of [`predicted_standard_errors`][].

    **Raises:** `ModelError` for unknown names, no parameter, no channel, or noise that is not
    given; `DataError` for a missing input.
    """
    system = as_parametric_system(model, record)
    named = {**dict(known or {}), **values}
    if unknown := [n for n in named if system.parameters and n not in system.parameters]:
        raise ModelError(
            f"unknown parameter '{unknown[0]}'; the model has: {', '.join(system.parameters)}."
        )
    if not values or not channels:
        raise ModelError("an experiment needs a parameter to estimate and a channel to measure.")
    held = {**system.defaults, **dict(known or {})}
    held = {name: jnp.asarray(value) for name, value in held.items() if name not in values}
    free = {name: jnp.asarray(value, float) for name, value in values.items()}
    built: AbstractSystem = system.build({**held, **free})
    if missing := [name for name in channels if name not in sigma]:
        raise ModelError(f"no noise (sigma) is given for {', '.join(missing)}.")
    made = built.simulated_names
    if unknown := [name for name in channels if name not in made]:
        raise ModelError(
            f"the simulation has no signal '{unknown[0]}' to measure; it has: {', '.join(made)}."
        )
    built.require_states(initial_state or {})
    start = [jnp.asarray((initial_state or {}).get(name, 0.0), float) for name in built.state_names]
    experiment = Experiment(
        system,
        jnp.stack(list(free.values())),
        held,
        jnp.stack(start),
        jnp.stack([jnp.asarray(sigma[name], float) for name in channels]),
        record.time_step,
        FixedStep() if method is None else method,
        tuple(channels),
        tuple(free),
    )
    if method is not None or not is_concrete(experiment, record):
        return experiment
    # Steps that are short enough along the motion that this record excites.
    levels = levels_of(experiment, record)
    states = eqx.filter_jit(Experiment.trajectory)(experiment, levels)
    steps = suitable_steps(built, states, levels, float(record.time_step))
    return eqx.tree_at(lambda e: e.method, experiment, FixedStep(steps))


def predicted_standard_errors(
    model: Any,
    values: Mapping[str, float | Array],
    record: Record,
    *,
    channels: Sequence[str],
    sigma: Mapping[str, float | Array],
    known: Mapping[str, float | Array] | None = None,
    initial_state: Mapping[str, float | Array] | None = None,
    method: AbstractMethod | None = None,
) -> dict[str, Float[Array, ""]]:
    """Standard errors that output error would have of a recording under these inputs.

    Differentiable and vmappable over records.

    **Arguments:**

    - `model`: something to simulate, as for [`refine`][] by output error.
    - `values`: of the parameters that will be estimated; the information depends on them.
    - `record`: holds the inputs.
    - `channels`: signals that will be measured: states, their derivatives, outputs.
    - `sigma`: standard deviation of the white noise on each, in its unit.
    - `known`: values that will be held. Parameters named nowhere keep the model's own.
    - `initial_state`: state name to value; those not named start at zero. It will be estimated.
    - `method`: as for [`simulate`][]; by default steps short enough for the model.

    **Raises:** as [`plan_experiment`][].
    """
    experiment = plan_experiment(
        model,
        values,
        record,
        channels=channels,
        sigma=sigma,
        known=known,
        initial_state=initial_state,
        method=method,
    )
    return dict(
        zip(experiment.parameters, _standard_errors(experiment, levels_of(experiment, record)))
    )


def levels_of(experiment: Experiment, record: Record) -> Float[Array, "n inputs"]:
    """The inputs of the system, side by side."""
    return jnp.stack([record.signals[name] for name in experiment.built().input_names], axis=-1)


@eqx.filter_jit
def _standard_errors(experiment: Experiment, levels: Array) -> Float[Array, " p"]:
    return experiment.standard_errors(experiment.information(levels)[0])


# The multisine that makes one parameter's interval tightest, within the travel that a rig allows.
#
# The cost is the logarithm of one diagonal entry of the inverse information, v = [I^-1]_jj, so that
# a step is worth the same whatever the units. With x = I^-1 e_j its slope is d log v = -x' dI x /
# v: what counts is information along x, the direction in which the data tell least about the
# parameter. Sensitivities go forward through the simulation, since parameters are few, and the
# slope by the input in reverse, since the amplitudes and phases of a multisine are many.
#
# For a linear model in steady state over whole periods, I = sum_i a_i^2 M(f_i): phases do not
# matter, powers add up, and p (p + 1) / 2 frequencies suffice, as many as I has entries. Phases
# decide about travel, which is the peak of a state, and about non-linear models. There are many
# local optima, hence several starts.

PENALTIES = (1.0, 1e2, 1e4)
"""Weights of the excess of travel, in turn. With the last one, a single sample that is 1 % beyond
costs as much as a variance that is e times as large."""
MARGIN = 0.005
"""A penalty begins this share of a limit below it, so that what is left stays within the limit."""
TOLERANCE = 1e-3
"""Change of a coefficient, the largest being about one, that is not worth another step."""


class DesignStatus(eqx.Enumeration):
    """How the search for an input ended."""

    converged = "converged"
    out_of_steps = "used up its steps before it converged (max_steps); the input can be used."
    travel_exceeded = (
        "found no input of this r.m.s. that keeps the travel. Lower the r.m.s., or allow other "
        "frequencies."
    )
    not_finite = (
        "the model has no finite sensitivities under these inputs. Lower the r.m.s., or use more "
        "steps per sample."
    )


class Design(eqx.Module):
    """An input, and what it promises.

    **Fields:**

    - `record`: the input.
    - `frequencies` in Hz, with the `amplitudes` (in the input's unit) and `phases` (rad) of the
      multisine.
    - `standard_error` of the `parameter` that was asked for, in its unit, with all others and the
      initial state unknown; `standard_errors` of all that are estimated.
    - `rms` of the input; `peaks`: largest size of each limited state over the samples.
    - `starts`: what the search from each start promised, infinite where the travel is exceeded.
    - `status` of the search.
    """

    record: Record
    frequencies: Float[Array, " k"]
    amplitudes: Float[Array, " k"]
    phases: Float[Array, " k"]
    standard_error: Float[Array, ""]
    standard_errors: dict[str, Float[Array, ""]]
    rms: Float[Array, ""]
    peaks: dict[str, Float[Array, ""]]
    starts: Float[Array, " starts"]
    status: DesignStatus
    parameter: str = eqx.field(static=True)

    @property
    def reason(self) -> str:
        """How the search ended, in words (not under jit)."""
        return DesignStatus[self.status]


class _Task(eqx.Module):
    """The cost of an input in terms of the cosine and sine part of each harmonic.

    Unlike a phase, which means nothing at zero amplitude, these have no singular point. Their
    common factor is free, since the input is scaled to its r.m.s.
    """

    experiment: Experiment
    frequencies: Float[Array, " k"]
    rms: Float[Array, ""]
    limits: Float[Array, " limited"]
    sample_count: int = eqx.field(static=True)
    place: int = eqx.field(static=True)
    limited: tuple[int, ...] = eqx.field(static=True)

    def polar(self, coefficients: Float[Array, " 2k"]) -> tuple[Array, Array]:
        """Amplitudes and phases of the input."""
        cosine, sine = jnp.split(coefficients, 2)
        factor = self.rms / _rms(self._raw(coefficients))
        return factor * jnp.hypot(cosine, sine), jnp.arctan2(-sine, cosine)

    def levels(self, coefficients: Float[Array, " 2k"]) -> Float[Array, "n 1"]:
        """The input, of exactly the r.m.s. that is asked for."""
        raw = self._raw(coefficients)
        return (raw * (self.rms / _rms(raw)))[:, None]

    def _raw(self, coefficients: Array) -> Float[Array, " n"]:
        cosine = jnp.zeros_like(self.frequencies)
        phases = jnp.concatenate([cosine, cosine - jnp.pi / 2])
        both = jnp.concatenate([self.frequencies, self.frequencies])
        step = self.experiment.time_step
        return multisine(coefficients, phases, both, self.sample_count, step)

    def peaks(self, states: Float[Array, "n states"]) -> Float[Array, " limited"]:
        """Largest size of each limited state."""
        return jnp.max(jnp.abs(states[:, np.array(self.limited, int)]), axis=0)

    def excess(self, states: Float[Array, "n states"]) -> Float[Array, ""]:
        """Squared travel beyond the limits, as shares of them, over all samples."""
        share = jnp.abs(states[:, np.array(self.limited, int)]) / self.limits[None, :]
        return jnp.sum(jnp.maximum(share - (1 - MARGIN), 0.0) ** 2)

    def cost(self, coefficients: Float[Array, " 2k"], penalty: Array) -> Float[Array, ""]:
        """Logarithm of the parameter's variance, with a penalty on travel."""
        information, states = self.experiment.information(self.levels(coefficients))
        variance = inverse(information)[self.place, self.place]
        return jnp.log(variance) + penalty * self.excess(states)


def design_input(
    model: Any,
    values: Mapping[str, float | Array],
    parameter: str,
    *,
    frequencies: Sequence[float] | Float[np.ndarray, " k"] | Float[Array, " k"],
    sample_count: int,
    time_step: float,
    rms: float | Array,
    channels: Sequence[str],
    sigma: Mapping[str, float | Array],
    key: Key[Array, ""],
    travel: Mapping[str, float | Array] | None = None,
    known: Mapping[str, float | Array] | None = None,
    initial_state: Mapping[str, float | Array] | None = None,
    method: AbstractMethod | None = None,
    starts: int = 4,
    max_steps: int = 100,
) -> Design:
    """The multisine that makes one parameter's interval tightest, all others being unknown too.

    The input has exactly this r.m.s. The best input depends on `values`, which are not known
    before the recording: design with an estimate, and again when there is a better one.

    **Arguments:**

    - `model`: something to simulate with one input, as for [`refine`][] by output error.
    - `values`: of the parameters that will be estimated; `parameter`, the one that matters.
    - `frequencies` in Hz, best on the grid of [`harmonics`][].
    - `sample_count` and `time_step` (s) of the recording; `rms` in the input's unit.
    - `channels`, `sigma`, `known`, `initial_state`, `method`: as for
      [`predicted_standard_errors`][].
    - `travel`: state name to the size that it must keep at every sample, in its unit.
    - `starts`: searches from as many draws of phases; `max_steps` of each, in each of three
      rounds with a rising penalty on travel.

    **Raises:** `ModelError` for unknown names, limits that are not positive, a system that has not
    one input, or frequencies that the time step does not resolve. A search that fails raises
    nothing: see `status` of the result.
    """
    grid = jnp.asarray(frequencies, float)
    phases = jax.random.uniform(key, (starts, grid.shape[0]), maxval=2 * jnp.pi)
    wave = multisine(jnp.ones_like(grid), phases[0], grid, sample_count, time_step)
    wave = wave * (rms / _rms(wave))
    family = as_parametric_system(model, Record({"": wave}, time_step))
    at: dict[str, Any] = {**family.defaults, **dict(known or {}), **values}
    inputs = family.build(at).input_names
    if len(inputs) != 1:
        raise ModelError(
            f"the input of a system with one input can be designed; this one has {len(inputs)}: "
            f"{', '.join(inputs)}. Give a system in which the others are known."
        )
    experiment = plan_experiment(
        model,
        values,
        Record({inputs[0]: wave}, time_step),
        channels=channels,
        sigma=sigma,
        known=known,
        initial_state=initial_state,
        method=method,
    )
    task = _task(experiment, parameter, grid, sample_count, rms, dict(travel or {}))
    found = jnp.concatenate([jnp.cos(phases), -jnp.sin(phases)], axis=1)
    settled = jnp.zeros(starts, bool)
    for penalty in PENALTIES if travel else PENALTIES[:1]:
        found, settled = _search(task, found, jnp.asarray(penalty), max_steps)
    return _best(task, found, settled, inputs[0], parameter)


def _rms(wave: Float[Array, " n"]) -> Float[Array, ""]:
    return jnp.sqrt(jnp.mean(wave**2))


def _task(
    experiment: Experiment,
    parameter: str,
    frequencies: Float[Array, " k"],
    sample_count: int,
    rms: float | Array,
    travel: Mapping[str, float | Array],
) -> _Task:
    system = experiment.built()
    if parameter not in experiment.parameters:
        raise ModelError(
            f"'{parameter}' is not estimated; estimated are: {', '.join(experiment.parameters)}."
        )
    system.require_states(travel)
    if wrong := [n for n, limit in travel.items() if is_concrete(limit) and not limit > 0]:
        raise ModelError(f"the travel of {wrong[0]} needs a positive limit.")
    return _Task(
        experiment,
        frequencies,
        jnp.asarray(rms, float),
        jnp.asarray(list(travel.values()), float),
        sample_count,
        experiment.parameters.index(parameter),
        tuple(system.state_names.index(name) for name in travel),
    )


@eqx.filter_jit
def _search(
    task: _Task, first: Float[Array, "starts 2k"], penalty: Float[Array, ""], max_steps: int
) -> tuple[Float[Array, "starts 2k"], Bool[Array, " starts"]]:
    """Each start's least cost, and whether its search converged."""

    def of_start(coefficients: Float[Array, " 2k"]) -> tuple[Array, Array]:
        solution = optx.minimise(
            lambda c, args: args[0].cost(c, args[1]),
            optx.BFGS(TOLERANCE, TOLERANCE),
            # One size for all starts: the cost does not depend on it, but the steps do.
            coefficients / _rms(coefficients),
            args=(task, penalty),
            max_steps=max_steps,
            throw=False,
        )
        return solution.value, solution.result == optx.RESULTS.successful

    return jax.vmap(of_start)(first)


@eqx.filter_jit
def _best(
    task: _Task,
    found: Float[Array, "starts 2k"],
    settled: Bool[Array, " starts"],
    name: str,
    parameter: str,
) -> Design:
    """The best of those that keep the travel; if none does, the one that comes nearest."""

    def outcome(coefficients: Array) -> tuple[Array, ...]:
        levels = task.levels(coefficients)
        information, states = task.experiment.information(levels)
        errors = task.experiment.standard_errors(information)
        return levels, errors, task.peaks(states), task.excess(states)

    levels, errors, peaks, excess = jax.vmap(outcome)(found)
    finite = jnp.isfinite(errors[:, task.place])
    within = jnp.all(peaks <= task.limits[None, :], axis=1) & finite
    promised = jnp.where(within, errors[:, task.place], jnp.inf)
    nearest = jnp.argmin(jnp.where(finite, excess, jnp.inf))
    best = jnp.where(jnp.any(within), jnp.argmin(promised), nearest)
    amplitudes, phases = task.polar(found[best])
    wave = levels[best, :, 0]
    experiment = task.experiment
    states = experiment.built().state_names
    status = DesignStatus.where(settled[best], DesignStatus.converged, DesignStatus.out_of_steps)
    status = DesignStatus.where(jnp.any(within), status, DesignStatus.travel_exceeded)
    status = DesignStatus.where(jnp.any(finite), status, DesignStatus.not_finite)
    return Design(
        record=Record({name: wave}, experiment.time_step, units=experiment.built().inputs),
        frequencies=task.frequencies,
        amplitudes=amplitudes,
        phases=phases,
        standard_error=errors[best, task.place],
        standard_errors=dict(zip(experiment.parameters, errors[best])),
        rms=_rms(wave),
        peaks={states[i]: peak for i, peak in zip(task.limited, peaks[best])},
        starts=promised,
        status=status,
        parameter=parameter,
    )
