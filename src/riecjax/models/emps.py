"""EMPS: an electro-mechanical positioning axis with friction.

A. Janot, M. Gautier and M. Brunot, "Data Set and Reference Models of EMPS", Workshop on Nonlinear
System Identification Benchmarks, Eindhoven, 2019.

EMPS with friction that changes near rest (Stribeck): not linear in its parameters.
"""

import math
from collections.abc import Mapping
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from riecjax.equations.equation import Equation
from riecjax.equations.term import Term
from riecjax.errors import ModelError
from riecjax.leaves import Leaf, as_leaf
from riecjax.records.record import Record
from riecjax.records.signals import Signals
from riecjax.refinement.integral_error import AbstractBalance
from riecjax.simulation.method import SimulationStatus
from riecjax.simulation.simulate import Simulation
from riecjax.simulation.system import AbstractSystem, Quantities


def _direction(signals: Signals) -> Array:
    return jnp.sign(signals["dq"])


def _one(signals: Signals) -> Array:
    return jnp.ones_like(signals["dq"])


def _forward_speed(signals: Signals) -> Array:
    return jnp.maximum(signals["dq"], 0.0)


def _backward_speed(signals: Signals) -> Array:
    return jnp.minimum(signals["dq"], 0.0)


def _forward(signals: Signals) -> Array:
    return jnp.where(signals["dq"] > 0, 1.0, 0.0)


def _backward(signals: Signals) -> Array:
    return jnp.where(signals["dq"] < 0, -1.0, 0.0)


def _inertia() -> Term:
    return Term("M", "q", derivative=2, measured=("dq", "ddq"), unit="kg")


def emps_equation() -> Equation:
    """M q'' + Fv q' + Fc sign(q') + offset = force."""
    return Equation(
        _inertia(),
        Term("Fv", "q", derivative=1, measured=("dq",), unit="N s/m"),
        Term("Fc", _direction, unit="N"),
        Term("offset", _one, unit="N"),
        -Term(1.0, "force"),
        name="emps",
        unit="N",
    )


def emps_asymmetric_equation() -> Equation:
    """M q'' + friction = force, with different viscous and Coulomb friction in each direction."""
    return Equation(
        _inertia(),
        Term("Fv_pos", _forward_speed, unit="N s/m"),
        Term("Fc_pos", _forward, unit="N"),
        Term("Fv_neg", _backward_speed, unit="N s/m"),
        Term("Fc_neg", _backward, unit="N"),
        -Term(1.0, "force"),
        name="emps-asymmetric",
        unit="N",
    )


