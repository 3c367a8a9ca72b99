"""`riecjax reproduce`: the paper's tables beside their reproduction."""

from pathlib import Path

import click

from riecjax.cli.options import json_option, out_option, seed_option
from riecjax.cli.runtime import start_jax

DEFAULT_ROADS, QUICK_ROADS, FULL_ROADS = 32, 8, 200


@click.command("reproduce")
@seed_option
@click.option(
    "--roads",
    type=click.IntRange(min=1, max=100_000),
    help=f"Number of random roads. [default: {DEFAULT_ROADS}]",
)
@click.option("--full", is_flag=True, help=f"{FULL_ROADS} roads.")
@click.option("--quick", is_flag=True, help=f"{QUICK_ROADS} roads.")
@json_option
@out_option
def command(
    seed: int, roads: int | None, full: bool, quick: bool, as_json: bool, out: Path | None
) -> None:
    """Reproduce Tables 1, 3, 4 and 5 of Best and Gordon (1999) on simulated roads."""
    if full and quick:
        raise click.UsageError("--full and --quick exclude each other.")
    if roads and (full or quick):
        raise click.UsageError(
            "--roads excludes --full and --quick, which set the number of roads."
        )
    count = roads or (FULL_ROADS if full else QUICK_ROADS if quick else DEFAULT_ROADS)
    start_jax()
    import jax
    from rich.console import Console
    from rich.progress import Progress

    from riecjax.models.quarter_car.reconstruction import quarter_car_source, reconstructed
    from riecjax.paper.reproduction import run_road
    from riecjax.reporting.output import emit
    from riecjax.reporting.reproduction import (
        print_reproduction,
        reproduction_charts,
        reproduction_document,
        reproduction_page,
    )
    from riecjax.studies.monte_carlo import over_keys

    shapes = reconstructed()
    source = quarter_car_source(shapes)
    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("roads", total=count)
        result = over_keys(
            run_road,
            jax.random.key(seed),
            count,
            source,
            shapes,
            progress=lambda done: progress.update(task, completed=done),
        )
    document = reproduction_document(result, seed=seed)
    emit(
        document,
        as_json=as_json,
        out=out,
        show=print_reproduction,
        charts=lambda: reproduction_charts(result, source),
        page=reproduction_page,
    )
