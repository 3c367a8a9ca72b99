"""An equation of motion, linear in its parameters."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial

import equinox as eqx
import numpy as np
from jaxtyping import Array

from riecjax.arrays import is_concrete
from riecjax.equations.expressions import evaluate, label_of, read_expression, signals_read
from riecjax.equations.quantity import Quantity
from riecjax.equations.term import AbstractTerm, from_elsewhere, samples_of
from riecjax.errors import ModelError, require
from riecjax.leaves import Leaf, PlainMethods
from riecjax.records.reading.units import contradict
from riecjax.records.record import Record, Signals
from riecjax.records.signal import Signal
from riecjax.shows import Shown

PROBE = 64
"""Samples that an expression is tried on."""


class Equation(PlainMethods, Shown, eqx.Module):
    """Terms that sum to zero, up to the equation error.

    Each is a coefficient times a time derivative of an expression of the signals. With the known
    terms on the left it is linear in the unknown coefficients: eq. (23) of the paper at a sample,
    eq. (24) integrated over a window.

    `M_s x4' = K_s x2 + F(x3 - x4)` is written as

    ```python
    Equation(
        Term("M_s", "x4", derivative=1, unit="kg"),
        -Term("K_s", "x2", unit="N/m"),
        -Terms("F", roof([-0.8, -0.3, 0.3, 0.8]), of=relative_velocity, unit="N"),
    )
    ```

    **Arguments:** the terms; `name` for messages and tables; `unit` of the terms, for figures;
    `where`, a function of the signals that is True at the samples where the equation is to be
    trusted, such as [`faster_than`][]`("dq", 1e-3)` where a sign of dq is noise. No window
    touches the others.

    **Raises:** `ModelError` if there is no unknown coefficient, or for what is no term.
    """

    terms: tuple[AbstractTerm, ...]
    where: Callable[[Signals], Array] | None = eqx.field(static=True)
    name: str = eqx.field(static=True)
    unit: str = eqx.field(static=True)

    def __init__(
        self,
        *terms: AbstractTerm,
        name: str = "equation",
        unit: str = "",
        where: Callable[[Signals], Array] | None = None,
    ):
        for term in terms:
            require(
                f"{name}: a term",
                term,
                AbstractTerm,
                "rx.Equation(rx.Term('m', 'x', derivative=2), -rx.Term(1.0, 'F')): terms one by "
                "one, rx.Equation(*terms) of a list",
            )
        self.terms = terms
        self.where = where
        self.name = name
        self.unit = unit
        if not self.parameters:
            raise ModelError(f"{name}: an equation needs at least one named coefficient.")
        for word in (name, unit, *self.parameters, *self.units.values()):
            if not (isinstance(word, str) and word.isprintable()):
                raise ModelError(f"names and units are shown, and must be printable; got {word!r}.")
        if not all(map(str.strip, (name, *self.parameters))):
            raise ModelError(f"{name.strip() or 'an equation'}: a name is empty.")

    def of_terms(self, *terms: AbstractTerm) -> "Equation":
        """Other terms under this equation's name, unit and mask."""
        return Equation(*terms, name=self.name, unit=self.unit, where=self.where)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the coefficients, known ones included, in order of first appearance."""
        return tuple(dict.fromkeys(name for term in self.terms for name in term.parameters))

    @property
    def units(self) -> dict[str, str]:
        """Unit of each named coefficient."""
        return first_stated([pair for term in self.terms for pair in term.units.items()])

    @property
    def known(self) -> Mapping[str, Leaf]:
        """Values of the named coefficients that are known in advance."""
        return {name: value for term in self.terms for name, value in term.known_values.items()}

    @property
    def signals(self) -> set[str]:
        """Names of the signals that the terms are of, or call derivatives of these."""
        return {name for t in self.terms for name in (*signals_read(t.of), *t.measured)}

    @property
    def has_target(self) -> bool:
        """Whether a term without an unknown name sets the scale of the solution."""
        return any(not term.parameters for term in self.terms)

    @property
    def derivatives(self) -> tuple[tuple[str, str], ...]:
        """Signals with those that the terms call their time derivatives."""
        return tuple(
            pair
            for term in self.terms
            if isinstance(term.of, str)
            for pair in zip((term.of, *term.measured), term.measured)
        )

    def inertia_of(self, body: str) -> AbstractTerm | None:
        """The term that accelerates a body, if there is one.

        **Arguments:** `body`, a velocity of which the term holds the first derivative, or a
        position, or its velocity, where it holds that one's second.
        """
        for term in self.terms:
            velocity = term.measured[0] if term.measured else f"d{term.signal}"
            moves = {1: (term.signal,), 2: (term.signal, velocity)}.get(term.derivative, ())
            if term.signal is not None and body in moves:
                return term
        return None

    @property
    def accelerated(self) -> tuple[str, ...]:
        """Signals of bodies that it accelerates."""
        signals = dict.fromkeys(t.signal for t in self.terms if t.derivative and t.signal)
        return tuple(of for of in signals if self.inertia_of(of) is not None)

    def signals_read(self, record: Record, smoothness: int, masked: bool = True) -> set[str]:
        """Names of the signals that a criterion reads which takes `smoothness` derivatives off.

        **Arguments:** `masked`: with those that only the mask reads.

        **Raises:** as [`evaluate`][] does, for an expression that cannot be evaluated.
        """
        signals = record.signals
        for term in self.terms:
            read_expression(term.expression(record, max(term.derivative - smoothness, 0)), signals)
        if masked and self.where is not None:
            read_expression(self.where, signals)
        return signals.read


def first_stated(units: Sequence[tuple[str, str]]) -> dict[str, str]:
    """Unit by name as the first of these pairs states it, empty where none does."""
    return dict(units) | {name: unit for name, unit in reversed(units) if unit}


def require_agreement(equations: Iterable[Equation], quantities: Iterable[Quantity]) -> None:
    """Raise `ModelError` for a coefficient of which terms, or these quantities, say two things."""
    values: dict[str, Leaf] = {}
    units = {name: unit for name, unit, *_ in quantities if unit}
    for term in (term for equation in equations for term in equation.terms):
        for name, value in term.known_values.items():
            said = values.setdefault(name, value)
            if is_concrete(said, value) and said != value:
                raise ModelError(f"{name} is known as {said:g} and, in another term, as {value:g}.")
        for name, unit in term.units.items():
            if unit and contradict(unit, said := units.setdefault(name, unit)):
                raise ModelError(f"the unit of {name} is {said} and, in another term, {unit}.")


def mixing_expressions(equations: Iterable[Equation], record: Record) -> list[str]:
    """Expressions whose value at one sample depends on others, as `equation: name` (not under jit).

    A mean, a difference between neighbours or a filter would see only a chunk of the record, or
    what fills it up. Each is tried on samples from all over the record, and on halves of these;
    and so is what a class of terms from elsewhere makes.
    """
    tried: list[tuple[str, Callable[..., Signal]]] = []
    for equation in equations:
        for expression in (*(term.of for term in equation.terms), equation.where):
            if callable(expression):
                label = label_of(expression)
                tried.append((f"{equation.name}: {label}", partial(evaluate, expression)))
        for term in equation.terms:
            if from_elsewhere(type(term)) or from_elsewhere(type(term.basis)):
                label = type(term).__name__
                tried.append((f"{equation.name}: {label}", partial(samples_of, term, order=0)))
    if not tried:
        return []
    at = np.linspace(0, record.sample_count - 1, PROBE).astype(int)
    arrays = {name: np.asarray(values)[at] for name, values in record.arrays.items()}
    thinned, half = Record(arrays, record.time_step), PROBE // 2
    parts = [thinned, thinned.part(0, half), thinned.part(half, PROBE)]

    def mixes(samples: Callable[..., Signal]) -> bool:
        whole, *halves = (np.asarray(samples(record=part).values) for part in parts)
        # Of differences of large numbers, compilers may round halves otherwise than the whole.
        size = np.max(np.abs(whole), where=np.isfinite(whole), initial=0.0)
        both = np.concatenate(halves, axis=-1)
        return not np.allclose(whole, both, rtol=1e-9, atol=1e-9 * size, equal_nan=True)

    try:
        return [label for label, samples in tried if mixes(samples)]
    except ModelError:  # told of the whole record, where it is summed
        return []
