"""Options that make an error criterion."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import click

from riecjax.cli.options import POSITIVE, collecting

if TYPE_CHECKING:
    from riecjax.criteria.criterion import AbstractCriterion

DEFAULT_ALPHA, DEFAULT_BETA, DEFAULT_WINDOWS = 0.05, 0.5, 8000


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
        "--alpha",
        type=POSITIVE,
        help=f"Shortest window in s: half a period of the fastest motion modelled. "
        f"[default: {DEFAULT_ALPHA}]",
    ),
    click.option(
        "--beta",
        type=POSITIVE,
        help=f"Longest window in s: half a period of the slowest motion modelled. "
        f"[default: {DEFAULT_BETA}]",
    ),
    click.option(
        "--windows",
        "count",
        type=WindowCount(),
        help=f"Number of random windows, or 'all' of them in closed form. "
        f"[default: {DEFAULT_WINDOWS}]",
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
    alpha: float | None
    beta: float | None
    count: int | str | None
    test_function: str | None
    quadrature: str | None

    def build(self) -> "AbstractCriterion":
        """The criterion.

        **Raises:** `click.UsageError` for options that do not go together.
        """
        own = (self.alpha, self.beta, self.count, self.test_function, self.quadrature)
        if self.criterion == "dols" and any(value is not None for value in own):
            raise click.UsageError(
                "--alpha, --beta, --windows, --test-function and --quadrature belong to "
                "--criterion riec."
            )
        if self.test_function == "bump" and self.quadrature is not None:
            raise click.UsageError("--quadrature belongs to the boxcar and the hat.")
        from riecjax.criteria.criterion import DOLS, RIEC
        from riecjax.criteria.test_functions import Boxcar, Bump, Hat
        from riecjax.criteria.windows import AllWindows, RandomWindows

        if self.criterion == "dols":
            return DOLS()
        alpha = DEFAULT_ALPHA if self.alpha is None else self.alpha
        beta = DEFAULT_BETA if self.beta is None else self.beta
        if self.count == "all":
            windows = AllWindows(alpha, beta)
        else:
            windows = RandomWindows(alpha, beta, int(self.count or DEFAULT_WINDOWS))
        if self.test_function == "bump":
            return RIEC(windows, Bump())
        order = int(self.quadrature or 2)
        return RIEC(windows, Hat(order) if self.test_function == "hat" else Boxcar(order))


criterion_options = collecting(CRITERION_OPTIONS, CriterionOptions, "criteria")
"""The criterion's options; they arrive as one `criteria`."""
