"""Sum up what recordings say to a model: what is asked, and what of it can be refused before any
arithmetic, then the sums, the only step that reads samples."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key
from numpy.typing import ArrayLike

from riecjax.arrays import is_concrete
from riecjax.criteria.criterion import AbstractCriterion
from riecjax.criteria.suited import criterion_for, suited, with_less_noise, with_velocities
from riecjax.criteria.windows import LengthBins
from riecjax.elements.catalogue import trusted, with_states
from riecjax.equations.equation import Equation
from riecjax.equations.model import AtRest, Model, as_model, with_rests
from riecjax.errors import DataError, MissingSignalError, ModelError, require
from riecjax.records.noise_judgement import GivenNoise, given_noise, judged, judged_together
from riecjax.records.preparation.filtering import without_computed
from riecjax.records.reading.units import contradict
from riecjax.records.record import Record, Records
from riecjax.records.recording import Recording, as_recordings, explaining_errors
from riecjax.summaries.normal_equations import Outline, RecordingSums
from riecjax.summaries.one_pass import recording_sums
from riecjax.summaries.summary import Summary

if TYPE_CHECKING:
    from riecjax.settings import Fit

LARGEST = 1e150
"""Size of a value past which its square is no number."""


def default_criterion(
    model: Equation | Model, records: Records, noise: GivenNoise = "auto"
) -> AbstractCriterion:
    """What [`identify`][] takes where no criterion is given.

    Boxcars of the model's band where every velocity was measured, smooth windows else.

    **Arguments:** as of [`identify`][].

    **Raises:** `DataError` for a missing signal.
    """
    model = as_model(model)
    recordings = [each.record for each in ready(model, records, noise)]
    return suited(model, model.band, recordings)


class Task(NamedTuple):
    """What is to be summed: a model's equations on records, by a criterion fitted to them.

    `keys`: what each record's random windows are drawn with.
    """

    model: Model
    records: list[Record]
    criterion: AbstractCriterion
    keys: list[Key[Array, ""] | None]


def task(
    model: Equation | Model,
    recordings: Sequence[Recording],
    criterion: "AbstractCriterion | Fit | None",
    key: Key[Array, ""] | None,
    at_rest: AtRest | None = None,
) -> Task:
    """What can be refused before arithmetic of recordings that are [`ready`][].

    `criterion` may be what settings say of one; see [`identify`][] for the other arguments.

    **Raises:** `ModelError` and `DataError` as [`identify`][].
    """
    plain = [each.record for each in recordings]
    model = with_rests(as_model(model), at_rest).for_records(plain)
    criterion = criterion_for(criterion, model, plain)
    _require_derivatives(model, criterion)
    require_key(key)
    if criterion.needs_key and key is None:
        raise ModelError("random windows need a key: key=jax.random.key(seed).")
    for recording, record in zip(recordings, plain):
        with recording.explaining_errors():
            criterion.check(record)
            if not is_concrete(record.arrays):
                continue
            # A value that is read and too large to be squared.
            sizes = {name: float(np.max(np.abs(values))) for name, values in record.arrays.items()}
            huge = [name for name, size in sizes.items() if size > LARGEST]
            for name in huge and signals_read(model, record, criterion):
                if name in huge:
                    place = int(np.argmax(np.abs(record.arrays[name])))
                    raise DataError(
                        f"{name} is {float(record.arrays[name][place]):.4g} at "
                        f"{float(record.elapsed[place]):.6g} s, so large that its square is not "
                        f"finite. If that is a spike, repair it (--outliers repair; in Python "
                        f"rx.records.repair_outliers(record)); else scale the signals to SI units."
                    )
    return Task(model, plain, criterion.fitted(plain), record_keys(key, len(plain)))


def _require_derivatives(model: Model, criterion: AbstractCriterion) -> None:
    """Raise `ModelError` unless a criterion takes off what hidden elements put before terms."""
    if not any(element.order for element in model.hidden):
        return
    most = max(t.derivative for stage in model.linear.stages for e in stage for t in e.terms)
    if criterion.smoothness < most or criterion.all_windows is None:
        raise ModelError(
            f"hidden elements need all windows of a test function that takes {most} "
            f"derivatives off: leave the criterion out, or give rx.RIEC.of_band((low, high), "
            f"rx.criteria.GradedBump(derivatives={most})), low and high in hertz (on the command "
            f"line: leave out --test-function, --quadrature, --windows and --criterion; --band, "
            f"--alpha and --beta may stay)."
        )


def ready(model: Model, records: Records, noise: GivenNoise = "auto") -> list[Recording]:
    """Recordings with the velocities that only functions read, and with their noise judged.

    **Raises:** `ModelError` for elements of which no sums tell; `DataError` for a batch of records,
    and for a signal in another unit than the model reads it in, or an earlier record has it in.
    """
    for element in model.hidden:
        element.require_linear(model.equations)
    units = {signal.name: signal.unit for signal in model.signals if signal.unit}
    read = [signal.name for signal in model.signals]

    def of(recording: Recording) -> Recording:
        # Units that the model does not say are those of the first recording that does.
        for name, unit in recording.record.units:
            said = units.setdefault(name, unit)
            if contradict(unit, said) and any(name in e.signals for e in model.equations):
                raise DataError(
                    f"{recording.name} has {name} in {unit}, where the model or another record has "
                    f"it in {said}, and nothing converts one to the other. Convert its samples, or "
                    f"correct its unit."
                )
        if recording.record.time_step.ndim or next(iter(recording.record.arrays.values())).ndim > 1:
            raise DataError(
                "a batch of records is one record under jax.vmap, which maps over it: "
                "jax.vmap(lambda record: rx.identify(model, record).values)(records)."
            )
        with recording.explaining_errors():
            record, steps = with_velocities(model, recording.record)
            known = {**record.noise.kernels, **given_noise(noise, record.arrays).kernels}
            record = judged(record, noise)
            record, found = without_computed(record, model.derivatives, known)
            record = judged_together(record, model.derivatives, read, {*known})
            record = with_states(model, record)
        return replace(recording, record=record, steps=(*recording.steps, *steps, *found))

    return [of(recording) for recording in as_recordings(records)]


def require_key(key: object) -> None:
    """Raise `ModelError` for a seed, several keys or anything else in place of a key."""
    if key is None:
        return
    if isinstance(key, jax.Array):
        typed = jnp.issubdtype(key.dtype, jax.dtypes.prng_key)
        # Keys of jax.random.PRNGKey are a row of whole numbers.
        if (typed and key.ndim == 0) or (key.dtype == jnp.uint32 and key.ndim == 1):
            return
        if typed or key.dtype == jnp.uint32:
            raise ModelError(
                f"the key is an array of {len(key)} keys. Write key=keys[0], or map over them by "
                f"jax.vmap."
            )
    seed = key if isinstance(key, int | np.integer) else 0
    require("the key", key, (), f"key=jax.random.key({int(seed)})")


def signals_read(
    model: Model, record: Record, criterion: AbstractCriterion, summed: bool = False
) -> tuple[str, ...]:
    """Names of the record's signals that a criterion reads for a model's equations.

    Raises what `identify` would raise of this one record, before any arithmetic; where it was
    `summed`, that raised it.

    **Raises:** `DataError` for a missing signal or a record shorter than a window; `ModelError`
    for an expression that fails, and for windows that hidden elements cannot have.
    """
    _require_derivatives(model, criterion)
    criterion.check(record)
    read: set[str] = set()
    for equation in model.equations:
        try:
            read |= equation.signals_read(record, criterion.smoothness)
        except MissingSignalError as error:
            # If the equation calls it a derivative, say whose it is.
            below = [of for of, name in equation.derivatives if name == error.signal]
            known = next((of for of in below if of in error.available), "")
            is_state = model.says_change_of(error.signal)
            raise MissingSignalError(error.signal, error.available, known, is_state) from None
        if not summed:
            eqx.filter_eval_shape(criterion.rows, equation, record, jax.random.key(0))
    return tuple(name for name in record.arrays if name in read)


def record_keys(key: Key[Array, ""] | None, count: int) -> list[Key[Array, ""] | None]:
    """The key that each of several records draws its windows with."""
    if key is None or count == 1:
        return [key] * count
    return list(jax.random.split(key, count))


def summarise(
    model: Equation | Model,
    record: Records,
    criterion: AbstractCriterion | None = None,
    *,
    key: Key[Array, ""] | None = None,
    bins: int | ArrayLike | None = None,
    survey: bool = False,
    noise: GivenNoise = "auto",
    at_rest: AtRest | None = None,
    starts: tuple[int, int] | None = None,
) -> Summary:
    """Sum up what one or several recordings say to a model: all that [`estimate`][] needs.

    Each recording is read once, chunk by chunk, and nothing is compiled. Under `jax.jit`,
    `jax.vmap` and `jax.grad` only moments are summed.

    **Arguments:** `model`, `record`, `criterion`, `key`, `noise` and `at_rest` as for
    [`identify`][];

    - `bins`: keep the sums of windows of different length apart, so that a band can be chosen
      afterwards: so many bins from alpha to beta in equal ratios, or their edges in seconds, to
      which alpha and beta are added.
    - `survey`: sum up also what [`check`][] and figures ask for.
    - `starts`: first of the samples whose windows count and one beyond the last, where a record is
      a stretch of a longer one with what its windows reach beyond it; see
      [`stretch_starts`][riecjax.summaries.stretch_starts].

    **Returns:** a [`Summary`][] of the recordings in this order.

    **Raises:** `ModelError` for an absent key, for bins of a criterion that does not sum all
    windows, or for an expression that mixes samples of a long record; `DataError` for an absent
    signal or a record shorter than a window.
    """
    recordings = ready(as_model(model), record, noise)
    asked = task(model, recordings, criterion, key, at_rest)
    with explaining_errors(recordings, asked.model.says_change_of):
        return summed(asked, bins=bins, survey=survey, starts=starts)


def summed(
    asked: Task,
    *,
    bins: int | ArrayLike | None = None,
    survey: bool = False,
    starts: tuple[int, int] | None = None,
) -> Summary:
    """The Summary of a task; see [`summarise`][]."""
    model, records, criterion, keys = asked
    # With hidden elements, sums are of more columns than there are parameters.
    linear = model.linear
    outline = Outline.of(linear)
    windows, own, kept_apart = criterion.all_windows, None, None
    if bins is None and windows is not None and is_concrete(windows):
        own = criterion.test_function.edges(float(windows.alpha), float(windows.beta))
        kept_apart = None if own is None else LengthBins(own, (0, len(own) - 1))
    if bins is not None:
        if windows is None or not is_concrete(records, criterion):
            raise ModelError(
                "bins of window lengths are kept of all windows, with numbers that are known: use "
                "rx.RIEC(rx.AllWindows(alpha, beta)), and not under jax.jit."
            )
        kept_apart = LengthBins.of(float(windows.alpha), float(windows.beta), bins)
    edges, band = (None, (0, 1)) if kept_apart is None else kept_apart

    def sums(record: Record, key: Key[Array, ""] | None) -> RecordingSums:
        read = with_less_noise(trusted(model, record, linear), record, criterion)
        apart = own is not None
        return recording_sums(read, record, criterion, key, kept_apart, survey, starts, apart)

    every = tuple(sums(record, key) for record, key in zip(records, keys))
    return Summary(every, criterion, outline, edges, band, band)
