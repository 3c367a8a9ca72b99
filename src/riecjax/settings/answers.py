"""Settings of an answer: its uncertainty, refinement, validation, and the terms it may lack."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from riecjax.errors import require
from riecjax.settings.files import Seed
from riecjax.settings.fits import Constrained, Fit, Known, Sharing, Sums
from riecjax.settings.kinds import (
    CODE,
    FILE,
    POSITIVE,
    SHARE,
    TEXT,
    choice,
    whole,
)
from riecjax.settings.option import Settings, flag, many, setting

if TYPE_CHECKING:
    from riecjax.estimation.estimate import Estimate
    from riecjax.records.noise_judgement import GivenNoise
    from riecjax.records.record import Records
    from riecjax.refinement.objective import AbstractObjective
    from riecjax.uncertainty.intervals import AbstractIntervals
    from riecjax.validation.tests import MakeTest


@dataclass(frozen=True, kw_only=True)
class Uncertainty(Settings):
    """How scatter is judged, and what is left out of the sums."""

    intervals: "Literal['bootstrap', 'sandwich', 'naive'] | AbstractIntervals | None" = setting(
        "--intervals", choice("bootstrap", "sandwich", "naive"), "bootstrap"
    )
    """How uncertainty is judged; naive takes overlapping windows for independent ones."""
    at_rest: Literal["mask", "keep"] | None = setting(
        "--at-rest", choice("mask", "keep"), default_in_words="mask"
    )
    """Leave out where a velocity with dry friction rests, or keep it."""


@dataclass(frozen=True, kw_only=True)
class Refine(Settings):
    """Whether and how the linear estimate is refined."""

    refine: "Literal['auto', 'none', 'integral', 'output-error'] | AbstractObjective | None" = (
        setting("--refine", choice("auto", "none", "integral", "output-error"), "auto")
    )
    """Refine the linear estimate: all equations at once over the same windows, or by
    simulation; auto does the latter where it leaves only white noise."""
    horizon: float | None = setting("--horizon SECONDS", POSITIVE)
    """Simulate over windows so long; by default over whole recordings, unless the motion is
    unstable."""
    channels: Sequence[str] = many("--channel SIGNAL", TEXT)
    """Signal to compare with its simulation; by default every recorded state."""
    loss: Literal["squares", "huber"] = setting("--loss", choice("squares", "huber"), "squares")
    """What is made small of simulated minus recorded: squares, or Huber's loss, in which what
    no noise explains pulls less."""

    def contradictions(self) -> Iterator[str]:
        """What the refinement that is asked for does not use."""
        by = self.refine
        if not (by is None or isinstance(by, str) or hasattr(type(by), "residuals")):
            require("refine", by, (), "refine=rx.OutputError(), 'auto' or None")
        if self.channels and self.refine != "output-error":
            yield "{channels} goes with {refine:output-error}."
        if self.loss not in (None, "squares") and self.refine != "output-error":
            yield "{loss} goes with {refine:output-error}."


@dataclass(frozen=True, kw_only=True)
class Validate(Settings):
    """What tests the answer beside its own residuals."""

    hold_out: float | None = setting("--hold-out SHARE", SHARE)
    """Keep this share at the end of each recording for validation by simulation."""
    validate_on: "Records | Sequence[Path]" = many("--validate RECORD", FILE, free=True)
    """Simulate the identified model on this recording."""
    sweep: bool = flag("--sweep/--no-sweep", True)
    """Estimates against window length, which show an inexact model."""
    follow: int = setting("--follow N", whole(0, 10), 0)
    """Carry out so many steps of advice, as long as one helps."""


@dataclass(frozen=True, kw_only=True)
class Identify(Uncertainty, Sharing, Known, Constrained, Sums):
    """Keywords of [`identify`][riecjax.identify]."""


@dataclass(frozen=True, kw_only=True)
class Assess(Validate, Uncertainty, Sharing, Known, Constrained, Refine, Sums):
    """Keywords of [`assess`][riecjax.assess].

    **Fields:** also `tests` of a user's own, each a function that makes one of the model, the
    records and the answer; `on_estimate`, called with the estimate before all that is slow, unless
    refinement answers; `progress`, called with the sum of squares after each step of a refinement
    that was asked for.
    """

    tests: "Sequence[MakeTest]" = ()
    on_estimate: "Callable[[Estimate], None] | None" = None
    progress: Callable[[float], None] | None = None

    def contradictions(self) -> Iterator[str]:
        """What nothing uses, and parameters without a value."""
        validates = self.hold_out is not None or bool(self.validate_on)
        if self.horizon is not None and self.refine in (None, "none", "integral") and not validates:
            yield (
                "{horizon} goes with {refine:auto} or {refine:output-error}, or with {hold_out} or "
                "{validate_on}: nothing else is simulated."
            )
        if self.per_record and self.validate_on:
            yield (
                "{per_record} gives a parameter no value on the recordings of {validate_on}: use "
                "one of the two."
            )


@dataclass(frozen=True)
class Offered(Settings):
    """Which terms a model may lack."""

    candidates: object = setting(
        "--candidates FILE.py:OBJECT",
        CODE,
        default_in_words="friction, springs, dead zones, offsets and the like of its motions",
    )
    """Terms that it may lack, a list of your own."""


@dataclass(frozen=True, kw_only=True)
class Discover(Seed, Uncertainty, Known, Fit, Offered):
    """How terms are looked for.

    Keywords of [`discover`][riecjax.discover].
    """

    hold_out: float | None = setting("--hold-out SHARE", SHARE)
    """Choose without this share at the end of each recording, and take values and intervals
    from it alone."""
    least: float = setting("--least SHARE", SHARE, 0.01)
    """Of what is unexplained, the share that a term must make up for."""
    smallest: float = setting("--smallest SHARE", SHARE, 2e-5)
    """Of the target's energy, the share that a term must make up for: less for exact data."""
    resamples: int = 40
    """Times that terms are searched for in data drawn again."""
    noise: "GivenNoise" = "auto"
