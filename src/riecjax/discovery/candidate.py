"""What a model may lack: terms that enter together, by a name, a meaning and units.

A candidate of a file, by its name: what a discovered model's file asks for.

What models of machines leave out most often: friction, springs, offsets, products of signals.
"""

import contextlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from riecjax.doubts.columns import STATES, Doubt
from riecjax.elements.catalogue import states_of_motion
from riecjax.equations.bases import AbstractShape, DeadZone, Saturation, Stribeck
from riecjax.equations.element import Element
from riecjax.equations.equation import Equation
from riecjax.equations.expressions import Expression, constant, even, odd, product, read_expression
from riecjax.equations.model import Model
from riecjax.equations.motions import Motion, is_slope, motions_and_unread, per
from riecjax.equations.term import AbstractTerm, Term, Terms
from riecjax.errors import ModelError, RiecjaxError, require
from riecjax.findings import Finding
from riecjax.models.catalogue import object_of_file
from riecjax.records.record import Record


@dataclass(frozen=True, eq=False)
class Candidate:
    """Terms that a model may lack, which enter it together or not at all.

    **Fields:**

    - `name` in tables, and `terms`, with signs as if they stood beside the inertia: the coefficient
      of what resists motion is positive. One coefficient is called like the candidate.
    - `meaning`, in words.
    - `equation`, the name of the one that it may belong to; the first by default.
    - `elements`, whose states its terms read and recordings lack.
    - `law`, the [`Shaped`][] one that it has a width of, that of this `number`; `None` without.

    **Raises:** `ModelError` without terms, or for what is no term.
    """

    name: str
    terms: tuple[AbstractTerm, ...]
    meaning: str = ""
    equation: str = ""
    elements: tuple[Element, ...] = ()
    law: "Shaped | None" = None
    number: int = 0

    def __post_init__(self):
        for term in self.terms:
            example = "rx.discovery.Candidate('drag', (rx.Term('drag', rx.odd('dx', 2)),))"
            require(f"{self.name}: a term", term, AbstractTerm, example)
        if not self.terms or not self.columns:
            raise ModelError(f"the candidate '{self.name}' has no term with a coefficient.")

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of its coefficients."""
        return tuple(name for term in self.terms for name in term.parameters)

    @property
    def family(self) -> str:
        """The name of its law, whatever the width."""
        return self.name if self.law is None else self.law.name

    @property
    def width(self) -> float | None:
        """That of its law."""
        return None if self.law is None else float(self.law.widths[self.number])

    @property
    def settled(self) -> "Candidate":
        """The same by the name of its law, once the width is chosen."""
        return self if self.law is None else self.law.at(self.number, self.law.name)


@dataclass(frozen=True, eq=False)
class Shaped:
    """A law with a width, which the coefficients are not linear in: a candidate for each of some.

    **Fields:** `name`, `meaning`, `equation` as of a [`Candidate`][]; `build`, which makes the term
    of a name and a width; `widths` that are tried, in the `unit` of the signal; `of`, that signal;
    `remember`, of a law with a memory, which makes the element whose state the term reads.
    """

    name: str
    build: Callable[[str, float], AbstractTerm]
    widths: Float[np.ndarray, " widths"]
    of: str
    unit: str = ""
    meaning: str = ""
    equation: str = ""
    remember: Callable[[str, float], Element] | None = None

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of its coefficients once a width is chosen."""
        return self.at(0, self.name).columns

    def at(self, number: int, name: str = "") -> Candidate:
        """The candidate of one of the widths, by a name of that width or another one."""
        name, width = name or f"{self.name}@{number}", float(self.widths[number])
        elements = () if self.remember is None else (self.remember(name, width),)
        terms = (self.build(name, width),)
        return Candidate(name, terms, self.meaning, self.equation, elements, self, number)

    def closer(self, number: int) -> "Shaped":
        """The same for widths between the two beside one of them, which stays among them."""
        widths = self.widths
        centre = widths[number]
        low = widths[number - 1] if number else 0.5 * centre
        high = widths[number + 1] if number + 1 < widths.size else 1.5 * centre
        spread = np.linspace(low, high, widths.size)
        spread[np.argmin(np.abs(spread - centre))] = centre
        return replace(self, widths=spread)


AnyCandidate = Candidate | Shaped


def members(candidates: Iterable[AnyCandidate]) -> list[Candidate]:
    """Candidates as they are summed: of a law with a width one for each width."""
    return [
        each
        for one in candidates
        for each in (map(one.at, range(one.widths.size)) if isinstance(one, Shaped) else [one])
    ]


