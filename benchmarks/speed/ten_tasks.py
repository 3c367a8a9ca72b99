"""Lines and seconds of `docs/how_to/ten_tasks.md`, written into its table.

`python -m benchmarks.speed ten_tasks`: all tasks are done twice, in a folder of
their own, and the second time counts. Commands start afresh, as from a shell; Python goes on where
it was.
"""

import contextlib
import os
import re
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

PAGE = Path(__file__).parents[2] / "docs" / "how_to" / "ten_tasks.md"
BLOCK = re.compile(r"```(console|python)\n(.*?)```", flags=re.DOTALL)


class Task(NamedTuple):
    """A heading of the page and the code beneath it, of kind `console` or `python`."""

    title: str
    blocks: tuple[tuple[str, str], ...]

    @property
    def lines(self) -> int:
        """Lines to type: commands, and Python that is no import."""
        every = [line for _, code in self.blocks for line in code.splitlines()]
        return sum(bool(line.strip()) and not line.startswith("import ") for line in every)


def tasks() -> Iterator[Task]:
    """The page's sections, what stands before the first heading too."""
    for section in re.split(r"^## ", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE):
        title = section.partition("\n")[0]
        yield Task(title, tuple((kind, code) for kind, code in BLOCK.findall(section)))


def command(line: str) -> None:
    """Run `riecjax ...` as a shell would."""
    words = shlex.split(line)[1:]
    again = "import sys; from riecjax.cli.main import main; main(sys.argv[1:])"
    subprocess.run([sys.executable, "-c", again, *words], check=True, capture_output=True)


def do(task: Task, names: dict[str, Any]) -> float:
    """Seconds that a task takes."""
    start = time.perf_counter()
    for kind, code in task.blocks:
        if kind == "console":
            command(code)
        else:
            with contextlib.redirect_stdout(None):
                exec(compile(code, task.title, "exec"), names)
    return time.perf_counter() - start


def main() -> None:
    every = list(tasks())
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        names: dict[str, Any] = {}
        for task in every:
            do(task, names)
        seconds = {task.title: do(task, names) for task in every}
    text = PAGE.read_text(encoding="utf-8")
    for task in every[1:]:
        took = seconds[task.title]
        said = f"{took:.1f}" if took >= 0.1 else "under 0.1"
        row = rf"^(\| \[{re.escape(task.title)}\]\([^|]*\|).*$"
        text = re.sub(row, rf"\1 {task.lines} | {said} |", text, flags=re.MULTILINE)
    PAGE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    os.environ.setdefault("COLUMNS", "80")
    main()
