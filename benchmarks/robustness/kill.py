"""`kill -9` at any moment of `identify --out` and of `reproduce --full`, and the same run again.

`python -m benchmarks.kill --identify 200 --reproduce 15 [--seed N]` kills so many runs, each at a
moment drawn evenly over the time that a whole run takes, and lets the next one end. Wrong is a run
after a killed one that fails, says anything else, or leaves other files, in the folder of results
or beside it, than a run that none was killed before. Files count to the byte. A home of its own
keeps what is compiled, so that caches are killed too, now and then as they are first filled.
"""

import argparse
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

RIECJAX = (sys.executable, "-m", "riecjax")
DRIVE = ("simulate", "drag-oscillator", "--input", "white-noise", "--duration", "20", "--out")
IDENTIFY = (
    *("identify", "drive.csv", "--model", "drag-oscillator", "--no-sweep", "--refine", "none"),
    *("--out", "out"),
)
FRESH = 10
"""Of so many killed runs one begins with nothing compiled."""


class Run(NamedTuple):
    """What a run said and left."""

    status: int
    said: tuple[str, str]
    files: dict[str, bytes]


class Machine:
    """A working folder with a home, in which a command is killed and run again."""

    def __init__(self, folder: Path, command: tuple[str, ...]) -> None:
        self.work, self.home, self.command = folder / "work", folder / "home", command
        for each in (self.work, self.home):
            each.mkdir()
        kept = {k: v for k, v in os.environ.items() if not k.startswith("JAX_")}
        self.environment = kept | {"XDG_CACHE_HOME": str(self.home)}
        subprocess.run(
            [*RIECJAX, *DRIVE, "drive.csv"], cwd=self.work, check=True, stdout=subprocess.DEVNULL
        )

    def begun(self) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [*RIECJAX, *self.command],
            cwd=self.work,
            env=self.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def whole(self) -> Run:
        began = time.monotonic()
        with self.begun() as process:
            said = process.communicate()
        self.took = time.monotonic() - began
        found = sorted(path for path in self.work.rglob("*") if path.is_file())
        files = {str(path.relative_to(self.work)): path.read_bytes() for path in found}
        shutil.rmtree(self.work / "out")
        return Run(process.returncode, said, files)

    def killed_at(self, seconds: float) -> bool:
        """Whether it was still running so long after it began."""
        with self.begun() as process:
            time.sleep(seconds)
            process.kill()
        return process.returncode < 0

    def temporaries(self) -> list[str]:
        """What was left behind in its caches and beside its results."""
        return [path.name for at in (self.home, self.work) for path in at.rglob(".riecjax-*")]


def compare(name: str, command: tuple[str, ...], count: int, draw: random.Random) -> int:
    """Kill so many runs of a command; the number of runs after them that are wrong."""
    wrong = killed = 0
    with tempfile.TemporaryDirectory() as folder:
        machine = Machine(Path(folder), command)
        machine.whole()
        right, takes = machine.whole(), machine.took
        assert right.status == 0, right.said
        while killed < count:
            if killed % FRESH == FRESH - 1:
                shutil.rmtree(machine.home)
                machine.home.mkdir()
            if not machine.killed_at(draw.uniform(0, takes)):
                takes *= 0.9
                continue
            killed += 1
            again = machine.whole()
            takes = machine.took  # which changes on a busy machine
            if again != right or machine.temporaries():
                wrong += 1
                others = right.files.keys() ^ again.files.keys()
                differing = {k for k, v in right.files.items() if again.files.get(k) != v}
                print(
                    f"wrong: {again.status} {sorted(others | differing)} {again.said[1]}",
                    flush=True,
                )
            if killed % FRESH == 0:
                print(f"{name}: killed {killed}, wrong {wrong}", file=sys.stderr, flush=True)
    print(f"{name}: a run takes {takes:.1f} s; killed {killed}, wrong {wrong}", flush=True)
    return wrong


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--identify", type=int, default=200)
    parser.add_argument("--reproduce", type=int, default=15)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    draw = random.Random(given.seed)
    study = ("reproduce", "--full", "--quick", "--out", "out")
    return bool(
        sum(
            compare(name, command, count, draw)
            for name, command, count in (
                ("identify --out", IDENTIFY, given.identify),
                ("reproduce --full --quick --out", study, given.reproduce),
            )
            if count
        )
    )


if __name__ == "__main__":
    sys.exit(main())