def as_candidates(given: object) -> list[AnyCandidate]:
    """What a user gives as candidates: these, or terms, each a candidate by itself.

    **Raises:** `ModelError` for anything else, and for two of one name.
    """
    listed: Sequence[object] = given if isinstance(given, list | tuple) else [given]
    found: list[Any] = [
        Candidate(" + ".join(one.parameters) or "a known term", (one,))
        if isinstance(one, AbstractTerm)
        else one
        for one in listed
    ]
    for candidate in found:
        example = "candidates=[rx.Term('drag', rx.odd('dx', 2))]"
        require("a candidate", candidate, (Candidate, Shaped), example)
    if not found:
        raise ModelError("no candidate is given: leave candidates out for the usual ones.")
    names = [one.name for one in found]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise ModelError(f"two candidates are called {', '.join(twice)}: give each its own name.")
    return found


def renamed(one: AnyCandidate, name: str) -> AnyCandidate:
    """The same by another name, and so a coefficient that is called like it."""
    if isinstance(one, Shaped):
        return replace(one, name=name)
    terms = tuple(
        t.with_fields(coefficient=name) if t.is_linear and t.name == one.name else t
        for t in one.terms
    )
    return replace(one, name=name, terms=terms)


def named(reference: str, name: str) -> Candidate:
    """The candidate of this name among those that `path/to/file.py:object` holds.

    **Raises:** `ModelError` if there is no such file, object or candidate, or it has a width.
    """
    for one in as_candidates(object_of_file(reference)):
        if one.name == name and isinstance(one, Candidate):
            return one
    raise ModelError(f"{reference} holds no candidate '{name}'.")


def lacked(model: Model, records: Sequence[Record]) -> list[Doubt]:
    """Of the usual candidates the terms without a width, and hysteresis of each, as doubts."""
    return [
        Doubt(
            one.columns[0],
            STATES if one.elements else "term",
            term=one.terms[0],
            equation=one.equation,
            meaning=one.meaning,
            elements=one.elements,
        )
        for one in members(default_candidates(model, records))
        if bool(one.elements) is (one.law is not None) and len(one.columns) == 1
    ]


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


def default_candidates(model: Model, records: Sequence[Record]) -> list[AnyCandidate]:
    """The usual candidates for each equation of a model.

    **Arguments:** `records`, which say what is recorded, in which units, and how far signals reach.
    """
    found: list[AnyCandidate] = []
    for name, equation, motions, unread, units in _motions(model, records):
        own: list[AnyCandidate] = [*_of_unread(unread, motions, equation.unit, units)]
        for motion in motions:
            after = f"_{motion.name}" if len(motions) > 1 else ""
            of_motion = _of_motion(motion, equation.unit, records)
            own += [renamed(one, one.name + after) for one in of_motion]
        own.append(of_term("offset", constant, equation.unit, "constant force"))
        for law in (law for law in states_of_motion() if not law.is_of_motion):
            state: Any = law
            state = state(state_name(law.kind))
            drift = of_term(law.kind, state_name(law.kind), per(equation.unit, "s"), law.words)
            own.append(replace(drift, elements=(state,)))
        found += [replace(one, equation=name) for one in own]
    # Those of several equations by the equation's name, where two are called the same.
    called = Counter(candidate.name for candidate in found)
    found = [renamed(c, f"{c.name}_{c.equation}") if called[c.name] > 1 else c for c in found]
    # Where the model has a coefficient of that name, under another one.
    taken = {*model.parameter_names}
    return [renamed(c, f"{c.name}_2") if taken & {*c.columns} else c for c in found]


def not_offered(model: Model, records: Sequence[Record]) -> list[Finding]:
    """Which of the usual kinds of candidates a model's motions have no signal for, and why."""
    found: dict[str, Finding] = {}
    motions = [(m, equation) for _, equation, those, *_ in _motions(model, records) for m in those]
    for motion, equation in motions:
        x, v = motion.position, motion.velocity
        if x in equation.accelerated and not v:
            recorded = records[0].arrays
            v = next((n for n in recorded if n != x and is_slope(records[0], x, n)), f"d{x}")
            found[x] = Finding(
                "not_offered",
                f"no velocity of {x} has a name in the model: dry friction, drag, hysteresis and "
                f"damping by position are not offered, and no hidden mode, which hysteresis "
                f"resembles. Write measured=('{v}',) in the term of the inertia: what is not "
                f"recorded is formed of {x}",
                (x,),
            )
        if v and not any(other.position for other, _ in motions):
            found[v] = Finding(
                "not_offered",
                f"no position belongs to {v}: springs, stops, forces that saturate and damping by "
                f"position are not offered. Record it",
                (v,),
            )
    return list(found.values())


