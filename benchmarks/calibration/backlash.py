"""What play is found to be, over drives of known truth. Written to backlash.json.

    python -m benchmarks.calibration backlash [--drives N] [--alone N] [--out FILE]

`play`: drives of two inertias, a spring between them behind a play of 0.2 to 3 times the twist's
rms, with both encoders and noise of 1 % of that rms. `none`: the same without play, asked for one.
`alone`: drives of a play of 0.1 to 1 times the rms from the motor's encoder alone, refined by
simulation from half the width, and from 1.05 times all other values.

Each drive is simulated here, by its own Runge-Kutta steps of an eighth of a sample, in NumPy.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from tests.machines import DRIVE

import riecjax as rx
from benchmarks.recorded import FOLDER, filled_in, write_json
from riecjax.errors import RiecjaxError

OUT = FOLDER / "backlash.json"
PAGE = FOLDER.parent / "docs" / "elements.md"
RATE, SECONDS, FINER = 500.0, 20.0, 8
NOISE = 0.01
"""Of each encoder, as a share of the twist's rms."""
TORQUE = np.linspace(0.5, 8.0, 16)
"""Hertz of the torque's sines."""
SMALL = 0.3
"""Play, in rms of the twist, below which simulations from near by go along with the motion."""
PASSES = 5
"""Simulations in which the ratio of play to twist is brought to what is asked for."""

MODEL = DRIVE.with_elements(rx.Backlash("k"))
FOUND = ("play", "k", "J_m", "J_l")


class Drives(NamedTuple):
    """Drives, one beside the other: true `values` of parameters, and samples of each signal."""

    values: dict[str, Float[np.ndarray, " drives"]]
    signals: dict[str, Float[np.ndarray, "samples drives"]]

    def record(self, number: int, names: tuple[str, ...] = ("q_m", "q_l", "tau")) -> rx.Record:
        """The recording of one."""
        samples = {name: self.signals[name][:, number] for name in names}
        return rx.Record.from_samples(samples, time_step=1 / RATE)

    def truth(self, number: int) -> dict[str, float]:
        """The parameters of one."""
        return {name: float(values[number]) for name, values in self.values.items()}


def random_drives(count: int, seed: int, ratios: tuple[float, float]) -> Drives:
    """Random drives, whose play is so many times the rms of their twist, in equal ratios."""
    random = np.random.default_rng(seed)
    inertias, dampings = (
        random.uniform(0.5e-3, 4e-3, (2, count)),
        random.uniform(2e-3, 8e-3, (2, count)),
    )
    reduced = inertias[0] * inertias[1] / inertias.sum(axis=0)
    stiffness = (2 * np.pi * random.uniform(8.0, 20.0, count)) ** 2 * reduced
    phases = random.uniform(0, 2 * np.pi, (len(TORQUE), count))
    low, high = ratios
    ratio = (
        np.zeros(count) if high == 0 else np.exp(random.uniform(np.log(low), np.log(high), count))
    )
    step = 1 / (RATE * FINER)
    times = np.arange(0, 2 * int(RATE * SECONDS) * FINER + 1) * step / 2
    torque = np.zeros((times.size, count))
    for hertz, phase in zip(TORQUE, phases):
        torque += (
            0.3 / np.sqrt(len(TORQUE) / 2) * np.sin(2 * np.pi * hertz * times[:, None] + phase)
        )

    def moved(play: Float[np.ndarray, " drives"]) -> Float[np.ndarray, "samples 2 drives"]:
        def rate(state: np.ndarray, drive: np.ndarray) -> np.ndarray:
            twist = state[0, 0] - state[0, 1]
            force = stiffness * (twist - np.clip(twist, -play / 2, play / 2))
            pushed = np.stack([drive - force, force])
            return np.stack([state[1], (pushed - dampings * state[1]) / inertias])

        state, kept = np.zeros((2, 2, count)), []
        for i in range(int(RATE * SECONDS) * FINER):
            if i % FINER == 0:
                kept.append(state[0])
            a, b, c = torque[2 * i : 2 * i + 3]
            one = rate(state, a)
            two = rate(state + step / 2 * one, b)
            three = rate(state + step / 2 * two, b)
            state = state + step / 6 * (one + 2 * (two + three) + rate(state + step * three, c))
        return np.stack(kept)

    play = np.zeros(count)
    angles = moved(play)
    for _ in range(PASSES if high else 0):
        play = ratio * np.std(angles[:, 0] - angles[:, 1], axis=0)
        angles = moved(play)
    spread = NOISE * np.std(angles[:, 0] - angles[:, 1], axis=0)
    noisy = angles + spread * random.standard_normal(angles.shape)
    names = ("J_m", "J_l", "d_m", "d_l", "k", "play")
    values: dict[str, Any] = dict(zip(names, (*inertias, *dampings, stiffness, play)))
    taken = torque[: 2 * len(angles) * FINER : 2 * FINER]
    return Drives(values, {"q_m": noisy[:, 0], "q_l": noisy[:, 1], "tau": taken})


