"""What is kept of an output, and how two of them differ."""

import json
import math
import re
from collections.abc import Collection, Iterator, Mapping
from typing import Any, TypeGuard

import numpy as np

LONGEST = 8
"""Numbers of a list that are kept one by one; of longer ones, what tells them apart."""
VALUE, SCALE, MOMENTS = 1e-6, 1e-6, 1e-12
"""Accepted: of a value in its standard errors; of other numbers as a share of themselves, or of the
largest of their kind; of moments as a share of their diagonal."""
NOUGHT = 1e-12
"""Beside numbers of order one, as correlations and shares are, what rounding leaves of zero."""
VOLATILE = ("riecjax", "jax", "jaxlib", "numpy", "python", "platform", "version", "versions",
            "seconds", "duration_s", "sha256", "digest", "created", "started", "host",
            "machine", "bytes", "command", "checksum", "folder", "processor", "device")  # fmt: skip
"""Keys of a document whose content depends on the machine, the day or the version."""
EXACT = 1e-6
"""Residual, as a share of the target, below which it is rounding of the moments, and with it what
is made of it, `OF_RESIDUAL`: neither is compared."""
OF_RESIDUAL = ("residual", "naive_std_error", "effective_windows")
NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w]*\.?\d)", re.IGNORECASE)


def condensed(document: Any, path: str = "") -> Any:
    """A document without what is volatile, its long lists of numbers as a few of their sums."""
    if isinstance(document, dict):
        return {k: condensed(v, f"{path}.{k}") for k, v in document.items() if k not in VOLATILE}
    if not isinstance(document, list):
        return document
    numbers = _numbers(document)
    if numbers is None or numbers.size <= LONGEST:
        return [condensed(entry, path) for entry in document]
    flat = numbers.ravel()
    finite = np.where(np.isfinite(flat), flat, 0.0)
    # The same two directions for every list of one length: an entry that moves, or two that are
    # exchanged, move the projections.
    draws = np.random.default_rng(flat.size).standard_normal((2, flat.size))
    return {
        "numbers": list(numbers.shape),
        "missing": int(flat.size - np.isfinite(flat).sum()),
        "mean": float(finite.mean()),
        "rms": float(np.sqrt(np.mean(finite**2))),
        "first": float(finite[0]),
        "last": float(finite[-1]),
        "projections": [float(p) for p in draws @ finite / math.sqrt(flat.size)],
    }


def _numbers(entries: list[Any]) -> np.ndarray | None:
    """A list of numbers, or of equally long lists of them, as an array; `None` where it is none."""
    flat, shapes = [], set()
    for entry in entries:
        row = entry if isinstance(entry, list) else [entry]
        if not all(v is None or (isinstance(v, int | float) and type(v) is not bool) for v in row):
            return None
        flat.append([math.nan if v is None else float(v) for v in row])
        shapes.add((isinstance(entry, list), len(row)))
    if len(shapes) != 1 or all(v != v for row in flat for v in row):
        return None
    array = np.array(flat)
    return array if isinstance(entries[0], list) else array[:, 0]


def differences(approved: Any, output: Any) -> Iterator[str]:
    """Each difference between two condensed documents: where, before, after, how large."""
    if max(_residual(approved), _residual(output)) < EXACT:
        approved, output = (_without(OF_RESIDUAL, one) for one in (approved, output))
    yield from _compared(approved, output, "", None)


def _residual(kept: Any) -> float:
    """The share of the target that is left, in a document or what is kept of an output."""
    document = (kept.get("document") or kept) if isinstance(kept, dict) else {}
    residual = document.get("residual") if isinstance(document, dict) else None
    return residual.get("relative_rms", math.inf) if isinstance(residual, dict) else math.inf


def _without(keys: Collection[str], entry: Any) -> Any:
    if isinstance(entry, dict):
        return {k: _without(keys, v) for k, v in entry.items() if k not in keys}
    return [_without(keys, v) for v in entry] if isinstance(entry, list) else entry


def _compared(old: Any, new: Any, path: str, unit: float | None) -> Iterator[str]:
    if isinstance(old, dict) and isinstance(new, dict):
        if set(old) >= {"numbers", "projections"} <= set(new):
            yield from _of_lists(old, new, path)
            return
        if _is_number(old.get("std_error")):
            unit = abs(old["std_error"])
        for key in dict.fromkeys([*old, *new]):
            where = f"{path}.{key}" if path else key
            if key not in new:
                yield f"{where}: {_short(old[key])} -> (gone)"
            elif key not in old:
                yield f"{where}: (none) -> {_short(new[key])}"
            else:
                in_errors = unit if key in ("value", "interval95") else None
                yield from _compared(old[key], new[key], where, in_errors)
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for i, (one, other) in enumerate(zip(old, new)):
            yield from _compared(one, other, f"{path}[{i}]", unit)
    elif _is_number(old) and _is_number(new):
        if unit is not None and not abs(new - old) <= VALUE * unit:
            errors = (new - old) / unit
            yield f"{path}: {old:.12g} -> {new:.12g} ({errors:+.3g} standard errors)"
        elif unit is None and not _near(old, new, max(abs(old), NOUGHT / SCALE)):
            share = (new - old) / abs(old) if old else math.inf
            yield f"{path}: {old:.12g} -> {new:.12g} ({share:+.3g} of itself)"
    elif isinstance(old, str) and isinstance(new, str):
        yield from text_differences(old, new, path)
    elif old != new:
        yield f"{path}: {_short(old)} -> {_short(new)}"


