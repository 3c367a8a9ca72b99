"""Approved outputs: `python -m tests.approved [--approve] [CASE...]`.

Each case is a command line (`cases.py`); what it says is kept in `outputs/`: `NAME.json` with the
exit status, the document and the names of files, `NAME.txt` with what the terminal shows. A change
of the program that moves any of it fails in `test_approved.py`. This command shows what moved: the
path in the document, before and after, values in their standard errors. With `--approve` it keeps
the new outputs, which then belong into the same commit as the change, with the reason.
`--list` names the cases; a name may hold `*`.

Accepted without approval: a value that moves by 1e-6 of its standard error, other numbers by 1e-6
of themselves, a printed number by one unit of its last digit, a Gram matrix by 1e-12 of its
diagonal. Long lists are kept as their length, mean, r.m.s., ends and two fixed projections.

A case with `known_wrong` says what should be said instead. It fails once that is said: then its
mark is to be removed, and the output approved.
"""

import argparse
import fnmatch
import sys
from pathlib import Path

import click

ROOT = Path(__file__).parents[2]


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.approved", description=(__doc__ or "").split("\n\n")[1]
    )
    parser.add_argument("cases", nargs="*", metavar="CASE", help="all, unless some are named")
    parser.add_argument("--approve", action="store_true", help="keep the new outputs")
    parser.add_argument("--list", action="store_true", help="names of the cases")
    parser.add_argument("--quick", action="store_true", help="without those marked slow")
    arguments = parser.parse_args()
    sys.path[:0] = [str(ROOT / "tests"), str(ROOT)]
    import pytest
    from tests.approved.approving import difference
    from tests.approved.cases import CASES

    import conftest  # noqa: F401  # compiles as the tests do

    chosen = [
        name
        for name, case in CASES.items()
        if not (arguments.quick and case.slow)
        and (not arguments.cases or any(fnmatch.fnmatch(name, p) for p in arguments.cases))
    ]
    if arguments.list or not chosen:
        click.echo("\n".join(CASES))
        return 0 if arguments.list else 2
    moved = 0
    for name in chosen:
        try:
            lines = difference(CASES[name], arguments.approve)
        except pytest.skip.Exception as absent:
            click.echo(f"{name}: skipped, {absent}")
            continue
        moved += bool(lines)
        click.echo("\n".join([f"{name}: {'as approved' if not lines else 'differs'}", *lines]))
    click.echo(
        f"{moved} of {len(chosen)} cases differ" + (", approved now" if arguments.approve else "")
    )
    return int(moved > 0 and not arguments.approve)


if __name__ == "__main__":
    sys.exit(main())
