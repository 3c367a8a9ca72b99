"""Missing terms: how often exactly those are found, and what right models are given.

    python -m benchmarks.discovery [--seeds 200] [--noise 0.01 0.05] [--only duffing drag ...]
        [--parts found false peers search measured] [--json FILE]
    python -m benchmarks.discovery --page

Ten motions of each problem, noise of every seed its own. `--page` writes docs/discovery.md.
"""

import argparse
import json
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from tests.machines import OTHERS, PROBLEMS, Machine

from benchmarks.discovery.measured import MEASURED
from benchmarks.measured.__main__ import DATA
from benchmarks.recorded import FOLDER, filled_in, write_json
from riecjax.runtime import start_jax

MOTIONS = 10
FOUND, FALSE = (0.01, 0.05), (0.0, 0.01, 0.05, 0.1)
PARTS = ("found", "false", "peers", "search", "measured")
CANDIDATES, BELONG = (10, 100), (1.0, 0.6, -0.5, 0.4)
EVERY = {**PROBLEMS, **OTHERS}
PAGE = FOLDER.parent / "docs" / "discovery.md"
BEGIN = "<!-- measured: python -m benchmarks.discovery -->"


def record_of(problem: Machine, noise: float, seed: int, first: int = 0) -> Any:
    """One of its motions, with noise of a seed of its own."""
    return problem.record(noise, 900 + first + seed, drive=seed % MOTIONS)


def found(problem: Machine, noise: float, seeds: int) -> dict[str, Any]:
    """Structures that are found, and how far coefficients are from those of the whole model."""
    import riecjax as rx

    exact, others, seconds = 0, Counter[str](), []
    for seed in range(seeds):
        record = record_of(problem, noise, seed)
        began = time.perf_counter()
        names = rx.discover(problem.start, record, intervals=rx.Naive(), resamples=0).names
        seconds.append(time.perf_counter() - began)
        exact += {*names} == problem.missing
        others.update({*names} - problem.missing)
        others.update(f"no {name}" for name in problem.missing - {*names})
    return {
        "seeds": seeds,
        "exact": exact / seeds,
        "others": dict(others),
        "seconds": float(np.median(seconds)),
    }


def false(problem: Machine, noise: float, seeds: int) -> dict[str, Any]:
    """Models that lack nothing, and terms that they are given all the same."""
    import riecjax as rx

    others, added = Counter[str](), 0
    for seed in range(seeds):
        record = record_of(problem, noise, seed, 10_000)
        names = rx.discover(problem.model, record, intervals=rx.Naive(), resamples=0).names
        added += bool(names)
        others.update(names)
    return {"seeds": seeds, "added": added / seeds, "others": dict(others)}


def peers(problem: Machine, noise: float, seeds: int) -> dict[str, Any]:
    """PySINDy's weak form with the same candidates on the same data."""
    from benchmarks.discovery.peer import SETTINGS, structure

    results = {}
    for name, settings in SETTINGS.items():
        exact, seconds = 0, []
        for seed in range(seeds):
            record = record_of(problem, noise, seed)
            began = time.perf_counter()
            names = structure(problem, record, **settings)
            seconds.append(time.perf_counter() - began)
            exact += names == problem.missing
        results[name] = {
            "seeds": seeds,
            "exact": exact / seeds,
            "seconds": float(np.median(seconds)),
        }
    return results


