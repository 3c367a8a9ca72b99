"""Table 1: eigenstructure of the linearised source model."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from riecjax.models.quarter_car.curves import BumpStopSpring, HardeningMount, LinearDamper
from riecjax.models.quarter_car.reconstruction import (
    MOUNT_DAMPING,
    MOUNT_RATE,
    SPRING_RATE,
    source_with_curves,
)
from riecjax.models.quarter_car.source import QuarterCarSource
from riecjax.paper.published import DAMPING_RATE, TABLE_1, PublishedMode
from riecjax.simulation.linearisation import Mode, linearise, modes

WHEEL, BODY, ENGINE = 2, 3, 5
"""Places of the velocities x3, x4, x6 in the state."""


class ModeComparison(NamedTuple):
    """A published mode beside the reproduced one, and whether every printed digit agrees."""

    published: PublishedMode
    reproduced: PublishedMode
    agrees: bool


def linear_source(
    mount_rate: float = MOUNT_RATE, mount_damping: float = MOUNT_DAMPING
) -> QuarterCarSource:
    """The source model as linearised in Section 3: 1.5 kN s/m, 20 kN/m, and a linear mount."""
    return source_with_curves(
        LinearDamper(jnp.asarray(DAMPING_RATE)),
        BumpStopSpring(jnp.asarray(SPRING_RATE), jnp.full(2, 1.0), jnp.zeros(2)),
        HardeningMount(jnp.asarray(mount_rate), jnp.zeros(())),
        mount_damping,
    )


def table_1() -> list[ModeComparison]:
    """Every row of Table 1, published and reproduced to the printed digits."""
    found = modes(linearise(linear_source())[0])
    return [_compare(published, mode) for published, mode in zip(TABLE_1, found, strict=True)]


def _compare(published: PublishedMode, mode: Mode) -> ModeComparison:
    reproduced = _printed(mode, published)
    return ModeComparison(published, reproduced, reproduced == published)


def _printed(mode: Mode, like: PublishedMode) -> PublishedMode:
    """The mode rounded as the paper prints it, scaled so that the larger velocity is 1."""
    wheel, body, engine = mode.shape[[WHEEL, BODY, ENGINE]]
    reference = wheel if abs(wheel) >= abs(body) else body
    parts = np.array([wheel, body, engine - body]) / reference
    return PublishedMode(
        _round(mode.eigenvalue, like.digits),
        None if mode.frequency is None else round(float(mode.frequency), 2),
        None if mode.damping_ratio is None else round(float(mode.damping_ratio), 2),
        _round(complex(parts[0]), 2),
        _round(complex(parts[1]), 2),
        _round(complex(parts[2]), 2),
        like.digits,
    )


def _round(value: complex, digits: int) -> complex:
    # Adding zero turns -0.0 into 0.0.
    return complex(round(value.real, digits) + 0.0, round(value.imag, digits) + 0.0)
