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

from riecjax import Adaptive, FixedStep, ModelError, Record, Signal, simulate
from riecjax.arrays import is_concrete
from riecjax.errors import refuse_unknown
from riecjax.linear_algebra import solve_scaled
from riecjax.refinement import ByFunction, as_parametric_system
from riecjax.simulation import AbstractSystem, multisine, suitable_steps


class _Experiment(eqx.Module):
    """A model that is to be excited, and what is measured of it.

    **Fields:**

    - `model` for every value of its parameters; `values` of the `parameters` that will be
      estimated; `known`, values held.
    - `initial_state`, which will be estimated too.
    - `sigma`: standard deviation of the white noise on each of `channels`.
    - `method` of simulation.
    """

    model: ByFunction
    values: Float[Array, " p"]
    known: dict[str, Array]
    initial_state: Float[Array, " states"]
    sigma: Float[Array, " channels"]
    method: FixedStep | Adaptive
    channels: tuple[str, ...] = eqx.field(static=True)
    parameters: tuple[str, ...] = eqx.field(static=True)

    def __init__(
        self,
        model: ByFunction,
        values: Mapping[str, float | Array],
        inputs: Record,
        channels: Sequence[str],
        sigma: Mapping[str, float | Array],
        settings: Mapping[str, Any],
    ):
        """Checked. `settings`: `known`, `initial_state` and `method`, or None."""
        known, initial_state = settings["known"] or {}, settings["initial_state"] or {}
        if names := model.names:
            refuse_unknown([name for name in {**known, **values} if name not in names], names)
        if not values or not channels:
            raise ModelError(
                "an experiment needs a parameter to estimate and a channel to measure."
            )
        held = {n: v for n, v in {**model.defaults, **known}.items() if n not in values}
        self.model, self.known = model, {name: jnp.asarray(value) for name, value in held.items()}
        self.parameters, self.channels = tuple(values), tuple(channels)
        self.values = jnp.stack([jnp.asarray(value, float) for value in values.values()])
        system = self.system(self.values)
        if lacking := [name for name in channels if name not in sigma]:
            raise ModelError(f"no noise (sigma) is given for {', '.join(lacking)}.")
        self.sigma = jnp.stack([jnp.asarray(sigma[name], float) for name in channels])
        made = system.simulated_names
        if unknown := [name for name in channels if name not in made]:
            raise ModelError(
                f"the simulation has no signal '{unknown[0]}' to measure; it has: "
                f"{', '.join(made)}."
            )
        system.require_states(initial_state)
        start = [jnp.asarray(initial_state.get(name, 0.0), float) for name in system.state_names]
        self.initial_state, self.method = jnp.stack(start), settings["method"] or FixedStep()
        if settings["method"] is None and is_concrete(system, start, inputs):
            # Steps that are short enough along the motion that this record excites.
            run = simulate(system, inputs, method=self.method, initial_state=initial_state).record
            states, levels = (
                jnp.stack([run[name] for name in names], axis=-1)
                for names in (system.state_names, system.input_names)
            )
            steps = suitable_steps(system, states, levels, float(inputs.time_step))
            self.method = FixedStep(steps)

    def system(self, values: Float[Array, " p"]) -> AbstractSystem:
        """The system at these values."""
        return self.model.build({**self.known, **dict(zip(self.parameters, values))})

    def standard_errors(self, inputs: Record) -> tuple[Float[Array, " p"], dict[str, Array]]:
        """Least standard deviation of each parameter in its unit, and the simulated signals.

        All other parameters and the initial state are unknown too.
        """
        p = self.values.shape[0]
        # Parameters in shares of their values; one that is zero, in its unit.
        size = jnp.where(self.values != 0, jnp.abs(self.values), 1.0)

        def measured(unknown: Array) -> tuple[Array, dict[str, Array]]:
            system = self.system(unknown[:p] * size)
            initial = dict(zip(system.state_names, unknown[p:]))
            run = simulate(system, inputs, method=self.method, initial_state=initial)
            signals = run.record.arrays
            columns = jnp.stack([signals[name] for name in self.channels], axis=-1)
            return columns / self.sigma[None, :], signals

        unknown = jnp.concatenate([self.values / size, self.initial_state])
        slopes, signals = jax.jacfwd(measured, has_aux=True)(unknown)
        information = jnp.einsum("nci,ncj->ij", slopes, slopes)
        # Its inverse is huge, not infinite, where there is no information.
        k, dtype = information.shape[0], information.dtype
        rounding = 8 * k * float(jnp.finfo(dtype).eps)
        inverse = solve_scaled(information, jnp.eye(k, dtype=dtype), ridge=rounding)
        return jnp.sqrt(jnp.diagonal(inverse)[:p]) * size, signals


