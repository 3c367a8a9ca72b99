"""Backlash: play between two sides that a spring couples, as of gears.

Across a play of width b a spring k carries nothing until the twist x between both sides has taken
up half of it:

    f = k (x - clip(x, -b/2, b/2)).

With both sides recorded, each width makes a column of its own, in which the equation is linear. The
sums hold those of a ladder of widths, and a width between two steps has a combination of the four
columns around it, whose products with others are those of its own to third order in the steps. So
the width is searched as any shape is, once the sums are there.

From one side alone the twist is not known, and the width is refined by simulation.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Float

from riecjax import arrays as xp
from riecjax.arrays import Array
from riecjax.charts import BLUE, GREY, RUST, Axis, Level, Line, Panel, labelled
from riecjax.elements.evidence import Evidence, Held
from riecjax.equations.bases import AbstractBasis, beyond
from riecjax.equations.element import Attached, Band, Element, Shape, Values, require_near
from riecjax.equations.equation import Equation
from riecjax.equations.expressions import evaluate
from riecjax.equations.quantity import Quantity
from riecjax.equations.term import AbstractTerm
from riecjax.errors import ModelError, require
from riecjax.findings import Finding
from riecjax.leaves import Leaf, finite, told
from riecjax.records.record import Record

WIDTHS = 24
"""Steps of the ladder."""
AROUND = 2.0
"""Ratio to a given width within which others are searched."""
NARROWEST = 0.1
"""Play that is searched, as a share of the twist's rms."""
ENGAGED = 0.99
"""Share of the time that the twist may be within the widest."""
NO_LADDER = (
    "which widths of play are searched depends on the recordings: take model.for_records(records), "
    "or say near which one, rx.Backlash('k', 0.01)."
)
TWIST_UNITS = {"N/m": "m", "N m/rad": "rad"}
"""Unit of the play by that of the spring."""


