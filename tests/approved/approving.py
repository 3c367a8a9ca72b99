"""Outputs as they are kept in files, compared and approved."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tests.approved.cases import Case, Moments
from tests.approved.comparison import differences, merged, moment_differences, text_differences
from tests.approved.running import output

OUTPUTS = Path(__file__).parent / "outputs"
TEXTS = {"out": "stdout", "err": "stderr"}


def approved(name: str) -> dict[str, Any] | None:
    """What is kept of a case; `None` where nothing is."""
    file = OUTPUTS / f"{name}.json"
    if not file.exists():
        return None
    kept = json.loads(file.read_text(encoding="utf-8"))
    text = OUTPUTS / f"{name}.txt"
    if text.exists():
        out, _, err = text.read_text(encoding="utf-8").partition("\n--- stderr ---\n")
        kept |= {"out": out, "err": err.removesuffix("\n")}
    return kept


def difference(case: Case | Moments, approve: bool = False) -> list[str]:
    """Lines that say how the output differs from what is approved; none where it does not.

    **Arguments:** `approve`: keep the output as it is.
    """
    kept, new = approved(case.name), output(case)
    lines = ["  nothing is approved yet"] if kept is None else list(_lines(kept, new))
    if lines and approve:
        _write(case.name, new if kept is None else merged(kept, new))
    if case.known_wrong and case.known_wrong.holds(new):
        lines.append(f"  now right ({case.known_wrong.right}): remove the mark known_wrong")
    return lines


def _lines(kept: dict[str, Any], new: dict[str, Any]) -> Iterator[str]:
    if "moments" in kept:
        for name in dict.fromkeys([*kept["moments"], *new["moments"]]):
            pair = [each["moments"].get(name, {"moments": []}) for each in (kept, new)]
            yield from (f"  {line}" for line in moment_differences(*pair, path=name))
        return
    for key, stream in TEXTS.items():
        yield from (f"  {line}" for line in text_differences(kept[key], new[key], stream))
    rest = [{k: v for k, v in each.items() if k not in TEXTS} for each in (kept, new)]
    yield from (f"  {line}" for line in differences(*rest))


def _write(name: str, output: dict[str, Any]) -> None:
    OUTPUTS.mkdir(exist_ok=True)
    rest = {key: entry for key, entry in output.items() if key not in TEXTS}
    (OUTPUTS / f"{name}.json").write_text(_readable(rest) + "\n", encoding="utf-8")
    if "out" in output:
        text = f"{output['out']}\n--- stderr ---\n{output['err']}\n"
        (OUTPUTS / f"{name}.txt").write_text(text, encoding="utf-8")


def _readable(entry: Any, indent: str = "") -> str:
    """JSON with short content on one line, so that a difference is a line."""
    line = json.dumps(entry, ensure_ascii=False)
    most = 400 if isinstance(entry, dict) and "projections" in entry else 100
    if len(line) + len(indent) <= most or not isinstance(entry, dict | list) or not entry:
        return line
    inner = indent + " "
    if isinstance(entry, list):
        rows = [inner + _readable(value, inner) for value in entry]
        return "[\n" + ",\n".join(rows) + f"\n{indent}]"
    rows = [
        f"{inner}{json.dumps(key, ensure_ascii=False)}: {_readable(value, inner)}"
        for key, value in entry.items()
    ]
    return "{\n" + ",\n".join(rows) + f"\n{indent}}}"