def search(candidates: int, seeds: int) -> dict[str, Any]:
    """Four columns that belong, of many that correlate by a half in groups of five, from sums."""
    import riecjax as rx
    from riecjax.discovery.search import Search
    from riecjax.folds import Folds

    names = [f"c{number}" for number in range(candidates)]
    offers = [rx.discovery.Candidate(name, (rx.Term(name, name),)) for name in names]
    exact, milliseconds = 0, []
    for seed in range(-1, seeds):  # the first one warms up
        rng = np.random.default_rng([seed + 1, candidates])
        own, kept, noise = (rng.standard_normal((2000, n)) for n in (candidates, 1, 1))
        columns = own + np.repeat(rng.standard_normal((2000, candidates // 5)), 5, axis=1)
        belong = rng.choice(candidates, len(BELONG), replace=False)
        target = kept + columns[:, belong] @ np.array(BELONG)[:, None] + 0.7 * noise
        rows = np.concatenate([target, kept, columns], axis=1).reshape(20, 100, -1)
        moments = rows.swapaxes(1, 2) @ rows
        began = time.perf_counter()
        looking = Search(Folds(moments, moments, ("kept", *names)), ("kept",), offers)
        chosen = looking.found()
        looking.path(chosen)
        looking.next_best(chosen)
        if seed >= 0:
            milliseconds.append(1e3 * (time.perf_counter() - began))
            exact += {offer.name for offer in chosen} == {names[number] for number in belong}
    return {"seeds": seeds, "exact": exact / seeds, "ms": float(np.median(milliseconds))}


def page() -> str:
    document = json.loads((FOLDER / "discovery.json").read_text())
    return filled_in(PAGE, BEGIN, "\n".join(words(document)))


def words(document: dict[str, Any]) -> list[str]:
    """What was measured, in Markdown."""
    lines = ["| problem | missing | noise | exactly these | PySINDy | right model, terms added |"]
    lines += ["|---|---|---|---|---|---|"]
    for name, problem in EVERY.items():
        for noise in map(str, FALSE):
            own = document.get("found", {}).get(name, {}).get(noise)
            wrong = document.get("false", {}).get(name, {}).get(noise)
            peer = document.get("peers", {}).get(name, {}).get(noise)
            if own is None and wrong is None:
                continue
            best = max(peer.values(), key=lambda one: one["exact"]) if peer else None
            lines.append(
                f"| {name} | {', '.join(sorted(problem.missing))} | {100 * float(noise):g} % | "
                f"{_share(own, 'exact')} | {_share(best, 'exact')} | {_share(wrong, 'added')} |"
            )
    for count, one in document.get("search", {}).items():
        lines += [""] if count == str(CANDIDATES[0]) else []
        lines.append(
            f"From given sums, four of {count} candidates are chosen in {one['ms']:.2g} ms, "
            f"exactly these in {_share(one, 'exact')}."
        )
    if (measured := document.get("measured")) is not None:
        lines += _of_measured(measured)
    return lines


def _of_measured(found: dict[str, Any]) -> list[str]:
    """A line for each measured recording."""
    lines = [
        "",
        "**Measured recordings**, each from a model that lacks all of this and told of none:",
        "",
    ]
    if (one := found.get("silverbox")) is not None:
        identified, refined = (_listed(one[key], 3) for key in ("identified_mV", "refined_mV"))
        lines.append(
            f"- *Silverbox*, from a mass under a voltage (`least=0.005`, `smallest=1e-6`): "
            f"{', '.join(one['terms'])}. Test slices ({', '.join(one['refined_mV'])}) are "
            f"simulated to {identified} mV as identified, and {refined} mV refined by output "
            f"error, by {one['parameters']} parameters."
        )
    if (one := found.get("emps")) is not None:
        before, after = (
            _listed({k: one[loop][k] for k in ("q", "dq", "force")}, 2)
            for loop in ("loop_before", "loop_after")
        )
        lines.append(
            f"- *EMPS*, from a mass under the drive's force: {', '.join(one['terms'])}. Under its "
            f"controller position, velocity and force are off by {after} %, instead of {before} %."
        )
    if (one := found.get("pendulum")) is not None:
        lines.append(
            f"- *Pendulum*, with viscous friction: {', '.join(one['terms']) or 'nothing'}. A "
            f"recording that was held out is simulated to {one['simulated_after']:.2g} %, "
            f"{one['simulated_before']:.2g} % before."
        )
    if (one := found.get("mr_damper")) is not None:
        lines.append(
            f"- *Magneto-rheological damper*, from a curve over velocity, which `identify` warns "
            f"of (`hysteresis`): {', '.join(one['terms'])}. The force behind what was searched is "
            f"off by {one['held_out_after']:.2g} % instead of {one['held_out_before']:.2g} %."
        )
    return lines


def _listed(values: dict[str, float], digits: int) -> str:
    return ", ".join(f"{value:.{digits}g}" for value in values.values())


def _share(one: dict[str, Any] | None, of: str) -> str:
    return "-" if one is None else f"{100 * one[of]:.3g} % of {one['seeds']}"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--noise", nargs="+", type=float)
    parser.add_argument("--only", nargs="+", choices=EVERY, default=list(EVERY))
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS)
    parser.add_argument("--json", type=Path, help="where results are kept")
    parser.add_argument("--page", action="store_true", help="write the documentation's page")
    given = parser.parse_args()
    if given.page:
        PAGE.write_text(page(), encoding="utf-8")
        return
    start_jax(keep_compiled=True)
    of_problem = {"found": (found, FOUND), "false": (false, FALSE), "peers": (peers, FOUND)}
    for part in given.parts:
        if part == "measured":
            for name, of in MEASURED.items():
                _keep(given.json, ["measured", name], of(DATA))
            continue
        if part == "search":
            for count in CANDIDATES:
                _keep(given.json, ["search", str(count)], search(count, given.seeds))
            continue
        measure, levels = of_problem[part]
        for name in given.only:
            for noise in (given.noise or levels) if part == "found" or name in PROBLEMS else ():
                one = measure(EVERY[name], noise, given.seeds)
                _keep(given.json, [part, name, str(noise)], one)


def _keep(file: Path | None, place: list[str], result: dict[str, Any]) -> None:
    print(*place, json.dumps(result), flush=True)
    if file is None:
        return
    document = json.loads(file.read_text()) if file.exists() else {}
    at = document
    for name in place[:-1]:
        at = at.setdefault(name, {})
    at[place[-1]] = result
    write_json(file, document)


if __name__ == "__main__":
    main()
