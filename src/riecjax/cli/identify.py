"""`riecjax identify`: parameters from recordings."""

import contextlib
from collections.abc import Iterator
from pathlib import Path

import click

from riecjax.cli.options import (
    POSITIVE,
    assignments,
    json_option,
    out_option,
    seed_option,
    set_option,
)
from riecjax.cli.runtime import start_jax
from riecjax.errors import DataError, MissingSignalError

DEFAULT_ALPHA, DEFAULT_BETA, DEFAULT_WINDOWS = 0.05, 0.5, 8000


class WindowCount(click.ParamType):
    """A number of random windows."""

    name = "N"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> int:
        if value == "all":
            self.fail("all windows at once are not available yet; give a number.", param, ctx)
        try:
            count = int(str(value))
        except ValueError:
            self.fail(f"'{value}' is not a whole number.", param, ctx)
        if not 1 <= count <= 100_000_000:
            self.fail(f"{count} is not between 1 and 100000000.", param, ctx)
        return count


class Available(click.Choice[str]):
    """A choice of which a part is still to come, and says so."""

    def __init__(self, available: list[str], to_come: list[str]):
        super().__init__([*available, *to_come])
        self.to_come = to_come

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> str:
        chosen = super().convert(value, param, ctx)  # pyright: ignore[reportArgumentType]
        if chosen in self.to_come:
            self.fail(f"'{chosen}' is not available yet.", param, ctx)
        return chosen


@contextlib.contextmanager
def about(file: Path, rename: dict[str, str]) -> Iterator[None]:
    """Name the file in what is said about its record."""
    try:
        yield
    except MissingSignalError as error:
        taken = [new for new, column in rename.items() if column == error.signal]
        if taken:
            raise DataError(
                f"{file.name}: there is no signal '{error.signal}', for --map {taken[0]}="
                f"{error.signal} renamed that column; there are: {', '.join(error.available)}."
            ) from None
        raise DataError(f"{file.name}: {error}") from None
    except DataError as error:
        message = str(error)
        prefix = "" if message.startswith(f"{file.name}: ") else f"{file.name}: "
        raise DataError(prefix + message) from None


@click.command("identify")
@click.argument(
    "files", metavar="RECORD...", nargs=-1, required=True, type=click.Path(path_type=Path)
)
@click.option(
    "--model",
    "model_name",
    required=True,
    help="A built-in model (see 'riecjax models') or path/to/file.py:object.",
)
@click.option(
    "--criterion",
    "criterion_name",
    type=click.Choice(["riec", "dols"]),
    default="riec",
    show_default=True,
    help="Windowed integrals of the equation of motion, or the equation at every sample.",
)
@click.option(
    "--alpha",
    type=POSITIVE,
    help=f"Shortest window in s: half a period of the fastest motion modelled. "
    f"[default: {DEFAULT_ALPHA}]",
)
@click.option(
    "--beta",
    type=POSITIVE,
    help=f"Longest window in s: half a period of the slowest motion modelled. "
    f"[default: {DEFAULT_BETA}]",
)
@click.option(
    "--windows",
    "count",
    type=WindowCount(),
    help=f"Number of random windows. [default: {DEFAULT_WINDOWS}]",
)
@click.option(
    "--test-function",
    type=Available(["boxcar"], ["hat", "bump"]),
    default="boxcar",
    show_default=True,
    help="Weight inside a window.",
)
@click.option(
    "--refine",
    type=Available(["none"], ["integral", "output-error"]),
    default="none",
    show_default=True,
    help="Non-linear refinement after the linear estimate.",
)
@assignments("--map", str, "SIGNAL=COLUMN", "Call a column by the model's name.", "rename")
@assignments("--scale", float, "COLUMN=FACTOR", "Convert a column to SI units.", "scale")
@assignments(
    "--low-pass",
    float,
    "SIGNAL=HZ",
    "Filter a signal first: zero-phase 4th-order Butterworth.",
    "cutoffs",
)
@click.option(
    "--every",
    type=click.IntRange(min=1),
    default=1,
    show_default=True,
    help="Use every N-th sample, after filtering and differentiation.",
)
@set_option
@seed_option
@json_option
@out_option
def command(
    files: tuple[Path, ...],
    model_name: str,
    criterion_name: str,
    alpha: float | None,
    beta: float | None,
    count: int | None,
    test_function: str,
    refine: str,
    rename: dict[str, str],
    scale: dict[str, float],
    cutoffs: dict[str, float],
    every: int,
    known: dict[str, float],
    seed: int,
    as_json: bool,
    out: Path | None,
) -> None:
    """Identify a model's parameters from one or several recordings (CSV, NPZ or MAT).

    A recording holds time `t` in seconds and the model's signals in SI units, evenly sampled.
    """
    if criterion_name == "dols" and (alpha or beta or count):
        raise click.UsageError("--alpha, --beta and --windows belong to --criterion riec.")
    start_jax()
    import jax

    from riecjax.criteria.criterion import DOLS, RIEC
    from riecjax.criteria.windows import RandomWindows
    from riecjax.estimation.identify import identify, signals_read
    from riecjax.models.preparation import Preparation, prepare
    from riecjax.models.resolve import find_model
    from riecjax.records.reading.read import read_record
    from riecjax.reporting.identification import (
        identification_document,
        identification_figures,
        print_identification,
    )
    from riecjax.reporting.output import emit

    model = find_model(model_name)
    procedure = model.build_procedure()
    if criterion_name == "riec":
        criterion = RIEC(
            RandomWindows(
                DEFAULT_ALPHA if alpha is None else alpha,
                DEFAULT_BETA if beta is None else beta,
                DEFAULT_WINDOWS if count is None else count,
            )
        )
    else:
        criterion = DOLS()
    settings = Preparation(cutoffs, every)
    records = []
    for file in files:
        with about(file, rename):
            record = read_record(file, rename=rename, scale=scale)
            record = prepare(record, model, settings)
            signals_read(procedure, record, criterion)
            records.append(record)
    key = jax.random.key(seed)
    estimate = identify(procedure, records, criterion, key=key, known=known)
    document = identification_document(
        estimate,
        model.name,
        files=files,
        records=records,
        seed=seed,
        steps=settings.describe(model),
    )
    emit(
        document,
        as_json=as_json,
        out=out,
        show=print_identification,
        figures=lambda: identification_figures(estimate, procedure, records, key),
        title=f"{model.name} from {', '.join(file.name for file in files)}",
    )
