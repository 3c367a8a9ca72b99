"""Oscillators that an equation leaves out, and what speaks for them.

A mass M on a spring K and a damper B, carried by a body with velocity v, adds to the body's
equation of motion the force that moves the mass,

    M (1 + q s) / D v',    D = 1 + q s + p s^2,    q = B / K,  p = M / K,

s standing for d/dt. The state of the mass is not recorded. D is 1 at rest, so that the equation
keeps its unit, and for a stiff mode it is the equation as it was: M then joins the body's mass.
"""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float

from riecjax import arrays as xp
from riecjax.arrays import Array
from riecjax.charts import BLUE, GREY, RUST, Axis, Level, Line, Panel
from riecjax.elements.evidence import LITTLE, Evidence, Held
from riecjax.equations.element import (
    Attached,
    Band,
    CarriedState,
    Element,
    Shape,
    Told,
    Values,
    require_near,
)
from riecjax.equations.equation import Equation
from riecjax.equations.expanded import inertia_sign
from riecjax.equations.expressions import difference
from riecjax.equations.quantity import Quantity
from riecjax.equations.term import AbstractTerm, Term
from riecjax.errors import ModelError, require
from riecjax.findings import Finding
from riecjax.leaves import Leaf, finite, told

DAMPINGS = (0.02, 0.06, 0.15, 0.35, 0.8)
"""Damping ratios of the grid."""
ROUGH_DAMPINGS = (0.02, 0.1, 0.4)
"""Damping ratios of a rough grid."""
AROUND = 1.5
"""Ratio to a given frequency up to which a mode is looked for."""
ZOOMS = 6
"""Times that a map looks for its damping at half the distance: then it knows it to a percent."""
LEAST = 1e-5
"""Share of the target that is left of any equation by integration between samples."""
NEAR = 2**0.5
"""Ratio of frequencies up to which a mode is near another frequency: half an octave."""
LOWEST = 0.3
"""Where nothing is left, beside the least that is, on a logarithmic axis."""
STATE_UNITS = {"kg": ("m", "m/s"), "kg m^2": ("rad", "rad/s")}
"""Units of a mode's deflection and velocity by that of its mass."""
OTHER_UNITS = {"kg": ("N/m", "N s/m"), "kg m^2": ("N m/rad", "N m s/rad"), "": ("", "")}
"""Units of its stiffness and damping."""


