"""What no term of an equation says, and the questions that the rest of the house asks of it.

An element is a part of the machine, or of its sensors, that equations leave out: a hidden mode, a
spring in series, play, hysteresis, the zero of a sensor, rests of dry friction. One class answers
for it wherever it matters: in the equations, in their sums, in a record, in a simulation, in what
is said of an answer. The engines ask and know no element by name.

**In the equations.** What terms can say becomes terms at once (`in_equation`).

**In their sums.** Of a *searched* element some parameters are not linear. It follows the motion by
a shape: polynomials N and D in s = d/dt, or functions of its signal. A force c a becomes

    c (sum_i w_i a_i) N / D,

with weights w_i of its own columns a_i, of which most have one, a itself. Multiplied by D the
equation is linear again in its coefficients theta, of known target y and columns a_j,

    D y = sum_j theta_j D a_j + c N sum_i w_i a_i,

with every term at higher derivatives, which a smooth test function takes off. Its columns for any
shape are combinations of the same few, so that one Gram matrix holds all (`expanded`). With several
elements D is the product of theirs, and each one's own columns have those of the others in front.

**In a simulation.** Further equations, and states that no recording need hold (`attached`).
"""

import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from typing import Any, ClassVar, NamedTuple, Self

import equinox as eqx
import numpy as np
from jaxtyping import Float

from riecjax import arrays as xp
from riecjax.arrays import Array
from riecjax.equations.equation import Equation
from riecjax.equations.expressions import Expression
from riecjax.equations.quantity import Quantity
from riecjax.equations.term import AbstractTerm, written
from riecjax.errors import ModelError
from riecjax.leaves import Leaf, PlainMethods, is_number
from riecjax.records.record import Record

SEARCHED = ("linear", "hidden", "shape", "shape_at", "values_at", "band", "moved", "attached")
"""What a class has to say that is searched."""
ROUGH = 14
"""Frequencies of a rough grid."""
Values = Mapping[str, Array]
Band = tuple[Leaf, Leaf]
"""Between which two an element is looked for: frequencies in hertz, or widths."""


class Shape(NamedTuple):
    """How an element follows the motion, for given values of what is not linear.

    **Fields:** coefficients of the polynomials N and D in s, lowest first, the `numerator` filled
    up with zeros to the length of the `denominator`; the `weights` of its columns.
    """

    numerator: Float[Array, "*shapes powers"]
    denominator: Float[Array, "*shapes powers"]
    weights: Float[Array, "*shapes columns"]

    @classmethod
    def filtering(cls, *denominator: Array, numerator: Sequence[Array] = ()) -> "Shape":
        """N / D, with 1 for the lowest coefficients, of one column."""
        one = xp.ones_like(denominator[0])
        above = (*numerator, *(xp.zeros_like(one) for _ in denominator[len(numerator) :]))
        above, below = (xp.stack([one, *rest], axis=-1) for rest in (above, denominator))
        return cls(above, below, one[..., None])

    @classmethod
    def weighing(cls, weights: Float[Array, "*shapes columns"]) -> "Shape":
        """N = D = 1, and these weights."""
        one = xp.ones_like(weights[..., :1])
        return cls(one, one, weights)

    @property
    def decay(self) -> Array:
        """Seconds in which what is free falls to 1 / e, by exp(-t / tau) or exp(-q t / (2 p))."""
        _, *above = self.denominator
        if len(above) < 2:
            return above[0] if above else np.zeros(())
        q, p = above
        return xp.where(q > 0, 2 * p / xp.where(q > 0, q, 1.0), xp.inf)


class CarriedState(eqx.Module):
    """A state that an element adds to a simulation, which no recording need hold.

    **Fields:** `name`, `unit`; the signal that it `follows` at rest, if it does; a `term` whose
    expression and derivative [`CarriedState.rate`][] is given, if it says how the state changes.
    """

    name: str = eqx.field(static=True)
    unit: str = eqx.field(static=True, default="")
    follows: str = eqx.field(static=True, default="")
    term: AbstractTerm | None = None

    def rate(self, signals: Values, values: Values, read: Array) -> Array:
        """The state's time derivative, of a class that has a `term`.

        **Arguments:** `values` of parameters; `read`, what the term's expression is.
        """
        raise NotImplementedError

    def at_rest(self, signals: Values, values: Values) -> dict[str, Array]:
        """The state's own level at rest by its name, as far as these samples tell it."""
        return {self.name: signals[self.follows]} if self.follows in signals else {}

    def why_not(self, values: Values) -> str:
        """Why it cannot be simulated with these values; empty where it can."""
        return ""


