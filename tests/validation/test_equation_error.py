import jax
import jax.numpy as jnp
import numpy as np
import pytest

from riecjax.criteria.test_functions import Boxcar, Hat
from riecjax.criteria.windows import WindowSet
from riecjax.equations.equation import Equation
from riecjax.equations.expressions import constant
from riecjax.equations.noisy_columns import sampled_columns
from riecjax.equations.procedure import staged
from riecjax.equations.term import Term
from riecjax.errors import DataError, ModelError
from riecjax.models.oscillators import TwoMass, two_mass_equation
from riecjax.records.record import Record, stack_records
from riecjax.simulation.inputs import band_limited_noise
from riecjax.simulation.simulate import simulate
from riecjax.validation.equation_errors import equation_error, errors_over_records, joined

STEP, W = 0.01, 2 * np.pi * 3
TIME = STEP * np.arange(400)


def velocity_equation() -> Equation:
    """m v' + c v = F."""
    return Equation(
        Term("m", "v", derivative=1, unit="kg"),
        Term("c", "v", unit="N s/m"),
        -Term(1.0, "F", unit="N"),
        name="mass",
        unit="N",
    )


def position_equation() -> Equation:
    """m x'' + k x = F."""
    return Equation(
        Term("m", "x", derivative=2, measured=("dx", "ddx"), unit="kg"),
        Term("k", "x", unit="N/m"),
        -Term(1.0, "F", unit="N"),
        unit="N",
    )


def oscillation(**extra) -> Record:
    """x = sin(W t), with the force that m = 2, c = 3 needs, and a part left out."""
    x, v = np.sin(W * TIME), W * np.cos(W * TIME)
    force = 2 * (-(W**2) * x) + 3 * v + 5 * np.cos(7 * TIME)
    return Record({"x": x, "v": v, "F": force, **extra}, STEP)


def mean_over(weight, function):
    """Mean of a function under a weight on (0, 1) from each sample on, by Gauss's quadrature."""
    nodes, weights = np.polynomial.legendre.leggauss(20)
    place = 0.5 * (nodes + 1)
    span = 1 if weight is None else 2
    at = TIME[:-span, None] + span * STEP * place[None, :]
    under = weights / 2 if weight is None else weights / 2 * weight(place)
    return function(at) @ under


def test_error_and_explained_part_are_means_over_each_sample_interval():
    (found,) = equation_error(velocity_equation(), oscillation(), {"m": 2.0, "c": 3.0})
    left_out = mean_over(None, lambda t: 5 * np.cos(7 * t))
    motion = mean_over(None, lambda t: -2 * W**2 * np.sin(W * t) + 3 * W * np.cos(W * t))
    np.testing.assert_allclose(found.error, left_out, atol=1e-5)
    np.testing.assert_allclose(found.explained, motion, atol=1e-5)
    np.testing.assert_allclose(found.target, left_out + motion, atol=1e-5)
    assert (found.span, found.name, found.unit) == (1, "mass", "N")
    assert bool(jnp.all(found.present))
    expected = np.sqrt(np.sum(left_out**2) / np.sum((left_out + motion) ** 2))
    assert float(found.relative_rms) == pytest.approx(expected, rel=1e-6)


def test_a_second_derivative_is_moved_onto_a_triangle_of_two_samples():
    record = oscillation().select("x", "F")
    (found,) = equation_error(position_equation(), record, {"m": 2.0, "k": 10.0})

    def triangle(place):
        return 2 * (1 - np.abs(2 * place - 1))

    def force(t):
        return -2 * W**2 * np.sin(W * t) + 3 * W * np.cos(W * t) + 5 * np.cos(7 * t)

    target = mean_over(triangle, force)
    explained = mean_over(triangle, lambda t: (10 - 2 * W**2) * np.sin(W * t))
    assert found.span == 2
    # The triangle has a corner inside the interval, which Gauss's nodes see.
    np.testing.assert_allclose(found.target, target, atol=2e-3 * np.max(np.abs(target)))
    np.testing.assert_allclose(found.explained, explained, atol=2e-3 * np.max(np.abs(target)))


def test_a_recorded_velocity_saves_the_second_derivative():
    record = oscillation(dx=W * np.cos(W * TIME))
    (found,) = equation_error(position_equation(), record, {"m": 2.0, "k": 10.0})
    assert found.span == 1


@pytest.mark.parametrize("weight", [Boxcar(8), Hat(8)])
def test_rises_of_the_impulse_are_the_errors_of_windows(weight):
    equation = velocity_equation() if isinstance(weight, Boxcar) else position_equation()
    record = oscillation() if isinstance(weight, Boxcar) else oscillation().select("x", "F")
    values = {"m": 1.7, "c": 2.0, "k": 11.0}
    (found,) = equation_error(equation, record, values)
    start, stop = jnp.array([0, 10, 200]), jnp.array([40, 16, 390])
    columns, _ = weight.integrals(
        sampled_columns(equation, record, weight.smoothness), WindowSet(start, stop)
    )
    theta = jnp.array([values[name] for name in equation.parameters])
    whole = columns[0] - theta @ columns[1:]
    impulse = np.concatenate([[0.0], found.impulse])
    if found.span == 1:
        rises = impulse[stop] - impulse[start]
    else:
        twice = np.concatenate([[0.0], np.cumsum(impulse[1:] * STEP)])
        # A hat over 2 L is made of hats over two samples, as a second running sum.
        middle = (start + stop) // 2
        rises = twice[stop - 1] - 2 * twice[middle - 1] + np.where(start > 0, twice[start - 1], 0)
    np.testing.assert_allclose(rises, whole, rtol=1e-6, atol=1e-8)


