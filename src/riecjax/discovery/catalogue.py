"""What models of machines leave out most often: friction, springs, offsets, products of signals."""

# Widths of a dead zone, of stops and of what saturates are tried at quantiles of the signal: most
# of them divide its samples into shares that both sides of the kink can be told from. Stribeck's
# speed is where friction falls off near standstill, and so among the slowest.

import contextlib
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import partial

import numpy as np

from riecjax.discovery.candidate import AnyCandidate, Candidate, Shaped, renamed
from riecjax.equations.bases import AbstractShape, DeadZone, Saturation, Stribeck
from riecjax.equations.equation import Equation
from riecjax.equations.expressions import (
    Expression,
    constant,
    even,
    odd,
    product,
    read_expression,
)
from riecjax.equations.memories import BoucWen, Dahl, Elapsed, Memory, usual_widths
from riecjax.equations.motions import Motion, motions_and_unread, per
from riecjax.equations.term import AbstractTerm, Term, Terms
from riecjax.errors import RiecjaxError
from riecjax.records.record import Record

WIDTHS = (0.1, 0.25, 0.4, 0.55, 0.7, 0.85)
"""Quantiles of a position's size."""
LIMITS = (0.3, 0.5, 0.7, 0.85)
"""The same, of what saturates far from standstill."""
SPEEDS = (0.05, 0.15, 0.3)
"""Quantiles of a speed."""

FRICTION = (
    ("coulomb", 0, True, "Coulomb friction"),
    ("asymmetry", 1, False, "viscous friction that differs by direction"),
    ("quadratic_drag", 2, True, "quadratic drag"),
    ("cubic_drag", 3, True, "cubic drag"),
)
STIFFNESS = (
    ("quadratic_stiffness", 2, False, "stiffness that differs by side"),
    ("cubic_stiffness", 3, True, "stiffness that hardens or softens"),
    ("quintic_stiffness", 5, True, "stiffness that hardens or softens further out"),
)


def default_candidates(
    equations: Sequence[Equation], names: Sequence[str], records: Sequence[Record],
    units: Mapping[str, str],
) -> list[AnyCandidate]:  # fmt: skip
    """The usual candidates for each equation.

    **Arguments:** `names` of the equations; `records`, which say what is recorded and how far
    signals reach; `units` of signals, as far as they are known.
    """
    found: list[AnyCandidate] = []
    recorded = set.intersection(*({*record.arrays} for record in records))
    unread = _unread(equations, records[0], recorded)
    for name, equation in zip(names, equations, strict=True):
        motions, others = motions_and_unread(equation, records[0], recorded, units, unread)
        found += _of_unread(others, motions, equation.unit, units, name)
        for motion in motions:
            after = f"_{motion.name}" if len(motions) > 1 else ""
            found += _of_motion(motion, equation.unit, records, name, after)
        unit = equation.unit
        found.append(
            Candidate("offset", (Term("offset", constant, unit=unit),), "constant force", name)
        )
        found.append(
            Candidate(
                "drift",
                (Term("drift", state_name("drift"), unit=per(unit, "s")),),
                "force that drifts",
                name,
                (Elapsed(state_name("drift")),),
            )
        )
    return _told_apart(found)


def _of_motion(
    motion: Motion, force: str, records: Sequence[Record], equation: str, after: str
) -> Iterator[AnyCandidate]:
    x, v, unit = motion
    speed = f"{unit}/s" if unit else ""

    def one(name: str, term: Callable[[str], AbstractTerm], meaning: str) -> Candidate:
        return Candidate(name + after, (term(name + after),), meaning, equation)

    def power(of: str, of_unit: str, p: int, is_odd: bool) -> Callable[[str], AbstractTerm]:
        expression: Expression = (odd if is_odd else even)(of, p)
        return lambda name: Term(name, expression, unit=per(force, of_unit, p) if p else force)

    def shaped(
        kind: Callable[[float], AbstractShape], name: str, of: str, of_unit: str, meaning: str,
        coefficient: str, quantiles: Sequence[float],
    ) -> Shaped:  # fmt: skip
        size = np.concatenate([np.abs(np.asarray(record.arrays[of])) for record in records])
        widths = np.quantile(size[np.isfinite(size)], quantiles)
        least = 1e-3 * float(widths[-1]) or 1.0
        widths = np.maximum.accumulate(np.maximum(widths, least * np.arange(1, widths.size + 1)))
        build = partial(_shaped_term, kind, of, coefficient)
        return Shaped(name + after, build, widths, of, of_unit, meaning, equation)

    if v or x:
        derivative = {"derivative": 1, "measured": (v,) if v else ()} if x else {}
        viscous = partial(Term, of=x or v, unit=per(force, speed), **derivative)
        yield one("viscous", viscous, "viscous friction")
    if v:
        for name, p, is_odd, meaning in FRICTION:
            yield one(name, power(v, speed, p, is_odd), meaning)
        yield from _with_memory(motion, force, records, equation, after)
        yield shaped(Stribeck, "stribeck", v, speed, "Stribeck friction", force, SPEEDS)
        damping = per(force, speed)
        limited = "friction that saturates"
        yield shaped(Saturation, "limited_friction", v, speed, limited, damping, LIMITS)
    if x:
        stiffness = partial(Term, of=x, unit=per(force, unit))
        yield one("stiffness", stiffness, "linear stiffness")
        for name, p, is_odd, meaning in STIFFNESS:
            yield one(name, power(x, unit, p, is_odd), meaning)
        slope = per(force, unit)
        yield shaped(
            DeadZone, "dead_zone", x, unit, "spring beyond a width, as of stops", slope, WIDTHS
        )
        yield shaped(Saturation, "saturation", x, unit, "force that saturates", slope, WIDTHS)
    if x and v:
        both = per(per(force, unit), speed)
        yield one("product", partial(Term, of=product(x, v), unit=both), "damping by position")


