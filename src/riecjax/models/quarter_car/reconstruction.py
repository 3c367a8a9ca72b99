"""What the paper's text does not give of its source model, and where it comes from here.

- *Published*: K_t 180 kN/m; first-stage stiffness 20 kN/m; mount 400 kN/m for small motion and
  the B_m of Table 6; damping "approximately 1.5 kN s/m" for the linearised model.
- *Derived*: masses and damper compliance, from Table 1, which they reproduce to every digit. They
  stand in the catalogue of models, as defaults of `quarter-car-source`.
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

from riecjax.models.catalogue import LISTED
from riecjax.models.quarter_car.source import (
    BumpStopSpring,
    Curve,
    DigressiveDamper,
    HardeningMount,
    QuarterCarSource,
)

Leaf = Array | np.ndarray

SPRING_RATE = 20e3
"""First-stage suspension stiffness in N/m, published."""
MOUNT_RATE = 400e3
"""Engine mount stiffness K_m in N/m, published (Table 6, pathological case), of the mount's curve
as it is reconstructed."""


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

    damper: Curve
    stop_gaps: Leaf
    stop_rates: Leaf
    mount_cubic: Leaf
    pothole: Pothole
    roughness: Leaf


def reconstructed() -> Reconstruction:
    """The reconstruction that this package uses, from the joint calibration to Tables 3 to 5.

    Of two numbers the first one is of compression, the other one of rebound.
    """
    return Reconstruction(
        damper=DigressiveDamper(
            low_speed_rate=jnp.asarray(4290.6),
            high_speed_rates=jnp.asarray([568.6, 648.4]),
            knees=jnp.asarray([0.19645, 0.16498]),
        ),
        stop_gaps=np.array([0.03658, 0.069088]),
        stop_rates=np.array([6128.5, 997.29]),
        mount_cubic=np.array(543110000.0),
        pothole=Pothole(np.array(0.092554), np.array(2.0443), np.array(1.2889)),
        roughness=np.array(ROUGHNESS),
    )


ROUGHNESS = 1.5e-5
"""k of eq. (27), read as a density per rad/s. Published: 3e-5, without saying per what."""


def quarter_car_source(
    values: Mapping[str, float | Array] = {}, shapes: Reconstruction | None = None
) -> QuarterCarSource:
    """The source model with these masses and rates, else the catalogue's, and with the
    reconstructed curves or others.

    The mount's whole curve is scaled by the gain of its stiffness, as the paper does.
    """
    listed = {q.name: q.default for q in LISTED["quarter-car-source"].system.parameters}
    parameters = {name: jnp.asarray(value) for name, value in {**listed, **values}.items()}
    shapes = reconstructed() if shapes is None else shapes
    gaps, rates = jnp.asarray(shapes.stop_gaps), jnp.asarray(shapes.stop_rates)
    gain = parameters["K_m"] / MOUNT_RATE
    return QuarterCarSource(
        wheel_mass=parameters["M_w"],
        body_mass=parameters["M_b"],
        engine_mass=parameters["M_e"],
        tyre_stiffness=parameters["K_t"],
        damper_compliance=parameters["K_c"],
        mount_damping=parameters["B_m"],
        damper=jax.tree.map(jnp.asarray, shapes.damper),
        spring=BumpStopSpring(jnp.asarray(SPRING_RATE), gaps, rates),
        mount=HardeningMount(MOUNT_RATE * gain, jnp.asarray(shapes.mount_cubic) * gain),
    )
