"""Signals computed from others by a formula of the user's: `35.15 * vir - mean(vir)`."""

import ast
import re
import warnings
from collections.abc import Callable, Mapping

import numpy as np

from riecjax.errors import ModelError

LONGEST_FORMULA = 2000
"""Characters of a formula."""


def _mean(values: np.ndarray) -> np.ndarray:
    known = values[~np.isnan(values)]
    return np.asarray(known.mean() if known.size else np.nan)


FUNCTIONS: dict[str, Callable[..., np.ndarray]] = {
    name: getattr(np, name)
    for name in ("sin", "cos", "tan", "exp", "log", "sqrt", "abs", "sign", "tanh", "minimum")
} | {"maximum": np.maximum, "mean": _mean}
"""What a formula may call. `mean` leaves gaps out."""
OPERATIONS: dict[type, Callable[..., np.ndarray]] = {
    ast.Add: np.add,
    ast.Sub: np.subtract,
    ast.Mult: np.multiply,
    ast.Div: np.divide,
    ast.Pow: np.float_power,
    ast.USub: np.negative,
    ast.UAdd: np.positive,
}


def derived(formula: str, columns: Mapping[str, np.ndarray]) -> np.ndarray:
    """The values of a formula of numbers, columns, `+ - * / **` and a few functions.

    Nothing but these is understood, and nothing is executed. Gaps (NaN) stay
    gaps; numbers are 64-bit floats throughout.

    **Arguments:** `columns`: name to samples, shape `(n,)`, or to a number, as in `rig.gain * vir`;
    a column whose name is no Python name must be renamed first.

    **Raises:** `ModelError` naming the piece that is not understood.
    """
    if len(formula) > LONGEST_FORMULA:
        raise ModelError(f"a formula may have {LONGEST_FORMULA} characters, not {len(formula)}.")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of `1if`, which is refused
            tree = ast.parse(formula.strip(), mode="eval")
        with np.errstate(all="ignore"):
            value = _value(tree.body, formula.strip(), columns)
    except ModelError:
        raise
    except OverflowError:
        raise ModelError(f"a number in {formula[:40]!r} is too large.") from None
    except (SyntaxError, ValueError):
        raise ModelError(f"the formula {formula[:80]!r} cannot be read.") from None
    except (RecursionError, MemoryError):
        raise ModelError(f"the formula {formula[:40]!r}... is nested too deep.") from None
    length = max(map(np.size, columns.values()), default=1)
    return np.array(np.broadcast_to(value, (length,)), dtype=float)


def names_in(formula: str) -> set[str]:
    """Names of columns and functions in a formula."""
    return {*re.findall(r"[^\W\d]\w*", formula)}


def sensitivities(
    formula: str, columns: Mapping[str, np.ndarray], levels: Mapping[str, float]
) -> dict[str, float]:
    """How much a formula's values change with each of its columns, r.m.s. over the samples.

    By central differences of a noise's standard deviation, to one side or the other by turns that
    follow no pattern, so that a mean in the formula stays. Negative where most values fall.

    **Arguments:** `levels`, standard deviations of the columns' noise; of those that are not named
    or have none there is no sensitivity.
    """
    names = {node.id for node in ast.walk(ast.parse(formula.strip())) if isinstance(node, ast.Name)}
    found = {}
    for name in sorted(names & columns.keys() & {k for k, level in levels.items() if level > 0}):
        values = columns[name]
        side = np.random.default_rng(0).choice([-1.0, 1.0], values.size)
        above, below = (
            derived(formula, {**columns, name: values + sign * side * levels[name]})
            for sign in (1, -1)
        )
        slopes = (above - below) * side / (2 * levels[name])
        slopes = slopes[np.isfinite(slopes)]
        if slopes.size:
            sign = -1.0 if np.sum(slopes) < 0 else 1.0
            found[name] = sign * float(np.sqrt(np.mean(slopes**2)))
    return found


def _value(node: ast.expr, formula: str, columns: Mapping[str, np.ndarray]) -> np.ndarray:
    match node:
        case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
            return np.float64(number)  # pyright: ignore[reportReturnType]
        case ast.Name(id=name) if name in columns:
            return columns[name]
        case ast.Attribute() if np.ndim(number := columns.get(ast.unparse(node), [])) == 0:
            return np.asarray(number)
        case ast.Name() | ast.Attribute() if ast.unparse(node) not in columns:
            name = ast.unparse(node)[:80]
            raise ModelError(
                f"there is no column or single value '{name}' in the formula {formula[:80]!r}."
            )
        case ast.BinOp(left=left, op=op, right=right) if type(op) in OPERATIONS:
            return OPERATIONS[type(op)](
                _value(left, formula, columns), _value(right, formula, columns)
            )
        case ast.UnaryOp(op=op, operand=operand) if type(op) in OPERATIONS:
            return OPERATIONS[type(op)](_value(operand, formula, columns))
        case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]) if name in FUNCTIONS:
            count = getattr(FUNCTIONS[name], "nin", 1)
            if len(arguments) != count:
                raise ModelError(f"{name} takes {count} argument(s) in {formula[:80]!r}.")
            return FUNCTIONS[name](*(_value(each, formula, columns) for each in arguments))
    piece = (ast.get_source_segment(formula, node) or formula)[:80]
    raise ModelError(
        f"{piece!r} is not allowed in a formula; it may hold numbers, names of columns, + - * / **,"
        f" and {', '.join(FUNCTIONS)}."
    )
