"""One file of the zoo: how it is written, how it is read, and what must come out."""

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
import scipy.interpolate
from tests.machines import DRAG

from riecjax.errors import RiecjaxError
from riecjax.records.record import Record

COUNT, STEP = 801, 0.005
Truth = Mapping[str, np.ndarray]
Texts = dict[str, list[str]]
Form = str | tuple[str, float]
"""Such as `%.3f`, or `("%.3f", 1e-3)` in a unit of this size."""


@functools.cache
def motion() -> Truth:
    """The drag oscillator of the benchmarks at 200 Hz, in SI: `t`, `x`, `dx`, `ddx`, `u`."""
    t = STEP * np.arange(COUNT)
    coarse = DRAG.shape.times
    signals = DRAG.signals().items()
    found = {name: scipy.interpolate.CubicSpline(coarse, v)(t) for name, v in signals}
    m, r, r2, k = DRAG.truth.values()
    x, v, u = found["x"], found["dx"], found["u"]
    return {"t": t, **found, "ddx": (u - r * v - r2 * v * abs(v) - k * x) / m}


def written(**forms: Form) -> tuple[Texts, dict[str, np.ndarray]]:
    """Signals in these forms: texts, and their SI values.

    The truth is what the texts say, so that rounding counts for no error.
    """
    texts, truth = {}, {}
    for name, form in forms.items():
        form, unit = (form, 1.0) if isinstance(form, str) else form
        texts[name] = [form % value for value in motion()[name] / unit]
        if name != "t":
            truth[name] = unit * np.array([float(text) for text in texts[name]])
    return texts, truth


def lines(*columns: Sequence[str], sep: str = ",", end: str = "", decimal: str = ".") -> list[str]:
    """Columns of texts as lines of a table."""
    swap = (lambda text: text.replace(".", decimal)) if decimal != "." else str
    return [sep.join(map(swap, row)) + end for row in zip(*columns, strict=True)]


def save(file: Path, *rows: str, encoding: str = "utf-8", newline: str = "\n") -> None:
    """Write lines."""
    file.write_bytes((newline.join(rows) + newline).encode(encoding))


class Case(NamedTuple):
    """A file and how it is read.

    **Fields:** `follows`, the logger or description; `rename`, as for `--map`; `options` beside
    `--model` and `--map`; `step` in seconds, met to a share of `step_rtol`; `refused`, words of
    the message where refusal is right; `needs`, the package without which it cannot be made.
    """

    name: str
    follows: str
    write: Callable[[Path], Truth | Sequence[Truth]]
    suffix: str
    rename: Mapping[str, str]
    options: tuple[str, ...]
    step: float
    step_rtol: float
    refused: str
    needs: str


CASES: dict[str, Case] = {}


def case(
    suffix: str = ".csv",
    *,
    options: Sequence[str] = (),
    step: float = STEP,
    step_rtol: float = 1e-6,
    refused: str = "",
    needs: str = "",
    **rename: str,
) -> Callable[[Callable[[Path], Truth | Sequence[Truth]]], None]:
    """Register what writes a file and returns its truth; the docstring names the logger."""

    def register(write: Callable[[Path], Truth | Sequence[Truth]]) -> None:
        name, follows = write.__name__, " ".join((write.__doc__ or "").split())
        CASES[name] = Case(
            name, follows, write, suffix, rename, tuple(options), step, step_rtol, refused, needs
        )

    return register


def table(
    *, t: Form | None = "%.3f", x: Form = "%.6f", u: Form = "%.5f", **keywords: Any
) -> Callable[[Callable[[Path, Texts], None]], None]:
    """Register what saves a table of texts in these forms, which are its truth.

    `t=None` leaves the time to whoever saves it; `names` are those for `--map`.
    """
    forms = {"x": x, "u": u} if t is None else {"t": t, "x": x, "u": u}
    names = keywords.pop("names", {})

    def register(write: Callable[[Path, Texts], None]) -> None:
        @functools.wraps(write)
        def wrote(file: Path) -> Truth:
            texts, truth = written(**forms)
            write(file, texts)
            return truth

        case(**keywords, **names)(wrote)

    return register


class Outcome(NamedTuple):
    """`right`, `asked` (refused) or `wrong`, and what was said or differs."""

    kind: str
    said: str = ""


def outcome(one: Case, folder: Path) -> Outcome:
    """Write a case's file, read it as the command line would, and compare."""
    file = folder / (one.name + one.suffix)
    return compared(one, file, one.write(file))


def compared(one: Case, file: Path, truth: Truth | Sequence[Truth]) -> Outcome:
    """What a file is read as, beside the truth."""
    try:
        records = read(file, [*mapped(one.rename), *one.options])
    except (RiecjaxError, click.UsageError) as error:
        rightly = one.refused and one.refused in str(error)
        return Outcome("right" if rightly else "asked", str(error))
    truths = [truth] if isinstance(truth, Mapping) else truth
    if one.refused:
        return Outcome("wrong", f"read, though it cannot be told ({one.refused})")
    if len(records) != len(truths):
        return Outcome("wrong", f"{len(records)} records of {len(truths)}")
    said = filter(None, (difference(r, t, one) for r, t in zip(records, truths, strict=True)))
    return next((Outcome("wrong", text) for text in said), Outcome("right"))


def mapped(rename: Mapping[str, str]) -> list[str]:
    return [word for name, column in rename.items() for word in ("--map", f"{name}={column}")]


def read(file: Path, options: Sequence[str], model: str = "drag-oscillator") -> list[Record]:
    """Records of a file by the options of `riecjax identify`, before velocities are formed."""
    from riecjax.cli.identify import command
    from riecjax.models.catalogue import find_model
    from riecjax.runtime import start_jax

    start_jax()
    with command.make_context("identify", [str(file), "--model", model, *options]) as context:
        # Differences shorten a record; what the file holds is compared.
        plain = dataclasses.replace(find_model(model), derived={})
        return [recording.record for recording in context.params["given"].recordings(plain)]


def difference(record: Record, truth: Truth, one: Case) -> str:
    """What a record says other than the truth: its values, its missing samples, its step."""
    for name, expected in truth.items():
        if name not in record.arrays:
            return f"no {name}; there are {', '.join(record.arrays)}"
        got = record.signal(name).with_nan
        if got.shape != expected.shape:
            return f"{name} has {got.size} samples of {expected.size}"
        if not np.allclose(
            got, expected, rtol=1e-9, atol=1e-12 * np.nanmax(abs(expected)), equal_nan=True
        ):
            return f"{name}: {_first(got, expected)}"
    if abs(float(record.time_step) / one.step - 1) > one.step_rtol:
        return f"time step {float(record.time_step):.9g} s for {one.step:g} s"
    return ""


def _first(got: np.ndarray, expected: np.ndarray) -> str:
    i = int(np.argmax(~np.isclose(got, expected, rtol=1e-9, equal_nan=True)))
    return f"{got[i]:.6g} for {expected[i]:.6g} at sample {i}"
