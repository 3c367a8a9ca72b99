"""Run every benchmark and write `benchmarks/results.json`: `python -m benchmarks`."""

import json
from pathlib import Path

import jax

from benchmarks import identification, simulation

RESULTS = Path(__file__).parent / "results.json"


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    results = []
    for module in (simulation, identification):
        for comparison in module.run():
            results.append(comparison._asdict())
            print(
                f"{comparison.name:<16} ours {comparison.ours_s:9.4f} s   baseline "
                f"{comparison.baseline_s:9.4f} s   ratio {comparison.ratio:8.2f}   target "
                f"{comparison.target:g}   {'met' if comparison.met else 'NOT MET'}   "
                f"{comparison.accuracy}",
                flush=True,
            )
    RESULTS.write_text(json.dumps(results, indent=2) + "\n")


if __name__ == "__main__":
    main()
