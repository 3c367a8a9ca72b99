"""Options that make an error criterion."""

import dataclasses
import inspect
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import click

from riecjax.cli.options import POSITIVE, collecting

if TYPE_CHECKING:
    from riecjax.criteria.criterion import AbstractCriterion
    from riecjax.criteria.test_functions import AbstractTestFunction
    from riecjax.models.model import Model
    from riecjax.records.recording import Recording

TEST_FUNCTION_NAMES = ("boxcar", "hat", "bump")
"""As in `criteria.plain_data`, whose import takes JAX; the first is the default."""


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


class TestFunction(click.ParamType):
    """The name of a test function, or a class of the user's own in a file."""

    name = "|".join(("auto", *TEST_FUNCTION_NAMES, "FILE.py:CLASS"))

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> str:
        name = str(value)
        if name not in ("auto", *TEST_FUNCTION_NAMES) and not name.rpartition(":")[0].endswith(
            ".py"
        ):
            listed = ", ".join(f"'{one}'" for one in ("auto", *TEST_FUNCTION_NAMES))
            self.fail(f"'{name}' is not one of {listed}, nor FILE.py:CLASS.", param, ctx)
        return name


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
        "long, bumps longer. [default: the model's, else 1 10]",
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
        type=TestFunction(),
        metavar=TestFunction.name,
        help="Weight inside a window, or a class of your own; hat and bump need no velocities. "
        "[default: auto, the boxcar, or the bump where no sensor measured a velocity]",
    ),
    click.option(
        "--quadrature",
        type=click.Choice(["2", "4", "6", "8"]),
        help="Order of the integrals in the time step, for test functions that have one. "
        "[default: 4; 2, trapezoids, for random windows between samples]",
    ),
)


@dataclasses.dataclass(frozen=True)
class CriterionOptions:
    """What the user said of the criterion."""

    criterion: str
    band: tuple[float, float] | None
    alpha: float | None
    beta: float | None
    count: int | str | None
    test_function: str | None
    quadrature: str | None

    @property
    def is_given(self) -> bool:
        """Whether anything was said of it, so that it is not the one that suits."""
        return self.criterion != "riec" or self._says_of_windows

    @property
    def _says_of_windows(self) -> bool:
        own = (
            *(self.band, self.alpha, self.beta, self.count),
            *(self.test_function, self.quadrature),
        )
        return any(value is not None for value in own)

    def require_sense(self) -> None:
        """Raise `click.UsageError` for options that do not go together."""
        if self.criterion == "dols" and self._says_of_windows:
            raise click.UsageError(
                "--band, --alpha, --beta, --windows, --test-function and --quadrature belong to "
                "--criterion riec."
            )
        if self.band is not None and self.alpha is not None and self.beta is not None:
            raise click.UsageError(
                "--band sets the same lengths as --alpha and --beta: leave out one of them."
            )

    def build(self, model: "Model", recordings: "Sequence[Recording]" = ()) -> "AbstractCriterion":
        """The criterion, for a model's band unless another is asked for.

        Raises `click.UsageError` for a quadrature where the test function has none.
        """
        from riecjax.criteria.criterion import DOLS, RIEC
        from riecjax.criteria.suited import suited
        from riecjax.criteria.windows import DEFAULT_BAND, RandomWindows

        if self.criterion == "dols":
            return DOLS()
        band = self.band or model.band or DEFAULT_BAND
        # Bumps have no quadrature: to ask for one is to ask for boxcars.
        if self.test_function in (None, "auto") and self.quadrature is None:
            records = [recording.record for recording in recordings]
            found = suited(model.build_procedure(), band, records)
        else:
            found = RIEC.of_band(band, self._build_test_function())
        own: Any = (found.windows.alpha, found.windows.beta)
        asked = self.alpha, self.beta
        alpha, beta = (b if a is None else a for a, b in zip(asked, own))
        if isinstance(self.count, int):
            return RIEC(RandomWindows(alpha, beta, self.count), found.test_function, found.why)
        return found.between(alpha, beta)

    def _build_test_function(self) -> "AbstractTestFunction":
        import numpy as np

        from riecjax.criteria.plain_data import TEST_FUNCTIONS
        from riecjax.criteria.test_functions import AbstractTestFunction
        from riecjax.errors import ModelError, users_code
        from riecjax.models.catalogue import object_of_file

        weights = {name: kind() for name, kind in TEST_FUNCTIONS.items()}
        given = self.test_function in (None, "auto")
        name = TEST_FUNCTION_NAMES[0] if given else str(self.test_function)
        if name in weights:
            weight: Any = weights[name]
        else:
            found = object_of_file(name)
            kind = found if isinstance(found, type) else type(found)
            if not issubclass(kind, AbstractTestFunction) or inspect.isabstract(kind):
                raise ModelError(
                    f"{name} is no test function: derive the class from "
                    f"riecjax.criteria.AbstractSmoothTestFunction."
                )
            # Whatever the class lacks shows here, and not in the middle of a fit.
            with users_code(name):
                weight = found() if isinstance(found, type) else found
                weight.describe()
                weight.gain(np.array([1.0]), np.array([0.5]))
                _ = weight.smoothness, weight.row_seconds
        if self.quadrature is None:
            return weight
        if not hasattr(weight, "quadrature"):
            having = [f"the {n}" for n, one in weights.items() if hasattr(one, "quadrature")]
            raise click.UsageError(f"--quadrature belongs to {' and '.join(having)}.")
        return dataclasses.replace(weight, quadrature=int(self.quadrature))


criterion_options = collecting(CRITERION_OPTIONS, CriterionOptions, "criteria")
"""The criterion's options; they arrive as one `criteria`."""
