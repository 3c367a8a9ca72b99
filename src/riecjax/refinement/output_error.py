"""Output-error refinement: the model simulated over windows, and compared with the recording."""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from diffrax import BacksolveAdjoint, RecursiveCheckpointAdjoint
from jaxtyping import Array, Bool, Float

from riecjax.compilation import kept_jit
from riecjax.errors import DataError, ModelError, require
from riecjax.leaves import Leaf, is_concrete, is_number
from riecjax.records.noise_judgement import judged
from riecjax.records.record import Record
from riecjax.refinement.objective import AbstractObjective, Parameters, Specification
from riecjax.refinement.output_misfit import LEAST_NOISE, THRESHOLD, OutputMisfit
from riecjax.refinement.parametric import AbstractParametric, as_parametric_system
from riecjax.refinement.shots import (
    AbstractShooting,
    Along,
    Compared,
    Recorded,
    Shots,
    WholeRecord,
    cut_records,
    over_windows,
    within,
)
from riecjax.simulation.intersample import Intersample, require_intersample, smooth_inputs
from riecjax.simulation.linearisation import MOST_STEPS, spread_points, suitable_steps
from riecjax.simulation.method import AbstractMethod, FixedStep
from riecjax.simulation.system import AbstractSystem, state_sources


class OutputError(AbstractObjective):
    """Simulated minus recorded signals, over windows from one sample to the whole record.

    Over one time step this is a fit of the equation error, over windows multiple shooting, over the
    whole record the output-error fit: one code. Short windows forgive a poor start and what the
    model leaves out; long ones tell most where the model is right and the sensors are noisy.

    **Arguments:**

    - `shooting`: [`WholeRecord`][], [`Tiles`][] or [`RandomShots`][].
    - `channels`: signals to compare: states, their derivatives `d<state>`, outputs. By default the
      recorded states, or if there are none, every output that the record holds; but not what was
      computed from others that are compared, such as a velocity differentiated from a position.
    - `sigma`: standard deviation of each channel's error, in its unit, by which it is weighed; by
      default the channel's own standard deviation, so that relative errors count alike.
    - `initial_states` of each window. `"estimated"`, with the recorded one for a first
      guess; `"measured"`, taken from the record where it holds the state and estimated where not;
      or values by name of those states that are known at the start, the others estimated.
    - `method`: as for [`simulate`][]. By default Runge-Kutta with steps that resolve the model's
      fastest motion along the recording (see [`suitable_steps`][]), made shorter for as long as
      halving them at the optimum changes the answer, up to 64 between samples; 8 under jit.
    - `intersample`: what inputs are between samples. `"smooth"` wherever they neither jump nor
      turn a corner, or straight `"lines"`, as of a command that is known to be, or of what
      [`simulate`][] made; of all inputs, or by name: `{"F": "lines"}`.
    - `loss`: `"squares"`, or `"huber"`, which grows with the square up to 1.345 standard deviations
      of a channel's noise and straight on past it, so that what no noise explains pulls less. The
      noise is what the records say of it, or their samples do; `rms` then is that of residuals
      whose squares are the loss.
    - `every`: compare one of so many samples. Of a record that was upsampled, the others would tell
      the same again.
    """

    shooting: AbstractShooting = eqx.field(default_factory=WholeRecord)
    channels: tuple[str, ...] | None = eqx.field(static=True, default=None)
    sigma: Mapping[str, float | Array] | None = None
    initial_states: Literal["estimated", "measured"] | Mapping[str, float | Array] = "estimated"
    method: AbstractMethod | None = None
    every: int = eqx.field(static=True, default=1)
    intersample: Intersample = "smooth"
    loss: Literal["squares", "huber"] = eqx.field(static=True, default="squares")

    def __check_init__(self):
        write = "rx.OutputError(rx.refinement.Tiles(0.5)), or without windows rx.OutputError()"
        require("what OutputError simulates over", self.shooting, AbstractShooting, write)
        require("the method", self.method or FixedStep(), AbstractMethod, "method=rx.FixedStep(8)")
        write = "initial_states='estimated', 'measured' or values by name such as {'x': 0.0}"
        require("initial states", self.initial_states, (str, Mapping), write)
        channels = self.channels if self.channels is None else f"('{self.channels}',)"
        write = f"channels={channels}: a tuple of names"
        require("channels", self.channels or (), (tuple, list), write)
        words, given = ("estimated", "measured"), self.initial_states
        if isinstance(given, str) and given not in words:
            raise ModelError(
                f"initial_states are 'estimated', 'measured' or values by name; got '{given}'."
            )
        require_intersample(self.intersample)
        if self.loss not in ("squares", "huber"):
            raise ModelError(f"the loss is 'squares' or 'huber'; got {self.loss!r}.")
        if self.every < 1:
            raise ModelError(f"every must be 1 or more; got {self.every}.")
        adjoint = getattr(self.method, "adjoint", None)
        if isinstance(adjoint, RecursiveCheckpointAdjoint | BacksolveAdjoint):
            raise ModelError(
                f"refinement forms its Jacobians forward, which {type(adjoint).__name__} cannot: "
                f"leave Adaptive its ForwardMode, or give it diffrax.DirectAdjoint() to "
                f"differentiate the result in reverse."
            )

    @property
    def needs_key(self) -> bool:
        """Whether windows are drawn at random."""
        return self.shooting.needs_key

    def parametric(self, model: Any, record: Record) -> AbstractParametric:
        """The system to simulate."""
        return as_parametric_system(model, record)

    def parameters(self, parametric: AbstractParametric) -> Parameters:
        """Of the system."""
        return Parameters(parametric.parameters, parametric.defaults, parametric.units)

    def misfit(self, specified: Specification) -> OutputMisfit:
        """Over the windows of all records."""
        system: AbstractSystem = specified.model.build(specified.of_record(0))
        channels = _channels(system, specified.records, self.channels)
        for record in specified.records:
            for name in system.input_names:
                _ = record.signals[name]
        _require_sigma(self.sigma or {}, channels)
        given = self.initial_states if isinstance(self.initial_states, Mapping) else {}
        estimated = _estimated(system, specified.records, self.initial_states)
        joined = not estimated
        # A missing sample of an input breaks the motion; of a free motion, one of any signal.
        inputs = [system.input_names or tuple(record.arrays) for record in specified.records]
        shots = [
            self.shooting.shots(record, unbroken, key, joined=joined)
            for record, unbroken, key in zip(specified.records, inputs, specified.keys)
        ]
        smooth = smooth_inputs(self.intersample, system.input_names)
        # By a method that is chosen here, lines are bent by zero: what is compiled serves both.
        bent = smooth if any(smooth) or (smooth and self.method is None) else None
        cut = Compared(channels, dict(given), self.every, joined, self.shooting.overlap, bent)
        recorded, along = cut_records(system, specified.records, shots, cut)
        method, simulated = _method(system, specified.records, recorded, along, self.method)
        units = dict(system.states) | dict(system.outputs)
        sigma, scale, seconds = _sizes(
            tuple(state_sources(system, specified.records[0]).values()),
            recorded,
            shots,
            dict(self.sigma or {}),
            channels,
            estimated,
            simulated,
        )
        return OutputMisfit(
            system=specified.model,
            recorded=recorded,
            known=specified.fixed,
            sigma=sigma,
            scale=scale,
            longest_window=seconds if self.shooting.overlap else jnp.zeros_like(seconds),
            method=method,
            threshold=None
            if self.loss == "squares"
            else THRESHOLD * (_noise(specified.records, recorded, channels) / sigma)[None, :],
            names=specified.names,
            local=specified.local,
            labels=channels,
            units=tuple(units.get(name, "") for name in channels),
            estimated=estimated,
            state_names=system.state_names,
            sharing=specified.sharing,
            most_steps=MOST_STEPS if self.method is None else 0,
        )

    def describe(self) -> dict[str, object]:
        """Name and settings."""
        initial = self.initial_states if isinstance(self.initial_states, str) else "partly known"
        loss: dict[str, object] = {} if self.loss == "squares" else {"loss": self.loss}
        shooting = self.shooting.describe()
        return {"refine": "output-error", **shooting, "starts": initial, **loss}


