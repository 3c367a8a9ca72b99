"""Which signals of an equation are positions and which are velocities.

Units of coefficients: of a force over powers of signals, spelled as users spell them.
"""

import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from riecjax.equations.bases import Polynomial
from riecjax.equations.equation import Equation
from riecjax.equations.expressions import odd
from riecjax.equations.model import Model
from riecjax.equations.term import Term
from riecjax.records.record import Record

POSITIONS, VELOCITIES = ("m", "rad", "mm", "deg"), ("m/s", "rad/s", "mm/s", "deg/s")

FEWEST, ALIKE = 100, 0.9
"""Samples, and correlation with its slope, that tell a velocity's position."""
MOST_UNREAD = 8
"""Signals that no equation reads, of those that are looked into."""
OF_INERTIA = {("N", "kg"): "m", ("N m", "kg m^2"): "rad"}
"""Unit of a position by those of a force and an inertia."""


@dataclass(frozen=True)
class Motion:
    """A position and the velocity that is its derivative, of which one may not be recorded.

    **Fields:** `position`, `velocity`, names of signals, empty where there is none; `unit` of the
    position, empty where it is not known.
    """

    position: str
    velocity: str
    unit: str = ""

    @property
    def name(self) -> str:
        """What candidates are called after, where there are several motions."""
        return self.position or self.velocity


def motions_and_unread(
    equation: Equation,
    record: Record,
    recorded: Collection[str],
    units: Mapping[str, str],
    unread: Sequence[str],
) -> tuple[list[Motion], list[str]]:
    """The motions that an equation reads, with the positions that are recorded beside them, and of
    the signals that no equation reads the first ones of those that are none of these.

    By the derivatives of its terms; by their units, of signals that it reads in no derivative.
    """
    motions: dict[str, Motion] = {}
    for position, velocity in _pairs(equation, units):
        # By the units of the equation and of coefficients, where signals have none.
        by_term = (
            OF_INERTIA.get((equation.unit, str(term.unit)), "")
            if term.derivative
            else per(equation.unit, str(term.unit))
            for term in equation.terms
            if term.signal == position and term.unit and term.derivative != 1
        )
        unit = units.get(position) or per(units.get(velocity, ""), "1/s")
        x, v = (name if name in recorded else "" for name in (position, velocity))
        motion = Motion(x, v, unit or next(filter(None, by_term), ""))
        # What is read as a velocity here may be the derivative of a position there.
        for name in filter(None, (x, v)):
            if name not in motions or (motion.position and not motions[name].position):
                motions[name] = motion
    # A velocity has the position whose slope it goes along with, among signals not read.
    with_positions = [
        motion
        if motion.position
        else replace(
            motion, position=next((n for n in unread if is_slope(record, n, motion.velocity)), "")
        )
        for motion in dict.fromkeys(motions.values())
    ]
    positions = {motion.position for motion in with_positions}
    return with_positions, [name for name in unread if name not in positions][:MOST_UNREAD]


def is_slope(record: Record, position: str, velocity: str) -> bool:
    """Whether a signal goes along with the slope of another one."""
    x, v = record.signal(position).with_nan, record.signal(velocity).with_nan[1:-1]
    slope = x[2:] - x[:-2]
    both = np.isfinite(v) & np.isfinite(slope)
    moves = both.sum() > FEWEST and np.ptp(slope[both]) > 0 and np.ptp(v[both]) > 0
    return bool(moves and np.corrcoef(slope[both], v[both])[0, 1] > ALIKE)


def reading_velocities(model: Model) -> Model:
    """The same equations with a term that reads each velocity that they have a name for."""
    names = [name for stage in model.equation_names for name in stage]
    velocities = (
        sorted({t.measured[0] for t in equation.terms if t.signal and t.measured})
        for equation in model.equations
    )
    return model.with_terms(
        {
            name: [Term(f"{name} {v}", odd(v, 2)) for v in read]
            for name, read in zip(names, velocities, strict=True)
        }
    )


def _pairs(equation: Equation, units: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    """Positions with their velocities, either of them empty where the equation has no name."""
    for term in equation.terms:
        of = term.of
        if not isinstance(of, str):
            continue
        if not term.is_linear:
            yield (of, "") if isinstance(term.basis, Polynomial) else ("", of)
        else:
            first = next(iter(term.measured), "")
            if term.derivative == 2:
                yield of, first
            elif term.derivative == 1 and (units.get(of) in VELOCITIES or not first):
                yield "", of
            elif term.derivative == 1 and units.get(first, "m/s") in VELOCITIES:
                yield of, first
        if not term.derivative:
            if units.get(of) in POSITIONS:
                yield of, ""
            elif units.get(of) in VELOCITIES:
                yield "", of


_FACTOR = re.compile(r"([^\W\d]+|1)(?:\^?(-?\d+))?")


def per(unit: str, of: str, power: int = 1) -> str:
    """A unit over a power of another: `per("N", "m/s", 2)` is `N s^2/m^2`.

    Empty where either is not known.
    """
    if not unit or (not of and power):
        return ""
    powers = _powers(unit)
    for name, exponent in _powers(of).items():
        powers[name] -= power * exponent
    above, below = (
        [name if p == sign else f"{name}^{abs(p)}" for name, p in powers.items() if p * sign > 0]
        for sign in (1, -1)
    )
    front = " ".join(above) or "1"
    if not below:
        return front if above else ""
    return f"{front}/{below[0] if len(below) == 1 else '(' + ' '.join(below) + ')'}"


def _powers(unit: str) -> Counter[str]:
    found: Counter[str] = Counter()
    above, *below = unit.split("/")
    for sign, part in ((1, above), *((-1, part) for part in below)):
        for name, exponent in _FACTOR.findall(part):
            if name != "1":
                found[name] += sign * int(exponent or 1)
    return found
