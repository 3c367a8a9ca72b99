"""What elements do, as signals made from the motion that they follow.

An element of shape N / D passes what it follows on as N / D of it (see `element`): a hidden mass
moves by w = N / D v, where v is its body's motion. With that among the signals an equation with
elements is one without. So whatever reads an equation sample by sample need not know of them.
"""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from riecjax import arrays as xp
from riecjax.arrays import Array
from riecjax.equations.element import Shape
from riecjax.equations.equation import Equation
from riecjax.equations.expressions import evaluate
from riecjax.equations.model import Model
from riecjax.equations.term import AbstractTerm
from riecjax.records.record import Record
from riecjax.records.signal import Signal

FORGOTTEN = 0.01
"""Share to which what is not known of a mass's start must have decayed."""
LONGEST_START = 0.25
"""Share of a record that is left out at the most until it has."""


def with_element_motion(
    model: Model, record: Record, values: Mapping[str, Array]
) -> tuple[Model, Record]:
    """A model without searched elements, and the record with what these do, for these values.

    Samples are marked missing until the start is forgotten, of a record and after each gap.

    **Raises:** `ModelError` for an element that the motion alone tells nothing of.
    """
    signals: dict[str, Signal] = {}

    def following(term: AbstractTerm, label: str, shape: Shape) -> list[str]:
        """Names of what follows a term's expression, and its derivatives, by this shape."""
        of = term.of if isinstance(term.of, str) else term.name
        names = [f"{name} {label}" for name in (of, *term.measured)]
        for name, read in zip(names, (term.of, *term.measured)):
            if name not in signals and (callable(read) or read in record.arrays):
                signals[name] = filtered(evaluate(read, record), record.time_step, shape)
        return names

    def without(equation: Equation) -> Equation:
        for element in model.hidden:
            equation = element.moved(equation, values, following)
        return equation

    # In this order: the stages fill the signals.
    return Model(stages=model.by_stage(without)), record.with_signals(signals)


def filtered(signal: Signal, step: Float[Array, ""], shape: Shape) -> Signal:
    """N / D of some samples, and where that is known.

    By the discrete Fourier transform, exact for motion below half the sampling rate. The record is
    continued at both ends by its mirror image through the end point, which has the same slope.
    """
    samples = signal.values
    count = samples.shape[-1]
    place = np.arange(count)
    there = np.ones(count, bool) if signal.present is None else signal.present
    # The last sample that was there stands for those that are not.
    before = xp.running_max(xp.where(there, place, 0))
    x = samples[before]
    around = xp.concatenate([2 * x[0] - x[:0:-1], x, 2 * x[-1] - x[-2::-1]])
    rate = 2j * np.pi * xp.fft.rfftfreq(around.shape[-1]) / step
    gain = xp.polyval(shape.numerator[::-1], rate) / xp.polyval(shape.denominator[::-1], rate)
    moved = xp.fft.irfft(xp.fft.rfft(around) * gain, around.shape[-1])[count - 1 : 2 * count - 1]
    since = (place - xp.running_max(xp.where(there, -1, place))) * step
    longest = LONGEST_START * count * step
    start = xp.minimum(-np.log(FORGOTTEN) * shape.decay, longest)
    return Signal(moved.astype(samples.dtype), there & (since > start))
