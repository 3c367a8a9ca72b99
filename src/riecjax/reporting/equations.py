"""Equations of motion in words: `m x'' + c x' + k x = u`."""

from collections.abc import Iterable

import numpy as np

from riecjax.arrays import is_concrete
from riecjax.equations.equation import Equation
from riecjax.equations.expressions import Expression, constant
from riecjax.equations.model import Model
from riecjax.equations.term import AbstractTerm
from riecjax.leaves import Leaf

Signed = tuple[bool, str]
"""Whether a summand is subtracted, and the summand."""


def equation_in_words(equation: Equation) -> str:
    """Terms with a named coefficient on the left, the others on the right.

    A coefficient whose value is known stands as that number; the first term is not subtracted.
    """
    left = [part for term in equation.terms if term.parameters for part in _parts(term)]
    right = [part for term in equation.terms if not term.parameters for part in _parts(term)]
    turned = left[0][0]
    left = [(minus != turned, words) for minus, words in left]
    right = [(minus == turned, words) for minus, words in right]
    return f"{_sum(left)} = {_sum(right) if right else '0'}"


def model_in_words(model: Model) -> list[str]:
    """A line for each equation, with the stage that solves it, and one for each hidden element."""
    lines = []
    for i, (stage, names) in enumerate(zip(model.stages, model.equation_names)):
        number = f"{i + 1}. " if len(model.stages) > 1 else ""
        lines += [f"{number}{name}: {equation_in_words(one)}" for name, one in zip(names, stage)]
    return [*lines, *(f"with {element.described}" for element in model.elements)]


def parameters_in_words(names: Iterable[str], units: dict[str, str]) -> str:
    """Names, each with its unit in brackets."""
    return ", ".join(f"{name} [{units[name]}]" if units.get(name) else name for name in names)


def expression_in_words(of: Expression) -> str:
    """A signal's name, what a function of signals is called, or `f(signals)` of a nameless one."""
    if isinstance(of, str):
        return of
    name = getattr(of, "__name__", type(of).__name__)
    return "f(signals)" if name == "<lambda>" else name.lstrip("_")


def _sum(parts: list[Signed]) -> str:
    words = " ".join(f"{'-' if minus else '+'} {words}" for minus, words in parts)
    return f"-{words[2:]}" if words.startswith("- ") else words.removeprefix("+ ")


def _parts(term: AbstractTerm) -> list[Signed]:
    """The summands of a term."""
    factor, of = term.factor, expression_in_words(term.of)
    if not term.is_linear:
        minus, size = _number(factor)
        front = "" if size == "1" else f"{size} "
        return [(minus, f"{front}{words}") for words in term.words(of)]
    name = next(iter(term.parameters), "")
    if term.known_values and is_concrete(factor, term.known_values):
        factor, name = np.asarray(factor) * np.asarray(term.known_values[name]), ""
    minus, size = _number(factor)
    if term.of is constant:
        of = ""
    elif not isinstance(term.of, str) and (" - " in of or term.derivative):
        of = f"({of})"
    factors = ("" if size == "1" else size, name, of + "'" * term.derivative)
    return [(minus, " ".join(filter(None, factors)) or size)]


def _number(number: Leaf) -> Signed:
    """Sign and size of a coefficient; one that is traced, or of a batch, has neither."""
    if not is_concrete(number) or np.ndim(number):
        return False, "(…)"
    value = float(number)
    return value < 0, f"{abs(value):.6g}"
