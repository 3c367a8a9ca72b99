"""Are verdicts right? Systems with known truth, wrong models and faulty sensors.

    python -m benchmarks.calibration verdicts [--systems 5] [--seed 2]

Nine kinds of systems, right models and models that leave something out, each recorded with ten
kinds of sensors (`benchmarks.calibration.verdict_cases`), at 0, 1 and 5 % noise: `systems` of each
pair. Beside them eight classes by which a verdict is easily misled, of 150 values each
(`benchmarks.calibration.verdict_classes`). The rules' constants were set on seed 1; other seeds are
the test. Written to benchmarks/verdicts.json.

- A value is *right* if it lies within 10 % of the truth and its 95 % interval holds the truth.
  `do not use` is right of a value that is not.
- A parameter is *sound* if its value is right, and model and sensors are, too. (A wrong sensor may
  leave a value right, and no one can know.)
- A *doubt* holds if it reaches the truth.
- *Advice* is followed up to three times. A value is *near* within 5 % of the truth; a step that
  leaves a good value that was near no more near makes it worse.
"""

import multiprocessing
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

import riecjax as rx
from benchmarks.calibration.verdict_cases import FAULTS, KINDS, Case, cases
from benchmarks.calibration.verdict_classes import CLASSES, class_cases
from benchmarks.recorded import FOLDER, write_json

FILE = FOLDER / "verdicts.json"
RIGHT = (*(kind.name for kind in KINDS if not kind.left_out), *CLASSES)
SOUND = ("none", "short", "position only", "coarse")
"""Sensors that are limited and not wrong."""
LEVELS = ("good", "caution", "do not use")
NEAR = 0.1
CLOSE = 0.05
STEPS = 3
TARGETS = {
    "good, within their doubt": (0.97, 1.0),
    "do not use, rightly": (0.85, 1.0),
    "sound, called good": (0.80, 1.0),
    "doubts that hold": (0.92, 0.99),
    "good, made worse by a step": (0.0, 0.01),
}
PROCESSES = 2
PARTS_IN_A_PROCESS = 10
"""Refinements are compiled anew for every model: a process has room for so many parts."""


class Judged(NamedTuple):
    """A verdict on one parameter beside the truth."""

    kind: str
    fault: str
    noise: float
    name: str
    level: str
    error: float
    inside: bool
    holds: bool
    share: float
    advised: float
    steps: int

    @property
    def right(self) -> bool:
        """Whether value and interval are right."""
        return abs(self.error) <= NEAR and self.inside

    @property
    def sound(self) -> bool:
        """Whether nothing is wrong: value, interval, model and sensors."""
        return self.right and self.kind in RIGHT and self.fault in SOUND


def judged(case: Case) -> list[Judged] | None:
    """Verdicts on a case's parameters; `None` where there is no answer."""
    try:
        advised = assessment = rx.assess(case.model, case.record, case.criterion, follow=STEPS)
    except rx.RiecjaxError:
        return None
    while assessment.before is not None:
        assessment = assessment.before
    return judged_values(case, assessment, advised)


def judged_values(case: Case, assessment: rx.Assessment, advised: rx.Assessment) -> list[Judged]:
    """Verdicts on a case's parameters, and what is found once it is `advised`."""
    found, after = [], case.truth
    if any(isinstance(element, rx.HiddenMode) for element in advised.model.elements):
        after = {**case.truth, **case.beside_mode}
    for name, one in assessment.verdict.parameters.items():
        truth = case.truth[name]
        low, high = assessment.answer.interval(name)
        # Where it may differ between recordings, the mean of them.
        every = [float(advised.answer[n]) for n in advised.answer.table.everywhere((name,))]
        found.append(
            Judged(
                case.kind,
                case.fault,
                case.noise,
                name,
                one.level,
                (one.value - truth) / abs(truth),
                bool(low <= truth <= high),
                bool(one.doubt[0] <= truth <= one.doubt[1]),
                one.share,
                float(np.mean(every)) / after[name] - 1,
                len(advised.followed),
            )
        )
    return found


class Part(NamedTuple):
    """Systems of one of the `KINDS` with one fault, or of one of the `CLASSES`."""

    kind: int | str
    fault: int
    seed: int
    systems: int

    def cases(self) -> list[Case]:
        """All of its systems."""
        if isinstance(self.kind, str):
            return class_cases(self.kind, self.seed)
        return cases(KINDS[self.kind], FAULTS[self.fault], self.seed, self.systems)


