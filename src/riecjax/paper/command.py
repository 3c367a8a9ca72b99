"""`riecjax reproduce`: the paper's tables, figures and statements beside their reproduction."""

import functools
import os
import shutil
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from riecjax.cli.options import json_option, out_option, seed_option
from riecjax.runtime import start_jax
from riecjax.whole_files import stamp

if TYPE_CHECKING:
    from collections.abc import Iterator

    from riecjax.paper.study import Progress as Report

DEFAULT_ROADS = 32
PARTS = "variations.parts"
"""Folder of what is finished of an interrupted study, inside the one of --out."""


@click.command("reproduce", short_help="Repeat the study of Best and Gordon (1999).")
@seed_option
@click.option(
    "--roads",
    type=click.IntRange(min=1, max=100_000),
    help=f"Number of random roads behind the tables. [default: {DEFAULT_ROADS}]",
)
@click.option("--full", is_flag=True, help="The whole study: every table, figure and statement.")
@click.option("--quick", is_flag=True, help="The whole study on few roads, in about a minute.")
@json_option
@out_option
def command(
    seed: int, roads: int | None, full: bool, quick: bool, as_json: bool, out: Path | None
) -> None:
    """Reproduce Best and Gordon (1999) on simulated roads.

    Without --full or --quick: Tables 1, 3, 4 and 5, and the statements that they decide. A study
    with --out that is interrupted goes on where it was when it is started again.
    """
    if roads and (full or quick):
        raise click.UsageError(
            "--roads excludes --full and --quick, which set the number of roads."
        )
    start_jax(keep_compiled=True, devices=os.cpu_count() or 1)
    import jax

    from riecjax.models.quarter_car.reconstruction import quarter_car_source, reconstructed
    from riecjax.paper.claims import table_claims
    from riecjax.paper.reproduction import run_road
    from riecjax.paper.study import FULL, QUICK, evaluate_claims, run_study
    from riecjax.paper.variations import write_variations
    from riecjax.reporting.output import emit
    from riecjax.reporting.paper_charts import study_charts, table_charts
    from riecjax.reporting.reproduction import (
        print_reproduction,
        reproduction_document,
        reproduction_page,
    )
    from riecjax.studies.monte_carlo import over_keys

    shapes, key = reconstructed(), jax.random.key(seed)
    parts = None if out is None else out / PARTS
    others: dict[str, Callable[[Path], None]] = {}
    with _progress() as report:
        if full or quick:
            scale = QUICK if quick else FULL
            study = run_study(scale, key, shapes, folder=parts, progress=report)
            report("statements", 0, 1)
            results, claims = study.roads, evaluate_claims(study)
            charts = functools.partial(study_charts, study, shapes)
            others["variations.parquet"] = lambda file: write_variations(
                study.table, file, stamp(file)
            )
        else:
            scale, count = None, roads or DEFAULT_ROADS
            results = over_keys(
                run_road,
                key,
                count,
                quarter_car_source(shapes),
                shapes,
                progress=lambda done: report("roads", done, count),
            )
            claims = table_claims(results)
            charts = functools.partial(table_charts, results, shapes)
    emit(
        reproduction_document(results, claims, seed=seed, scale=scale),
        as_json=as_json,
        out=out,
        show=print_reproduction,
        charts=charts,
        page=reproduction_page,
        others=others,
    )
    if scale is not None and parts is not None:
        shutil.rmtree(parts, ignore_errors=True)


@contextmanager
def _progress() -> "Iterator[Report]":
    """A bar for each thing that is computed, on standard error."""
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as progress:
        tasks = {}

        def report(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = progress.add_task(what, total=total)
            progress.update(tasks[what], completed=done, total=total)

        yield report
