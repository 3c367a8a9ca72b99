"""Expressions of signals: what a term or a mask is of, common ones, and their samples.

Two of the common ones that say the same compare equal, so that building an equation anew compiles
nothing anew, as a fresh `lambda` would.
"""

import functools
import json
import operator
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from riecjax import arrays as xp
from riecjax.arrays import Array
from riecjax.errors import ModelError, users_code
from riecjax.records.record import Record, Signals
from riecjax.records.relations import Relation
from riecjax.records.signal import Signal, both

Expression = str | Callable[[Signals], Array]
"""A signal's name, or a function of the signals such as `lambda s: s["x3"] - s["x4"]`.

A function returns one number for each sample, which depends on that sample alone (long records are
worked through in chunks), or one for all if it reads no signal. Made of operators and of riecjax's
functions it runs eagerly on NumPy and traced on JAX alike. Functions of `jax.numpy` do so too,
eagerly in double precision, and compile for each new number of samples; those of `numpy` run
eagerly alone, so that such a model is identified and not refined.
Write functions once, at module level: a new function object each time compiles anew.
"""


def combined(function: Callable[..., Array], *signals: Signal) -> Signal:
    """A function of the values of several, present where all of these are."""
    masks = (signal.present for signal in signals)
    return Signal(function(*(s.values for s in signals)), functools.reduce(both, masks, None))


def evaluate(expression: Expression, record: Record) -> Signal:
    """Samples of an expression on a record, present where every signal that it reads is.

    **Raises:** `DataError` for a missing signal, `ModelError` if a function of the user's own
    fails or does not return one number for each sample.
    """
    if isinstance(expression, str):
        return record.signal(expression)
    signals = record.signals
    name = label_of(expression)
    with users_code(f"the expression {name}"):
        samples = called(expression, signals)
    # One number of the signals, such as their sum, is a slip; one of no signal is a constant.
    if samples.shape == () and not signals.read:
        samples = xp.broadcast_to(samples, (record.sample_count,))
    if samples.shape != (record.sample_count,):
        raise ModelError(
            f"the expression {name} must return one number for each of the {record.sample_count} "
            f"samples; it returned shape {samples.shape}."
        )
    return Signal(samples, record.present(signals.read))


@np.errstate(all="ignore")
def called(function: Callable[[Signals], Any], signals: Signals) -> Array:
    """What a function makes of signals, as an array.

    One of known signals that is of JAX runs in double precision, and comes back as NumPy's.
    """
    samples = xp.in_double(lambda *_: function(signals), *signals.data.values())
    return samples if xp.is_traced(samples) else xp.asarray(samples)


def read_expression(expression: Expression, signals: Signals) -> None:
    """Note in `signals.read` what an expression reads, without computing anything."""
    if isinstance(expression, str):
        _ = signals[expression]
        return
    probe = Signals(dict.fromkeys(signals.data, np.full(2, 0.5)))
    probe.read = signals.read
    # While something else is traced, what is known is not traced with it.
    with users_code(f"the expression {label_of(expression)}"), jax.ensure_compile_time_eval():
        called(expression, probe)


class _AnySignals(Signals):
    """Signals of any name, which note in what order they are read."""

    def __init__(self):
        # An expression may ask for some signal, no matter which, to learn the number of samples.
        super().__init__({"": np.zeros(1)})
        self.order: list[str] = []

    def __getitem__(self, name: str) -> Array:
        if name not in self.data:
            self.order.append(name)
        return np.full(1, 0.5)

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str)


def signals_read(expression: Expression) -> tuple[str, ...]:
    """Signals that an expression reads, in order.

    **Raises:** `ModelError` for a function that fails, or returns other than a number a sample.
    """
    if isinstance(expression, str):
        return (expression,)
    signals = _AnySignals()
    with users_code(f"the expression {label_of(expression)}"):
        shape = called(expression, signals).shape
    if shape != (1,) and (shape != () or signals.order):
        raise ModelError(
            f"the expression {label_of(expression)} must return one number for each sample; for "
            f"one sample it returned shape {shape}."
        )
    return tuple(dict.fromkeys(signals.order))


def label_of(expression: Expression) -> str:
    """What an expression is called in messages."""
    return expression if isinstance(expression, str) else getattr(expression, "__name__", "given")