class Axis(AbstractSystem):
    """A mass with friction that may differ between the directions, driven by a force.

    **Fields:** `M` in kg; `Fv_pos`, `Fv_neg` in N s/m; `Fc_pos`, `Fc_neg`, `offset` in N.
    """

    M: Float[Array, ""]
    Fv_pos: Float[Array, ""]
    Fc_pos: Float[Array, ""]
    Fv_neg: Float[Array, ""]
    Fc_neg: Float[Array, ""]
    offset: Float[Array, ""]

    states: ClassVar[Quantities] = (("q", "m"), ("dq", "m/s"))
    inputs: ClassVar[Quantities] = (("force", "N"),)

    @property
    def reversing(self) -> tuple[str, ...]:
        """The velocity, with whose sign the friction changes."""
        return ("dq",)

    def friction(self, velocity: Array, smoothing: Array | float | None = None) -> Array:
        """Friction force in N, positive for positive velocity.

        With `smoothing` in m/s the sign of the velocity is tanh(velocity / smoothing).
        """
        if smoothing is None:
            forward = self.Fv_pos * velocity + self.Fc_pos
            backward = self.Fv_neg * velocity - self.Fc_neg
            return jnp.where(velocity > 0, forward, jnp.where(velocity < 0, backward, 0.0))
        direction = jnp.tanh(velocity / smoothing)
        forward = self.Fv_pos * velocity + self.Fc_pos * direction
        backward = self.Fv_neg * velocity + self.Fc_neg * direction
        return jnp.where(velocity > 0, forward, backward)

    def acceleration(
        self, velocity: Array, force: Array, smoothing: Array | float | None = None
    ) -> Array:
        """In m/s^2, at a velocity in m/s under a force in N."""
        return (force - self.offset - self.friction(velocity, smoothing)) / self.M

    def derivative(self, state: Array, inputs: Array) -> Array:
        """Velocity and acceleration."""
        return jnp.stack([state[1], self.acceleration(state[1], inputs[0])])

    def advance(
        self, position: Array, velocity: Array, force: Array, seconds: Array
    ) -> tuple[Array, Array, Array]:
        """Motion under a constant force, exactly, stops and sticking included.

        Under a constant force the axis slides in one direction with linear friction, which has a
        closed form. It stops at most once; then it sticks if the force is within the Coulomb
        friction, and otherwise slides off with the force, never to stop again. So no step size and
        no smoothed sign come in, and nothing chatters about rest.

        **Returns:** position in m, velocity in m/s after `seconds`, and the acceleration in m/s^2
        at their start, 0 while sticking. Coulomb friction must not be negative.
        """
        drive = force - self.offset
        pulled = jnp.where(drive > self.Fc_pos, 1.0, jnp.where(drive < -self.Fc_neg, -1.0, 0.0))
        sliding = jnp.where(velocity == 0, pulled, jnp.sign(velocity))
        rate, acceleration = self._sliding(sliding, drive)
        # When v e^(-rate t) + acceleration (1 - e^(-rate t)) / rate vanishes.
        slowing = velocity * acceleration < 0
        ratio = jnp.where(slowing, -velocity / jnp.where(slowing, acceleration, 1.0), 0.0)
        stop = jnp.where(slowing, ratio * _log_ratio(rate * ratio), jnp.inf)
        stops = stop < seconds
        before = jnp.where(stops, stop, seconds)
        reached, left = _slide(position, velocity, rate, acceleration, before)
        rate_after, acceleration_after = self._sliding(pulled, drive)
        final, gained = _slide(
            reached, jnp.zeros_like(left), rate_after, acceleration_after, seconds - before
        )
        return (
            jnp.where(stops, final, reached),
            jnp.where(stops, gained, left),
            acceleration - rate * velocity,
        )

    def _sliding(self, direction: Array, drive: Array) -> tuple[Array, Array]:
        """Decay rate in 1/s and acceleration at rest while sliding; both 0 without a direction."""
        viscous = jnp.where(direction > 0, self.Fv_pos, self.Fv_neg)
        coulomb = jnp.where(direction > 0, self.Fc_pos, -self.Fc_neg)
        moving = direction != 0
        return (
            jnp.where(moving, viscous / self.M, 0.0),
            jnp.where(moving, (drive - coulomb) / self.M, 0.0),
        )


def _log_ratio(x: Array) -> Array:
    """log(1 + x) / x, also at 0."""
    small = jnp.abs(x) < 1e-4
    safe = jnp.where(small, 1.0, x)
    return jnp.where(small, 1 - x / 2 + x**2 / 3 - x**3 / 4, jnp.log1p(safe) / safe)


def _slide(
    position: Array, velocity: Array, rate: Array, acceleration: Array, seconds: Array
) -> tuple[Array, Array]:
    """x'' = acceleration - rate x', started at a position with a velocity."""
    x = rate * seconds
    # (1 - e^-x) / x and (e^-x - 1 + x) / x^2; the second one cancels at small x.
    small = jnp.abs(x) < 0.05
    safe = jnp.where(small, 1.0, x)
    once = jnp.where(small, _series(x, 1), -jnp.expm1(-safe) / safe)
    twice = jnp.where(small, _series(x, 2), (safe + jnp.expm1(-safe)) / safe**2)
    reached = position + seconds * (velocity * once + acceleration * seconds * twice)
    return reached, velocity * jnp.exp(-x) + acceleration * seconds * once


def _series(x: Array, start: int) -> Array:
    """Sum over k of (-x)^k / (k + start)!, to 1e-16 for |x| < 0.05."""
    total = jnp.zeros_like(x)
    for k in reversed(range(9)):
        total = total * -x + 1 / math.factorial(k + start)
    return total


