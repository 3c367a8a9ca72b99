"""What a command is doing, on standard error, and the estimate as soon as it is there."""

import itertools
import time
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from rich.text import Text

    from riecjax.estimation.estimate import Estimate

SHORTEST = 1e-3
"""Seconds in which something may be done."""


class Progress:
    """A line with a spinner, on a terminal, that says what takes the time and how much has passed.

    An estimate appears beneath it before all that is slow, and goes when the verdict, which holds
    it too, is printed.

    **Arguments:** `lines`: where there is no terminal, print a line for each tenth of what is
    counted.
    """

    def __init__(self, *, lines: bool = False) -> None:
        from rich.console import Console
        from rich.live import Live
        from rich.spinner import Spinner

        self._console, self._lines = Console(stderr=True), lines
        self._began = self._counted_since = time.monotonic()
        self._doing = "reading, and compiling what was not compiled before"
        self._counted, self._tenth = "", -1
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

    def count(self, what: str, done: int, total: int, samples: int = 0) -> None:
        """Show how much is done of what is being done, how many samples a second that was, and how
        long the rest takes at that pace."""
        now = time.monotonic()
        if what != self._counted:
            self._counted, self._counted_since, self._tenth = what, now, -1
        passed = max(now - self._counted_since, SHORTEST)
        self._doing = f"{what}: {done} of {total}"
        if samples:
            self._doing += f", {samples / passed / 1e3:,.0f} thousand samples/s"
        if 0 < done < total:
            self._doing += f", {passed * (total - done) / done:.0f} s left"
        tenth = 10 * done // total if total else -1
        if self._lines and not self._console.is_terminal and tenth > self._tenth:
            self._tenth = tenth
            line = f"riecjax: {self._doing}"
            self._console.print(line, markup=False, highlight=False, soft_wrap=True)

    def show_estimate(self, estimate: "Estimate") -> None:
        """Show a first table; what follows is about how far to trust it."""
        if not self._console.is_terminal:
            return
        from rich.console import Group

        from riecjax.reporting.answer import part_of
        from riecjax.reporting.parameters import parameter_table
        from riecjax.reporting.tables import in_rich

        self._doing = "identified; now testing how far to trust it"
        table = in_rich(parameter_table(part_of(estimate)))
        self._live.update(Group(table, self._spinner), refresh=True)

    def refining(self, cost: float) -> None:
        """Show how a refinement gets on."""
        self._doing = f"refining: step {next(self._steps)}, sum of squares {float(cost):.6g}"
