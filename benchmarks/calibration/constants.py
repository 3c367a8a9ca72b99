"""Which numbers decide a verdict? Each is doubled, and verdicts are taken anew.

    python -m benchmarks.calibration constants [--systems 1] [--of-a-class 3] [--only MODULE ...]

On cases of every class of `benchmarks.calibration.verdicts`, and of every other pair of a kind and
a fault, seed 1. Told of each constant: values whose level changes with it, and by how much the
shares move that verdicts are measured by, all in all and in the class or kind where good values
fall outside their doubt most. A constant whose doubling changes no level decides nothing here.
Advice is not tried, nor is anything refined. Written to benchmarks/constants.json.
"""

import ast
import functools
import importlib
import inspect
import multiprocessing
import operator
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import riecjax as rx
from benchmarks.calibration.verdict_cases import FAULTS, KINDS
from benchmarks.calibration.verdict_classes import CLASSES
from benchmarks.calibration.verdicts import PROCESSES, Judged, Part, figures, judged_values, share
from benchmarks.recorded import FOLDER, write_json

FILE = FOLDER / "constants.json"
SEED = 1
DECIDING = {
    "riecjax.assessment.demands": ("SPOILT", "ENOUGH", "NOISE_ALONE", "NOTHING_EXPLAINED"),
    "riecjax.doubts.causes": (
        *("LEVEL", "UNEXPLAINED", "OF_NOISE", "LOST", "CLEARER", "FEWEST", "MOST"),
        *("OWN", "OWN_NOISE"),
    ),
    "riecjax.doubts.columns": ("SLIGHT", "APART", "LONGEST_SHARE", "REACH", "GAIN", "JUMPS"),
    "riecjax.doubts.delays": ("SMALLEST", "TURN", "PERHAPS", "CERTAIN", "SLIGHT", "FARTHEST"),
    "riecjax.doubts.equation_faults": ("HALF", "MOVES", "NOTABLE", "NEAR"),
    "riecjax.doubts.kinematics": (
        *("MOST_NOISE", "MOVING", "ALIKE", "ROUGHLY", "ROUGH", "MOST", "GROSS", "GAIN", "OFFSET"),
        *("UNRELATED", "CLEAR", "CALIBRATED"),
    ),
    "riecjax.doubts.lacked_elements": ("PASSES", "CLOSER", "AT_END"),
    "riecjax.equations.element": ("ROUGH",),
    "riecjax.doubts.sampled_inputs": ("LEFT", "RESTS"),
    "riecjax.estimation.constant_target": (
        *("CONSTANT", "STILL", "EXPLAINED", "DISAGREEING", "SLIGHT"),
    ),
    "riecjax.estimation.estimate": ("NOTABLE_INFLATION", "MATTERING_SHARE"),
    "riecjax.estimation.excitation": ("NEARLY_COLLINEAR", "DOMINATES", "DROWNED"),
    "riecjax.findings": ("FINEST",),
    "riecjax.folds": ("FOLDS", "COLLINEAR"),
    "riecjax.validation.residuals": (
        *("BAND_SHARE", "PROMINENCE", "PEAK_BAND", "PEAK_SHARE", "NOTABLE_SIZE"),
    ),
    "riecjax.validation.sweep": (
        *("LEVEL", "SMALLEST_DRIFT", "MOST", "FEWEST_STRETCHES", "LONGER"),
    ),
}
"""Of modules that doubts come from, the numbers that a rule compares with."""
FACTOR = 2.0


class Changed(NamedTuple):
    """A constant by name and module that is doubled; none for all as they are."""

    module: str = ""
    name: str = ""


@contextmanager
def changed(one: Changed) -> Iterator[None]:
    """The package with a constant changed where it is defined, and wherever it is imported."""
    if not one.name:
        yield
        return
    places = [importlib.import_module(one.module)]
    for name, module in list(sys.modules.items()):
        if name.startswith("riecjax.") and hasattr(module, one.name):
            imports = (n for n in ast.walk(_tree(name)) if isinstance(n, ast.ImportFrom))
            if any(
                n.module == one.module and one.name in (a.name for a in n.names) for n in imports
            ):
                places.append(module)
    before = getattr(places[0], one.name)
    value = type(before)(FACTOR * before)
    try:
        for place in places:
            setattr(place, one.name, value)
        yield
    finally:
        for place in places:
            setattr(place, one.name, before)


