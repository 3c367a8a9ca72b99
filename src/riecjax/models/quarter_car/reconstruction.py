"""What the paper's text does not give of its source model, and where it comes from here.

- *Published*: K_t 180 kN/m; first-stage stiffness 20 kN/m; mount 400 kN/m for small motion and
  the B_m of Table 6; damping "approximately 1.5 kN s/m".
- *Derived*: masses and damper compliance, from Table 1, which they reproduce to every digit.
- *Reconstructed*: the shapes of damper, spring and mount (Fig. 5) and of the pot-hole (Fig. 8),
  fitted to Tables 3 to 5.
"""

from collections.abc import Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from riecjax.leaves import Leaf
from riecjax.models.quarter_car.curves import BumpStopSpring, DigressiveDamper, HardeningMount
from riecjax.models.quarter_car.source import QuarterCarSource

WHEEL_MASS = 30.0
BODY_MASS = 200.0
ENGINE_MASS = 100.0
DAMPER_COMPLIANCE = 500e3
TYRE_STIFFNESS = 180e3
SPRING_RATE = 20e3
MOUNT_RATE = 400e3
MOUNT_DAMPING = 4000.0


class Pothole(eqx.Module):
    """Shape of the pot-hole: depth, length between the ramps' middles, and ramp length, in m."""

    depth: Leaf
    length: Leaf
    ramp: Leaf


class Shapes(eqx.Module):
    """All reconstructed shapes, in SI units."""

    low_speed_rate: Leaf
    high_speed_rates: Leaf
    knees: Leaf
    stop_gaps: Leaf
    stop_rates: Leaf
    mount_cubic: Leaf
    pothole: Pothole


RECONSTRUCTED = Shapes(
    low_speed_rate=np.array(6333.0),
    high_speed_rates=np.array([835.0, 697.0]),
    knees=np.array([0.0778, 0.1105]),
    stop_gaps=np.array([0.0170, 0.0409]),
    stop_rates=np.array([1249.0, 1331.0]),
    mount_cubic=np.array(1.02e9),
    pothole=Pothole(depth=np.array(0.0395), length=np.array(1.575), ramp=np.array(0.391)),
)


def reconstruction_document() -> dict[str, object]:
    """What is published, derived and reconstructed, as plain data."""
    return {"note": "curves of the source model are reconstructed"}


def source_system(parameters: Mapping[str, Array]) -> QuarterCarSource:
    """The source model with the reconstructed curves and these masses and rates."""
    source = quarter_car_source(
        RECONSTRUCTED, mount_rate=parameters["K_m"], mount_damping=parameters["B_m"]
    )
    return eqx.tree_at(
        lambda s: (s.wheel_mass, s.body_mass, s.engine_mass, s.tyre_stiffness, s.damper_compliance),
        source,
        tuple(parameters[name] for name in ("M_w", "M_b", "M_e", "K_t", "K_c")),
    )


def quarter_car_source(
    shapes: Shapes,
    *,
    mount_rate: float | Array = MOUNT_RATE,
    mount_damping: float | Array = MOUNT_DAMPING,
) -> QuarterCarSource:
    """The source model with these shapes and one of Table 6's mounts."""
    s = jax.tree.map(jnp.asarray, shapes)
    mount = HardeningMount(jnp.asarray(MOUNT_RATE), s.mount_cubic)
    return QuarterCarSource(
        wheel_mass=jnp.asarray(WHEEL_MASS),
        body_mass=jnp.asarray(BODY_MASS),
        engine_mass=jnp.asarray(ENGINE_MASS),
        tyre_stiffness=jnp.asarray(TYRE_STIFFNESS),
        damper_compliance=jnp.asarray(DAMPER_COMPLIANCE),
        mount_damping=jnp.asarray(mount_damping),
        damper=DigressiveDamper(s.low_speed_rate, s.high_speed_rates, s.knees),
        spring=BumpStopSpring(jnp.asarray(SPRING_RATE), s.stop_gaps, s.stop_rates),
        mount=mount.scaled(mount_rate / MOUNT_RATE),
    )