def found_in(made: Drives, number: int) -> dict[str, Any] | None:
    """What is found of one drive; `None` where the recording is said to carry no play."""
    record = made.record(number)
    model = MODEL.for_records([record])
    try:
        estimate = rx.identify(model, record)
    except RiecjaxError as error:
        print(f"drive {number}: {error}")
        return None
    (evidence,) = rx.estimation.element_evidence(model, estimate)
    if not evidence.carried:
        return None
    truth = made.truth(number)
    low, high = estimate.interval("play")
    return {
        "errors": {name: float(estimate[name]) / truth[name] - 1 for name in FOUND},
        "covered": bool(low <= truth["play"] <= high),
    }


def found_alone(made: Drives, number: int) -> dict[str, float]:
    """The ratio of play to twist, and the error of a width that is refined from the motor alone."""
    record, truth = made.record(number, ("q_m", "tau")), made.truth(number)
    start = {name: 1.05 * value for name, value in truth.items()} | {"play": 0.5 * truth["play"]}
    twist = np.std(made.signals["q_m"][:, number] - made.signals["q_l"][:, number])
    try:
        found = float(rx.refine(MODEL, record, start, rx.OutputError())["play"])
    except RiecjaxError as error:
        print(f"drive {number} alone: {error}")
        found = float("inf")
    return {"ratio": truth["play"] / float(twist), "error": found / truth["play"] - 1}


def main(drives: int = 100, alone: int = 20, out: Path = OUT) -> None:
    rx.start_jax()
    made, without = random_drives(drives, 0, (0.2, 3.0)), random_drives(drives, 1, (0.0, 0.0))
    told = [one for number in range(drives) if (one := found_in(made, number)) is not None]
    errors = {name: np.abs([one["errors"][name] for one in told]) for name in FOUND}
    motors = random_drives(alone, 2, (0.1, 1.0))
    refined = [found_alone(motors, number) for number in range(alone)]
    small, large = (
        [of for of in refined if (of["ratio"] < SMALL) == want] for want in (True, False)
    )
    report: dict[str, Any] = {
        "drives": drives,
        "found": len(told),
        "covered": sum(one["covered"] for one in told),
        "median_error_percent": {n: 100 * float(np.median(of)) for n, of in errors.items()},
        "largest_error_percent": 100 * float(errors["play"].max()),
        "false_alarms": sum(found_in(without, number) is not None for number in range(drives)),
        "alone": {
            name: {
                "drives": len(of),
                "within_5_percent": sum(abs(one["error"]) < 0.05 for one in of),
            }
            for name, of in (("play_below_0.3", small), ("play_above", large))
        },
    }
    print(report)
    write_json(out, report)
    if out == OUT:
        PAGE.write_text(filled_in(PAGE, "<!-- backlash -->", in_words(report)), encoding="utf-8")


def in_words(report: dict[str, Any]) -> str:
    """What the page on elements says of it."""
    errors, small, large = report["median_error_percent"], *report["alone"].values()
    count, share = report["drives"], NOISE * 100
    return (
        f"On {count} simulated drives of 20 s, with a play of 0.2 to 3 times the rms of the twist "
        f"and {share:g} % of that as noise of both encoders, it is found and carried in "
        f"{report['found']} (`python -m benchmarks.calibration backlash`); the median error of the "
        f"width is {errors['play']:.2g} % (largest {report['largest_error_percent']:.2g} %), of "
        f"the spring {errors['k']:.2g} %, and {report['covered']} intervals hold the width. Of "
        f"{count} drives without play {report['false_alarms']} are given one. From the motor "
        f"alone, started at half the width and 5 % off in all else, {small['within_5_percent']} of "
        f"{small['drives']} widths below 0.3 times the rms are refined to within 5 %, and "
        f"{large['within_5_percent']} of {large['drives']} above."
    )