def _channels(
    system: AbstractSystem, records: Sequence[Record], asked: tuple[str, ...] | None
) -> tuple[str, ...]:
    available = system.simulated_names
    if asked is not None:
        if unknown := [name for name in asked if name not in available]:
            raise ModelError(
                f"the simulation has no signal '{unknown[0]}' to compare; it has: "
                f"{', '.join(available)}."
            )
        for record in records:
            for name in asked:
                _ = record.signals[name]
        return asked
    held = [name for name in available if all(name in record.arrays for record in records)]
    chosen = [name for name in system.state_names if name in held] or held
    if not chosen:
        raise DataError(
            f"the records hold nothing that is simulated, so there is nothing to compare; needed "
            f"is one of: {', '.join(available)}."
        )
    computed = [_computed(record, chosen) for record in records]
    return tuple(name for name in chosen if not all(name in of for of in computed))


def _computed(record: Record, names: Sequence[str]) -> set[str]:
    """Signals that were made of others among these: their noise is the others', sample by sample.

    They tell nothing new, and compared as if they did would have noise that hangs together in time.
    """

    def sensor(source: str) -> str:
        # Of a thinned record, a sensor's noise is split up into sources `sensor#phase`.
        return source if source in record.arrays else source.rpartition("#")[0]

    sources = {n: {sensor(source) for source in record.noise.kernels.get(n, {})} for n in names}
    sensed = {n for n in names if n in sources[n]}
    return {n for n in names if n not in sensed and sources[n] and sources[n] <= sensed}


