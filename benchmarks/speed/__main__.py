"""How fast it is: `python -m benchmarks.speed [--small] [--check] [--page]`, or one of `PARTS`.

Speed against what users would write instead. Writes `benchmarks/results.json` (`results_small.json`
for the small size), with `--check` nothing: it fails where a ratio has fallen under half of what is
recorded there.
"""

import argparse
import importlib
import json
import sys
from collections.abc import Iterable

from benchmarks.recorded import FOLDER, filled_in, run_part, table, write_json
from riecjax.runtime import start_jax

SUITE = ("all_windows", "simulation", "estimation", "reading")
PARTS = ("instant", "growth")
PAGE = FOLDER.parent / "docs" / "speed.md"
BEGIN = "<!-- measured: make bench -->"


def measured(small: bool, only: Iterable[str]) -> dict[str, list[dict]]:
    """Results of the files of the suite, of all where none are named."""
    start_jax()
    from benchmarks.speed import timing

    size, found = timing.SMALL if small else timing.FULL, {}
    for file in only or SUITE:
        found[file] = []
        for comparison in importlib.import_module(f"benchmarks.speed.{file}").run(size):
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


def comparisons(results: list[dict]) -> str:
    """In Markdown."""

    def row(r: dict) -> list[str]:
        ours, theirs = (
            f"{1e3 * seconds:.3g} ms" if seconds < 1 else f"{seconds:.3g} s"
            for seconds in (r["ours_s"], r["baseline_s"])
        )
        asked = f"{r['target']:g}" + ("" if r["met"] else ", **not met**")
        return [r["name"], ours, f"{r['baseline']}: {theirs}", f"{r['ratio']:.3g}", asked]

    return table(("name", "ours", "baseline", "ratio", "asked"), [row(r) for r in results])


def page() -> str:
    """docs/speed.md with the table of what is recorded."""
    return filled_in(PAGE, BEGIN, comparisons(json.loads((FOLDER / "results.json").read_text())))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--small", action="store_true", help="less of everything, in a minute")
    parser.add_argument("--check", action="store_true", help="compare with what is recorded")
    parser.add_argument("--only", nargs="*", default=[], choices=SUITE, help="files")
    parser.add_argument("--page", action="store_true", help="write the documentation's table")
    arguments = parser.parse_args()
    if arguments.page:
        PAGE.write_text(page(), encoding="utf-8")
        return
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
            again = [fallen(r, recorded) for r in measured(arguments.small, suspects).values()]
            once = {each.partition(":")[0] for each in slower}
            slower = [e for of_file in again for e in of_file if e.partition(":")[0] in once]
        sys.exit("\n".join(slower) or 0)
    names = {result["name"] for result in results}
    kept = [result for result in recorded if result["name"] not in names]
    write_json(file, [*kept, *results] if arguments.only else results)


if __name__ == "__main__":
    if len(sys.argv) > 1 and sys.argv[1] in PARTS:
        run_part("speed", PARTS)
    main()
