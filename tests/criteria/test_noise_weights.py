"""The weights of noise in all windows, against windows one by one."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from riecjax import Boxcar, Bump, Hat
from riecjax.criteria.windows import LagBins, StartBlocks, WindowSet
from riecjax.equations.noisy_columns import Columns

N, STEP = 80, 0.1
LAW = LagBins(np.array([5, 7]), np.array([6, 9]))
LONG = LagBins(np.array([14, 17]), np.array([16, 19]))
"""Where the ends of quadrature of high order do not overlap."""
BUMPS = LagBins(np.array([9, 12]), np.array([9, 12]))
PRESENT = np.ones(N, bool)
PRESENT[[9, 23]] = False


def windows(test_function, law, present, blocks):
    """Every window that starts in the blocks and touches no gap."""
    multiple = test_function.length_multiple
    for first, last in zip(law.first, law.last):
        for lag in range(first, last + 1):
            length = multiple * lag
            for start in range(blocks.first, blocks.first + blocks.size * blocks.number):
                inside = start + length < N
                if inside and present[start : start + length + 1].all():
                    yield start, start + length


def brute_force(test_function, law, present, blocks):
    """sum over windows of w_k(u) w_l(u): each window's integral of a pulse at every sample."""
    orders = test_function.smoothness + 1
    found = list(windows(test_function, law, present, blocks))
    drawn = WindowSet(*(jnp.array(place) for place in zip(*found)))

    def of_pulse(order, u):
        values = jnp.zeros((orders, 1, N)).at[order, 0, u].set(1.0)
        if isinstance(test_function, Bump):
            # Lengths of their own, which a set of drawn windows would round.
            return of_bump(test_function, values, found)
        columns = Columns(values, None, jnp.asarray(STEP), ())
        return test_function.integrals(columns, drawn)[0][0]

    every = jax.vmap(lambda k: jax.vmap(lambda u: of_pulse(k, u))(jnp.arange(N)))
    rows = np.asarray(every(jnp.arange(orders)))  # orders, samples, windows
    return np.einsum("kuw,luw->klu", rows, rows)


def of_bump(bump, values, found):
    """By the formula: h phi, -h phi', h phi'' of (1 - tau^2)^p at the samples."""
    rows = []
    for start, stop in found:
        length = stop - start
        tau = 2 * np.arange(1, length) / length - 1
        slope, p = 2 / (length * STEP), bump.p
        one = (1 - tau**2) ** p
        two = -slope * (-2 * p * tau * (1 - tau**2) ** (p - 1))
        three = slope**2 * (
            -2 * p * (1 - tau**2) ** (p - 1) + 4 * p * (p - 1) * tau**2 * (1 - tau**2) ** (p - 2)
        )
        weights = STEP * np.stack([one, two, three])
        rows.append(jnp.sum(weights * values[:, 0, start + 1 : stop]))
    return jnp.stack(rows)


@pytest.mark.parametrize("present", [None, PRESENT])
@pytest.mark.parametrize(
    "test_function",
    [Boxcar(2), Boxcar(4), Boxcar(8), Hat(2), Hat(4), Hat(6), Hat(8), Bump(3)],
    ids=repr,
)
def test_weights_are_those_of_windows_one_by_one(test_function, present):
    law = BUMPS if isinstance(test_function, Bump) else LAW
    law = LONG if getattr(test_function, "quadrature", 0) > 4 else law
    blocks = StartBlocks(8, 14, 2)
    columns = Columns(
        jnp.zeros((test_function.smoothness + 1, 1, N)),
        None if present is None else jnp.asarray(present),
        jnp.asarray(STEP),
        (),
    )
    law = LagBins(*map(jnp.asarray, law))
    weights = np.asarray(test_function.noise_weights(columns, law, blocks))
    there = np.ones(N, bool) if present is None else present
    expected = brute_force(test_function, law, there, blocks)
    # Away from the record's ends, whose quadrature is another, and beside the steps at which the
    # odd products of a hat change sign, which cancel over a window.
    inner = slice(6, N - 9)
    size = np.abs(expected).max(axis=-1)[..., None]
    assert np.allclose(weights[..., inner] / size, expected[..., inner] / size, atol=1e-9)