def _require_sigma(sigma: Mapping[str, Any], channels: tuple[str, ...]) -> None:
    if unknown := [name for name in sigma if name not in channels]:
        raise ModelError(
            f"sigma is given for '{unknown[0]}', which is not compared; compared are: "
            f"{', '.join(channels)}."
        )
    for name, value in sigma.items():
        if not is_number(value) or (is_concrete(value) and not 0 < float(value) < np.inf):
            raise ModelError(
                f"sigma of {name} is {value!r}: a standard deviation is a positive number, in the "
                f"unit of {name}."
            )


def _estimated(
    system: AbstractSystem, records: Sequence[Record], initial: str | Mapping[str, Any]
) -> tuple[int, ...]:
    """Places of the states whose initial values are estimated."""
    if isinstance(initial, Mapping):
        system.require_states(initial)
        known = set(initial)
    elif initial == "measured":
        sources = [state_sources(system, record) for record in records]
        known = {n for n in system.state_names if all(s[n] == "measured" for s in sources)}
    else:
        known = set()
    return tuple(i for i, name in enumerate(system.state_names) if name not in known)


def _method(
    system: AbstractSystem,
    records: Sequence[Record],
    recorded: Sequence[Recorded],
    along: Sequence[Along],
    asked: AbstractMethod | None,
) -> tuple[AbstractMethod, Float[Array, "windows longest states"] | None]:
    """The method that was asked for, or steps for the fastest motion of all recordings.

    **Returns:** the method; the first recording's motion, simulated, if it has states that no
    recording tells.
    """
    free = asked is None and is_concrete(system, recorded)
    method = FixedStep(_steps(system, recorded, along)) if free else asked or FixedStep()
    if not any("zero" in state_sources(system, record).values() for record in records):
        return method, None
    simulated, kept = _trajectories(system, recorded, method)
    if not isinstance(method, FixedStep) or not free:
        return method, simulated[0]
    steps = method.steps_per_sample
    while not all(kept) and steps < MOST_STEPS:
        steps = min(4 * steps, MOST_STEPS)
        simulated, kept = _trajectories(system, recorded, FixedStep(steps))
    if not all(kept):
        return method, simulated[0]
    along = [_spread(states, part) for states, part in zip(simulated, recorded)]
    return FixedStep(max(steps, _steps(system, recorded, along))), simulated[0]


def _steps(system: AbstractSystem, recorded: Sequence[Recorded], along: Sequence[Along]) -> int:
    return max(
        suitable_steps(system, states, levels, float(part.time_step))
        for part, (states, levels) in zip(recorded, along)
    )