def _with_memory(
    motion: Motion, force: str, records: Sequence[Record], equation: str, after: str
) -> Iterator[Shaped]:
    """Hysteresis, whose widths are shares of a usual stroke."""
    widths = usual_widths(motion.velocity, records)
    for name, kind, meaning in (
        ("dahl", Dahl, "hysteresis, as Dahl's friction"),
        ("bouc_wen", BoucWen, "hysteresis, as of Bouc and Wen"),
    ):
        yield Shaped(
            name + after,
            partial(_of_state, force),
            widths,
            motion.velocity,
            motion.unit,
            meaning,
            equation,
            partial(_remembering, kind, motion.velocity),
        )


def _of_state(unit: str, name: str, width: float) -> AbstractTerm:
    return Term(name, state_name(name), unit=unit)


def _remembering(
    kind: Callable[[str, str, float], Memory], velocity: str, name: str, width: float
) -> Memory:
    return kind(state_name(name), velocity, width)


def state_name(name: str) -> str:
    """What the state of a law with a memory is called as a signal."""
    return f"{name}_state"


def _unread(equations: Sequence[Equation], record: Record, recorded: Collection[str]) -> list[str]:
    """Signals that are recorded, and that no equation reads or knows as a derivative."""
    known = {name for e in equations for pair in e.derivatives for name in pair}
    for equation in equations:
        signals = record.signals
        for term in equation.terms:
            with contextlib.suppress(RiecjaxError):
                read_expression(term.of, signals)
        known |= {*signals.read}
    return [name for name in record.arrays if name in recorded and name not in known]


def _of_unread(
    unread: Sequence[str],
    motions: Sequence[Motion],
    force: str,
    units: Mapping[str, str],
    equation: str,
) -> Iterator[Candidate]:
    """What a signal does that is recorded and not read: by itself, and to friction."""
    for name in unread:
        unit = units.get(name, "")
        own = per(force, unit)
        yield Candidate(
            f"signal_{name}",
            (Term(f"signal_{name}", name, unit=own),),
            f"force that follows {name}",
            equation,
        )
        for v, speed in ((m.velocity, f"{m.unit}/s" if m.unit else "") for m in motions):
            after = f"{name}_{v}" if len(motions) > 1 else name
            if v:
                damping, friction = f"viscous_by_{after}", f"coulomb_by_{after}"
                yield Candidate(
                    damping,
                    (Term(damping, product(name, v), unit=per(own, speed)),),
                    f"damping that {name} changes",
                    equation,
                )
                yield Candidate(
                    friction,
                    (Term(friction, product(name, odd(v, 0)), unit=own),),
                    f"dry friction that {name} changes",
                    equation,
                )


def _shaped_term(
    kind: Callable[[float], AbstractShape], of: str, unit: str, name: str, width: float
) -> AbstractTerm:
    return Terms(name, kind(width), of, unit=unit)


def _told_apart(candidates: Sequence[AnyCandidate]) -> list[AnyCandidate]:
    """Those of several equations by the equation's name, where two are called the same."""
    names = [one.name for one in candidates]
    found: list[AnyCandidate] = []
    for one in candidates:
        if names.count(one.name) > 1:
            one = renamed(one, f"{one.name}_{one.equation}")
        found.append(one)
    return found
