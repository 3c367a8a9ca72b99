"""Settings of a fit: its criterion, and what is said of parameters beforehand."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Literal

from riecjax.settings.kinds import (
    ENDS,
    FINITE,
    MEAN_AND_DEVIATION,
    POSITIVE,
    TEST_FUNCTION,
    TEXT,
    WINDOW_COUNT,
    choice,
)
from riecjax.settings.option import Settings, many, named, setting

if TYPE_CHECKING:
    from jaxtyping import Array, Key

    from riecjax.criteria.criterion import AbstractCriterion
    from riecjax.criteria.test_functions import AbstractTestFunction
    from riecjax.records.noise_judgement import GivenNoise


@dataclass(frozen=True)
class Fit(Settings):
    """What is fitted: the criterion, by its band or as an object."""

    criterion: "Literal['riec', 'dols'] | AbstractCriterion | None" = setting(
        "--criterion", choice("riec", "dols"), "riec"
    )
    """Windowed integrals of the equation of motion, or the equation at every sample."""
    _: KW_ONLY
    band: tuple[float, float] | None = setting(
        "--band LOW HIGH",
        POSITIVE,
        count=2,
        default_in_words="the model's, else 1 10",
        excludes=("alpha", "beta"),
    )
    """Frequencies in Hz that the model should explain; windows are half their periods long,
    bumps longer."""
    alpha: float | None = setting(
        "--alpha", POSITIVE, default_in_words="half a period of HIGH", excludes=("band",)
    )
    """Shortest window in s."""
    beta: float | None = setting(
        "--beta", POSITIVE, default_in_words="half a period of LOW", excludes=("band",)
    )
    """Longest window in s."""
    windows: int | str | None = setting("--windows", WINDOW_COUNT, default_in_words="all")
    """All windows there are, in closed form, or a number of random ones."""
    test_function: "str | AbstractTestFunction | None" = setting(
        "--test-function",
        TEST_FUNCTION,
        default_in_words="auto, the boxcar, or the bump where no sensor measured a velocity",
    )
    """Weight inside a window; hat and bump need no velocities."""
    quadrature: Literal["2", "4", "6", "8"] | None = setting(
        "--quadrature",
        choice("2", "4", "6", "8"),
        default_in_words="4; 2, trapezoids, for random windows between samples",
    )
    """Order of the integrals in the time step, for test functions that have one."""

    @property
    def says_of_criterion(self) -> bool:
        """Whether a criterion is asked for, so that it is not the one that suits."""
        return (self.criterion is not None and self.says("criterion")) or self.says_of_windows

    @property
    def says_of_windows(self) -> bool:
        """Whether anything is said of the windows."""
        return self.says("band", "alpha", "beta", "windows", "test_function", "quadrature")

    def contradictions(self) -> Iterator[str]:
        """What belongs to another criterion, or says the same twice."""
        if self.criterion is not None and self.says("criterion") and self.says_of_windows:
            yield (
                "{band}, {alpha}, {beta}, {windows}, {test_function} and {quadrature} belong to "
                "{criterion:riec}."
            )
        if self.band is not None and self.alpha is not None and self.beta is not None:
            yield "{band} sets the same lengths as {alpha} and {beta}: leave out one of them."


@dataclass(frozen=True, kw_only=True)
class Known(Settings):
    """What is known beforehand."""

    known: "Mapping[str, float | Array]" = named("--set NAME=VALUE", FINITE)
    """Hold a parameter at a known value (SI units)."""


@dataclass(frozen=True, kw_only=True)
class Constrained(Settings):
    """What is likely beforehand, of the linear estimate and of a refinement."""

    bounds: Mapping[str, tuple[float | None, float | None]] = named("--bound NAME=LOW:HIGH", ENDS)
    """Keep a parameter between two values, either of which may be left out."""
    priors: Mapping[str, tuple[float, float]] = named("--prior NAME=MEAN±SD", MEAN_AND_DEVIATION)
    """What is known of a parameter beforehand, in SI units: it counts as one more observation."""


@dataclass(frozen=True, kw_only=True)
class Sharing(Settings):
    """Which parameters recordings do not share."""

    per_record: Sequence[str] = many("--per-record NAME", TEXT)
    """Give a parameter a value of its own in each recording (such as an offset)."""


@dataclass(frozen=True, kw_only=True)
class Sums(Fit):
    """What only Python says of sums: `key` of random windows, and the `noise` of bare records."""

    key: "Key[Array, ''] | None" = None
    noise: "GivenNoise" = "auto"


@dataclass(frozen=True, kw_only=True)
class Check(Sharing, Known, Sums):
    """Keywords of [`check`][riecjax.check]."""