class Backlash(Element):
    """Play in series with a spring, whose force is nothing within it.

    The whole width of the play, `play`, of a second one `play_2`, is a parameter of every equation
    that holds the spring. It is found by [`identify`][riecjax.identify] where the motion of both
    sides was recorded, else by [`refine`][riecjax.refine], started from a width that is not zero.

    **Arguments:** `of`, the name of the spring's coefficient, of a term that reads the twist;
    `near`, a width near which to look: by default all are searched from a tenth of the twist's rms
    to what the twist leaves in 1 % of the time, `ends` that `model.for_records(records)` sets.

    **Raises:** `ModelError` for a width that is not positive.
    """

    of: str = eqx.field(static=True)
    near: float | None = eqx.field(static=True, default=None)  # pyright: ignore
    ends: tuple[float, float] | None = eqx.field(static=True, kw_only=True, default=None)
    kind: ClassVar = "backlash"
    words: ClassVar = "the backlash"
    coordinates: ClassVar = 1
    test: ClassVar = "backlash"
    is_discovered: ClassVar = True

    def __check_init__(self):
        require("what play is in series with", self.of, str, "rx.Backlash(of='k')")
        require_near("a play's width", self.near, "")

    @classmethod
    def at(cls, place: str, near: float | None = None) -> "Backlash":
        """In series with the spring of a coefficient, near a width."""
        return cls(place, near)

    @classmethod
    def places(cls, equation: Equation, equations: Sequence[Equation]) -> tuple[str, ...]:
        """Coefficients of an equation's springs."""
        springs = (t for t in equation.terms if t.is_linear and not t.derivative)
        return tuple(str(t.name) for t in springs if t.parameters and t.unit in TWIST_UNITS)

    def found_near(self, values: Values) -> "Backlash":
        """The play, near the width that these values have."""
        return Backlash(self.of, float(f"{float(values[self.hidden[0]]):.4g}"))

    @property
    def described(self) -> str:
        """`play in series with k`."""
        near = "" if self.near is None else f" near {self.near:g}"
        return f"play in series with {self.of}{near}"

    def require(self, equations: Sequence[Equation], others: Sequence[Element]) -> None:
        """Raise `ModelError` for what is no one spring, or has play already."""
        terms = [term for e in equations if (term := self.term_in(e)) is not None]
        if not terms:
            names = dict.fromkeys(name for equation in equations for name in equation.parameters)
            raise ModelError(
                f"no equation has a coefficient '{self.of}' that play could be in series with; "
                f"there are: {', '.join(names)}."
            )
        if any(type(other) is type(self) and other.place == self.of for other in others):
            raise ModelError(f"'{self.of}' has play in series already.")
        if any(not term.is_linear or term.derivative for term in terms):
            raise ModelError(
                f"play is in series with a spring, a coefficient times a twist: the term of "
                f"'{self.of}' is none."
            )
        if any(other.linear == self.of for other in others if other.coordinates):
            raise ModelError(f"'{self.of}' has another element in series: leave one of both out.")

    def require_known(self, given: Values) -> None:
        """Raise `ModelError` for a width that the ladder does not hold."""
        width = given.get(self.hidden[0])
        if width is None or not xp.is_concrete(width):
            return
        low, high = self.reach
        if not low <= width <= high:
            raise ModelError(
                f"{self.hidden[0]} is held at {float(width):g}, and the widths that these "
                f"recordings tell of are {float(low):.4g} to {float(high):.4g}: leave the "
                f"backlash out where there is none, or say near which width it is."
            )

    @property
    def linear(self) -> str:
        """The spring."""
        return self.of

    @property
    def hidden(self) -> tuple[str, ...]:
        """The width."""
        return (self.named("play"),)

    @property
    def parameters(self) -> tuple[str, ...]:
        """The spring and the width."""
        return self.of, *self.hidden

    def quantities(self, equations: Sequence[Equation]) -> list[Quantity]:
        """The width, in a unit by the spring's."""
        named = [e.units[self.of] for e in equations if self.of in e.units]
        unit = TWIST_UNITS.get(named[0], "") if named else ""
        (name,) = self.hidden
        return [Quantity(name, unit, f"whole width of the play in series with {self.of}")]

    def for_records(self, records: Sequence[Record], equations: Sequence[Equation]) -> "Backlash":
        """With the ends of the ladder by the twist, unless a width is given.

        **Raises:** `DataError` for a record that lacks a side; `ModelError` under a trace.
        """
        if self.near is not None or self.ends is not None:
            return self
        if not xp.is_concrete(list(records)):
            raise ModelError(NO_LADDER)
        term = next(term for e in equations if (term := self.term_in(e)) is not None)
        twist = np.concatenate([np.abs(evaluate(term.of, one).with_nan) for one in records])
        size = float(np.sqrt(np.nanmean(twist**2))) or 1.0
        widest = 2 * float(np.nanquantile(twist, ENGAGED)) or size
        return replace(self, ends=(NARROWEST * size, widest))

    @property
    def ladder(self) -> Float[np.ndarray, " widths"]:
        """Widths in equal ratios, one beyond either end.

        **Raises:** `ModelError` where nothing says which ends.
        """
        ends = self.ends if self.near is None else (self.near / AROUND, self.near * AROUND)
        if ends is None:
            raise ModelError(NO_LADDER)
        low, high = ends
        step = (high / low) ** (1 / (WIDTHS - 3))
        return np.geomspace(low / step, high * step, WIDTHS)

    @property
    def reach(self) -> tuple[float, float]:
        """The narrowest and the widest that have both neighbours."""
        ladder = self.ladder
        return float(ladder[1]), float(ladder[-2])

    def columns(self, term: AbstractTerm) -> tuple[AbstractTerm, ...]:
        """The spring without play, and behind each play of the ladder."""
        widths = np.array([0.0, *self.ladder])
        names = tuple(map(self._column, range(len(widths))))
        return (Slack.of_term(term, names, widths),)

    def _column(self, number: int) -> str:
        return f"{self.of} behind play {number}"

    def shape(self, values: Values) -> Shape:
        """Of the width."""
        return self.shape_at(xp.log(values[self.hidden[0]])[None])

    def shape_at(self, at: Float[Array, "1"] | None) -> Shape:
        """Of the width's logarithm; `None`: no play."""
        if at is None:
            return Shape.weighing(np.eye(1 + WIDTHS)[0])
        # By cubic convolution (Keys 1981) of the ladder, whose steps are equal in the logarithm:
        # smooth, and of third order in them, as the products of columns are smooth in the width.
        steps = np.log(self.ladder)
        # Beyond the ladder its ends, with their slope.
        place = xp.stop_gradient(xp.real(at))
        at = at - place + xp.clip(place, steps[1], steps[-2])
        apart = (at - steps) / (steps[1] - steps[0])
        far = apart * xp.sign(xp.real(apart))
        near = (1.5 * far - 2.5) * far**2 + 1
        next_to = ((-0.5 * far + 2.5) * far - 4) * far + 2
        places = xp.real(far)
        weights = xp.where(places < 1, near, xp.where(places < 2, next_to, 0.0))
        return Shape.weighing(xp.concatenate([xp.zeros_like(at), weights], axis=-1))

    def values_at(self, at: Float[Array, "1"], values: Values) -> dict[str, Array]:
        """The width."""
        return {self.hidden[0]: xp.exp(at[..., 0])}

    def is_possible(self, at: Float[Array, "1"]) -> Any:
        """Whether it lies on the ladder, where the convolution has both neighbours."""
        low, high = np.log(self.reach)
        return (at[0] >= low) & (at[0] <= high)

    def band(self, longest: Leaf, step: Leaf) -> Band:
        """Widths of the ladder that have both neighbours."""
        low, high = self.reach
        return np.asarray(low), np.asarray(high)

    def moved(self, equation: Equation, values: Values, following: Any) -> Equation:
        """The equation with its spring behind this play."""
        width = values[self.hidden[0]]
        return self._replaced(equation, (self.of,), width[None])

    def attached(self, equations: tuple[Equation, ...]) -> Attached:
        """The equations with the spring behind a play that is a parameter."""
        return Attached(tuple(self._replaced(each, self.parameters) for each in equations))

    def _replaced(
        self, equation: Equation, names: tuple[str, ...], widths: Leaf | None = None
    ) -> Equation:
        terms = (
            Slack.of_term(term, names, widths) if self.of in term.parameters else term
            for term in equation.terms
        )
        return equation.of_terms(*terms)

    def evidence(self, held: Held) -> "BacklashEvidence":
        """What speaks for the play, and what others in its place would leave."""
        stage, others = held.last()
        (logs,) = self.axes(held.band, held.stage.grid)
        shapes = np.stack([*(np.full(logs.shape, x) for x in others), logs], axis=-1)
        name, (width,) = self.hidden[0], np.sqrt(np.diagonal(held.covariance))
        springs = [e.equation.units.get(self._column(0), "") for e in stage.equations]
        low, high = self.reach
        # From its end no smaller play is told from none; any other end is one of what was searched.
        ended = held.values[name] >= high or (self.near is not None and held.values[name] <= low)
        concerned = (n for e in stage.equations for n in e.all_parameters)
        return BacklashEvidence(
            *held.shared(),
            of=self.of,
            width=(float(held.values[name]), float(width)),
            widths=np.exp(logs),
            left=np.asarray(stage.shares(shapes)[0]),
            unit=TWIST_UNITS.get(max(springs), ""),
            beyond=tuple(dict.fromkeys(concerned)) if ended else (),
        )


