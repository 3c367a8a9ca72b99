"""`--refine` of `riecjax identify`: options, and the objective they ask for."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import click

from riecjax.cli.options import FINITE, POSITIVE, collecting, pairs_to_dict

if TYPE_CHECKING:
    from riecjax.refinement.coordinates import Prior
    from riecjax.refinement.objective import AbstractObjective


class BoundType(click.ParamType):
    """`NAME=LOW:HIGH`, either end of which may be left out."""

    name = "NAME=LOW:HIGH"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, tuple[float | None, float | None]]:
        name, equals, ends = str(value).partition("=")
        low, colon, high = ends.partition(":")
        if not (name.strip() and equals and colon):
            self.fail(f"'{value}' is not of the form {self.name}.", param, ctx)
        try:
            bounds = [float(end) if end.strip() else None for end in (low, high)]
        except ValueError:
            self.fail(f"the ends in '{value}' are not numbers.", param, ctx)
        return name.strip(), (bounds[0], bounds[1])


class PriorType(click.ParamType):
    """`NAME=MEAN±SD`, or with `+-`."""

    name = "NAME=MEAN±SD"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, tuple[float, float]]:
        name, equals, text = str(value).partition("=")
        mean, sign, std = text.replace("+-", "±").partition("±")
        if not (name.strip() and equals and sign):
            self.fail(f"'{value}' is not of the form {self.name} (or MEAN+-SD).", param, ctx)
        return name.strip(), (FINITE.convert(mean, param, ctx), POSITIVE.convert(std, param, ctx))


@dataclass(frozen=True)
class RefinementOptions:
    """What was asked for on the command line."""

    refine: str
    horizon: float | None
    channels: tuple[str, ...]
    bounds: tuple[tuple[str, tuple[float | None, float | None]], ...]
    priors: Mapping[str, tuple[float, float]]
    loss: Literal["squares", "huber"]

    def require_sense(self, *, validates: bool) -> None:
        """**Raises:** `click.UsageError` for options that nothing would come of."""
        if self.channels and self.refine != "output-error":
            raise click.UsageError("--channel goes with --refine output-error.")
        if self.loss != "squares" and self.refine != "output-error":
            raise click.UsageError("--loss goes with --refine output-error.")
        simulates = validates or self.refine in ("auto", "output-error")
        if self.horizon is not None and not simulates:
            raise click.UsageError(
                "--horizon goes with --refine auto or output-error, or with --hold-out or "
                "--validate: nothing else is simulated."
            )
        if self.bounds and self.refine == "none":
            raise click.UsageError("--bound goes with --refine auto, integral or output-error.")
        if self.priors and self.refine not in ("integral", "output-error"):
            raise click.UsageError(
                "--prior goes with --refine integral or output-error: the linear estimate knows of "
                "none."
            )

    @property
    def validation_horizon(self) -> float | None:
        """Seconds after which simulations start anew; None for as the motion asks."""
        return None if self.refine == "output-error" else self.horizon

    def known_before(self) -> "dict[str, Prior]":
        """Priors by name."""
        from riecjax.refinement.coordinates import Prior

        return {name: Prior(*each) for name, each in self.priors.items()}

    def objective(self) -> "AbstractObjective | Literal['auto'] | None":
        """What is to be made small; `None` for no refinement."""
        if self.refine == "none":
            return None
        if self.refine == "auto":
            return "auto"
        from riecjax.refinement.integral_error import IntegralError
        from riecjax.refinement.output_error import OutputError
        from riecjax.refinement.shots import Tiles, WholeRecord

        if self.refine == "integral":
            return IntegralError()
        shooting = WholeRecord() if self.horizon is None else Tiles(seconds=self.horizon)
        return OutputError(shooting, channels=self.channels or None, loss=self.loss)


refinement_options: Callable[[Callable[..., Any]], Callable[..., Any]] = collecting(
    [
        click.option(
            "--refine",
            type=click.Choice(["auto", "none", "integral", "output-error"]),
            default="auto",
            show_default=True,
            help="Refine the linear estimate: all equations at once over the same windows, or by "
            "simulation; auto does the latter where it leaves only white noise.",
        ),
        click.option(
            "--horizon",
            type=POSITIVE,
            metavar="SECONDS",
            help="Simulate over windows so long; by default over whole recordings, unless the "
            "motion is unstable.",
        ),
        click.option(
            "--channel",
            "channels",
            multiple=True,
            metavar="SIGNAL",
            help="Signal to compare with its simulation; by default every recorded state. "
            "Repeatable.",
        ),
        click.option(
            "--bound",
            "bounds",
            multiple=True,
            type=BoundType(),
            help="Keep a refined parameter between two values, either of which may be left out. "
            "Repeatable.",
        ),
        click.option(
            "--prior",
            "priors",
            multiple=True,
            type=PriorType(),
            callback=pairs_to_dict,
            help="What is known of a refined parameter beforehand, in SI units: it counts as one "
            "more observation. Repeatable.",
        ),
        click.option(
            "--loss",
            type=click.Choice(["squares", "huber"]),
            default="squares",
            show_default=True,
            help="What is made small of simulated minus recorded: squares, or Huber's loss, in "
            "which what no noise explains pulls less.",
        ),
    ],
    RefinementOptions,
    "refining",
)