class HiddenMode(Element):
    """An oscillator that a model leaves out, on the body whose velocity is named.

    Its mass `M_mode`, stiffness `K_mode` and damping `B_mode` are parameters of every equation that
    holds the derivative of that velocity; a further mode's end in `_2`, `_3`.

    **Arguments:** `on`, the signal: a velocity of which a term holds the first derivative, or a
    position of which one holds the second; `hz`, near which frequency in hertz to look, everywhere
    if it is not given.

    **Raises:** `ModelError` for a frequency that is not positive.
    """

    on: str = eqx.field(static=True)
    hz: float | None = eqx.field(static=True, default=None)
    kind: ClassVar = "mode"
    words: ClassVar = "the hidden mode"
    order: ClassVar = 2
    coordinates: ClassVar = 2
    test: ClassVar = "modes"
    is_discovered: ClassVar = True
    is_like_hysteresis: ClassVar = True
    is_doubted: ClassVar = True

    def __check_init__(self):
        require("what a hidden mode is on", self.on, str, "rx.HiddenMode(on='x4'), a signal")
        require_near("a mode's frequency", self.hz, " of hertz")

    @classmethod
    def at(cls, place: str, near: float | None = None) -> "HiddenMode":
        """On the body of a signal, near a frequency."""
        return cls(place, near)

    @classmethod
    def option(cls) -> str:
        """`--add-mode`."""
        return "--add-mode"

    @classmethod
    def places(cls, equation: Equation, equations: Sequence[Equation]) -> tuple[str, ...]:
        """The bodies that an equation accelerates."""
        return equation.accelerated

    @classmethod
    def suggested(
        cls, equation: Equation, equations: Sequence[Equation], others: Sequence[Element]
    ) -> Element | None:
        """On the last body of an equation in which no mode is."""
        bodies, modes = equation.accelerated, (e for e in others if isinstance(e, cls))
        if not bodies or any(mode.term_in(equation) is not None for mode in modes):
            return None
        return cls(bodies[-1])

    @property
    def to_find(self) -> str:
        """What to do to find it, in words."""
        return f"Find the mode on {self.on} that the model leaves out"

    def rough_axes(self, slowest: float, fastest: float) -> list[Float[np.ndarray, " axis"]]:
        """Frequencies, and damping ratios."""
        return [*super().rough_axes(slowest, fastest), np.array(ROUGH_DAMPINGS)]

    def rough_shape(self, at: tuple[float, ...]) -> Shape:
        """That of a frequency and a damping ratio."""
        hertz, damping = at
        return self.shape_at(np.array([np.log(hertz), damping]))

    def lacked_at(self, at: tuple[float, ...]) -> str:
        """`a mode on x4 near 10.5 Hz`."""
        return f"a mode on {self.on} near {at[0]:.3g} Hz"

    def as_cause(self, equation: str, at: tuple[float, ...], size: float, unit: str = "") -> Told:
        """That what is left is its ringing."""
        hertz, damping = at
        remedy = ("--add-mode", f"{self.on}={hertz:.3g}")
        return Told(
            "unmodelled_mode",
            f"{equation}: what the model leaves is the ringing of {self.lacked_at(at)}, of a mass "
            f"of about {size:.3g} and a damping ratio of {damping:.2g}",
            f"Find it (on the command line: {shlex.join(remedy)}; rx.HiddenMode('{self.on}', "
            f"{hertz:.3g})).",
            remedy,
            self.to_find,
        )

    @property
    def near(self) -> float | None:
        """The frequency."""
        return self.hz

    @property
    def described(self) -> str:
        """`a hidden mode on x4 near 10 Hz`."""
        return f"a hidden mode on {self.on}" + ("" if self.hz is None else f" near {self.hz:g} Hz")

    def require(self, equations: Sequence[Equation], others: Sequence[Element]) -> None:
        """Raise `ModelError` unless some equation accelerates the body."""
        if not any(self.term_in(equation) is not None for equation in equations):
            raise ModelError(
                f"a hidden mode on '{self.on}' needs a term that accelerates it, such as "
                f"rx.Term('m', '{self.on}', derivative=1): no equation has one."
            )

    def require_known(self, given: Values) -> None:
        """Raise `ModelError` where of a mode something is known, and not all."""
        held = [name for name in self.parameters if name in given]
        if 0 < len(held) < len(self.parameters):
            raise ModelError(
                f"of a hidden mode all of {', '.join(self.parameters)} are known or none; got "
                f"{', '.join(held)}."
            )

    def term_in(self, equation: Equation) -> AbstractTerm | None:
        """The term of an equation that accelerates the body, if it has one."""
        return equation.inertia_of(self.on)

    @property
    def hidden(self) -> tuple[str, ...]:
        """Names of mass, stiffness and damping."""
        return tuple(self.named(f"{part}_mode") for part in "MKB")

    @property
    def linear(self) -> str:
        """The mass."""
        return self.hidden[0]

    @property
    def judged(self) -> tuple[str, ...]:
        """Mass and stiffness."""
        return self.hidden[:2]

    def shape(self, values: Values) -> Shape:
        """1 + q s over 1 + q s + p s^2 with these values."""
        mass, stiffness, damping = (values[name] for name in self.hidden)
        q = damping / stiffness
        return Shape.filtering(q, mass / stiffness, numerator=[q])

    def shape_at(self, at: Float[Array, "2"] | None) -> Shape:
        """Of the logarithm of the frequency in hertz and the damping ratio; `None`: rigid."""
        if at is None:
            none = np.zeros(())
            return Shape.filtering(none, none, numerator=[none])
        rate = 2 * np.pi * xp.exp(at[..., 0])
        q = 2 * at[..., 1] / rate
        return Shape.filtering(q, 1 / rate**2, numerator=[q])

    def values_at(self, at: Float[Array, "2"], values: Values) -> dict[str, Array]:
        """Stiffness and damping of the shape there, the mass being among the values."""
        _, q, p = xp.moveaxis(self.shape_at(at).denominator, -1, 0)
        mass, stiffness, damping = self.hidden
        found = values[mass] / p
        return {stiffness: found, damping: found * q}

    def is_possible(self, at: Float[Array, "2"]) -> Any:
        """Whether its damping is positive."""
        return at[1] > 0

    def axes(self, band: Band, count: int) -> list[Float[Array, " grid"]]:
        """Frequencies in equal ratios, and damping ratios."""
        return [*super().axes(band, count), np.array(DAMPINGS)]

    def band(self, longest: Leaf, step: Leaf) -> Band:
        """Hertz between which to look.

        **Raises:** `ModelError` for a frequency above what the sampling shows.
        """
        if self.hz is None:
            # From half a period of the longest window to where a period has a dozen samples.
            return 0.5 / longest, 1 / (8 * step)
        rate = 1 / step if xp.is_concrete(step) else np.inf
        if not self.hz < rate / 2:
            raise ModelError(
                f"no mode near {self.hz:g} Hz can be seen at {rate:g} samples a second: give one "
                f"below {rate / 2:g} Hz, or none."
            )
        return np.asarray(self.hz / AROUND), np.asarray(self.fastest)

    @property
    def fastest(self) -> float:
        """Half an octave and more above the frequency that is given."""
        return 0.0 if self.hz is None else AROUND * self.hz

    def quantities(self, equations: Sequence[Equation]) -> list[Quantity]:
        """The parameters, in units by the body's own."""
        terms = [term for e in equations if (term := self.term_in(e)) is not None]
        mass = next((str(term.unit) for term in terms if term.unit), "")
        others = OTHER_UNITS.get(mass, (f"{mass}/s^2", f"{mass}/s"))
        parts = zip(self.hidden, (mass, *others), ("mass", "stiffness", "damping"))
        words = f"of the hidden mode on {self.on}"
        return [Quantity(name, unit, f"{part} {words}") for name, unit, part in parts]

    def frequency(self, values: Values) -> tuple[Array, Array]:
        """Natural frequency in hertz and damping ratio of the mode on a body at rest."""
        mass, stiffness, damping = (values[name] for name in self.hidden)
        root = xp.sqrt(xp.abs(stiffness / mass))
        return root / (2 * np.pi), damping / (2 * mass * root)

    def found_near(self, values: Values) -> "HiddenMode":
        """The mode, near where these values have it."""
        return HiddenMode(self.on, float(f"{float(self.frequency(values)[0]):.4g}"))

    def moved(self, equation: Equation, values: Values, following: Any) -> Equation:
        """The equation with a term M w' of the mass's own motion w."""
        inertia = self.term_in(equation)
        if inertia is None:
            return equation
        of, *measured = following(inertia, f"of {self.linear}", self.shape(values))
        own = Term(self.linear, of, unit=inertia.unit, sign=inertia_sign(inertia))
        own = own.with_fields(derivative=inertia.derivative, measured=tuple(measured))
        return equation.of_terms(*equation.terms, own)

    def attached(self, equations: tuple[Equation, ...]) -> Attached:
        """The motion of the mode among some equations, for a simulation.

        With velocity v of the body, w of the mass, and deflection d, body minus mass,

            d' = v - w,    M w' = f,    f = K d + B (v - w),

        and every equation that accelerates the body gains f, with the sign of its inertia. No
        acceleration is in f. At rest the mass moves as its body does.
        """
        inertias = [self.term_in(equation) for equation in equations]
        inertia = next(term for term in inertias if term is not None)
        body = self.on
        if inertia.derivative != 1:
            terms = [t for e in equations for t in e.terms if t.of == inertia.of]
            named = (t for t in terms if t.derivative and t.measured)
            body = next((t.measured[0] for t in named), f"d{inertia.of}")
        mass, stiffness, damping = self.hidden
        deflection, velocity = (f"{self.named('mode')}_{s}" for s in ("deflection", "velocity"))
        stretching = difference(body, velocity)

        def force(sign: float | Leaf) -> tuple[Term, Term]:
            return Term(stiffness, deflection, sign=sign), Term(damping, stretching, sign=sign)

        loaded = (
            equation if t is None else equation.of_terms(*equation.terms, *force(inertia_sign(t)))
            for equation, t in zip(equations, inertias)
        )
        moved = Equation(Term(mass, velocity, derivative=1), *force(-1.0))
        units = STATE_UNITS.get(self.quantities(equations)[0].unit, ("", ""))
        states = CarriedState(deflection, units[0]), CarriedState(velocity, units[1], body)
        return Attached((*loaded, moved), {deflection: stretching}, states)

    def evidence(self, held: Held) -> "ModeEvidence":
        """What speaks for the mode, and a map of what others in its place would leave."""
        modes = [other for other in held.stage.sought if isinstance(other, HiddenMode)]
        # Modes that lie far from the frequency asked for, and the band that shows this one.
        strays = tuple(
            Stray(mode.hidden, mode.hz, at)
            for mode in modes
            for at in [float(mode.frequency(held.values)[0])]
            if mode.hz is not None and not mode.hz / NEAR <= at <= mode.hz * NEAR
        )
        low, high = held.band
        for stray in (stray for stray in strays if stray.parameters == self.hidden):
            low, high = np.minimum(low, stray.found / NEAR), np.maximum(high, stray.found * NEAR)
        mass, stiffness, damping = size = [float(held.values[name]) for name in self.hidden]
        # Frequency and damping ratio, with errors by their logarithms' slopes:
        # log f = (log K - log M) / 2 + ..., log zeta = log B - (log K + log M) / 2 + ...
        relative = held.covariance / np.outer(size, size)
        slopes = np.array([[-0.5, 0.5, 0.0], [-0.5, -0.5, 1.0]])
        errors = np.sqrt(np.einsum("ki,ij,kj->k", slopes, relative, slopes))
        frequency, ratio = (
            (float(value), abs(float(value)) * float(error))
            for value, error in zip(self.frequency(held.values), errors)
        )
        return ModeEvidence(
            *held.shared(),
            on=self.on,
            frequency=frequency,
            damping_ratio=ratio,
            oscillates=min(size) > 0 and damping**2 < 4 * mass * stiffness,
            map=mode_map(held, (low, high)),
            strays=strays,
        )


