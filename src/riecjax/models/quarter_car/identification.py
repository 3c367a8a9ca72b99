"""The identification model of the quarter car, eqs (21)-(24), in the paper's stages.

One equation of motion serves both criteria: DOLS reads it as eq. (23), RIEC as eq. (24). With the
damper map's break points v_i free as well, the equations are no longer linear in their parameters:
they are refined, by output error ([`damper_system`][]) or by integral error ([`body_balance`][],
[`wheel_balance`][]).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from riecjax import Equation, Model, Term, Terms, staged
from riecjax.equations import RoofFunctions
from riecjax.models.catalogue import built_in_model
from riecjax.refinement import ByFunction
from riecjax.simulation import AbstractSystem

Signals = Mapping[str, Array]
Values = Mapping[str, Any]
BREAK_POINTS = (-0.8, -0.3, 0.3, 0.8)
"""Suspension velocities v_i of the damper map in m/s (Table 2)."""
Points = Sequence[float] | Array


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


def wheel_equation(break_points: Points = BREAK_POINTS) -> Equation:
    """(23c), (24c): F_t - M_us x3' = K_s x2 + sum F_i R_i(x3 - x4)."""
    forces = -_spring(), -_damper(break_points)
    return Equation(Term(1.0, "F_t"), -_unsprung(), *forces, name="wheel", unit="N")


def body_equation(break_points: Points = BREAK_POINTS) -> Equation:
    """(23d), (24d): M_s x4' = K_s x2 + sum F_i R_i(x3 - x4)."""
    return Equation(_sprung(), -_spring(), -_damper(break_points), name="body", unit="N")


def quarter_car_by_body(break_points: Points = BREAK_POINTS) -> Model:
    """The paper's three stages, suspension forces from the motion of the body (variants B)."""
    return staged(tyre_equation(), mass_equation(), body_equation(break_points))


def quarter_car_by_wheel() -> Model:
    """The paper's three stages, suspension forces from the motion of the wheel (variants W)."""
    return staged(tyre_equation(), mass_equation(), wheel_equation())


def _unsprung() -> Term:
    return Term("M_us", "x3", derivative=1, measured=("dx3",), unit="kg")


def _sprung() -> Term:
    return Term("M_s", "x4", derivative=1, measured=("dx4",), unit="kg")


def _spring() -> Term:
    return Term("K_s", "x2", unit="N/m")


def _damper(break_points: Points) -> Term:
    return Terms("F", RoofFunctions(break_points), of=suspension_velocity, unit="N")


def quarter_car_system(parameters: Values, break_points: Points = BREAK_POINTS) -> AbstractSystem:
    """Eqs (21)-(22) with these values of `K_t, M_us, M_s, K_s, F_1 ... F_4`.

    States and signs are those of the source model's `x1` to `x4`.
    """
    model = replace(built_in_model("quarter-car"), stages=quarter_car_by_body(break_points))
    return model.build_system({name: parameters[name] for name in model.parameter_names})


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


def body_balance() -> ByFunction:
    """The body's motion for every M_s, K_s, F_i and v_i."""
    return _parametric(_body, ("M_s", "K_s"))


def wheel_balance() -> ByFunction:
    """The wheel's motion for every M_us, K_s, F_i and v_i."""
    return _parametric(_wheel, ("M_us", "K_s"))


def damper_system() -> ByFunction:
    """The four-state model of eqs (21)-(22) for every K_t, M_us, M_s, K_s, F_i and v_i."""
    return _parametric(quarter_car_of_break_points, ("K_t", "M_us", "M_s", "K_s"))


def quarter_car_of_break_points(parameters: Values) -> AbstractSystem:
    """The four-state model; break points that are not among the parameters stay as in Table 2."""
    places = {**dict(zip(VELOCITIES, BREAK_POINTS)), **parameters}
    return quarter_car_system(parameters, _stacked(places, VELOCITIES))


def _body(values: Values) -> Equation:
    return body_equation(_stacked(values, VELOCITIES))


def _wheel(values: Values) -> Equation:
    return wheel_equation(_stacked(values, VELOCITIES))


def _stacked(values: Values, names: Sequence[str]) -> Float[Array, " points"]:
    return jnp.stack([jnp.asarray(values[name], jnp.result_type(float)) for name in names])


def _parametric(function: Callable[[Values], Any], rates: tuple[str, ...]) -> ByFunction:
    names = (*rates, *FORCES, *VELOCITIES)
    units = tuple((name, unit) for name, unit in UNITS if name in names)
    return ByFunction(function, names, units, dict(zip(VELOCITIES, BREAK_POINTS)))
