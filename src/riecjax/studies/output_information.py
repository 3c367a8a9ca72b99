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
from jaxtyping import Array, Float

from riecjax.errors import ModelError
from riecjax.leaves import is_concrete
from riecjax.linear_algebra import solve_scaled
from riecjax.records.record import Record
from riecjax.refinement.output_misfit import observed
from riecjax.refinement.parametric import AbstractParametric, as_parametric_system
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
    _check_names(built, channels, initial_state or {})
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
    return eqx.tree_at(lambda e: e.method, experiment, _resolving(experiment, built, record))


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


def _check_names(
    system: AbstractSystem, channels: Sequence[str], initial_state: Mapping[str, Any]
) -> None:
    made = system.simulated_names
    if unknown := [name for name in channels if name not in made]:
        raise ModelError(
            f"the simulation has no signal '{unknown[0]}' to measure; it has: {', '.join(made)}."
        )
    system.require_states(initial_state)


def _resolving(experiment: Experiment, system: AbstractSystem, record: Record) -> FixedStep:
    """Steps that are short enough along the motion that this record excites."""
    levels = levels_of(experiment, record)
    states = eqx.filter_jit(Experiment.trajectory)(experiment, levels)
    return FixedStep(suitable_steps(system, states, levels, float(record.time_step)))
