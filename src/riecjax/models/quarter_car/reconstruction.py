"""What the paper's text does not give of its source model, and where it comes from here.

- *Published*: K_t 180 kN/m; first-stage stiffness 20 kN/m; mount 400 kN/m for small motion and
  the B_m of Table 6; damping "approximately 1.5 kN s/m" for the linearised model.
- *Derived*: masses and damper compliance, from Table 1, which they reproduce to every digit.
- *Reconstructed*: the curves of damper, spring and mount (Fig. 5), the pot-hole (Fig. 8) and the
  amplitude of the Robson road, whose density the text does not normalise. They are fitted to
  Tables 3 to 5 by `benchmarks/paper/reconstruct_curves.py`; other shapes fit about as well, see the
  page "What is reconstructed" of the documentation.
"""

from collections.abc import Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from riecjax.models.quarter_car.source import (
    BumpStopSpring,
    DamperCurve,
    DigressiveDamper,
    HardeningMount,
    QuarterCarSource,
)

Leaf = Array | np.ndarray

WHEEL_MASS = 30.0
"""M_w in kg, derived."""
BODY_MASS = 200.0
"""M_b in kg, derived."""
ENGINE_MASS = 100.0
"""M_e in kg, derived."""
DAMPER_COMPLIANCE = 500e3
"""K_c in N/m, derived."""
TYRE_STIFFNESS = 180e3
"""K_t in N/m, published."""
SPRING_RATE = 20e3
"""First-stage suspension stiffness in N/m, published."""
MOUNT_RATE = 400e3
"""Engine mount stiffness K_m in N/m, published (Table 6, pathological case)."""
MOUNT_DAMPING = 4000.0
"""Engine mount damping B_m in N s/m, published (Table 6, pathological case)."""


class Pothole(eqx.Module):
    """Shape of the pot-hole: depth, length between the ramps' middles, and ramp length, in m."""

    depth: Leaf
    length: Leaf
    ramp: Leaf


class Reconstruction(eqx.Module):
    """Everything that is reconstructed, in SI units; all leaves are positive.

    **Fields:**

    - `damper`: F_d, a curve with a slope.
    - `stop_gaps`, `stop_rates`: bump stops of the spring, for compression and rebound.
    - `mount_cubic`: k_3 of the mount.
    - `pothole`: Fig. 8.
    - `roughness`: k of eq. (27) for a density per rad/s.
    """

    damper: DamperCurve
    stop_gaps: Leaf
    stop_rates: Leaf
    mount_cubic: Leaf
    pothole: Pothole
    roughness: Leaf


def reconstructed() -> Reconstruction:
    """The reconstruction that this package uses, from the joint calibration to Tables 3 to 5."""
    return Reconstruction(
        damper=DigressiveDamper(
            low_speed_rate=jnp.asarray(DAMPER_LOW_SPEED_RATE),
            high_speed_rates=jnp.asarray(DAMPER_HIGH_SPEED_RATES),
            knees=jnp.asarray(DAMPER_KNEES),
        ),
        stop_gaps=np.array(STOP_GAPS),
        stop_rates=np.array(STOP_RATES),
        mount_cubic=np.array(MOUNT_CUBIC),
        pothole=Pothole(*(np.array(value) for value in POTHOLE)),
        roughness=np.array(ROUGHNESS),
    )


DAMPER_LOW_SPEED_RATE = 4290.6
"""Slope of the damper curve at rest in N s/m."""
DAMPER_HIGH_SPEED_RATES = (568.6, 648.4)
"""Slope far beyond the knee in N s/m, compression and rebound."""
DAMPER_KNEES = (0.19645, 0.16498)
"""Velocity of the knee in m/s, compression and rebound."""
STOP_GAPS = (0.03658, 0.069088)
"""Deflection at which the second stage of the spring begins in m, compression and rebound."""
STOP_RATES = (6128.5, 997.29)
"""Stiffness that the second stage adds in N/m, compression and rebound."""
MOUNT_CUBIC = 543110000.0
"""Cubic stiffness of the engine mount in N/m^3."""
POTHOLE = (0.092554, 2.0443, 1.2889)
"""Depth, length and ramp of the pot-hole in m."""
ROUGHNESS = 1.5e-5
"""k of eq. (27), read as a density per rad/s. Published: 3e-5, without saying per what."""


def quarter_car_source(
    shapes: Reconstruction,
    *,
    mount_rate: float | Array = MOUNT_RATE,
    mount_damping: float | Array = MOUNT_DAMPING,
) -> QuarterCarSource:
    """The source model with these shapes and one of Table 6's mounts.

    The mount's whole curve is scaled by the gain of its stiffness, as the paper does.
    """
    gaps, rates = jnp.asarray(shapes.stop_gaps), jnp.asarray(shapes.stop_rates)
    mount = HardeningMount(jnp.asarray(MOUNT_RATE), jnp.asarray(shapes.mount_cubic))
    return QuarterCarSource(
        wheel_mass=jnp.asarray(WHEEL_MASS),
        body_mass=jnp.asarray(BODY_MASS),
        engine_mass=jnp.asarray(ENGINE_MASS),
        tyre_stiffness=jnp.asarray(TYRE_STIFFNESS),
        damper_compliance=jnp.asarray(DAMPER_COMPLIANCE),
        mount_damping=jnp.asarray(mount_damping),
        damper=jax.tree.map(jnp.asarray, shapes.damper),
        spring=BumpStopSpring(jnp.asarray(SPRING_RATE), gaps, rates),
        mount=mount.scaled(mount_rate / MOUNT_RATE),
    )


def source_system(parameters: Mapping[str, Array]) -> QuarterCarSource:
    """The source model with the reconstructed curves and these masses and rates."""
    source = quarter_car_source(
        reconstructed(), mount_rate=parameters["K_m"], mount_damping=parameters["B_m"]
    )
    return eqx.tree_at(
        lambda s: (s.wheel_mass, s.body_mass, s.engine_mass, s.tyre_stiffness, s.damper_compliance),
        source,
        tuple(parameters[name] for name in ("M_w", "M_b", "M_e", "K_t", "K_c")),
    )