class Plays(AbstractBasis):
    """What is beyond half of each of some widths, as functions of a twist."""

    widths: Leaf
    is_continuous: ClassVar[bool] = True

    @property
    def labels(self) -> tuple[str, ...]:
        """The numbers of the widths."""
        return tuple(map(str, range(len(self.widths))))

    def __call__(self, x: Float[Array, " n"]) -> Float[Array, "widths n"]:
        """x - clip(x, -width / 2, width / 2)."""
        return beyond(x[None], 0.5 * xp.asarray(self.widths)[:, None])


class Slack(AbstractTerm):
    """A spring behind play: a column for each width of its `basis`; without one the width is a
    parameter, the second after the spring."""

    names: tuple[str, ...] = eqx.field(static=True)

    @classmethod
    def of_term(
        cls, term: AbstractTerm, names: tuple[str, ...], widths: Leaf | None = None
    ) -> "Slack":
        """In place of a term."""
        basis = None if widths is None else Plays(widths)
        unit = "" if basis is None else str(term.unit)
        return cls(names, of=term.of, unit=unit, factor=term.factor, basis=basis)

    @property
    def parameters(self) -> tuple[str, ...]:
        """The names."""
        return self.names

    def force(self, values: Sequence[Array], x: Float[Array, " n"]) -> Float[Array, " n"]:
        """The spring times what is beyond half of the width."""
        if self.basis is not None:
            return super().force(values, x)
        stiffness, width = values
        return stiffness * beyond(x, 0.5 * xp.maximum(width, 0.0))


