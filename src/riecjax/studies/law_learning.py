"""The law of window lengths that makes identified models predict best on other recordings.

The criterion cannot choose its windows by itself, since its residual means something else under
another law. The error of prediction does not. With G(w) theta = g(w) the normal equations under
the weights w of the law, both linear in w, and E(theta) the error of the identified model on
another recording, its slope is

    dE/dw_i = dE/dtheta G^-1 (dg/dw_i - dG/dw_i theta),

through the simulation, the solution of each stage and the sums over all windows of one part of the
band. A part that is in the sums with next to no weight has next to no slope.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Float, Int, Key

from riecjax.criteria.criterion import RIEC
from riecjax.criteria.laws import RatioLaw
from riecjax.criteria.test_functions import Boxcar
from riecjax.criteria.windows import AllWindows
from riecjax.equations.equation import Equation
from riecjax.equations.procedure import HasProcedure, Procedure, as_procedure
from riecjax.errors import DataError, ModelError
from riecjax.estimation.stages import found_values, solve_stages
from riecjax.records.record import Record, stack_records
from riecjax.simulation.method import AbstractMethod, FixedStep
from riecjax.simulation.simulate import simulate
from riecjax.simulation.system import AbstractSystem, measured_states
from riecjax.summaries.stage_sums import stage_normal_equations
from riecjax.validation.goodness_of_fit import percentage_error

TOLERANCE = 1e-4
"""Change of a weight's logarithm, and share of the error, that are not worth another step."""
SIZE_POWER = 3
"""Power of a part's length that its share of the moments grows with: once with the number of
lengths in it, twice with the square of a window's integral."""


class LearnedLaw(eqx.Module):
    """A law, and what it gains on the recordings that it was learned from.

    **Fields:** `weights` of a [`RatioLaw`][], their largest 1; `error`, mean over the recordings
    of the validation error in percent, summed over the signals, and `error_of_equal`, that of
    equal weights; `errors` that the search from each start came to; whether the best one
    `converged`, and its `steps`.
    """

    weights: Float[Array, " parts"]
    error: Float[Array, ""]
    error_of_equal: Float[Array, ""]
    errors: Float[Array, " starts"]
    converged: Array
    steps: Int[Array, ""]

    @property
    def law(self) -> RatioLaw:
        """For `AllWindows(alpha, beta, law=...)` over the band that it was learned on."""
        return RatioLaw(self.weights)


class Prediction(eqx.Module):
    """Identified on one recording, how well a model predicts another.

    **Fields:**

    - `procedure` that identifies; `build`, the system of the values that it finds.
    - `known`: values that are held.
    - `signals`: states or outputs whose errors are summed.
    - `method` of simulation.
    """

    procedure: Procedure
    build: Callable[[Mapping[str, Array]], AbstractSystem] = eqx.field(static=True)
    known: dict[str, Array]
    method: AbstractMethod
    signals: tuple[str, ...] = eqx.field(static=True)

    def values(self, training: Record, windows: AllWindows) -> dict[str, Array]:
        """Parameters identified on the training record, by name."""
        stages = stage_normal_equations(self.procedure, training, RIEC(windows, Boxcar(2)), None)
        known = dict(self.known)
        return found_values(solve_stages(stages, known), known)

    def errors(
        self, training: Record, validation: Record, windows: AllWindows
    ) -> Float[Array, " signals"]:
        """p_i of eq. (28) in percent; a model that loses its solution predicts nothing, 100 %."""
        system = self.build(self.values(training, windows))
        first = dict(zip(system.state_names, measured_states(system, validation)[0]))
        run = simulate(system, validation, method=self.method, initial_state=first)
        found = [percentage_error(run.record[s], validation[s]) for s in self.signals]
        return jnp.where(run.successful, jnp.stack(found), 100.0)


def validation_errors(
    prediction: Prediction,
    training: Sequence[Record],
    validation: Sequence[Record],
    windows: AllWindows,
) -> Float[Array, "pairs signals"]:
    """p_i of each signal in percent, identified on each training record, on its partner.

    **Raises:** `DataError` unless both hold as many records, of one length each.
    """
    return _errors(prediction, *_stacked(training, validation), _sized(windows, training))


