"""Options that make an error criterion."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import click

from riecjax.cli.options import POSITIVE, collecting

if TYPE_CHECKING:
    from riecjax.criteria.criterion import AbstractCriterion
    from riecjax.models.model import Model


class WindowCount(click.ParamType):
    """A number of random windows, or all of them."""

    name = "N|all"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> int | str:
        if value == "all":
            return "all"
        try:
            count = int(str(value))
        except ValueError:
            self.fail(f"'{value}' is neither a whole number nor 'all'.", param, ctx)
        if not 1 <= count <= 100_000_000:
            self.fail(f"{count} is not between 1 and 100000000.", param, ctx)
        return count


CRITERION_OPTIONS = (
    click.option(
        "--criterion",
        type=click.Choice(["riec", "dols"]),
        default="riec",
        show_default=True,
        help="Windowed integrals of the equation of motion, or the equation at every sample.",
    ),
    click.option(
        "--band",
        type=(POSITIVE, POSITIVE),
        metavar="LOW HIGH",
        help="Frequencies in Hz that the model should explain; windows are half their periods "
        "long. [default: the model's, else 1 10]",
    ),
    click.option(
        "--alpha", type=POSITIVE, help="Shortest window in s. [default: half a period of HIGH]"
    ),
    click.option(
        "--beta", type=POSITIVE, help="Longest window in s. [default: half a period of LOW]"
    ),
    click.option(
        "--windows",
        "count",
        type=WindowCount(),
        help="All windows there are, in closed form, or a number of random ones. [default: all]",
    ),
    click.option(
        "--test-function",
        type=click.Choice(["boxcar", "hat", "bump"]),
        help="Weight inside a window; hat and bump need no velocities. [default: boxcar]",
    ),
    click.option(
        "--quadrature",
        type=click.Choice(["2", "4", "6", "8"]),
        help="Order of boxcar's and hat's integrals in the time step. [default: 2, trapezoids]",
    ),
)


@dataclass(frozen=True)
class CriterionOptions:
    """What the user said of the criterion."""

    criterion: str
    band: tuple[float, float] | None
    alpha: float | None
    beta: float | None
    count: int | str | None
    test_function: str | None
    quadrature: str | None

    def require_sense(self) -> None:
        """Raise `click.UsageError` for options that do not go together."""
        own = (
            *(self.band, self.alpha, self.beta, self.count),
            *(self.test_function, self.quadrature),
        )
        if self.criterion == "dols" and any(value is not None for value in own):
            raise click.UsageError(
                "--band, --alpha, --beta, --windows, --test-function and --quadrature belong to "
                "--criterion riec."
            )
        if self.test_function == "bump" and self.quadrature is not None:
            raise click.UsageError("--quadrature belongs to the boxcar and the hat.")
        if self.band is not None and self.alpha is not None and self.beta is not None:
            raise click.UsageError(
                "--band says what --alpha and --beta say: leave out one of them."
            )

    def build(self, model: "Model") -> "AbstractCriterion":
        """The criterion, for a model's band unless another is asked for."""
        from riecjax.criteria.bump import Bump
        from riecjax.criteria.criterion import DOLS, RIEC
        from riecjax.criteria.test_functions import Boxcar, Hat
        from riecjax.criteria.windows import (
            DEFAULT_BAND,
            AllWindows,
            RandomWindows,
            half_periods,
        )

        if self.criterion == "dols":
            return DOLS()
        shortest, longest = half_periods(self.band or model.band or DEFAULT_BAND)
        alpha = shortest if self.alpha is None else self.alpha
        beta = longest if self.beta is None else self.beta
        if isinstance(self.count, int):
            windows = RandomWindows(alpha, beta, self.count)
        else:
            windows = AllWindows(alpha, beta)
        if self.test_function == "bump":
            return RIEC(windows, Bump())
        order = int(self.quadrature or 2)
        return RIEC(windows, Hat(order) if self.test_function == "hat" else Boxcar(order))


criterion_options = collecting(CRITERION_OPTIONS, CriterionOptions, "criteria")
"""The criterion's options; they arrive as one `criteria`."""
