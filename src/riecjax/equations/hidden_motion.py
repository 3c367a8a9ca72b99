"""The motion of hidden masses, from that of the bodies that carry them.

A mass on a spring and a damper moves by w = (1 + q s) / D v, D = 1 + q s + p s^2, where v is its
body's motion (see `hidden_modes`). With w among the signals, an equation with modes is one without:
each mode adds the term M w'. So whatever reads an equation sample by sample need not know of them.
"""

from collections.abc import Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from riecjax.equations.equation import Equation
from riecjax.equations.hidden_modes import Expanded, HiddenMode, ModeParameters, Shape, inertia_sign
from riecjax.equations.procedure import Procedure
from riecjax.equations.term import AbstractTerm, Term
from riecjax.records.record import Record

FORGOTTEN = 0.01
"""Share to which what is not known of a mass's start must have decayed."""
LONGEST_START = 0.25
"""Share of a record that is left out at the most until it has."""


def with_hidden_motion(
    procedure: Procedure, record: Record, values: Mapping[str, Array]
) -> tuple[Procedure, Record]:
    """A procedure without modes, and the record with the motion of their masses, for these values.

    Samples are marked missing until the start is forgotten, of a record and after each gap. A
    procedure without modes and its record come back as they are.
    """
    signals: dict[str, Array] = {}
    missing: dict[str, Array] = {}
    stages = []
    for stage in procedure.stages:
        carrying = []
        for equation in stage:
            terms = list(equation.terms)
            for number, mode in enumerate(procedure.modes):
                names = ModeParameters.of(number)
                inertia = mode.inertia(equation)
                if inertia is None:
                    continue
                terms.append(_mass_term(mode, inertia, names))
                shape = Expanded.shape(values, names)
                for body in _motions(inertia):
                    mine = _name(body, names)
                    if body in record.arrays and mine not in signals:
                        signals[mine], present = followed(record, body, shape)
                        missing[mine] = ~present
            carrying.append(_with(equation, terms))
        stages.append(tuple(carrying))
    if not procedure.modes:
        return procedure, record
    return Procedure(tuple(stages)), record.with_signals(signals, missing=missing)


def followed(
    record: Record, body: str, shape: Shape
) -> tuple[Float[Array, " n"], Bool[Array, " n"]]:
    """A mass's motion from its body's, and where that is known.

    By the discrete Fourier transform, exact for motion below half the sampling rate. The record is
    continued at both ends by its mirror image through the end point, which has the same slope.
    """
    samples, step = record[body], record.time_step
    count = samples.shape[-1]
    place = jnp.arange(count)
    there = record.present((body,))
    there = jnp.ones(count, bool) if there is None else there
    # The last sample that was there stands for those that are not.
    before = jax.lax.cummax(jnp.where(there, place, 0))
    x = samples[before]
    around = jnp.concatenate([2 * x[0] - x[:0:-1], x, 2 * x[-1] - x[-2::-1]])
    rate = 2j * np.pi * jnp.fft.rfftfreq(around.shape[-1]) / step
    gain = (1 + shape.q * rate) / (1 + shape.q * rate + shape.p * rate**2)
    moved = jnp.fft.irfft(jnp.fft.rfft(around) * gain, around.shape[-1])[count - 1 : 2 * count - 1]
    since = (place - jax.lax.cummax(jnp.where(there, -1, place))) * step
    # What is free decays as exp(-q t / (2 p)).
    forgotten = -np.log(FORGOTTEN) * 2 * shape.p / jnp.where(shape.q > 0, shape.q, 1.0)
    longest = LONGEST_START * count * step
    start = jnp.where(shape.q > 0, jnp.minimum(forgotten, longest), longest)
    return moved.astype(samples.dtype), there & (since > start)


def _motions(inertia: Term) -> Sequence[str]:
    """The signals of a body's motion that an inertia may read."""
    assert isinstance(inertia.of, str)
    return (inertia.of, *inertia.measured)


def _name(body: str, names: ModeParameters) -> str:
    return f"{body} of {names.mass}"


def _mass_term(mode: HiddenMode, inertia: Term, names: ModeParameters) -> Term:
    return Term(
        names.mass,
        _name(str(inertia.of), names),
        derivative=inertia.derivative,
        measured=tuple(_name(one, names) for one in inertia.measured),
        sign=inertia_sign(inertia),
        unit=inertia.unit,
    )


def _with(equation: Equation, terms: Sequence[AbstractTerm]) -> Equation:
    return Equation(*terms, name=equation.name, unit=equation.unit, where=equation.where)
