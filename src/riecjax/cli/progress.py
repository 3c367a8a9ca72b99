"""What a command is doing, on standard error, and the estimate as soon as it is there."""

import itertools
import time
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from rich.text import Text

    from riecjax.estimation.estimate import Estimate


class Progress:
    """A line with a spinner, on a terminal, that says what takes the time and how much has passed.

    The estimate appears beneath it before all that is slow, and goes when the verdict, which holds
    it too, is printed.
    """

    def __init__(self) -> None:
        from rich.console import Console
        from rich.live import Live
        from rich.spinner import Spinner

        self._console = Console(stderr=True)
        self._began = time.monotonic()
        self._doing = "reading, and compiling what was not compiled before"
        self._spinner = Spinner("dots", self)
        self._live = Live(self._spinner, console=self._console, transient=True)
        self._steps = itertools.count(1)

    def __rich__(self) -> "Text":
        from rich.text import Text

        return Text(f"{self._doing}: {time.monotonic() - self._began:.0f} s")

    def __enter__(self) -> Self:
        if self._console.is_terminal:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._live.stop()

    def show_estimate(self, estimate: "Estimate") -> None:
        """Show a first table; what follows is about how far to trust it."""
        if not self._console.is_terminal:
            return
        from rich.console import Group

        from riecjax.reporting.estimate import estimate_entries, parameter_table
        from riecjax.reporting.tables import in_rich

        self._doing = "identified; now testing how far to trust it"
        table = in_rich(parameter_table(estimate_entries("", estimate)))
        self._live.update(Group(table, self._spinner), refresh=True)

    def refining(self, cost: float) -> None:
        """Show how a refinement gets on."""
        self._doing = f"refining: step {next(self._steps)}, sum of squares {float(cost):.6g}"