# It prints in words, which no named tuple can take from a base class.
@dataclass(frozen=True, eq=False, repr=False)
class BacklashEvidence(Evidence):
    """What speaks for play in series with the spring `of`.

    **Further fields:** the `width` with its standard error; the `widths` of a map, and the share
    `left` of the target by each, at the best stiffness; their `unit`;
    parameters of the stage, where the search led `beyond` the widths.
    """

    of: str
    width: tuple[float, float]
    widths: Float[np.ndarray, " widths"]
    left: Float[np.ndarray, " widths"]
    unit: str = ""
    beyond: tuple[str, ...] = ()
    test: ClassVar = "backlash"
    caption: ClassVar = (
        "The map of play: of each width that the play could have, the share of the target's energy "
        "that the equation then leaves, at the best stiffness."
    )

    @property
    def carried(self) -> bool:
        """Whether the recordings carry the play, and of a width that was searched."""
        return super().carried and not self.beyond

    def findings(self) -> list[Finding]:
        """That the recordings carry no play, where nothing speaks for it."""
        if self.beyond:
            return [
                Finding(
                    "element_not_carried",
                    f"{self.stage}: the search for the play in series with {self.of} ended at the "
                    f"end of the widths that were searched, {self.widths[0]:.3g} to "
                    f"{self.widths[-1]:.3g}: say near which other width it is, or leave it out.",
                    parameters=self.beyond,
                )
            ]
        if self.carried:
            return []
        return [
            Finding(
                "element_not_carried",
                f"{self.stage}: the recordings do not carry this play: "
                f"{self.held_out(f'play in series with {self.of}')} Leave it out.",
                parameters=self.parameters,
            )
        ]

    def entry(self) -> dict[str, Any]:
        """All of it, as plain data for JSON."""
        return {
            "of": self.of,
            "equation": self.stage,
            "parameters": list(self.parameters),
            "width": finite(self.width[0]),
            "width_std_error": finite(self.width[1]),
            "window_s": list(self.lengths),
            **told(self, "carried", "explained"),
            "held_out": self.shares(),
            "map": {"width": finite(self.widths), "unexplained": finite(self.left)},
        }

    def panel(self) -> Panel:
        """What each width leaves of its equation, and what is left without play."""
        marks = [
            Level(float(self.without), "y", "without play, on time left out", GREY),
            Line(self.widths, self.left, "with play of this width", RUST, markers=True),
            Level(self.width[0], "x", "the play found", BLUE, "dashed"),
        ]
        share = Axis(f"share of {self.stage} unexplained", log=True)
        return Panel(marks, Axis(labelled("width of the play", self.unit), log=True), share)
