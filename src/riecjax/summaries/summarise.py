"""Sum up what recordings say to a model: the only step that reads samples."""

from jaxtyping import Array, Key
from numpy.typing import ArrayLike

from riecjax.arrays import is_concrete
from riecjax.criteria.criterion import AbstractCriterion
from riecjax.criteria.suited import with_less_noise
from riecjax.criteria.windows import LengthBins
from riecjax.equations.dry_friction import in_motion
from riecjax.equations.equation import Equation
from riecjax.equations.model import AtRest, Model, as_model
from riecjax.errors import ModelError
from riecjax.records.noise_judgement import GivenNoise
from riecjax.records.record import Record, Records
from riecjax.records.recording import explaining_errors
from riecjax.summaries.normal_equations import Outline, RecordingSums
from riecjax.summaries.one_pass import recording_sums
from riecjax.summaries.summary import Summary
from riecjax.summaries.task import Task, ready, task


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
    model = model.linear
    outline = Outline.of(model)
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
        read = with_less_noise(in_motion(model, record), record, criterion)
        apart = own is not None
        return recording_sums(read, record, criterion, key, kept_apart, survey, starts, apart)

    every = tuple(sums(record, key) for record, key in zip(records, keys))
    return Summary(every, criterion, outline, edges, band, band)