class Stray(NamedTuple):
    """A mode that the search has led away: its parameters, the frequency in hertz near which it was
    asked for, and that where it was found."""

    parameters: tuple[str, ...]
    asked: float
    found: float


class ModeMap(NamedTuple):
    """Shares of the target that modes of each frequency leave, at their best damping.

    **Fields:** `frequency` in hertz; `unexplained` share with a mode there, `without` one, both in
    the same windows; `damping` ratio; infinite where no mode of positive mass fits.
    """

    frequency: Float[Array, " frequencies"]
    unexplained: Float[Array, " frequencies"]
    without: Float[Array, " frequencies"]
    damping: Float[Array, " frequencies"]


def mode_map(held: Held, band: Band) -> ModeMap:
    """The map of the last mode that is sought, all else being where it is.

    Both shares are of the target D y. Of dampings of the grid alone they would step wherever the
    best of them changes: the map zooms in.
    """
    logs, stage, others = *held.element.axes(band, held.stage.grid)[:1], *held.last()
    count, middle = len(DAMPINGS), len(DAMPINGS) // 2

    def best(dampings: Float[Array, "frequencies dampings"]) -> tuple[Array, Array, Array]:
        shapes = [*others, xp.broadcast_to(logs[:, None], dampings.shape), dampings]
        left, without = stage.shares(xp.stack(xp.broadcast_arrays(*shapes), axis=-1))
        at = xp.argmin(left, axis=-1)[:, None]
        return tuple(
            xp.take_along_axis(each, at, axis=-1)[:, 0] for each in (left, without, dampings)
        )

    def closer(state: tuple[tuple[Array, Array, Array], Array]):
        found, width = state
        damping = found[-1][:, None]
        steps = np.linspace(-1.0, 1.0, count)[None]
        around = xp.clip(damping * xp.exp(width * steps), DAMPINGS[0], DAMPINGS[-1])
        # The middle is the best so far, up to rounding, so that none is lost.
        around = xp.where(np.arange(count)[None] == middle, damping, around)
        return best(around), width / 2

    dampings = np.array(DAMPINGS)
    widest = np.log(np.max(dampings[1:] / dampings[:-1])) / 2
    first = best(xp.broadcast_to(dampings[None], (len(logs), count)))
    found = xp.repeated(closer, (first, widest), ZOOMS, beside=(stage.moments, stage.given))[0]
    return ModeMap(xp.exp(logs), *found)


