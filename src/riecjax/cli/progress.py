"""What a command is doing, on standard error, and the estimate as soon as it is there."""

import contextlib
import itertools
import time
from types import TracebackType
from typing import TYPE_CHECKING, NamedTuple, Self

from riecjax.work import Work, in_time, listening

if TYPE_CHECKING:
    from rich.console import Console
    from rich.text import Text

    from riecjax.estimation.estimate import Estimate


def announce(console: "Console", what: str, work: Work) -> None:
    """Print what is about to be done if it takes much."""
    if work.is_much:
        console.print(
            f"riecjax: {what} takes {work.words}.", markup=False, highlight=False, soft_wrap=True
        )


class _Doing(NamedTuple):
    """What is being done, with the seconds since it began and those that it takes."""

    what: str
    seconds: float
    began: float

    def __rich__(self) -> "Text":
        from rich.text import Text

        passed = time.monotonic() - self.began
        return Text(f"{self.what}: {passed:.0f} s of about {in_time(max(self.seconds, passed))}")


class Progress:
    """A line with a spinner that says what takes the time; where no one is looking, a line for all
    that takes much, before it starts.

    The estimate appears beneath it before all that is slow, and goes when the verdict, which holds
    it too, is printed.
    """

    def __init__(self) -> None:
        from rich.console import Console
        from rich.live import Live
        from rich.spinner import Spinner

        self._console = Console(stderr=True)
        self._spinner = Spinner("dots", "reading, and compiling what was not compiled before")
        self._live = Live(self._spinner, console=self._console, transient=True)
        self._steps = itertools.count(1)
        self._open = contextlib.ExitStack()

    def __enter__(self) -> Self:
        self._open.enter_context(listening(self.expect))
        if self._console.is_terminal:
            self._live.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._live.stop()
        self._open.close()

    def expect(self, what: str, work: Work) -> None:
        """Show what is about to be done, if it takes much also where no one is looking."""
        announce(self._console, what, work)
        if work.is_much:
            self._spinner.update(text=_Doing(what, work.seconds, time.monotonic()))

    def show_estimate(self, estimate: "Estimate") -> None:
        """Show a first table; what follows is about how far to trust it."""
        if not self._console.is_terminal:
            return
        from rich.console import Group

        from riecjax.reporting.estimate import estimate_entries, parameter_table
        from riecjax.reporting.tables import in_rich

        self._spinner.update(text="identified; now testing how far to trust it")
        table = in_rich(parameter_table(estimate_entries("", estimate)))
        self._live.update(Group(table, self._spinner), refresh=True)

    def refining(self, cost: float) -> None:
        """Show how a refinement gets on."""
        self._spinner.update(
            text=f"refining: step {next(self._steps)}, sum of squares {float(cost):.6g}"
        )