class Told(NamedTuple):
    """What is told of a cause: its code, what it is, and what to do about it, in a sentence, by
    options and in few words."""

    code: str
    what: str
    then: str = ""
    remedy: tuple[str, ...] = ()
    step: str = ""


class Absence(NamedTuple):
    """How an answer itself tells that an element may not be there.

    **Fields:** `code` and `message` of the finding, with `{name}` and `{away}`, where a hidden
    parameter lies fewer standard errors than `least` away from none.
    """

    code: str
    least: float
    message: str


class Part(NamedTuple):
    """Of which element a parameter is one: in `words`, the `option` that adds it, its
    `absence`."""

    words: str
    option: str
    absence: Absence | None = None


class Attached(NamedTuple):
    """Equations with an element written out, `rates` of states that none of them has, and the
    `states` that they gain."""

    equations: tuple[Equation, ...]
    rates: Mapping[str, Expression] = {}
    states: tuple[CarriedState, ...] = ()


class Element(PlainMethods, eqx.Module):
    """Something of a machine that no term of its equations says; every answer here is "nothing".

    A class of your own has what it acts on for its first field, names its parameters, and answers
    what concerns it: terms by [`Element.in_equation`][], or a search by `coordinates` and
    `shape_at`, a simulation by [`Element.attached`][], a record by [`Element.with_states`][]. It is
    added by `model.with_elements(...)`, on the command line by `--add FILE.py:CLASS:SIGNAL`, or
    under a kind of its own by an entry point in the group `riecjax.elements`.

    **Fields:** `number` among those of its class in a model, from 0, which the model gives it.
    """

    number: int | None = eqx.field(static=True, kw_only=True, default=None)

    kind: ClassVar[str] = ""
    """What `--add KIND:SIGNAL` calls it."""
    words: ClassVar[str] = "the element"
    meaning: ClassVar[str] = ""
    """Of coefficients that it adds to the equations."""
    order: ClassVar[int] = 0
    """Of the polynomial D."""
    coordinates: ClassVar[int] = 0
    """Of a shape that is searched; 0 where all parameters are linear, or none is."""
    test: ClassVar[str] = ""
    """Name of the test of an answer that its evidence makes; empty where there is none."""
    absence: ClassVar[Absence | None] = None

    # What it is.

    @classmethod
    def at(cls, place: str, near: float | None = None) -> Self:
        """The element of a place, as `--add` names it: a signal, or a coefficient.

        **Raises:** `ModelError` for a number that it is to be near, of a class that takes none.
        """
        if near is not None:
            raise ModelError(f"{cls.kind}:{place} is near nothing: leave out ={near:g}.")
        made: Any = cls
        return made(place)

    @classmethod
    def option(cls) -> str:
        """How the command line adds one."""
        return f"--add {cls.kind}"

    @property
    def asked(self) -> tuple[str, str]:
        """Options of the command line that add this one."""
        option = self.option()
        kind = option.removeprefix("--add ")
        return (option, self.place) if kind == option else ("--add", f"{kind}:{self.place}")

    @property
    def part(self) -> Part:
        """What is said of its parameters."""
        return Part(self.words, self.option(), self.absence)

    @property
    def place(self) -> str:
        """What it acts on: its first field."""
        own = (field.name for field in fields(self) if field.name != "number")
        return getattr(self, next(own))

    @property
    def near(self) -> float | None:
        """Near which frequency, or width, to look; `None` for everywhere."""
        return None

    @property
    def described(self) -> str:
        """What it is and where, in words."""
        return f"{self.words.replace('the ', 'a ', 1)} of {self.place}"

    def named(self, part: str) -> str:
        """A parameter's name: `part`, of a second element `part_2`."""
        return f"{part}_{self.number + 1}" if self.number else part

    @property
    def source(self) -> str:
        """As it is written after `import riecjax as rx`, of a class with a public name there."""
        own = (field for field in fields(self) if field.name != "number")
        given = ((getattr(self, field.name), field.default) for field in own)
        words = [written(value) for value, default in given if value != default]
        return f"rx.{type(self).__name__}({', '.join(words)})"

    # What a model may lack.

    is_discovered: ClassVar[bool] = False
    """Whether `discover` tries one beside terms, which costs an estimate for each place."""
    is_like_hysteresis: ClassVar[bool] = False
    """Whether what is left of hysteresis looks like it: it is tried only where that is offered."""

    @classmethod
    def places(cls, equation: Equation, equations: Sequence[Equation]) -> tuple[str, ...]:
        """Where an equation, one of all these, may have one."""
        return ()

    @classmethod
    def suggested(
        cls, equation: Equation, equations: Sequence[Equation], others: "Sequence[Element]"
    ) -> "Element | None":
        """The element of this class that an equation, one of all these, may lack beside others."""
        return None

    is_doubted: ClassVar[bool] = False
    """Whether what a model leaves is weighed against one that it may lack."""

    def rough_axes(self, slowest: float, fastest: float) -> list[Float[np.ndarray, " axis"]]:
        """A grid of shapes that may be lacked between two frequencies in hertz: of positive
        numbers, one or two, in about equal ratios, the first a frequency."""
        return [np.geomspace(slowest, fastest, ROUGH)]

    def rough_shape(self, at: tuple[float, ...]) -> Shape:
        """The shape at a point of that grid."""
        return self.shape_at(np.log(at))

    def lacked_at(self, at: tuple[float, ...]) -> str:
        """In words, such an element with the shape at a point of that grid."""
        return f"{self.described} near {at[0]:.3g} Hz"

    def as_cause(self, equation: str, at: tuple[float, ...], size: float, unit: str = "") -> Told:
        """What is told of it where a model lacks it.

        **Arguments:** `at`, the point of that grid; `size` of its linear parameter, or of the
        coefficient of its state; `unit` of a displacement, of what has a width.
        """
        remedy = self.asked
        then = f"{self.to_find} (on the command line: {shlex.join(remedy)})."
        what = f"{equation}: what the model leaves is {self.lacked_at(at)}"
        return Told("unmodelled_mode", what, then, remedy, self.to_find)

    @property
    def to_find(self) -> str:
        """What to do to find it, in words."""
        return f"Find {self.words} of {self.place}, which the model leaves out"

    @property
    def hidden(self) -> tuple[str, ...]:
        """Names of its parameters that are no coefficient of the equations."""
        return ()

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of all that its shape and size depend on."""
        return self.hidden

    def quantities(self, equations: Sequence[Equation]) -> list[Quantity]:
        """The hidden parameters, with units by the equations' own."""
        return []

    def require_whole(self) -> None:
        """Raise `ModelError` where a class that is searched leaves one of `SEARCHED` open."""
        kind = type(self)
        if self.coordinates and (
            lacking := [name for name in SEARCHED if getattr(kind, name) is getattr(Element, name)]
        ):
            raise ModelError(
                f"{kind.__name__} is searched, and has to say {', '.join(lacking)}; see rx.Element."
            )

    @property
    def is_of_equations(self) -> bool:
        """Whether it has to be in some equation: it makes nothing of a record by itself, and no
        state of a simulation."""
        kind, alone = type(self), ("with_states", "trusted", "findings", "attached")
        return all(getattr(kind, name) is getattr(Element, name) for name in alone)

    def require(self, equations: Sequence[Equation], others: "Sequence[Element]") -> None:
        """Raise `ModelError` where such equations cannot have it, beside these others."""

    def require_linear(self, equations: Sequence[Equation]) -> None:
        """Raise `ModelError` where sums do not tell of it: it is refined, or its term no column."""
        if not self.coordinates:
            raise ModelError(
                f"{self.words} is not linear in {', '.join(self.hidden)}: identify the model "
                f"without, and refine it from there, in Python: rx.refine(model, record, "
                f"{{**estimate.values, '{self.hidden[0]}': 1.0}}, rx.OutputError())."
            )

    def require_known(self, given: Values) -> None:
        """Raise `ModelError` where these given values leave a part of it open."""

    # What it makes of equations and records.

    def in_equation(self, equation: Equation, units: Mapping[str, str]) -> Equation:
        """The equation with what terms can say of it.

        **Arguments:** `units` of signals, as far as the model says them.
        """
        return equation

    def with_states(self, record: Record) -> Record:
        """The record with the signals of it that recordings lack."""
        return record

    def for_records(self, records: Sequence[Record], equations: Sequence[Equation]) -> Self:
        """The element with what is left open set as these records suggest (not under jit)."""
        return self

    def trusted(self, model: Any, record: Record) -> Any:
        """The [`Model`][riecjax.Model] as it holds where the element lets this record be
        trusted."""
        return model

    def findings(
        self, model: Any, records: Sequence[Record], found: Any, otherwise: Callable[[Any], Any]
    ) -> list[Any]:
        """What is to be said of records beside an estimate that was `found`.

        **Arguments:** `otherwise`, makes the estimate by another model.
        """
        return []

    # How a searched element is found.

    def term_in(self, equation: Equation) -> AbstractTerm | None:
        """The term of an equation that it acts on, if there is one."""
        return next((term for term in equation.terms if self.place in term.parameters), None)

    @property
    def linear(self) -> str:
        """The parameter that its force is proportional to, for a given shape."""
        raise NotImplementedError

    @property
    def judged(self) -> tuple[str, ...]:
        """Parameters that are positive, and sure, where such an element is found."""
        return self.hidden

    def doubted(self, values: Values, band: Band) -> Float[Array, " judged"]:
        """Errors of what is judged that count as one: its values."""
        return xp.stack([values[name] for name in self.judged])

    def columns(self, term: AbstractTerm) -> tuple[AbstractTerm, ...]:
        """Terms of columns that stand for its term in the sums, by default that one."""
        return (term,)

    def shape(self, values: Values) -> Shape:
        """The shape with these values.

        Its derivatives are taken by an imaginary step: compare `xp.real(...)` and leave out what
        takes sizes, such as `abs`.
        """
        raise NotImplementedError

    def shape_at(self, at: Float[Array, " coordinates"] | None) -> Shape:
        """The shape of coordinates, with any leading axes; `None`: as if it were not there."""
        raise NotImplementedError

    def found_near(self, values: Values) -> Self:
        """The same, to be looked for near where these values have it."""
        return self

    @property
    def fastest(self) -> float:
        """Up to which frequency in hertz it is looked for, if that was asked."""
        return 0.0

    def values_at(self, at: Float[Array, " coordinates"], values: Values) -> dict[str, Array]:
        """Hidden parameters of the shape there, `linear` being among the values."""
        raise NotImplementedError

    def is_possible(self, at: Float[Array, " coordinates"]) -> Any:
        """Whether such an element can be there."""
        return True

    def axes(self, band: Band, count: int) -> list[Float[Array, " grid"]]:
        """The grid that is searched, an array for each coordinate, the first of this length."""
        return [xp.linspace(*(xp.log(end) for end in band), count)]

    def band(self, longest: Leaf, step: Leaf) -> Band:
        """Where to look by default, in windows up to a length and at this time step, in seconds."""
        raise NotImplementedError

    def moved(
        self, equation: Equation, values: Values, following: Callable[..., list[str]]
    ) -> Equation:
        """The equation without it, reading what it does as signals.

        **Arguments:** `following`, makes signals of a term's expression, and of its recorded
        derivatives, behind this shape, given the term and a label; returns their names.
        """
        raise NotImplementedError

    def evidence(self, held: Any) -> Any:
        """What speaks for it, of a class with a `test`; see
        [`Held`][riecjax.elements.Held]."""
        raise NotImplementedError

    # How it moves.

    def attached(self, equations: tuple[Equation, ...]) -> Attached:
        """What a simulation solves: the equations with it written out, and its states."""
        return Attached(equations)


def require_near(what: str, near: Any, unit: str) -> None:
    """Raise `ModelError` unless this is `None` or a positive number."""
    if near is not None and not (is_number(near) and np.isfinite(near) and near > 0):
        raise ModelError(f"{what} is a positive number{unit}; got {near!r}.")
