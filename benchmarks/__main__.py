"""Speed against what users would write instead: `python -m benchmarks [--small] [--check]`.

Writes `benchmarks/results.json` (`results_small.json` for the small size), with `--check` nothing:
it fails where a ratio has fallen under half of what is recorded there.
"""

import argparse
import importlib
import json
import sys
from collections.abc import Iterable
from pathlib import Path

from benchmarks.writing import write_json
from riecjax.runtime import start_jax

FOLDER = Path(__file__).parent
SUITE = ("all_windows", "simulation", "estimation", "study", "bypassed")


def measured(small: bool, only: Iterable[str]) -> dict[str, list[dict]]:
    """Results of the files of the suite, of all where none are named."""
    start_jax()
    from benchmarks import timing

    size, found = timing.SMALL if small else timing.FULL, {}
    for file in only or SUITE:
        found[file] = []
        for comparison in importlib.import_module(f"benchmarks.suite.{file}").run(size):
            print(line(comparison._asdict()), flush=True)
            found[file].append(comparison._asdict())
    return found


def line(result: dict) -> str:
    verdict = "met" if result["met"] else "NOT MET"
    return (
        f"{result['name']:<18} ours {result['ours_s']:10.5f} s  baseline "
        f"{result['baseline_s']:10.5f} s  ratio {result['ratio']:8.2f}  target "
        f"{result['target']:g}  {verdict}  {result['accuracy']}"
    )


def fallen(results: list[dict], recorded: list[dict]) -> list[str]:
    """What is less than half as good, against the baseline, as when it was recorded."""
    before = {result["name"]: result["ratio"] for result in recorded}
    return [
        f"{r['name']}: ratio {r['ratio']:.2f}, recorded {before[r['name']]:.2f}"
        for r in results
        if r["name"] in before and r["ratio"] < 0.5 * before[r["name"]]
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--small", action="store_true", help="less of everything, in a minute")
    parser.add_argument("--check", action="store_true", help="compare with what is recorded")
    parser.add_argument("--only", nargs="*", default=[], choices=SUITE, help="files")
    arguments = parser.parse_args()
    file = FOLDER / ("results_small.json" if arguments.small else "results.json")
    by_file = measured(arguments.small, arguments.only)
    results = [result for of_file in by_file.values() for result in of_file]
    recorded = json.loads(file.read_text()) if file.exists() else []
    if arguments.check:
        slower = fallen(results, recorded)
        # Another program on the machine slows one side only: what is really slower stays so.
        if slower:
            print("again, for " + "; ".join(slower))
            suspects = [file for file, of_file in by_file.items() if fallen(of_file, recorded)]
            again = measured(arguments.small, suspects)
            slower = [each for of_file in again.values() for each in fallen(of_file, recorded)]
        sys.exit("\n".join(slower) or 0)
    names = {result["name"] for result in results}
    kept = [result for result in recorded if result["name"] not in names]
    write_json(file, [*kept, *results] if arguments.only else results)


if __name__ == "__main__":
    main()