@pytest.mark.slow
def test_impulse_of_a_mode_is_bounded_by_equation_8():
    force = band_limited_noise(jax.random.key(3), 20_000, 0.001, bandwidth=100.0, rms=100.0)
    system = TwoMass(*(jnp.asarray(value) for value in (10.0, 1.0, 100.0, 0.5)))
    record = simulate(system, Record({"F": force}, 0.001)).record
    (found,) = equation_error(two_mass_equation(), record.select("z", "dz", "F"), {"M": 11.0})
    # Eq. (6), whose integral is the momentum of m2 = 1 kg against m1.
    gained = record["dd"][1:] - record["dd"][0]
    np.testing.assert_allclose(found.impulse, gained, atol=0.1 * float(jnp.max(jnp.abs(gained))))
    reach = float(jnp.max(found.impulse) - jnp.min(found.impulse))
    bound = 2 * float(jnp.max(jnp.abs(record["dd"])))
    assert 0.5 * bound < reach < 1.05 * bound


def test_missing_samples_are_not_present_and_touch_no_other():
    gap = np.zeros(400, bool)
    gap[100:103] = True
    whole = oscillation()
    record = whole.with_signals({"F": whole["F"]}, missing={"F": jnp.asarray(gap)})
    values = {"m": 2.0, "c": 3.0}
    (found,) = equation_error(velocity_equation(), record, values)
    (intact,) = equation_error(velocity_equation(), whole, values)
    there = ~(gap[1:] | gap[:-1])
    np.testing.assert_array_equal(found.present, there)
    np.testing.assert_array_equal(found.error[~there], 0)
    # Quadrature falls back to the trapezoid beside a gap, which is 0.3 % off here.
    most = float(jnp.max(jnp.abs(intact.target)))
    np.testing.assert_allclose(found.error[there], intact.error[there], atol=0.004 * most)
    np.testing.assert_allclose(found.error[110:], intact.error[110:], atol=1e-8)


def test_without_a_known_term_the_first_one_is_the_target():
    free = Equation(Term("m", "v", derivative=1), Term("k", "x"), Term("b", constant))
    record = oscillation()
    (found,) = equation_error(free, record, {"m": 2.0, "k": 700.0, "b": 4.0})
    rise = 2.0 * jnp.diff(record["v"]) / STEP
    np.testing.assert_allclose(found.target, -rise, rtol=1e-9)
    x = mean_over(None, lambda t: np.sin(W * t))
    np.testing.assert_allclose(found.explained, 700 * x + 4, atol=1e-5)


@pytest.mark.slow
def test_it_jits_and_vmaps_and_names_every_equation_of_a_procedure():
    records = [oscillation(), oscillation()]
    records[1] = records[1].with_signals({"F": 2 * records[1]["F"]})
    other = Equation(Term(1.0, "F"), -Term("d", "v"), name="damper")
    model = staged(velocity_equation(), other)
    values = {"m": jnp.array(2.0), "c": jnp.array(3.0), "d": jnp.array(1.0)}
    one_by_one = [equation_error(model, record, values) for record in records]
    at_once = jax.jit(jax.vmap(lambda record: equation_error(model, record, values)))(
        stack_records(records)
    )
    assert [each.name for each in at_once] == ["mass", "damper"]
    for i, alone in enumerate(one_by_one):
        for batch, each in zip(at_once, alone):
            np.testing.assert_allclose(batch.error[i], each.error, atol=1e-8)


def test_records_are_joined_with_a_gap_and_take_their_own_parameters():
    model = Equation(*velocity_equation().terms, Term("offset", constant), name="mass")
    records = [oscillation(), oscillation()]
    records[1] = records[1].with_signals({"F": records[1]["F"] + 6.0})
    values = {"m": 2.0, "c": 3.0, "offset[1]": 0.0, "offset[2]": 6.0}
    (parts,) = errors_over_records(model, records, values)
    np.testing.assert_allclose(parts[0].error, parts[1].error, atol=1e-9)
    whole = joined(parts, 7)
    assert whole.error.shape == (2 * 399 + 7,)
    assert int(jnp.sum(~whole.present)) == 7
    np.testing.assert_array_equal(whole.error[399 + 7 :], parts[1].error)


def test_what_cannot_be_computed_says_so():
    with pytest.raises(ModelError, match="needs a value of 'c'"):
        equation_error(velocity_equation(), oscillation(), {"m": 2.0})
    with pytest.raises(DataError, match="2 samples has no equation error"):
        equation_error(velocity_equation(), oscillation().part(0, 2), {"m": 2.0, "c": 1.0})
    slow = Record(oscillation().arrays, 0.02)
    with pytest.raises(DataError, match="one time step"):
        errors_over_records(velocity_equation(), [oscillation(), slow], {"m": 2.0, "c": 1.0})


def test_times_count_from_the_recording_s_first_sample():
    whole = oscillation()
    stamped = Record(whole.arrays, STEP, 1.7e9).part(150, 300)
    (left,) = equation_error(position_equation(), stamped, {"m": 2.0, "k": 1.0})
    # Windows of two samples: the first has its middle at sample 151.
    np.testing.assert_allclose(left.times, 1.51 + STEP * np.arange(148), rtol=1e-12)
    both = joined([left, left], pad=3)
    np.testing.assert_allclose(both.times, 1.51 + STEP * np.arange(2 * 148 + 3), rtol=1e-12)
