"""The identification model with the damper map's break points as parameters too.

With v_i free the equations are no longer linear in their parameters: they are refined, by output
error ([`damper_system`][]) or by integral error ([`body_balance`][], [`wheel_balance`][]).

The map's end segments are continued as straight lines, so that v_1 and F_1 may slide along theirs
without changing any force, and v_4 with F_4 likewise: of the four break points only the inner two
can be found, which is [`INNER`][]. The outer ones keep the values of Table 2 unless others are
given.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from riecjax.equations.bases import RoofFunctions
from riecjax.leaves import Leaf
from riecjax.models.quarter_car.identification import BREAK_POINTS, QuarterCar, suspension_velocity
from riecjax.records.record import Signals
from riecjax.refinement.balance import AbstractBalance
from riecjax.refinement.parametric import ByFunction

FORCES = ("F_1", "F_2", "F_3", "F_4")
VELOCITIES = ("v_1", "v_2", "v_3", "v_4")
INNER = ("v_2", "v_3")
"""Break points that data can determine."""
UNITS = (
    ("K_t", "N/m"),
    ("M_us", "kg"),
    ("M_s", "kg"),
    ("K_s", "N/m"),
    *((name, "N") for name in FORCES),
    *((name, "m/s") for name in VELOCITIES),
)

Values = Mapping[str, Leaf | float]


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
