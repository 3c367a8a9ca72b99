"""The table of docs/speed.md from what was measured: `python -m benchmarks.table`."""

import json
from pathlib import Path

FOLDER = Path(__file__).parent
PAGE = FOLDER.parent / "docs" / "speed.md"
BEGIN, END = "<!-- measured: make bench -->", "<!-- end -->"


def table(results: list[dict]) -> str:
    """In Markdown."""
    rows = ["| name | ours | baseline | ratio | asked |", "|---|---|---|---|---|"]
    for r in results:
        asked = f"{r['target']:g}" + ("" if r["met"] else ", **not met**")
        rows.append(
            f"| {r['name']} | {duration(r['ours_s'])} | {r['baseline']}: "
            f"{duration(r['baseline_s'])} | {r['ratio']:.3g} | {asked} |"
        )
    return "\n".join(rows)


def duration(seconds: float) -> str:
    return f"{1e3 * seconds:.3g} ms" if seconds < 1 else f"{seconds:.3g} s"


def page() -> str:
    """docs/speed.md with the table of what is recorded."""
    return filled_in(PAGE, BEGIN, table(json.loads((FOLDER / "results.json").read_text())))


def filled_in(page: Path, begin: str, text: str) -> str:
    """A page of the documentation with this text between a mark and the next end."""
    before, rest = page.read_text(encoding="utf-8").split(begin)
    after = rest.split(END)[1]
    return f"{before}{begin}\n{text}\n{END}{after}"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
