"""The identification model of the quarter car, eqs (21)-(24), and the paper's procedure.

One equation of motion serves both criteria: DOLS reads it as eq. (23), RIEC as eq. (24). With the
damper map's break points v_i free as well, the equations are no longer linear in their parameters:
they are refined, by output error ([`damper_system`][]) or by integral error ([`body_balance`][],
[`wheel_balance`][]).
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from riecjax import Equation, Term, Terms, staged
from riecjax.equations import Procedure, RoofFunctions
from riecjax.refinement import AbstractBalance, ByFunction
from riecjax.simulation import AbstractSystem

Signals = Mapping[str, Array]
BREAK_POINTS = (-0.8, -0.3, 0.3, 0.8)
"""Suspension velocities v_i of the damper map in m/s (Table 2)."""


def suspension_velocity(signals: Signals) -> Array:
    """x3 - x4: wheel relative to body, positive in rebound."""
    return signals["x3"] - signals["x4"]


def tyre_velocity(signals: Signals) -> Array:
    """v_r - x3: road relative to wheel, at which the tyre extends."""
    return signals["v_r"] - signals["x3"]


def tyre_equation() -> Equation:
    """(23a), (24a): F_t = K_t x1."""
    return Equation(Term(1.0, "F_t"), -Term("K_t", "x1", unit="N/m"), name="tyre", unit="N")


def mass_equation() -> Equation:
    """(23b), (24b): F_t = M_us x3' + M_s x4'."""
    return Equation(Term(1.0, "F_t"), -_unsprung(), -_sprung(), name="masses", unit="N")


def wheel_equation() -> Equation:
    """(23c), (24c): F_t - M_us x3' = K_s x2 + sum F_i R_i(x3 - x4)."""
    return Equation(Term(1.0, "F_t"), -_unsprung(), -_spring(), -_damper(), name="wheel", unit="N")


def body_equation() -> Equation:
    """(23d), (24d): M_s x4' = K_s x2 + sum F_i R_i(x3 - x4)."""
    return Equation(_sprung(), -_spring(), -_damper(), name="body", unit="N")


def quarter_car_by_body() -> Procedure:
    """The paper's three stages, suspension forces from the motion of the body (variants B)."""
    return staged(tyre_equation(), mass_equation(), body_equation())


def quarter_car_by_wheel() -> Procedure:
    """The paper's three stages, suspension forces from the motion of the wheel (variants W)."""
    return staged(tyre_equation(), mass_equation(), wheel_equation())


def _unsprung() -> Term:
    return Term("M_us", "x3", derivative=1, measured=("dx3",), unit="kg")


def _sprung() -> Term:
    return Term("M_s", "x4", derivative=1, measured=("dx4",), unit="kg")


def _spring() -> Term:
    return Term("K_s", "x2", unit="N/m")


def _damper() -> Term:
    return Terms("F", RoofFunctions(BREAK_POINTS), of=suspension_velocity, unit="N")


class QuarterCar(AbstractSystem):
    """Two masses, linear but for a damper map F_di = sum F_i R_i(x3 - x4), eqs (21)-(22).

    States and signs are those of the source model's `x1` to `x4`.

    **Fields:** `K_t`, `K_s` in N/m; `M_us`, `M_s` in kg; `F` damper forces in N at the break
    points; `roof` the damper map's functions.
    """

    K_t: Float[Array, ""]
    M_us: Float[Array, ""]
    M_s: Float[Array, ""]
    K_s: Float[Array, ""]
    F: Float[Array, " points"]
    roof: RoofFunctions

    states: ClassVar = (("x1", "m"), ("x2", "m"), ("x3", "m/s"), ("x4", "m/s"))
    inputs: ClassVar = (("v_r", "m/s"),)
    outputs: ClassVar = (("F_t", "N"),)

    @classmethod
    def from_parameters(cls, parameters: Mapping[str, Array]) -> "QuarterCar":
        """The model with these values of `K_t, M_us, M_s, K_s, F_1 ... F_4`."""
        forces = jnp.stack([jnp.asarray(parameters[f"F_{i}"]) for i in range(1, 5)])
        named = {name: jnp.asarray(parameters[name]) for name in ("K_t", "M_us", "M_s", "K_s")}
        return cls(**named, F=forces, roof=RoofFunctions(BREAK_POINTS))

    def derivative(self, state: Array, inputs: Array) -> Array:
        """Eq. (21)."""
        x1, x2, x3, x4 = (state[i] for i in range(4))
        suspension = self.K_s * x2 + self.roof.interpolate(self.F, x3 - x4)
        return jnp.stack(
            [
                inputs[0] - x3,
                x3 - x4,
                (self.K_t * x1 - suspension) / self.M_us,
                suspension / self.M_s,
            ]
        )

    def output(self, state: Array, inputs: Array) -> Mapping[str, Array]:
        """Tyre force F_t in N."""
        return {"F_t": self.K_t * state[0]}


