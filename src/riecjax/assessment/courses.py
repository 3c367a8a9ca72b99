"""What inputs are between samples, where a refinement is so exact that this shows."""

import jax.numpy as jnp
import numpy as np

from riecjax.assessment.asked import Asked
from riecjax.assessment.trust import seen, system_of
from riecjax.estimation.estimated_parameters import AbstractEstimate
from riecjax.records.consistency import is_motion
from riecjax.records.record import Record
from riecjax.refinement.objective import AbstractMisfit
from riecjax.refinement.output_error import OutputError
from riecjax.refinement.output_misfit import OutputMisfit
from riecjax.refinement.refine import Refined
from riecjax.simulation.intersample import Course

LIKELIER = float(np.log(100))
"""Odds, as a logarithm, from which inputs are taken for straight lines between samples. Where these
hardly show in what is left, they may still put a parameter off by several standard errors: of the
lesser of two sums of squares, noise would often choose the wrong one."""
SHOWS = 4.0
"""Squared difference of two simulations, in units of what is left, from which they compete."""


def straight_inputs(asked: Asked, estimate: AbstractEstimate) -> dict[str, Course]:
    """Inputs that may be straight lines between samples: not those with a recorded derivative.

    Of a position x that is read as an input, lines lack h^2 / 12 of x'' in every interval. A mass
    that is too small by k h^2 / 12 makes up for that to the last digit, and nothing left shows it.
    """
    system = system_of(asked.model, estimate.values, *seen(asked)[0])
    record = asked.records[0]
    rates = [n for n in (*system.state_names, *system.input_names) if n in record.arrays]
    others = {name: [one for one in rates if one != name] for name in system.input_names}
    return {n: "lines" for n in system.input_names if not is_motion(record, n, others[n])}


def course_shows(asked: Asked, refined: Refined, misfit: AbstractMisfit, by: OutputError) -> bool:
    """Whether inputs that go otherwise from one sample to the next would move the answer.

    What they move the simulation by, in units of what is left, is as chi-square: from a few on it
    is more than chance does to the parameters.
    """
    own = tuple(asked.settings["per_record"])
    other = by.misfit(by.specify(asked.model, asked.records, refined, {}, own, None))
    if not isinstance(misfit, OutputMisfit):
        return False
    at = jnp.asarray(refined.theta), jnp.asarray(refined.initial_states)
    apart = sum(
        np.sum((np.asarray(one) - np.asarray(two)) ** 2, axis=(0, 1))
        for one, two in zip(misfit.residuals(*at), other.residuals(*at))
    )
    left = (np.asarray(refined.rms) / np.asarray(misfit.sigma)) ** 2
    return bool(np.sum(apart / np.maximum(left, np.finfo(float).tiny)) > SHOWS)


def surely_likelier(one: Refined, other: Refined, records: list[Record]) -> bool:
    """Whether what was recorded is far likelier by one refinement than by another.

    Of n residuals with white noise of unknown size, the largest likelihood is rms^-n.
    """
    counts = []
    for name in one.quantities:
        masks = (record.present((name,)) for record in records)
        sizes = zip(masks, (record.sample_count for record in records))
        counts.append(sum(n if mask is None else int(np.sum(mask)) for mask, n in sizes))
    gains = np.log(np.asarray(other.rms) / np.asarray(one.rms))
    return bool(np.sum(np.array(counts) * gains) > LIKELIER)
