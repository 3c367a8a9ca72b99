"""The identification model of the quarter car, eqs (21)-(24), in the paper's stages.

One equation of motion serves both criteria: DOLS reads it as eq. (23), RIEC as eq. (24). With the
damper map's break points v_i free as well, the equations are no longer linear in their parameters:
a function of these is refined ([`ByFunction`][riecjax.refinement.ByFunction]). The end segments are
continued as straight lines, so v_1 and F_1 may slide along theirs without changing any force, and
v_4 with F_4 likewise: data determine v_2 and v_3.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from jaxtyping import Array

from riecjax import Equation, Model, Term, Terms, staged
from riecjax.equations import RoofFunctions
from riecjax.models.catalogue import built_in_model
from riecjax.simulation import AbstractSystem

Signals = Mapping[str, Array]
Values = Mapping[str, Any]
BREAK_POINTS = (-0.8, -0.3, 0.3, 0.8)
"""Suspension velocities v_i of the damper map in m/s (Table 2)."""
Points = Sequence[float] | Array
UNSPRUNG = Term("M_us", "x3", derivative=1, measured=("dx3",), unit="kg")
SPRUNG = Term("M_s", "x4", derivative=1, measured=("dx4",), unit="kg")
SPRING = Term("K_s", "x2", unit="N/m")


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
    return Equation(Term(1.0, "F_t"), -UNSPRUNG, -SPRUNG, name="masses", unit="N")


def wheel_equation(break_points: Points = BREAK_POINTS) -> Equation:
    """(23c), (24c): F_t - M_us x3' = K_s x2 + sum F_i R_i(x3 - x4)."""
    forces = -SPRING, -_damper(break_points)
    return Equation(Term(1.0, "F_t"), -UNSPRUNG, *forces, name="wheel", unit="N")


def body_equation(break_points: Points = BREAK_POINTS) -> Equation:
    """(23d), (24d): M_s x4' = K_s x2 + sum F_i R_i(x3 - x4)."""
    return Equation(SPRUNG, -SPRING, -_damper(break_points), name="body", unit="N")


def quarter_car_by_body(break_points: Points = BREAK_POINTS) -> Model:
    """The paper's three stages, suspension forces from the motion of the body (variants B)."""
    return staged(tyre_equation(), mass_equation(), body_equation(break_points))


def quarter_car_by_wheel() -> Model:
    """The paper's three stages, suspension forces from the motion of the wheel (variants W)."""
    return staged(tyre_equation(), mass_equation(), wheel_equation())


def _damper(break_points: Points) -> Term:
    return Terms("F", RoofFunctions(break_points), of=suspension_velocity, unit="N")


def quarter_car_system(parameters: Values, break_points: Points = BREAK_POINTS) -> AbstractSystem:
    """Eqs (21)-(22) with these values of `K_t, M_us, M_s, K_s, F_1 ... F_4`.

    States and signs are those of the source model's `x1` to `x4`.
    """
    model = replace(built_in_model("quarter-car"), stages=quarter_car_by_body(break_points))
    return model.build_system({name: parameters[name] for name in model.parameter_names})