def _of_lists(old: Mapping[str, Any], new: Mapping[str, Any], path: str) -> Iterator[str]:
    if old["numbers"] != new["numbers"] or old["missing"] != new["missing"]:
        yield (
            f"{path}: {old['numbers']} numbers, {old['missing']} missing -> "
            f"{new['numbers']}, {new['missing']}"
        )
        return
    for key in ("mean", "rms", "first", "last", "projections"):
        pairs = zip(np.atleast_1d(old[key]), np.atleast_1d(new[key]))
        for one, other in pairs:
            if not _near(one, other, max(old["rms"], NOUGHT / SCALE)):
                yield f"{path}: {key} of {old['numbers']} numbers {one:.10g} -> {other:.10g}"
                return


def _near(old: float, new: float, scale: float) -> bool:
    return old == new or (old != old and new != new) or abs(new - old) <= SCALE * scale


def _is_number(entry: Any) -> TypeGuard[float]:
    return isinstance(entry, int | float) and type(entry) is not bool


def _short(entry: Any) -> str:
    text = json.dumps(entry)
    return text if len(text) <= 120 else text[:117] + "..."


def text_differences(old: str, new: str, path: str = "") -> Iterator[str]:
    """Lines that differ by more than the last printed digit of their numbers."""
    before, after = old.splitlines(), new.splitlines()
    if len(before) != len(after):
        only = [f"  - {line}" for line in before if line not in after]
        only += [f"  + {line}" for line in after if line not in before]
        yield "\n".join([f"{path}: {len(before)} lines -> {len(after)} lines", *only])
        return
    for i, (one, other) in enumerate(zip(before, after)):
        if not _same_line(one, other):
            where = f"{path} line {i + 1}" if len(before) > 1 else path
            yield f"{where}:\n  - {one}\n  + {other}"


def _same_line(old: str, new: str) -> bool:
    if old == new:
        return True
    # Digits move columns of a table.
    words = [" ".join(NUMBER.sub("#", line).split()) for line in (old, new)]
    numbers = [NUMBER.findall(line) for line in (old, new)]
    return words[0] == words[1] and all(map(_same_printed, *numbers))


def _same_printed(old: str, new: str) -> bool:
    digit = max(_last_digit(old), _last_digit(new))
    return abs(float(old) - float(new)) <= 1.0001 * digit


def _last_digit(text: str) -> float:
    """One unit of a printed number's last digit; whole numbers that may be counts are exact."""
    mantissa, _, power = text.lower().partition("e")
    whole, _, decimals = mantissa.partition(".")
    if not decimals and not power:
        # A value of six significant digits shows no decimals either.
        return 1.0 if len(whole.strip("+-")) >= 5 else 0.0
    return 10.0 ** (int(power or 0) - len(decimals))


def moment_differences(
    old: Mapping[str, Any], new: Mapping[str, Any], path: str = ""
) -> Iterator[str]:
    """Entries of Gram matrices that differ by more than rounding, as a share of their diagonal."""
    if {k: v for k, v in old.items() if k != "moments"} != {
        k: v for k, v in new.items() if k != "moments"
    }:
        yield f"{path}: parameters or number of rows differ"
        return
    before, after = np.array(old["moments"]), np.array(new["moments"])
    size = np.sqrt(np.outer(np.diag(before), np.diag(before)))
    for i, j in np.argwhere(~(abs(after - before) <= MOMENTS * size)):
        names = ["y", *old["parameters"]]
        share = (after - before)[i, j] / size[i, j]
        yield (
            f"{path} [{names[i]}, {names[j]}]: {before[i, j]:.17g} -> {after[i, j]:.17g} "
            f"({share:+.3g} of the diagonal)"
        )


def merged(old: Any, new: Any, unit: float | None = None) -> Any:
    """The new output, with the old numbers where they are as good: diffs show what moved.

    **Arguments:** `unit`: the standard error that numbers are of.
    """
    if not any(True for _ in _compared(old, new, "", unit)):
        return old
    if isinstance(old, dict) and isinstance(new, dict) and "projections" not in new:
        unit = abs(old["std_error"]) if _is_number(old.get("std_error")) else unit
        units = dict.fromkeys(("value", "interval95"), unit)
        return {k: merged(old[k], v, units.get(k)) if k in old else v for k, v in new.items()}
    if isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        return [merged(one, other, unit) for one, other in zip(old, new)]
    return new
