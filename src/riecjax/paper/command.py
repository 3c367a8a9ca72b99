"""`riecjax reproduce`: the paper's tables, figures and statements beside their reproduction."""

import functools
import os
import shutil
from pathlib import Path

import click

from riecjax.cli.options import json_option, out_option, seed_option
from riecjax.runtime import start_jax

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
    from rich.console import Console
    from rich.progress import Progress, TaskID

    from riecjax.models.quarter_car import reconstructed
    from riecjax.paper.charts import study_charts
    from riecjax.paper.claims import evaluate_claims
    from riecjax.paper.report import print_reproduction, reproduction_document, reproduction_page
    from riecjax.paper.study import FULL, QUICK, run_study
    from riecjax.paper.variations import write_variations
    from riecjax.reporting import emit, require_folder

    if out is not None:
        require_folder(out)
    shapes, parts = reconstructed(), None if out is None else out / PARTS
    scale = QUICK if quick else FULL if full else roads or DEFAULT_ROADS
    bars: dict[str, TaskID] = {}
    with Progress(console=Console(stderr=True), transient=True) as bar:

        def report(what: str, done: int, total: int) -> None:
            """A bar for each thing that is computed."""
            if what not in bars:
                bars[what] = bar.add_task(what, total=total)
            bar.update(bars[what], completed=done, total=total)

        study = run_study(scale, jax.random.key(seed), shapes, folder=parts, progress=report)
        report("statements", 0, 1)
        claims = evaluate_claims(study)
    others = {}
    if study.further is not None:
        variations = study.further.variations
        others["variations.parquet"] = functools.partial(write_variations, variations)
    emit(
        reproduction_document(study, claims, seed=seed),
        as_json=as_json,
        out=out,
        show=print_reproduction,
        charts=functools.partial(study_charts, study, shapes),
        page=reproduction_page,
        others=others,
    )
    if study.further is not None and parts is not None:
        shutil.rmtree(parts, ignore_errors=True)