def quarter_car_system(parameters: Mapping[str, Array]) -> QuarterCar:
    """The identification model with these parameters."""
    return QuarterCar.from_parameters(parameters)


FORCES = ("F_1", "F_2", "F_3", "F_4")
VELOCITIES = ("v_1", "v_2", "v_3", "v_4")
INNER = ("v_2", "v_3")
"""Break points that data can determine.

The map's end segments are continued as straight lines, so v_1 and F_1 may slide along theirs
without changing any force, and v_4 with F_4 likewise. The outer ones keep the values of Table 2
unless others are given.
"""
UNITS = (
    ("K_t", "N/m"),
    ("M_us", "kg"),
    ("M_s", "kg"),
    ("K_s", "N/m"),
    *((name, "N") for name in FORCES),
    *((name, "m/s") for name in VELOCITIES),
)

Values = Mapping[str, Any]


class Suspension(AbstractBalance):
    """Force K_s x2 + sum F_i R_i(x3 - x4) between the masses, and what it does to one of them.

    **Fields:** `mass` in kg of the body or the wheel, `K_s` in N/m, damper forces `F` in N at the
    velocities `v` in m/s, both of shape `(4,)`.
    """

    mass: Float[Array, ""]
    K_s: Float[Array, ""]
    F: Float[Array, " points"]
    v: Float[Array, " points"]

    def suspension_force(self, signals: Signals) -> Array:
        """Of spring and damper in N, shape `(n,)`."""
        damper = RoofFunctions(self.v).interpolate(self.F, suspension_velocity(signals))
        return self.K_s * signals["x2"] + damper


class Body(Suspension):
    """(24d): M_s x4' = K_s x2 + sum F_i R_i(x3 - x4)."""

    name = "body"
    unit = "N"

    def force(self, signals: Signals) -> Array:
        """Of the suspension, which drives the body."""
        return -self.suspension_force(signals)

    def momentum(self, signals: Signals) -> Array:
        """M_s x4."""
        return self.mass * signals["x4"]


class Wheel(Suspension):
    """(24c): F_t - M_us x3' = K_s x2 + sum F_i R_i(x3 - x4)."""

    name = "wheel"
    unit = "N"

    def force(self, signals: Signals) -> Array:
        """Of the tyre, less that of the suspension."""
        return signals["F_t"] - self.suspension_force(signals)

    def momentum(self, signals: Signals) -> Array:
        """M_us x3, which takes up the rest."""
        return -self.mass * signals["x3"]


def body_balance() -> ByFunction:
    """The body's motion for every M_s, K_s, F_i and v_i."""
    return _parametric(_body, ("M_s", "K_s"))


def wheel_balance() -> ByFunction:
    """The wheel's motion for every M_us, K_s, F_i and v_i."""
    return _parametric(_wheel, ("M_us", "K_s"))


def damper_system() -> ByFunction:
    """The four-state model of eqs (21)-(22) for every K_t, M_us, M_s, K_s, F_i and v_i."""
    return _parametric(quarter_car_of_break_points, ("K_t", "M_us", "M_s", "K_s"))


def quarter_car_of_break_points(parameters: Values) -> QuarterCar:
    """The four-state model; break points that are not among the parameters stay as in Table 2."""
    places = {**dict(zip(VELOCITIES, BREAK_POINTS)), **parameters}
    rates = {name: jnp.asarray(places[name]) for name in ("K_t", "M_us", "M_s", "K_s")}
    roof = RoofFunctions(_stacked(places, VELOCITIES))
    return QuarterCar(**rates, F=_stacked(places, FORCES), roof=roof)


def _body(values: Values) -> Body:
    return Body(jnp.asarray(values["M_s"]), *_suspension(values))


def _wheel(values: Values) -> Wheel:
    return Wheel(jnp.asarray(values["M_us"]), *_suspension(values))


def _suspension(values: Values) -> tuple[Array, Array, Array]:
    return jnp.asarray(values["K_s"]), _stacked(values, FORCES), _stacked(values, VELOCITIES)


def _stacked(values: Values, names: Sequence[str]) -> Float[Array, " points"]:
    return jnp.stack([jnp.asarray(values[name], jnp.result_type(float)) for name in names])


def _parametric(function: Callable[[Values], Any], rates: tuple[str, ...]) -> ByFunction:
    names = (*rates, *FORCES, *VELOCITIES)
    units = tuple((name, unit) for name, unit in UNITS if name in names)
    return ByFunction(function, names, units, dict(zip(VELOCITIES, BREAK_POINTS)))
