"""Files as loggers write them: `python -m benchmarks.zoo [--write]`.

Every case is written, read by the options of `riecjax identify` and compared with the numbers it
was made from. Fails where one is read wrongly, or too few need nothing beside --model and --map.
"""

import argparse
import importlib.util
import sys
import tempfile
from collections import Counter
from pathlib import Path

from benchmarks import recorded
from benchmarks.zoo import binary, programs, spellings, stamps, text  # noqa: F401
from benchmarks.zoo.case import CASES, Case, Outcome, compared, outcome
from benchmarks.zoo.measured import measured

PAGE = Path(__file__).parents[2] / "docs" / "how_to" / "files_as_they_come.md"
BEGIN = "<!-- zoo: python -m benchmarks.zoo --write -->"
ASKED_PLAIN, ASKED_FILES = 50, 60


def outcomes() -> dict[str, Outcome]:
    """What becomes of each case that can be made here."""
    with tempfile.TemporaryDirectory() as folder:
        return {
            name: outcome(one, Path(folder))
            for name, one in CASES.items()
            if not one.needs or importlib.util.find_spec(one.needs)
        }


def table() -> str:
    """How many files there are and every one, in Markdown."""
    plain = sum(not one.options and not one.refused for one in CASES.values())
    counts = f"{len(CASES)} files, {plain} of which need no option beside `--model` and `--map`:"
    head = ("file", "as written by", "options beside `--model` and `--map`")
    return f"{counts}\n\n{recorded.table(head, [_row(one) for one in CASES.values()])}"


def _row(one: Case) -> list[str]:
    options = f"`{' '.join(one.options)}`" if one.options else ""
    options = "refused, with the reason" if one.refused else options
    return [f"`{one.name}{one.suffix}`", one.follows, options]


def page() -> str:
    """The page of the documentation with the table as it is."""
    return recorded.filled_in(PAGE, BEGIN, table())


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--write", action="store_true", help="the table of the documentation")
    arguments = parser.parse_args()
    found = outcomes()
    for name, (kind, said) in found.items():
        one = CASES[name]
        print(f"{kind:<6} {name + one.suffix:<34} {' '.join(one.options):<24} {said}")
    right = [name for name, one in found.items() if one.kind == "right"]
    plain = sum(not CASES[name].options and not CASES[name].refused for name in right)
    kinds = Counter(one.kind for one in found.values())
    print(
        f"{len(found)} files: {len(right)} right, {plain} of them with --model and --map alone; "
        f"{kinds['asked']} asked, {kinds['wrong']} wrong"
    )
    for file, one in measured():
        kind, said = compared(one, file, one.write(file))
        kinds[kind] += 1
        print(f"{kind:<6} {one.follows}/{file.name:<60} {said}")
    if arguments.write:
        PAGE.write_text(page(), encoding="utf-8")
    sys.exit(bool(kinds["wrong"]) or plain < ASKED_PLAIN or len(right) < ASKED_FILES)


if __name__ == "__main__":
    main()
