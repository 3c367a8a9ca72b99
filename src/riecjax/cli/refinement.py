"""`--refine` of `riecjax identify`: options, and the refinement they ask for."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import click

from riecjax.cli.options import POSITIVE, collecting

if TYPE_CHECKING:
    from riecjax.criteria.criterion import AbstractCriterion
    from riecjax.estimation.estimate import Estimate
    from riecjax.models.model import Model
    from riecjax.records.record import Record
    from riecjax.refinement.objective import AbstractObjective
    from riecjax.refinement.refined import Refined

STEPS = 200
"""Steps that a refinement may take."""


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


@dataclass(frozen=True)
class RefinementOptions:
    """What was asked for on the command line."""

    refine: str
    horizon: float | None
    channels: tuple[str, ...]
    bounds: tuple[tuple[str, tuple[float | None, float | None]], ...]

    def require_sense(self) -> None:
        """**Raises:** `click.UsageError` for options that nothing would come of."""
        given = {
            "--horizon": self.horizon is not None,
            "--channel": bool(self.channels),
        }
        for option, there in given.items():
            if there and self.refine != "output-error":
                raise click.UsageError(f"{option} goes with --refine output-error.")
        if self.bounds and self.refine == "none":
            raise click.UsageError("--bound goes with --refine integral or output-error.")

    def objective(self, criterion: "AbstractCriterion") -> "AbstractObjective":
        """What is to be made small."""
        from riecjax.refinement.integral_error import IntegralError
        from riecjax.refinement.output_error import OutputError
        from riecjax.refinement.shots import Tiles, WholeRecord

        if self.refine == "integral":
            return IntegralError(criterion)
        shooting = WholeRecord() if self.horizon is None else Tiles(seconds=self.horizon)
        return OutputError(shooting, channels=self.channels or None)

    def run(
        self,
        model: "Model",
        records: "list[Record]",
        estimate: "Estimate",
        **settings: Any,
    ) -> "Refined | None":
        """The refinement from an estimate, with its progress on standard error.

        **Raises:** as `refine`.
        """
        from rich.console import Console

        from riecjax.leaves import on_host
        from riecjax.refinement.refine import refine

        if self.refine == "none":
            return None
        with Console(stderr=True).status("refining") as status:
            step = 0

            def report(cost: float) -> None:
                nonlocal step
                step += 1
                status.update(f"refining: step {step}, sum of squares {float(cost):.6g}")

            return on_host(
                refine(
                    model,
                    records,
                    estimate,
                    self.objective(estimate.criterion),
                    bounds=dict(self.bounds),
                    max_steps=STEPS,
                    progress=report,
                    **settings,
                )
            )


refinement_options: Callable[[Callable[..., Any]], Callable[..., Any]] = collecting(
    [
        click.option(
            "--refine",
            type=click.Choice(["none", "integral", "output-error"]),
            default="none",
            show_default=True,
            help="Refine the linear estimate: all equations at once over the same windows, or by "
            "simulation.",
        ),
        click.option(
            "--horizon",
            type=POSITIVE,
            metavar="SECONDS",
            help="Simulate over windows so long; by default over whole recordings.",
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
    ],
    RefinementOptions,
    "refining",
)