def judged_part(part: Part) -> list[list[Judged] | None]:
    """Verdicts on the systems of a part."""
    rx.start_jax()
    return [judged(case) for case in part.cases()]


def share(of: Sequence[Judged], which: Callable[[Judged], bool]) -> float:
    """Share of some verdicts for which something holds."""
    return sum(map(which, of)) / len(of) if of else float("nan")


def figures(every: Sequence[Judged]) -> dict[str, float]:
    """What the verdicts are measured by."""
    return {
        "good, within their doubt": share([j for j in every if j.level == "good"], _holds),
        "do not use, rightly": share(
            [j for j in every if j.level == "do not use"], lambda j: not j.right
        ),
        "sound, called good": share([j for j in every if j.sound], lambda j: j.level == "good"),
        "doubts that hold": share(every, _holds),
        "median doubt of good values": float(
            np.median([j.share for j in every if j.level == "good"] or [np.nan])
        ),
        "near, before advice": share(every, lambda j: abs(j.error) <= CLOSE),
        "near, after advice": share(every, lambda j: abs(j.advised) <= CLOSE),
        "good, made worse by a step": share([j for j in every if j.steps], _made_worse),
    }


def _made_worse(one: Judged) -> bool:
    return one.level == "good" and abs(one.error) <= CLOSE < abs(one.advised)


def _holds(one: Judged) -> bool:
    return one.holds


def confusion(every: Iterable[Judged]) -> dict[str, dict[str, int]]:
    """How many of each level are sound, near the truth beside their interval, and wrong."""
    counts = Counter((one.level, _state(one)) for one in every)
    states = ("right", "within 10 %, outside its interval", "off by more than 10 %")
    return {level: {state: counts[level, state] for state in states} for level in LEVELS}


def _state(one: Judged) -> str:
    if abs(one.error) > NEAR:
        return "off by more than 10 %"
    return "right" if one.inside else "within 10 %, outside its interval"


def main(systems: int = 5, seed: int = 2, only: tuple[str, ...] = (*CLASSES, *FAULTS)) -> None:
    """Nothing is written where some classes or faults are left out."""
    parts = [Part(name, 0, seed, 0) for name in CLASSES if name in only]
    parts += [
        Part(k, f, seed, systems)
        for k in range(len(KINDS))
        for f in range(len(FAULTS))
        if FAULTS[f] in only
    ]
    spawning = multiprocessing.get_context("spawn")
    answers = []
    with spawning.Pool(PROCESSES, maxtasksperchild=PARTS_IN_A_PROCESS) as pool:
        for done, found in enumerate(pool.imap(judged_part, parts)):
            answers += found
            print(f"{done + 1} of {len(parts)} parts", end="\r", flush=True)
    every = [one for answer in answers if answer is not None for one in answer]
    found = figures(every)
    by = {
        of: {name: rounded([one for one in every if getattr(one, of) == name]) for name in names}
        for of in ("kind", "fault", "noise")
        if (names := dict.fromkeys(getattr(one, of) for one in every))
    }
    result: dict[str, Any] = {
        "systems": len(answers),
        "without an answer": sum(answer is None for answer in answers),
        "parameters": len(every),
        "figures": {name: round(value, 4) for name, value in found.items()},
        "confusion": confusion(every),
        **by,
    }
    for name, (low, high) in TARGETS.items():
        met = "met" if low <= found[name] <= high else "NOT MET"
        print(
            f"{name:<28} {100 * found[name]:5.1f} %  asked {100 * low:g} to {100 * high:g}, {met}"
        )
    for level, states in result["confusion"].items():
        print(f"{level:<12} {states}")
    for name, of_kind in by["kind"].items():
        print(f"{name:<20}", *(f"{key} {value};" for key, value in of_kind.items()))
    if {*only} == {*CLASSES, *FAULTS}:
        write_json(FILE, result)


def rounded(some: Sequence[Judged]) -> dict[str, float | None]:
    """The figures of some verdicts, and how many there are."""
    found = figures(some).items()
    return {"values": len(some)} | {k: None if v != v else round(v, 3) for k, v in found}