def _spread(states: Leaf, part: Recorded) -> Along:
    """Of the samples within all windows, those to look at: what lies behind may run away."""
    window, sample = np.nonzero(np.asarray(within(part.length, states.shape[1])))
    chosen = spread_points(window.size)
    at = window[chosen], sample[chosen]
    return np.asarray(states)[at], np.asarray(part.levels)[at]


@kept_jit
def _trajectories(
    system: AbstractSystem, recorded: Sequence[Recorded], method: AbstractMethod
) -> tuple[list[Float[Array, "windows longest states"]], list[Bool[Array, ""]]]:
    """Of each window of each recording, and whether all kept their solution."""
    runs = [
        over_windows(lambda first, own: own.trajectory(method, system, first), part.initial, part)
        for part in recorded
    ]
    return [states for states, _ in runs], [jnp.all(kept) for _, kept in runs]


@kept_jit
def _sizes(
    sources: tuple[str, ...],
    recorded: Sequence[Recorded],
    shots: Sequence[Shots],
    sigma: dict[str, Any],
    channels: tuple[str, ...],
    estimated: tuple[int, ...],
    simulated: Float[Array, "windows longest states"] | None,
) -> tuple[Float[Array, " channels"], Float[Array, " s"], Float[Array, ""]]:
    """What channels are weighed by, the size of estimated states, seconds of the longest window."""
    seconds = [cut.longest * part.time_step for cut, part in zip(shots, recorded)]
    return (
        _sigma(sigma, channels, recorded),
        _scale(sources, recorded[0], estimated, simulated),
        jnp.max(jnp.stack(seconds)),
    )


def _sigma(
    given: Mapping[str, Any], channels: tuple[str, ...], recorded: Sequence[Recorded]
) -> Float[Array, " channels"]:
    """Given values, else the standard deviation of each channel over all that is compared."""
    count = sum(jnp.sum(part.present, axis=(0, 1)) for part in recorded)
    count = jnp.maximum(count, 1)

    def mean(values: Sequence[Array]) -> Array:
        held = [jnp.where(part.present, v, 0.0) for part, v in zip(recorded, values)]
        return sum(jnp.sum(v, axis=(0, 1)) for v in held) / count

    centre = mean([part.measured for part in recorded])
    variance = mean([(part.measured - centre[None, None, :]) ** 2 for part in recorded])
    spread = jnp.where(variance > 0, jnp.sqrt(jnp.where(variance > 0, variance, 1.0)), 1.0)
    chosen = [
        jnp.asarray(given.get(name, spread[i]), spread.dtype) for i, name in enumerate(channels)
    ]
    return jnp.stack(chosen)


def _noise(
    records: Sequence[Record], recorded: Sequence[Recorded], channels: tuple[str, ...]
) -> Float[Array, " channels"]:
    """Standard deviation of each channel's noise, over all records."""
    known = [judged(record, "auto", *channels).noise for record in records]
    mean = [sum(noise.std(name) ** 2 for noise in known) / len(known) for name in channels]
    least = LEAST_NOISE * _sigma({}, channels, recorded)
    return jnp.maximum(jnp.sqrt(jnp.stack([jnp.asarray(each) for each in mean])), least)


def _scale(
    sources: tuple[str, ...],
    recorded: Recorded,
    estimated: tuple[int, ...],
    simulated: Float[Array, "windows longest states"] | None,
) -> Float[Array, " s"]:
    """Root mean square of each estimated state: recorded, else simulated; 1 of one that rests."""
    if not estimated:
        return jnp.ones(0)
    size = recorded.square
    if simulated is not None:
        inside = within(recorded.length, simulated.shape[1])
        squares = jnp.where(inside[..., None], simulated, 0.0) ** 2
        of_motion = jnp.sum(squares, axis=(0, 1)) / jnp.sum(recorded.length)
        size = jnp.where(np.array([source == "zero" for source in sources]), of_motion, size)
    usable = jnp.isfinite(size) & (size > 0)
    return jnp.sqrt(jnp.where(usable, jnp.where(usable, size, 1.0), 1.0))[np.array(estimated)]