@functools.cache
def _tree(name: str) -> ast.Module:
    return ast.parse(inspect.getsource(sys.modules[name]))


def variants(only: tuple[str, ...]) -> list[Changed]:
    """All constants of some modules, changed."""
    return [Changed(module, name) for module in only for name in DECIDING[module]]


class Asked(NamedTuple):
    """Cases of one part, and what is to be changed."""

    part: Part
    most: int
    variants: list[Changed]


def verdicts_of(asked: Asked) -> list[list[list[Judged] | None]]:
    """Of each case its verdicts as things are, and with each change; `None` without an answer."""
    rx.start_jax()
    # Nothing is proposed, so that nothing has to be tried.
    importlib.import_module("riecjax.assessment.assess").tried = lambda *_: ()  # pyright: ignore
    found = []
    for case in asked.part.cases()[: asked.most]:
        of_case: list[list[Judged] | None] = []
        for one in (Changed(), *asked.variants):
            with changed(one):
                try:
                    made = rx.assess(case.model, case.record, case.criterion, refine="none")
                    of_case.append(judged_values(case, made, made))
                except Exception:  # a number that something else counts on breaks it
                    of_case.append(None)
        found.append(of_case)
    return found


def told(before: list[list[Judged] | None], after: list[list[Judged] | None]) -> dict[str, Any]:
    """What a change did to the verdicts on all cases."""
    pairs = [
        (a, b)
        for one, other in zip(before, after)
        if one is not None and other is not None
        for a, b in zip(one, other, strict=True)
    ]
    figures_of = [figures([pair[place] for pair in pairs]) for place in (0, 1)]
    kinds = dict.fromkeys(before.kind for before, _ in pairs)
    lost = {"": 0.0}
    for kind in kinds:
        some = list(zip(*(pair for pair in pairs if pair[0].kind == kind), strict=True))
        held = [share([one for one in of if one.level == "good"], HOLDS) for of in some]
        # Of none that are good nothing is lost.
        lost[kind] = held[0] - held[1] if all(one == one for one in held) else 0.0
    return {
        "answers lost or won": sum((a is None) != (b is None) for a, b in zip(before, after)),
        "levels that change": sum(a.level != b.level for a, b in pairs),
        "doubts that change": sum(
            abs(a.advised - b.advised) > 1e-9 or abs(a.share - b.share) > CHANGES * a.share
            for a, b in pairs
        ),
        **{name: round(figures_of[1][name] - figures_of[0][name], 4) for name in NAMED},
        "lost most": max(lost, key=lambda kind: lost[kind]),
        "lost": round(max(lost.values()), 3),
    }


HOLDS = operator.attrgetter("holds")
NAMED = ("good, within their doubt", "do not use, rightly", "sound, called good")
CHANGES = 0.1
"""Share by which a doubt changes at the least."""


def main(systems: int = 1, of_a_class: int = 3, only: tuple[str, ...] = (*DECIDING,)) -> None:
    """Nothing is written where some modules are left out."""
    every = variants(only)
    parts = [Asked(Part(name, 0, SEED, 0), of_a_class, every) for name in CLASSES]
    parts += [
        Asked(Part(k, f, SEED, systems), systems, every)
        for k in range(len(KINDS))
        for f in range(k % 2, len(FAULTS), 2)
    ]
    spawning = multiprocessing.get_context("spawn")
    cases_of: list[list[list[Judged] | None]] = []
    with spawning.Pool(PROCESSES) as pool:
        for done, found in enumerate(pool.imap(verdicts_of, parts)):
            cases_of += found
            print(f"{done + 1} of {len(parts)} parts", end="\r", flush=True)
    before, *after = (list(one) for one in zip(*cases_of, strict=True))
    result = {}
    for one, verdicts in zip(every, after, strict=True):
        name = f"{one.module}.{one.name}"
        result[name] = told(before, verdicts)
        print(f"{name:<60}", *result[name].values())
    if {*only} == {*DECIDING}:
        write_json(FILE, result)
