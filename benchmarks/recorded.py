"""What benchmarks record: JSON files beside them, and tables in the pages of the documentation.

Every benchmark is run as `python -m benchmarks.QUESTION`; where a question has parts, each is named
behind it, `python -m benchmarks.calibration verdicts --systems 2`, and has options of its own.
"""

import argparse
import importlib
import inspect
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parent
END = "<!-- end -->"


def write_json(path: Path, document: Any) -> None:
    """Write under a temporary name, then rename: nobody reads half a file."""
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    beside.write_text(json.dumps(document, indent=2) + "\n")
    beside.replace(path)


def filled_in(page: Path, begin: str, text: str) -> str:
    """A page of the documentation with this text between a mark and the next end."""
    before, rest = page.read_text(encoding="utf-8").split(begin)
    after = rest.split(END, 1)[1]
    return f"{before}{begin}\n{text}\n{END}{after}"


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """In Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def environment(cache: str) -> dict[str, str]:
    """This process's environment without settings of JAX; what is compiled is kept in `cache`."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("JAX_", "XLA_"))}
    return kept | {"XDG_CACHE_HOME": cache}


def last_line(command: Sequence[str], **settings: Any) -> Any:
    """The JSON document in the last line that a process prints."""
    run = subprocess.run(command, capture_output=True, text=True, check=True, **settings)
    return json.loads(run.stdout.splitlines()[-1])


def run_part(question: str, parts: Sequence[str]) -> None:
    """Run the `main` of the part that the command line names, with the options behind it.

    Its keywords are the options: `False` is a flag, a tuple holds the choices, all of which are
    taken unless some are named, and `None` stands for no path.
    """
    parser = argparse.ArgumentParser(prog=f"python -m benchmarks.{question}")
    parser.add_argument("part", choices=parts)
    part = parser.parse_args(sys.argv[1:2]).part
    module = importlib.import_module(f"benchmarks.{question}.{part}")
    options = argparse.ArgumentParser(f"{question} {part}", description=module.__doc__)
    for name, keyword in inspect.signature(module.main).parameters.items():
        flag, default = f"--{name.replace('_', '-')}", keyword.default
        if default is False:
            options.add_argument(flag, action="store_true")
        elif isinstance(default, tuple):
            kind = type(default[0])
            options.add_argument(flag, nargs="*", type=kind, choices=default, default=default)
        else:
            kind = Path if default is None else type(default)
            options.add_argument(flag, type=kind, default=default)
    sys.exit(module.main(**vars(options.parse_args(sys.argv[2:]))) or 0)