def constant(signals: Signals) -> Array:
    """1 at every sample: `Term("offset", constant, unit="N")` is a constant force."""
    return np.ones(())


@dataclass(frozen=True)
class _Formula:
    """A function of signals that is equal to another one of this kind and these arguments.

    **Fields:** `kind`, as users call it, in `FORMULAS`; `arguments`, expressions and numbers;
    `words`.
    """

    kind: str
    arguments: tuple[Expression | float, ...]
    words: str

    @property
    def __name__(self) -> str:
        return self.words

    @property
    def source(self) -> str | None:
        """As it is written, if its arguments can be."""
        texts = [
            repr(of) if isinstance(of, int | float) else source_of(of) for of in self.arguments
        ]
        return None if None in texts else f"{self.kind}({', '.join(map(str, texts))})"

    def __call__(self, signals: Signals) -> Array:
        values = (
            signals[of] if isinstance(of, str) else of(signals) if callable(of) else of
            for of in self.arguments
        )
        return FORMULAS[self.kind](*values)


FORMULAS: dict[str, Callable[..., Array]] = {
    "odd": lambda x, power: x**power if power % 2 else xp.sign(x) * xp.abs(x) ** power,
    "even": lambda x, power: xp.abs(x) ** power if power % 2 else x**power,
    "product": lambda *factors: functools.reduce(operator.mul, factors),
    "difference": operator.sub,
    "equations.faster_than": lambda x, threshold: xp.abs(x) > threshold,
}


def _raised(base: str, power: int) -> str:
    return base if power == 1 else f"{base}^{power}"


def odd(name: str, power: int) -> _Formula:
    """sign(x) |x|^power of a signal x: dry friction of a velocity (0), drag (2), a cubic (3)."""
    if power % 2:
        words = _raised(name, power)
    else:
        words = f"{name} {_raised(f'|{name}|', power - 1)}" if power else f"sign({name})"
    return _Formula("odd", (name, power), words)


def even(name: str, power: int) -> _Formula:
    """|x|^power of a signal x, the same in both directions."""
    words = _raised(f"|{name}|" if power % 2 else name, power) if power else "1"
    return _Formula("even", (name, power), words)


def source_of(of: Expression) -> str | None:
    """An expression as it is written after `import riecjax as rx`; `None` for a function of the
    user's own."""
    if isinstance(of, str):
        return json.dumps(of, ensure_ascii=False)
    if of is constant:
        return "rx.constant"
    source = getattr(of, "source", None)
    return None if source is None else f"rx.{source}"


def product(*factors: Expression) -> _Formula:
    """The product of signals and expressions, such as `product("current", "flux")`."""
    return _Formula("product", factors, " ".join(map(label_of, factors)))


def difference(first: str, second: str) -> _Formula:
    """One signal minus another, such as the velocity across a damper."""
    return _Formula("difference", (first, second), f"{first} - {second}")


def faster_than(name: str, threshold: float) -> _Formula:
    """A mask: True where the signal's magnitude is above a threshold, in the signal's unit.

    Near standstill the sign of a measured velocity is noise, and so is Coulomb friction
    computed from it.
    """
    return _Formula("equations.faster_than", (name, threshold), f"|{name}| > {threshold:g}")


PROBES, EXACT = 32, 1e-5
"""Values that an expression is tried with, and how nearly it must be a sum of them."""


def relation_of(signal: str, rate: Expression) -> Relation | None:
    """The relation that a rate of a signal stands for; `None` unless it is a sum of signals."""
    if isinstance(rate, str):
        return Relation(signal, ((rate, 1.0),))
    try:
        read = signals_read(rate)
        probe = {n: np.random.default_rng(i).standard_normal(PROBES) for i, n in enumerate(read)}
        values = np.asarray(rate(Signals(probe)), float)  # pyright: ignore[reportArgumentType]
    except Exception:  # of the user's function, which says so where it is used
        return None
    if values.shape != (PROBES,) or not 0 < len(probe) < PROBES // 2 or signal in probe:
        return None
    columns = np.transpose([*probe.values()])
    factors = np.linalg.lstsq(columns, values)[0]
    if not np.abs(columns @ factors - values).max() < EXACT * np.abs(factors).max():
        return None
    # What rounding adds to 1 would be told as a factor.
    told = zip(probe, np.round(factors, 6).tolist())
    return Relation(signal, tuple((name, factor) for name, factor in told if factor))