def _motions(
    model: Model, records: Sequence[Record]
) -> Iterator[tuple[str, Equation, list[Motion], list[str], dict[str, str]]]:
    """The name of each equation, it, its motions, signals that none reads, and units of all."""
    units = {signal.name: signal.unit for signal in model.signals}
    for record in records:
        units |= {name: unit for name, unit in dict(record.units).items() if unit}
    recorded = set.intersection(*({*record.arrays} for record in records))
    # Signals that are recorded, and that no equation reads or knows as a derivative.
    signals = records[0].signals
    for term in (term for equation in model.equations for term in equation.terms):
        with contextlib.suppress(RiecjaxError):
            read_expression(term.of, signals)
    known = {name for e in model.equations for pair in e.derivatives for name in pair}
    known |= {*signals.read}
    # A term of a signal that misses samples which all others hold would take these from them.
    whole = [record.segments(signals.read) for record in records]
    unread = [
        name
        for name in records[0].arrays
        if name in recorded and name not in known
        if [record.segments([name, *signals.read]) for record in records] == whole
    ]
    names = (name for stage in model.equation_names for name in stage)
    for name, equation in zip(names, model.equations, strict=True):
        motions, others = motions_and_unread(equation, records[0], recorded, units, unread)
        yield name, equation, motions, others, units


def of_term(name: str, of: Expression, unit: str, meaning: str, **term: Any) -> Candidate:
    """A candidate of one term, whose coefficient is called like it."""
    return Candidate(name, (Term(name, of, unit=unit, **term),), meaning)


def _of_motion(motion: Motion, force: str, records: Sequence[Record]) -> Iterator[AnyCandidate]:
    x, v, unit = motion.position, motion.velocity, motion.unit
    speed, slope = f"{unit}/s" if unit else "", per(force, unit)

    def powers(
        listed: Sequence[tuple[str, int, bool, str]], of: str, of_unit: str
    ) -> Iterator[Candidate]:
        for name, p, is_odd, meaning in listed:
            expression = (odd if is_odd else even)(of, p)
            yield of_term(name, expression, per(force, of_unit, p) if p else force, meaning)

    def shaped(
        kind: Callable[[float], AbstractShape], name: str, of: str, of_unit: str, meaning: str,
        coefficient: str, quantiles: Sequence[float],
    ) -> Shaped:  # fmt: skip
        size = np.concatenate([np.abs(np.asarray(record.arrays[of])) for record in records])
        widths = np.quantile(size[np.isfinite(size)], quantiles)
        least = 1e-3 * float(widths[-1]) or 1.0
        widths = np.maximum.accumulate(np.maximum(widths, least * np.arange(1, widths.size + 1)))

        return Shaped(
            name,
            lambda name, width: Terms(name, kind(width), of, unit=coefficient),
            widths,
            of,
            of_unit,
            meaning,
        )

    if v or x:
        derivative = {"derivative": 1, "measured": (v,) if v else ()} if x else {}
        yield of_term("viscous", x or v, per(force, speed), "viscous friction", **derivative)
    if v:
        yield from powers(FRICTION, v, speed)
        for law in (law for law in states_of_motion() if law.is_of_motion):
            yield Shaped(
                law.kind,
                lambda name, _: Term(name, state_name(name), unit=force),
                law.widths(v, records),
                v,
                unit,
                law.words,
                remember=lambda name, width, law=law: law(state_name(name), v, width),
            )
        yield shaped(Stribeck, "stribeck", v, speed, "Stribeck friction", force, SPEEDS)
        limited, damping = "friction that saturates", per(force, speed)
        yield shaped(Saturation, "limited_friction", v, speed, limited, damping, LIMITS)
    if x:
        yield of_term("stiffness", x, slope, "linear stiffness")
        yield from powers(STIFFNESS, x, unit)
        beyond, limited = "spring beyond a width, as of stops", "force that saturates"
        yield shaped(DeadZone, "dead_zone", x, unit, beyond, slope, WIDTHS)
        yield shaped(Saturation, "saturation", x, unit, limited, slope, WIDTHS)
    if x and v:
        yield of_term("product", product(x, v), per(slope, speed), "damping by position")


def state_name(name: str) -> str:
    """What the state of a law with a memory is called as a signal."""
    return f"{name}_state"


def _of_unread(
    unread: Sequence[str], motions: Sequence[Motion], force: str, units: Mapping[str, str]
) -> Iterator[Candidate]:
    """What a signal does that is recorded and not read: by itself, and to friction."""
    for name in unread:
        unit = units.get(name, "")
        own, follows = per(force, unit), f"force that follows {name}"
        yield of_term(f"signal_{name}", name, own, follows)
        for v, speed in ((m.velocity, f"{m.unit}/s" if m.unit else "") for m in motions):
            after = f"{name}_{v}" if len(motions) > 1 else name
            if v:
                by, damping = product(name, v), f"damping that {name} changes"
                yield of_term(f"viscous_by_{after}", by, per(own, speed), damping)
                by, friction = product(name, odd(v, 0)), f"dry friction that {name} changes"
                yield of_term(f"coulomb_by_{after}", by, own, friction)