class ControlledAxis(AbstractSystem):
    """The axis under its two control loops: force = gtau kv (kp (qg - q) - q').

    In continuous form, for [`simulate`][] along a reference position qg. The sign of the velocity
    in the friction is narrowed to tanh(q' / smoothing), since the sign itself switches at every
    step while the axis sticks. The width does not matter in motion (tested). While sticking, the
    axis creeps at a fraction of it, and with the controller's stiffness of 1.4e6 N/m the force
    fades in seconds where it should stay. Steps of dt resolve widths down to about Fc dt / (3 M),
    1e-5 m/s at 8 steps per millisecond. The rig's controller is sampled, and
    [`simulate_sampled_control`][] has no width, no creep and is nearer to the record.

    **Fields:** `axis`; `gtau` in N/V; `kp` in 1/s; `kv` in V s/m; `smoothing` in m/s.
    """

    axis: Axis
    gtau: Leaf
    kp: Leaf
    kv: Leaf
    smoothing: Leaf

    states: ClassVar[Quantities] = (("q", "m"), ("dq", "m/s"))
    inputs: ClassVar[Quantities] = (("qg", "m"),)
    outputs: ClassVar[Quantities] = (("force", "N"),)

    def __init__(
        self,
        axis: Axis,
        *,
        gtau: float | Array = 35.15065188,
        kp: float | Array = 160.18,
        kv: float | Array = 243.45,
        smoothing: float | Array = 2e-5,
    ):
        self.axis = axis
        self.gtau = as_leaf(gtau)
        self.kp = as_leaf(kp)
        self.kv = as_leaf(kv)
        self.smoothing = as_leaf(smoothing)

    def force(self, reference: Array, position: Array, velocity: Array) -> Array:
        """Force in N that the controller commands."""
        speed_error = jnp.asarray(self.kp) * (reference - position) - velocity
        return jnp.asarray(self.gtau) * jnp.asarray(self.kv) * speed_error

    def derivative(self, state: Array, inputs: Array) -> Array:
        """Velocity and acceleration."""
        force = self.force(inputs[0], state[0], state[1])
        return jnp.stack(
            [state[1], self.axis.acceleration(state[1], force, jnp.asarray(self.smoothing))]
        )

    def output(self, state: Array, inputs: Array) -> Mapping[str, Array]:
        """The force in N."""
        return {"force": self.force(inputs[0], state[0], state[1])}


def simulate_sampled_control(
    system: ControlledAxis,
    reference: Record,
    *,
    delay: int = 0,
    initial_state: Mapping[str, Array | float] | None = None,
) -> Simulation:
    """The axis under its controller as the rig runs it: sampled, its force held between samples.

    At each sample of the reference position `qg` the controller reads the position and takes the
    velocity from it over two samples, (q_k - q_(k-2)) / 2 dt. The logged voltage is this law of
    the logged positions to 0.24 % (tested); a difference over one sample leaves 3 %. Between
    samples the motion is exact, see `Axis.advance`; `smoothing` is not used.

    **Arguments:**

    - `delay`: samples between reading the position and applying the force, 0 or 1. The rig's
      record is best described by 0, the published simulation by 1.
    - `initial_state`: `q` and `dq` at the first sample; zero where not named. Before it the
      controller saw the axis at rest at `q`, if `dq` is zero, else in steady motion.

    **Returns:** `q`, `dq`, `ddq` and `force`, each from the sample on, and `qg`.

    **Raises:** `DataError` if the record has no `qg`; `ModelError` for an unknown state or delay.
    """
    start = dict(initial_state or {})
    system.require_states(start)
    if delay not in (0, 1):
        raise ModelError(f"the delay must be 0 or 1 samples; got {delay}.")
    goal = reference["qg"]
    first = [jnp.asarray(start.get(name, 0.0), goal.dtype) for name in system.state_names]
    return _simulate_sampled(system, reference.select("qg"), first[0], first[1], delay)


@eqx.filter_jit
def _simulate_sampled(
    system: ControlledAxis, reference: Record, position: Array, velocity: Array, delay: int
) -> Simulation:
    step = reference.time_step

    def sample(carry, goal):
        q, dq, last, before_last, waiting = carry
        commanded = system.force(goal, q, (q - before_last) / (2 * step))
        applied = waiting if delay else commanded
        moved, speed, acceleration = system.axis.advance(q, dq, applied, step)
        return (moved, speed, q, last, commanded), (q, dq, acceleration, applied)

    past = [position - k * step * velocity for k in (1, 2)]
    carry = (position, velocity, *past, jnp.zeros_like(position))
    _, found = jax.lax.scan(sample, carry, reference["qg"])
    finite = jnp.all(jnp.isfinite(jnp.stack(found)), axis=0)
    reached = jnp.sum(jnp.cumprod(finite.astype(jnp.int32)))
    shown = jnp.minimum(jnp.arange(finite.size), jnp.maximum(reached - 1, 0))
    units = {"q": "m", "dq": "m/s", "ddq": "m/s^2", "force": "N"}
    signals = {name: values[shown] for name, values in zip(units, found)}
    status = SimulationStatus.where(
        reached == finite.size, SimulationStatus.successful, SimulationStatus.diverged
    )
    return Simulation(reference.with_signals(signals, units), status, reached)


def emps_system(parameters: Mapping[str, Array]) -> Axis:
    """The axis with symmetric friction."""
    p = parameters
    return Axis(p["M"], p["Fv"], p["Fc"], p["Fv"], p["Fc"], p["offset"])


def emps_asymmetric_system(parameters: Mapping[str, Array]) -> Axis:
    """The axis with asymmetric friction."""
    return Axis(**parameters, offset=jnp.zeros(()))


SUBSTEPS = 8
"""Parts of a sample over which the friction's level is taken as constant."""