def predicted_standard_errors(
    model: Any,
    values: Mapping[str, float | Array],
    record: Record,
    *,
    channels: Sequence[str],
    sigma: Mapping[str, float | Array],
    known: Mapping[str, float | Array] | None = None,
    initial_state: Mapping[str, float | Array] | None = None,
    method: FixedStep | Adaptive | None = None,
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

    **Raises:** `ModelError` for unknown names, no parameter, no channel, or noise that is not
    given; `DataError` for an absent input.
    """
    settings = {"known": known, "initial_state": initial_state, "method": method}
    family = as_parametric_system(model, record)
    experiment = _Experiment(family, values, record, channels, sigma, settings)
    errors, _ = eqx.filter_jit(_Experiment.standard_errors)(experiment, record)
    return dict(zip(experiment.parameters, errors))


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
    - `standard_errors` of all that are estimated, in their units, with all others and the initial
      state unknown; `parameter`, the one that was asked for.
    - `peaks`: largest size of each limited state over the samples.
    - `status` of the search.
    """

    record: Record
    frequencies: Float[Array, " k"]
    amplitudes: Float[Array, " k"]
    phases: Float[Array, " k"]
    standard_errors: dict[str, Float[Array, ""]]
    peaks: dict[str, Float[Array, ""]]
    status: DesignStatus
    parameter: str = eqx.field(static=True)

    @property
    def standard_error(self) -> Float[Array, ""]:
        """Of the parameter that was asked for."""
        return self.standard_errors[self.parameter]

    @property
    def reason(self) -> str:
        """How the search ended, in words (not under jit)."""
        return DesignStatus[self.status]


class _Problem(eqx.Module):
    """The cost of an input in terms of the cosine and sine part of each harmonic.

    Unlike a phase, which means nothing at zero amplitude, these have no singular point. Their
    common factor is free, since the input is scaled to its r.m.s. `place` is that of the parameter
    that matters among those that are estimated.
    """

    experiment: _Experiment
    frequencies: Float[Array, " k"]
    rms: Float[Array, ""]
    travel: dict[str, Array]
    sampling: Record
    place: int = eqx.field(static=True)

    def wave(self, coefficients: Float[Array, " 2k"]) -> Float[Array, " n"]:
        """The input before it is scaled."""
        cosine = jnp.zeros_like(self.frequencies)
        phases = jnp.concatenate([cosine, cosine - jnp.pi / 2])
        both = jnp.concatenate([self.frequencies, self.frequencies])
        sampling = self.sampling
        return multisine(coefficients, phases, both, sampling.sample_count, sampling.time_step)

    def outcome(
        self, coefficients: Float[Array, " 2k"]
    ) -> tuple[Float[Array, " n"], Float[Array, " p"], dict[str, Array], Float[Array, ""]]:
        """The input, of exactly the r.m.s. that is asked for; each parameter's standard error;
        the largest size of each limited state; and the squared travel beyond the limits, as shares
        of them, over all samples."""
        wave = self.wave(coefficients)
        wave = wave * (self.rms / _rms(wave))
        inputs = self.sampling.with_signals(dict.fromkeys(self.sampling.arrays, wave))
        errors, signals = self.experiment.standard_errors(inputs)
        sizes = {name: jnp.abs(signals[name]) for name in self.travel}
        beyond = [jnp.maximum(sizes[n] / self.travel[n] - (1 - MARGIN), 0.0) for n in sizes]
        excess = sum((jnp.sum(share**2) for share in beyond), jnp.zeros(()))
        return wave, errors, {name: jnp.max(size) for name, size in sizes.items()}, excess

    def cost(self, coefficients: Float[Array, " 2k"], penalty: Array) -> Float[Array, ""]:
        """Logarithm of the parameter's variance, with a penalty on travel."""
        _, errors, _, excess = self.outcome(coefficients)
        return 2 * jnp.log(errors[self.place]) + penalty * excess


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
    method: FixedStep | Adaptive | None = None,
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
    family = as_parametric_system(model, Record({"the input": wave}, time_step))
    at: dict[str, Any] = {**family.defaults, **dict(known or {}), **values}
    inputs = family.build(at).input_names
    if len(inputs) != 1:
        raise ModelError(
            f"the input of a system with one input can be designed; this one has {len(inputs)}: "
            f"{', '.join(inputs)}. Give a system in which the others are known."
        )
    sampling = Record({inputs[0]: wave}, time_step)
    settings = {"known": known, "initial_state": initial_state, "method": method}
    experiment = _Experiment(family, values, sampling, channels, sigma, settings)
    if parameter not in values:
        raise ModelError(f"'{parameter}' is not estimated; estimated are: {', '.join(values)}.")
    experiment.system(experiment.values).require_states(travel or {})
    limits = {name: jnp.asarray(limit, float) for name, limit in (travel or {}).items()}
    if wrong := [n for n, limit in limits.items() if is_concrete(limit) and not limit > 0]:
        raise ModelError(f"the travel of {wrong[0]} needs a positive limit.")
    rms = jnp.asarray(rms, float)
    place = experiment.parameters.index(parameter)
    problem = _Problem(experiment, grid, rms, limits, sampling, place)
    found = jnp.concatenate([jnp.cos(phases), -jnp.sin(phases)], axis=1)
    settled = jnp.zeros(starts, bool)
    for penalty in PENALTIES if travel else PENALTIES[:1]:
        found, settled = _search(problem, found, jnp.asarray(penalty), max_steps)
    return _best(problem, found, settled)


def _rms(wave: Float[Array, " n"]) -> Float[Array, ""]:
    return jnp.sqrt(jnp.mean(wave**2))


@eqx.filter_jit
def _search(
    problem: _Problem, first: Float[Array, "starts 2k"], penalty: Float[Array, ""], max_steps: int
) -> tuple[Float[Array, "starts 2k"], Bool[Array, " starts"]]:
    """Each start's least cost, and whether its search converged."""

    def of_start(coefficients: Float[Array, " 2k"]) -> tuple[Array, Array]:
        solution = optx.minimise(
            lambda c, args: args[0].cost(c, args[1]),
            optx.BFGS(TOLERANCE, TOLERANCE),
            # One size for all starts: the cost does not depend on it, but the steps do.
            coefficients / _rms(coefficients),
            args=(problem, penalty),
            max_steps=max_steps,
            throw=False,
        )
        return solution.value, solution.result == optx.RESULTS.successful

    return jax.vmap(of_start)(first)


@eqx.filter_jit
def _best(
    problem: _Problem, found: Float[Array, "starts 2k"], settled: Bool[Array, " starts"]
) -> Design:
    """The best of those that keep the travel; if none does, the one that comes nearest."""
    experiment, place = problem.experiment, problem.place
    waves, errors, peaks, excess = jax.vmap(problem.outcome)(found)
    within = finite = jnp.isfinite(errors[:, place])
    for name, limit in problem.travel.items():
        within = within & (peaks[name] <= limit)
    promised = jnp.where(within, errors[:, place], jnp.inf)
    nearest = jnp.argmin(jnp.where(finite, excess, jnp.inf))
    best = jnp.where(jnp.any(within), jnp.argmin(promised), nearest)
    cosine, sine = jnp.split(found[best], 2)
    factor = problem.rms / _rms(problem.wave(found[best]))
    status = DesignStatus.where(settled[best], DesignStatus.converged, DesignStatus.out_of_steps)
    status = DesignStatus.where(jnp.any(within), status, DesignStatus.travel_exceeded)
    status = DesignStatus.where(jnp.any(finite), status, DesignStatus.not_finite)
    wave, system = waves[best], experiment.system(experiment.values)
    (name,) = problem.sampling.arrays
    return Design(
        record=Record(
            {name: Signal(wave, unit=dict(system.inputs).get(name, ""))}, problem.sampling.time_step
        ),
        frequencies=problem.frequencies,
        amplitudes=factor * jnp.hypot(cosine, sine),
        phases=jnp.arctan2(-sine, cosine),
        standard_errors=dict(zip(experiment.parameters, errors[best])),
        peaks={name: peak[best] for name, peak in peaks.items()},
        status=status,
        parameter=experiment.parameters[place],
    )
