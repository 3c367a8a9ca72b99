"""The regression equations of the quarter car, eqs (23) and (24), and the paper's procedure.

One equation of motion serves both criteria: DOLS reads it as eq. (23), RIEC as eq. (24).
"""

from collections.abc import Mapping
from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from riecjax.equations.bases import RoofFunctions
from riecjax.equations.equation import Equation
from riecjax.equations.procedure import Procedure, simultaneous, staged
from riecjax.equations.term import Term, Terms
from riecjax.records.record import Signals
from riecjax.simulation.system import AbstractSystem, Quantities


def suspension_velocity(signals: Signals) -> Array:
    """x3 - x4: wheel relative to body, positive in rebound."""
    return signals["x3"] - signals["x4"]


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


def quarter_car_at_once() -> Procedure:
    """All parameters from all four equations in one solve."""
    return simultaneous(tyre_equation(), mass_equation(), wheel_equation(), body_equation())


def _unsprung() -> Term:
    return Term("M_us", "x3", derivative=1, measured=("dx3",), unit="kg")


def _sprung() -> Term:
    return Term("M_s", "x4", derivative=1, measured=("dx4",), unit="kg")


def _spring() -> Term:
    return Term("K_s", "x2", unit="N/m")


def _damper() -> Terms:
    return Terms("F", RoofFunctions(BREAK_POINTS), of=suspension_velocity, unit="N")


BREAK_POINTS = (-0.8, -0.3, 0.3, 0.8)
"""Suspension velocities v_i of the damper map in m/s (Table 2)."""


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

    states: ClassVar[Quantities] = (("x1", "m"), ("x2", "m"), ("x3", "m/s"), ("x4", "m/s"))
    inputs: ClassVar[Quantities] = (("v_r", "m/s"),)
    outputs: ClassVar[Quantities] = (("F_t", "N"),)

    @classmethod
    def from_parameters(cls, parameters: Mapping[str, Array]) -> "QuarterCar":
        """The model with these values of `K_t, M_us, M_s, K_s, F_1 ... F_4`."""
        forces = jnp.stack([jnp.asarray(parameters[f"F_{i}"]) for i in range(1, 5)])
        named = {name: jnp.asarray(parameters[name]) for name in ("K_t", "M_us", "M_s", "K_s")}
        return cls(**named, F=forces, roof=RoofFunctions(BREAK_POINTS))

    def derivative(
        self, state: Float[Array, " 4"], inputs: Float[Array, " 1"]
    ) -> Float[Array, " 4"]:
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

    def output(self, state: Float[Array, " 4"], inputs: Float[Array, " 1"]) -> Mapping[str, Array]:
        """Tyre force F_t in N."""
        return {"F_t": self.K_t * state[0]}


def quarter_car_system(parameters: Mapping[str, Array]) -> QuarterCar:
    """The identification model with these parameters."""
    return QuarterCar.from_parameters(parameters)
