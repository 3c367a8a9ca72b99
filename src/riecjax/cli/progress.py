"""What a command is doing, on standard error."""

import itertools
import time
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from rich.text import Text

SHORTEST = 1e-3
"""Seconds in which something may be done."""


class Progress:
    """A line with a spinner, on a terminal, that says what takes the time and how much has passed.

    **Arguments:** `lines`: where there is no terminal, print a line for each tenth of what is
    counted.
    """

    def __init__(self, *, lines: bool = False) -> None:
        from rich.console import Console

        self._console, self._lines = Console(stderr=True), lines
        self._began = self._counted_since = time.monotonic()
        self._doing = "reading, and compiling what was not compiled before"
        self._counted, self._tenth = "", -1
        self._status = self._console.status(self)
        self._steps = itertools.count(1)

    def __rich__(self) -> "Text":
        from rich.text import Text

        return Text(f"{self._doing}: {time.monotonic() - self._began:.0f} s")

    def __enter__(self) -> Self:
        if self._console.is_terminal:
            self._status.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._status.stop()

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

    def refining(self, cost: float) -> None:
        """Show how a refinement gets on."""
        self._doing = f"refining: step {next(self._steps)}, sum of squares {float(cost):.6g}"
