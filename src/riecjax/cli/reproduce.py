"""`riecjax reproduce`: the paper's tables, figures and statements beside their reproduction."""

import os
import shutil
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
    if full or quick:
        _study(seed, quick, as_json, out)
    else:
        _tables(seed, roads or DEFAULT_ROADS, as_json, out)


def _tables(seed: int, count: int, as_json: bool, out: Path | None) -> None:
    import jax

    from riecjax.models.quarter_car.reconstruction import quarter_car_source, reconstructed
    from riecjax.paper.claims import table_claims
    from riecjax.paper.reproduction import run_road
    from riecjax.reporting.output import emit
    from riecjax.reporting.paper_charts import table_charts
    from riecjax.reporting.reproduction import (
        print_reproduction,
        reproduction_document,
        reproduction_page,
    )
    from riecjax.studies.monte_carlo import over_keys

    shapes = reconstructed()
    with _progress() as report:
        roads = over_keys(
            run_road,
            jax.random.key(seed),
            count,
            quarter_car_source(shapes),
            shapes,
            progress=lambda done: report("roads", done, count),
        )
    emit(
        reproduction_document(roads, table_claims(roads), seed=seed),
        as_json=as_json,
        out=out,
        show=print_reproduction,
        charts=lambda: table_charts(roads, shapes),
        page=reproduction_page,
    )


def _study(seed: int, quick: bool, as_json: bool, out: Path | None) -> None:
    import jax

    from riecjax.models.quarter_car.reconstruction import reconstructed
    from riecjax.paper.study import FULL, QUICK, evaluate_claims, run_study
    from riecjax.paper.variations import write_variations
    from riecjax.reporting.output import emit
    from riecjax.reporting.paper_charts import study_charts
    from riecjax.reporting.reproduction import (
        print_reproduction,
        reproduction_document,
        reproduction_page,
    )

    scale = QUICK if quick else FULL
    shapes = reconstructed()
    parts = None if out is None else out / PARTS
    with _progress() as report:
        study = run_study(scale, jax.random.key(seed), shapes, folder=parts, progress=report)
        report("statements", 0, 1)
        claims = evaluate_claims(study)
    emit(
        reproduction_document(study.roads, claims, seed=seed, scale=scale),
        as_json=as_json,
        out=out,
        show=print_reproduction,
        charts=lambda: study_charts(study, shapes),
        page=reproduction_page,
        others={
            "variations.parquet": lambda file: write_variations(study.table, file, stamp(file))
        },
    )
    if parts is not None:
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