# It prints in words, which no named tuple can take from a base class.
@dataclass(frozen=True, eq=False, repr=False)
class ModeEvidence(Evidence):
    """What speaks for the last hidden mode of a stage.

    **Further fields:** the signal that it is `on`; natural `frequency` in hertz of the mass on a
    body at rest, and `damping_ratio`, each with its standard error; `oscillates`, whether mass,
    stiffness and damping are positive and the damping less than critical; `map`, what a mode of any
    frequency leaves, see [`ModeMap`][riecjax.elements.ModeMap]; `strays`, modes of the stage that
    the search has led farther than half an octave away from where they were asked for.
    """

    on: str
    frequency: tuple[float, float]
    damping_ratio: tuple[float, float]
    oscillates: bool
    map: ModeMap
    strays: tuple[Stray, ...] = ()
    test: ClassVar = "modes"
    figure: ClassVar = "mode_map"
    least: ClassVar = LEAST

    @property
    def carried(self) -> bool:
        """Whether the recordings carry the mode, and it is one."""
        return super().carried and self.oscillates

    def findings(self) -> list[Finding]:
        """Warnings if nothing speaks for the mode, or little, and of modes found elsewhere."""
        elsewhere = [
            Finding(
                "mode_elsewhere",
                f"{self.stage}: no mode near {asked:.4g} Hz: the search for {names[0]} ended at "
                f"{found:.3g} Hz. If the record carries both, ask for both (on the command line: "
                f"--add-mode {self.on}={asked:.4g} --add-mode {self.on}={found:.3g}).",
                parameters=names,
            )
            for names, asked, found in self.strays
        ]
        if self.carried:
            return elsewhere
        names = self.parameters
        first = names == HiddenMode(self.on).hidden
        close = "" if first else ", or cannot tell it from another that lies close"
        mode = f"the hidden mode on {self.on} ({names[0]})"
        message = (
            f"{self.stage}: the recordings do not carry this mode{close}: {self.held_out(mode)} "
            f"Leave it out; something else is missing, such as friction or a delay, or nothing."
        )
        if not self.oscillates and self.explained > LITTLE:
            message = (
                f"{self.stage}: what fits best in place of {mode} is no oscillator: its mass, "
                f"stiffness or damping is negative, or its damping more than critical. Leave it "
                f"out; something else is missing, such as a delay of one signal."
            )
        return [Finding("mode_not_carried", message, parameters=names), *elsewhere]

    def entry(self) -> dict[str, Any]:
        """All of it, as plain data for JSON."""
        return {
            "on": self.on,
            "equation": self.stage,
            "parameters": list(self.parameters),
            "frequency_hz": finite(self.frequency[0]),
            "frequency_std_error_hz": finite(self.frequency[1]),
            "damping_ratio": finite(self.damping_ratio[0]),
            "damping_ratio_std_error": finite(self.damping_ratio[1]),
            "window_s": list(self.lengths),
            "strays": [
                {"parameters": list(names), "asked_hz": asked, "found_hz": finite(found)}
                for names, asked, found in self.strays
            ],
            **told(self, "carried", "oscillates", "explained"),
            "held_out": self.shares(),
            "map": {
                "frequency_hz": finite(self.map.frequency),
                **told(self.map, "unexplained", "without"),
                "damping_ratio": finite(self.map.damping),
            },
        }

    def panel(self) -> Panel:
        """What a mode at each frequency leaves of its equation, and what is left without one."""
        frequency, left = (np.asarray(of) for of in self.map[:2])
        # Where no mode fits there is no best damping either, which the other share depends on.
        fits = np.isfinite(left)
        # A logarithmic axis has no room for nothing.
        floor = LOWEST * np.min(left, where=left > 0, initial=1.0)
        shown = np.where(fits, np.maximum(left, floor), np.nan)
        without = np.where(fits, np.asarray(self.map.without), np.nan)
        marks = [
            Line(frequency, without, "without a mode", GREY),
            Line(frequency, shown, "with a mode there", RUST, markers=True),
            Level(self.frequency[0], "x", "the mode found", BLUE, "dashed"),
        ]
        share = Axis(f"share of {self.stage} unexplained", log=True)
        return Panel(marks, Axis("frequency of the mode / Hz", log=True), share)

    caption: ClassVar = (
        "The mode map: of each frequency that a hidden mode could have, the share of the target's "
        "energy that the equation then leaves, at the best mass and the best damping ratio from "
        "0.02 to 0.8. Both shares are of the equation multiplied by that mode's own polynomial, "
        "so that the share without a mode, too, depends on its frequency and damping; where the "
        "best damping jumps from one value to another, it has a step. Gaps are frequencies at "
        "which only a negative mass would fit; at the lowest points noise accounts for all."
    )