def stribeck_rise(velocity: Array, excess: Array, width: Array) -> Array:
    """Friction above the Coulomb level, as a share of it: excess e^-(velocity / width)^2."""
    return excess * jnp.exp(-((velocity / width) ** 2))


class StribeckBalance(AbstractBalance):
    """M q'' + friction(q') = force, with different friction in each direction.

    friction = Fv q' + Fc (1 + excess e^-(q'/vs)^2) tanh(q'/width), where the width over which it
    changes its sign is a parameter too: what the velocity's noise and the drive's play make of it.

    **Fields:** `M` in kg; `Fv_pos`, `Fv_neg` in N s/m; `Fc_pos`, `Fc_neg` in N; `excess` of static
    over Coulomb friction; `vs`, `width` in m/s.
    """

    M: Float[Array, ""]
    Fv_pos: Float[Array, ""]
    Fc_pos: Float[Array, ""]
    Fv_neg: Float[Array, ""]
    Fc_neg: Float[Array, ""]
    excess: Float[Array, ""]
    vs: Float[Array, ""]
    width: Float[Array, ""]

    name: ClassVar[str] = "emps-stribeck"
    unit: ClassVar[str] = "N"
    units: ClassVar[Mapping[str, str]] = {
        "M": "kg",
        "Fv_pos": "N s/m",
        "Fc_pos": "N",
        "Fv_neg": "N s/m",
        "Fc_neg": "N",
        "excess": "",
        "vs": "m/s",
        "width": "m/s",
    }

    def momentum(self, signals: Signals) -> Array:
        """M q'."""
        return self.M * signals["dq"]

    def force(self, signals: Signals) -> Array:
        """Friction less the drive's force."""
        v = signals["dq"]
        forward = v > 0
        viscous = jnp.where(forward, self.Fv_pos, self.Fv_neg)
        coulomb = jnp.where(forward, self.Fc_pos, self.Fc_neg)
        level = coulomb * (1 + stribeck_rise(v, self.excess, self.vs))
        return viscous * v + level * jnp.tanh(v / self.width) - signals["force"]


class SteppedAxis(Axis):
    """An axis whose friction's level changes with the speed, for the sampled control loop."""

    def at_speed(self, velocity: Array) -> Axis:
        """The axis with the level that it has at a velocity."""
        raise NotImplementedError

    def advance(
        self, position: Array, velocity: Array, force: Array, seconds: Array
    ) -> tuple[Array, Array, Array]:
        """Motion under a constant force, as of `Axis`, exact in each of `SUBSTEPS` parts.

        Within a part the friction keeps the level that it has at the part's first velocity, so
        that stops and sticking stay exact.
        """
        step = seconds / SUBSTEPS

        def part(_: Array, motion: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
            q, v, first = motion
            moved, speed, acceleration = self.at_speed(v).advance(q, v, force, step)
            return moved, speed, jnp.where(jnp.isnan(first), acceleration, first)

        begun = jnp.full_like(velocity, jnp.nan)
        return jax.lax.fori_loop(0, SUBSTEPS, part, (position, velocity, begun))

    def with_levels(self, positive: Array, negative: Array) -> Axis:
        """An axis with these Coulomb levels, and all else as here."""
        return Axis(self.M, self.Fv_pos, positive, self.Fv_neg, negative, self.offset)


class StribeckAxis(SteppedAxis):
    """An axis whose Coulomb friction is higher near rest.

    **Fields:** those of `Axis`, `excess` of static over Coulomb friction, and `vs` in m/s.
    """

    excess: Float[Array, ""]
    vs: Float[Array, ""]

    def at_speed(self, velocity: Array) -> Axis:
        """Both levels times 1 + excess e^-(v/vs)^2."""
        factor = 1 + stribeck_rise(velocity, self.excess, self.vs)
        return self.with_levels(factor * self.Fc_pos, factor * self.Fc_neg)


def stribeck_axis(parameters: Mapping[str, Array]) -> StribeckAxis:
    """The axis with a balance's parameters, but for the width, which exact sticking needs not."""
    fields = {name: value for name, value in parameters.items() if name != "width"}
    return StribeckAxis(**fields, offset=jnp.zeros(()))


def stribeck_balance(start: Mapping[str, Array | float]) -> StribeckBalance:
    """The balance with these values."""
    fields = {field: jnp.asarray(start[field]) for field in StribeckBalance.units}
    return StribeckBalance(**fields)


def without_rise(axis: Mapping[str, Array | float]) -> dict[str, Array | float]:
    """A start for the refinement: asymmetric friction, with a tenth more near rest."""
    return {**axis, "excess": 0.1, "vs": 0.02, "width": 1e-4}