def learn_law(
    model: Equation | Procedure | HasProcedure,
    training: Sequence[Record],
    validation: Sequence[Record],
    build: Callable[[Mapping[str, Array]], AbstractSystem],
    *,
    alpha: float,
    beta: float,
    parts: int,
    signals: Sequence[str],
    key: Key[Array, ""],
    known: Mapping[str, float | Array] | None = None,
    method: AbstractMethod | None = None,
    starts: int = 4,
    max_steps: int = 40,
) -> LearnedLaw:
    """Weights of window lengths for the least error of prediction, by BFGS from several starts.

    There are many local optima, each part by itself among them. The first start lets each part
    tell about as much, the others are drawn around it. What is gained on the recordings given may
    be theirs alone: test the law on others, by [`validation_errors`][].

    **Arguments:**

    - `model`: equations to identify; `build`, from values by name to the system to simulate.
    - `training`: one record for each model to identify; `validation`: what it should predict,
      with the inputs of the system and the `signals` to compare (states and outputs).
    - `alpha`, `beta`: shortest and longest window in seconds; `parts` of the band, in equal
      ratios, that get a weight each.
    - `known`: values held fixed. `method`: as for [`simulate`][].
    - `starts`: searches, drawn with `key`; `max_steps` of each.

    **Raises:** `ModelError` for fewer than two parts; `DataError` unless there are as many records
    to validate as to train on, of one length each.
    """
    if parts < 2:
        raise ModelError(f"a law to learn needs at least two parts; got {parts}.")
    prediction = as_prediction(model, build, signals, known=known, method=method)
    stacked = _stacked(training, validation)
    windows = _sized(AllWindows(alpha, beta), training)
    first = _starts(key, alpha, beta, parts, starts)
    return _learn(prediction, *stacked, windows, first, max_steps)


def as_prediction(
    model: Equation | Procedure | HasProcedure,
    build: Callable[[Mapping[str, Array]], AbstractSystem],
    signals: Sequence[str],
    *,
    known: Mapping[str, float | Array] | None = None,
    method: AbstractMethod | None = None,
) -> Prediction:
    """How well a model predicts; arguments as of [`learn_law`][]."""
    procedure = as_procedure(model)
    held = {name: jnp.asarray(v) for name, v in {**procedure.known, **dict(known or {})}.items()}
    return Prediction(procedure, build, held, method or FixedStep(), tuple(signals))


def mean_error(
    logits: Float[Array, " parts"],
    prediction: Prediction,
    training: Record,
    validation: Record,
    windows: AllWindows,
) -> Float[Array, ""]:
    """Mean over pairs of records of the summed p_i in percent, of a law with these log-weights."""
    law = RatioLaw(jax.nn.softmax(logits))
    weighted = eqx.tree_at(lambda w: w.law, windows, law)
    return jnp.mean(jnp.sum(_errors(prediction, training, validation, weighted), axis=1))


@eqx.filter_jit
def _errors(
    prediction: Prediction, training: Record, validation: Record, windows: AllWindows
) -> Float[Array, "pairs signals"]:
    return jax.vmap(lambda one, other: prediction.errors(one, other, windows))(training, validation)


def _starts(
    key: Key[Array, ""], alpha: float, beta: float, parts: int, count: int
) -> Float[Array, "starts parts"]:
    """Log-weights. Equal ones would leave short windows without influence, and without a slope."""
    told_alike = -SIZE_POWER * jnp.log(beta / alpha) * jnp.arange(parts) / parts
    draws = jax.random.normal(key, (count, parts)).at[0].set(0.0)
    return told_alike[None, :] + draws


@eqx.filter_jit
def _learn(
    prediction: Prediction,
    training: Record,
    validation: Record,
    windows: AllWindows,
    starts: Float[Array, "starts parts"],
    max_steps: int,
) -> LearnedLaw:
    args = (prediction, training, validation, windows)

    def cost(logits: Array, args: Any) -> Array:
        # In logarithms: a share of the error is worth the same whatever its size.
        return jnp.log(mean_error(logits, *args))

    def of_start(start: Array) -> tuple[Array, Array, Array, Array]:
        solution = optx.minimise(
            cost, optx.BFGS(TOLERANCE, TOLERANCE), start, args, max_steps=max_steps, throw=False
        )
        found = solution.value
        converged = solution.result == optx.RESULTS.successful
        return found, mean_error(found, *args), converged, solution.stats["num_steps"]

    # One after the other: side by side, each would wait for the slowest.
    found, errors, converged, steps = jax.lax.map(of_start, starts)
    best = jnp.nanargmin(errors)
    return LearnedLaw(
        jnp.exp(found[best] - jnp.max(found[best])),
        errors[best],
        mean_error(jnp.zeros_like(found[best]), *args),
        errors,
        converged[best],
        steps[best],
    )


def _stacked(training: Sequence[Record], validation: Sequence[Record]) -> tuple[Record, Record]:
    if len(training) != len(validation) or not training:
        raise DataError(
            f"each of {len(training)} training records needs one to validate on; got "
            f"{len(validation)}."
        )
    return stack_records(list(training)), stack_records(list(validation))


def _sized(windows: AllWindows, records: Sequence[Record]) -> AllWindows:
    """Windows whose size in samples is known before anything is traced."""
    windows.check(records[0].sample_count, records[0].time_step)
    return windows.fitted(records)
