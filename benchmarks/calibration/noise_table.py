"""The tables of docs/sensor_noise.md from what was measured: `--page` of `sensor_noise`."""

import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from benchmarks.recorded import FOLDER, filled_in, table

PAGE = FOLDER.parent / "docs" / "sensor_noise.md"
BEGIN = "<!-- measured: python -m benchmarks.calibration sensor_noise -->"
WAYS = ("none", "auto")
"""Keywords of `noise=`: uncorrected, corrected."""

Document = Mapping[str, Any]


def tables(document: Document) -> str:
    """In Markdown; a dash stands where nothing was measured."""
    parts = [drag(document, motion) for motion in ("with velocity", "position only")]
    parts += [quarter_car(document), hidden_cars(document), dry_friction(document)]
    return "\n\n".join(parts)


def drag(document: Document, motion: str) -> str:
    head = (
        *("noise", "bias / sd, `none`", "`auto`"),
        *("error / bound, `none`", "`auto`", "answer", "refined"),
        *("coverage, `none`", "`auto`"),
    )

    def row(level: str) -> list[str]:
        linear = [_at(document, way, "drag", motion, level, "linear") for way in WAYS]
        final = _at(document, "auto", "drag", motion, level, "final")
        return [
            level,
            *(_largest(one, "bias") for one in linear),
            *(_largest(one, "error_over_bound") for one in [*linear, final]),
            f"{final['refined']} of {final['answers']}" if final.get("answers") else "-",
            *(_pooled(one) for one in linear),
        ]

    levels = (name for name in _there(document, "drag", motion) if name.endswith("%"))
    return _table(f"Oscillator with drag, {motion}", head, map(row, levels))


def quarter_car(document: Document) -> str:
    head = ("car, noise", "shift / standard error, `none`", "`auto`", "coverage, `none`", "`auto`")

    def row(car: str, level: str) -> list[str]:
        found = [_at(document, way, "quarter-car", car, level) for way in WAYS]
        shifts = (_largest(one, "shift") for one in found)
        return [f"{car}, {level}", *shifts, *map(_pooled, found)]

    cars = ("paper", "heavier")
    rows = ((c, n) for c in cars for n in _there(document, "quarter-car", c) if n.endswith("%"))
    return _table("Reduced quarter car", head, (row(*one) for one in rows))


def hidden_cars(document: Document) -> str:
    head = ("model, noise", "shift / standard error, judged", "given")

    def row(case: str, level: str) -> list[str]:
        ways = (f"{level}, judged", f"{level}, given")
        found = (_at(document, "auto", "hidden-cars", case, way) for way in ways)
        return [f"{case}, {level}", *(_largest(one, "shift") for one in found)]

    cases = (case for case in _there(document, "hidden-cars") if case not in ("seeds", "seconds"))
    rows = (row(case, level) for case in cases for level in ("1 %", "5 %", "20 %"))
    return _table("Cars of random masses with a hidden engine", head, rows)


def dry_friction(document: Document) -> str:
    head = (
        *("noise on", "bias / sd, `none`", "`auto`", "answer"),
        *("coverage, `none`", "`auto`", "answer", "refined"),
    )

    def row(case: str) -> list[str]:
        linear = [_at(document, way, "coulomb", case, "linear") for way in WAYS]
        final = _at(document, "auto", "coulomb", case, "final")
        found = [*linear, final]
        refined = f"{final['refined']} of {final['answers']}" if final.get("answers") else "-"
        return [case, *(_largest(one, "bias") for one in found), *map(_pooled, found), refined]

    cases = (name for name in _there(document, "coulomb") if name.endswith("%"))
    return _table("Dry friction", head, map(row, cases))


def _at(document: Document, *path: str) -> Document:
    """What stands there, empty if nothing was measured."""
    found: Any = document
    for name in path:
        found = found.get(name, {})
    return found


def _there(document: Document, *path: str) -> list[str]:
    """Names that either way has there, in the order of the file."""
    return list(dict.fromkeys(name for way in WAYS for name in _at(document, way, *path)))


def _largest(found: Document, what: str) -> str:
    values = [abs(one["value"]) for one in found.get(what, {}).values()]
    return _number(max(values)) if values else "-"


def _pooled(found: Document) -> str:
    pooled = found.get("coverage", {}).get("pooled")
    return "-" if pooled is None else f"{100 * pooled['value']:.1f} %"


def _number(value: float) -> str:
    return f"{value:.2g}" if value < 100 else f"{value:.0f}"


def _table(title: str, head: Sequence[str], rows: Iterable[Iterable[str]]) -> str:
    return f"**{title}**\n\n{table(head, list(map(list, rows)))}"


def page() -> str:
    """docs/sensor_noise.md with the tables of what is recorded."""
    recorded = json.loads((FOLDER / "sensor_noise.json").read_text())
    return filled_in(PAGE, BEGIN, tables(recorded))
